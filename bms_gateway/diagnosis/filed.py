"""A filed model compared with records: only what belongs to each record is fitted.

Start, offsets of thermocouples and inlet, and delays of the inputs belong to a record, and no file contains them. They
are found as in a refit: with a model error if the model does not follow the surfaces. So the numbers of a fit, read
from their file, give the error of that fit, and every change by a refit comes from the numbers.
"""

from collections.abc import Sequence
from dataclasses import replace

from bms_gateway.diagnosis.model_error import Bench, ModelError, averaged
from bms_gateway.diagnosis.model_error import fit as fit_with_error
from bms_gateway.diagnosis.record import in_held_out
from bms_gateway.diagnosis.residuals import structured
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.likelihood import generalised
from bms_gateway.identify.map_fit import TO_THE_END, MapFit, fitted, stacked
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import StringModel

OF_A_RECORD = ("surface_offset_K", "inlet_offset_K")
"""Tolerances that belong to a record and not to the string."""


def as_filed(model: StringModel) -> StringModel:
    """Return the model with all its numbers exact; what belongs to a record stays free."""
    return replace(
        model,
        priors={name: replace(p, rel_sd=0.0) for name, p in model.priors.items()},
        effects=tuple(replace(e, sd=dict.fromkeys(e.values, 0.0)) for e in model.effects),
        tolerances={name: sd if name in OF_A_RECORD else 0.0 for name, sd in model.tolerances.items()},
    )


def filed_fit(model: StringModel, records: Sequence[Measured], *, model_error: bool) -> MapFit:
    """Compare the numbers of a model, as they are, with records.

    Parameters
    ----------
    model : StringModel
    records : sequence of Measured
    model_error : bool
        Whether a refit to these records allows for a model error; if the numbers leave structure in the readings, it is
        always allowed for.
    """
    exact = as_filed(model)
    if not model_error:
        fit = fitted(Problem(exact, records))
        if not structured(fit):
            return fit
    bench = bench_of(exact, records)
    problem = Problem(exact, bench.records, bench.beliefs)
    return seen_on(fit_with_error(bench, problem, problem.begin, TO_THE_END).map, records)


def bench_of(model: StringModel, records: Sequence[Measured]) -> Bench:
    """Average records for fits with a model error; the same blocks are held out."""
    settings = ModelError().fine if model.effects else ModelError()
    return Bench([held_out(averaged(m, settings)) for m in records], settings)


def seen_on(fit: MapFit, records: Sequence[Measured]) -> MapFit:
    """Compare the numbers of a fit with other readings of its records: prediction and residual."""
    problem = Problem(fit.problem.model, records, fit.problem.beliefs)
    prediction = problem.predict(fit.theta, nu=fit.nu)
    y, _, sigma0, step, _ = stacked(problem)
    r, _ = generalised(y - prediction.y, sigma0, step)
    return replace(fit, problem=problem, prediction=prediction, r=r, noise=None)


def held_out(m: Measured) -> Measured:
    """Mark the averaged readings in the held-out blocks of every record."""
    at = m.row + m.share
    return replace(m, used=~in_held_out(at / max(float(at.max()), 1.0)))
