"""Windows made up from known numbers: what a fit would say of a string whose state is known."""

from dataclasses import replace

import numpy as np

from bms_gateway.health.window_fit import Observed

SD = (0.03, 0.05, 0.05, 0.05, 0.05)


def observed(rng=None, *, growth=0.0, cooling=0.0, drift=(0.0, 0.0), B=2500.0, job_B=2500.0, core=30.0, soc=0.5,
             flow=1.0, level=0.0, scale=1.0) -> Observed:  # fmt: skip
    """One window; ln R_e and ln R_u over the commissioned ones, drifts in K."""
    warmth = 1.0 / (core + 273.15) - 1.0 / 298.15
    mean = np.zeros(5 + len(drift))
    mean[0] = level + growth + (B - job_B) * warmth
    mean[1] = cooling - 0.5 * np.log(flow)
    mean[5:] = drift
    sd = scale * np.array([*SD, *[0.1] * len(drift)])
    if rng is not None:
        mean = mean + rng.normal(0.0, sd)
    by_B = np.array([-warmth, *np.zeros(len(mean) - 1)])
    return Observed(mean, np.diag(sd**2), job_B, by_B, warmth, core, soc, flow, 0.1, 0.02)


HEAT = np.array([1.0, -1.0, -1.0, 1.0, 1.0])
"""What a window takes for another scale of heat: R_e, C_c, C_s up, R_u, R_c down; its surfaces are the same."""


def unsure_of_heat(rng, sd=0.13, **more) -> Observed:
    """One window whose scale of heat is known to `sd` only, as one drive tells it."""
    seen = observed(rng, **more)
    along = np.append(HEAT, np.zeros(len(seen.mean) - len(HEAT)))
    return replace(seen, mean=seen.mean + rng.normal(0.0, sd) * along, cov=seen.cov + sd**2 * np.outer(along, along))
