"""Whether the fitted cooling of the cells has a trend along the coolant, which shows a wrong coolant in the model file.

With a wrong flow or medium (C_f), the coolant of the model warms too little or too much from cell to cell. A fit
compensates for it by an R_u that grows or falls along the string, beyond the file's tolerance from cell to cell.
"""

from collections.abc import Iterator

import numpy as np

from bms_gateway.identify.map_fit import MapFit, stacked

BEYOND = 4.0
"""Least trend of R_u along the coolant, in standard deviations. With the right coolant and one of five strong effects
missing it reached 3.7 in 15 simulated strings; with thirty times the flow and no effect missing, 3.9 to 6.5."""


def trend(fit: MapFit) -> tuple[float, float]:
    """Return the trend of R_u along the coolant.

    Returns
    -------
    growth : float
        Of R_u from the first to the last sensed cell, relative.
    z : float
        The same in sd of the tolerance, over the error in units of the noise, because a model error changes the
        numbers. 0 if the tolerance is zero, or fewer than two cells have a sensor.
    """
    problem = fit.problem
    cells = sorted({k for m in problem.records for kind, k in m.channels if kind == "surface"})
    at = {c.name: i for i, c in enumerate(problem.nuisances)}
    own = [(k, at[f"R_u[{k}]"]) for k in cells if f"R_u[{k}]" in at]
    if len(own) < 2:
        return 0.0, 0.0
    place = np.array([float(k) for k, _ in own])
    place -= place.mean()
    nu, sd = fit.nu[[i for _, i in own]], fit.linear.sd[[i for _, i in own]]
    slope, scatter = float(place @ nu), float(np.sqrt(np.square(place * sd).sum()))
    missed = float(np.sqrt(np.mean(np.square(fit.r[stacked(problem)[4]]))))
    return slope / float(place @ place) * float(np.ptp(place)), slope / scatter / max(missed, 1.0)


def coolant_doubts(fit: MapFit) -> Iterator[str]:
    """Say that the coolant of the model file must be checked; nothing without a trend of the cells' cooling."""
    model = fit.problem.model
    if not model.has_coolant_path:
        return
    growth, z = trend(fit)
    if abs(z) <= BEYOND:
        return
    C_f = float(np.mean(model.priors["C_f"].value))
    way, than = ("grows", "more") if growth > 0.0 else ("falls", "less")
    yield (
        f"R_u {way} along the coolant by {100.0 * abs(growth):.0f} %, {abs(z):.1f} sd of what the model file allows by "
        f"chance: the surfaces rise along the string {than} than its coolant has it. Check the coolant's flow and "
        f"medium: C_f = {C_f:.4g} W/K in the file."
    )
