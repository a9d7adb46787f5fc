"""Errors of the numbers of a fit, in sd."""

import numpy as np

from bms_gateway.diagnosis.core_band import posterior

NAMES = ("R_c", "R_u")
"""Their truth does not hang on where the law of R_e is stated."""


def off(fit, log):
    """Errors of a fit's numbers, in sd."""
    sd = np.sqrt(np.diag(posterior(fit)))
    found = []
    for name in NAMES:
        i = fit.problem.index(name)
        nominal = np.mean(np.log(fit.problem.model.priors[name].value))
        found.append((nominal + fit.theta[i] - np.mean(np.log(log.pack[name]))) / sd[i])
    return found
