"""Uncertainty of a fit's numbers in pairs: the page draws the contours of any two of them.

The posterior is treated as a Gaussian of the fit's coordinates. Most of these are logarithms, so a contour of the
numbers themselves is an ellipse that is bent if they are uncertain.
"""

from typing import Any

import numpy as np

from bms_gateway.diagnosis.core_band import posterior
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.report.core_text import wider_than_known
from bms_gateway.report.html_correlation import shown
from bms_gateway.report.html_tables import called, shown_as
from bms_gateway.report.words import in_words, parameters_labelled


def known(fit: MapFit) -> dict[str, Any]:
    """Return each number of a fit except the starts, with its prior, and the covariance of all.

    A number is `scale` times its coordinate, or times its exponential if `log` is set. `wider` names those that the fit
    leaves wider than they were known before, and says why.
    """
    at = shown(fit)
    numbers = []
    for i in at:
        c = fit.problem.coordinates[i]
        plain = shown_as(c, fit.problem.model)
        numbers.append(
            {
                "key": c.name,
                "name": called(c),
                "unit": plain.unit,
                "scale": _short(plain.scale),
                "log": plain.log,
                "at": _short(float(fit.theta[i])),
                "before": [_short(c.prior), _short(c.sd)],
            }
        )
    covariance = [list(map(_short, row)) for row in posterior(fit)[np.ix_(at, at)]]
    return {"numbers": numbers, "covariance": covariance, "wider": in_words(parameters_labelled(wider_than_known(fit)))}


def _short(x: float) -> float:
    return float(f"{x:.7g}")
