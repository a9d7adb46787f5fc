"""The entropic coefficient over the state of charge as a curve with a band, to be compared with a calorimetric curve.

The effect itself has a level and four knots, which is enough to find it and to predict with it. After it is found, a
last fit to all readings lets the curve differ from the lines between the knots, as much as dU/dT of real electrodes
does, with all other numbers free. Two sets of R_e, R_c and R_u can explain one surface (Lin et al., Eq 9), especially
if R_c is greater than R_u. Heat and curve have another scale in each set. So the fit starts from two points, and the
curve is the mean of both results, weighted by their evidence. The band is that of the posteriors, widened by the Birge
ratio of the strain, and by the distance of the results. An uncertain level of the charge shifts the curve, which adds
its sd times the slope.
"""

from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.diagnosis.adding_bench import all_used
from bms_gateway.diagnosis.core_band import posterior
from bms_gateway.diagnosis.model_error import Bench, ModelError
from bms_gateway.diagnosis.model_error import fit as fit_with_error
from bms_gateway.diagnosis.witness import strain_of
from bms_gateway.identify.map_fit import FitEffort, FitStart, MapFit, fitted, map_fit
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import AddedEffect, Floats
from bms_gateway.thermal.effects.entropic_curve import FINE, SHAPES, EntropicCurve
from bms_gateway.thermal.effects.entropic_heat import KNOTS
from bms_gateway.thermal.effects.laws import by_knots

TEMPERED = 5.0
"""Factor on the evidence between the two results, because the model error is greater than the noise of the readings."""
EFFORT = FitEffort(iterations=30)
LOADED = 0.05
"""Least share of the greatest current with which a record determines the coefficient at its charge."""


@dataclass(frozen=True, slots=True)
class Curve:
    """A coefficient over the state of charge.

    Attributes
    ----------
    effect : str
        Key, as in model files.
    unit : str
    soc, value, sd : ndarray (K,)
        Charges that the records cover, 5 % apart; values in this unit.
    """

    effect: str
    unit: str
    soc: Floats
    value: Floats
    sd: Floats


def entropic_curve(found: MapFit, charge_sd: float = 0.0, error: ModelError | None = None) -> Curve | None:
    """Compute dU/dT over the state of charge from a fit with `entropic_heat`.

    Parameters
    ----------
    found : MapFit
    charge_sd : float
        sd of the level of the charge, 0…1.
    error : ModelError, optional
        Model error with which the fit was made; None if its noise is that of the thermocouples.

    Returns
    -------
    Curve or None
        In mV/K; None without the effect, or if it has only a level.
    """
    if not any(c.name.startswith("entropic_heat.dUdT_") for c in found.problem.coordinates):
        return None
    fits = _with_curve(found, error)
    evidence = np.array([f.log_evidence for f in fits])
    weight = np.exp((evidence - evidence.max()) / TEMPERED)
    weight /= weight.sum()
    values, variances = (np.stack(x) for x in zip(*map(_of, fits), strict=True))
    value = weight @ values
    variance = weight @ (variances + np.square(values - value))
    there = _visited(fits[0])
    soc, value, variance = FINE[there], 1e3 * value[there], 1e6 * variance[there]
    return Curve("entropic_heat", "mV/K", soc, value, np.sqrt(variance + (charge_sd * np.gradient(value, soc)) ** 2))


def _of(fit: MapFit) -> tuple[Floats, Floats]:
    """Return the curve at `FINE`, V/K, and its variance."""
    names = [c.name for c in fit.problem.coordinates]
    E = np.stack([_shape(name) for name in names], axis=1)
    P = len(names)
    square, freedom = strain_of(fit)
    # numbers too far from their priors show a model error, which widens the band
    birge = max(1.0, square / max(freedom, 1))
    return E @ fit.theta, birge * np.einsum("kp,pq,kq->k", E, posterior(fit)[:P, :P], E)


def _with_curve(found: MapFit, error: ModelError | None) -> list[MapFit]:
    """Fit all readings with a free curve: from the found numbers, and from the priors."""
    shapes = EntropicCurve.parameters
    free = AddedEffect(EntropicCurve.name, None, {p.name: 0.0 for p in shapes}, {p.name: p.sd for p in shapes})
    model = replace(found.problem.model, effects=(*found.problem.model.effects, free))
    records = all_used(found.problem.records)
    problem = Problem(model, records, found.problem.beliefs)
    if error is not None:
        theta, bench = np.concatenate([found.theta, np.zeros(len(shapes))]), Bench(records, error)
        on = fit_with_error(bench, problem, theta, EFFORT, guess=found.prediction.X)
        return [on.map, fit_with_error(bench, problem, problem.begin, EFFORT).map]
    # from the priors, because the lines between knots have biased the other numbers
    return [fitted(problem), map_fit(problem, FitStart(problem.begin))]


def _shape(name: str) -> Floats:
    """Return the derivative of the curve at `FINE` by a number of the fit, V/K per unit."""
    effect, _, number = name.partition(".")
    if effect == "entropic_heat":
        knot = number.rpartition("_")[2]
        return (
            by_knots(FINE, KNOTS, np.eye(len(KNOTS))[int(knot) - 1].tolist()) if knot.isdigit() else np.ones(len(FINE))
        )
    if effect == EntropicCurve.name:
        return np.asarray(SHAPES[int(number.removeprefix("a_")) - 1])
    return np.zeros(len(FINE))


def _visited(fit: MapFit) -> np.ndarray:
    """Which of `FINE` lie at charges at which some record has a current."""
    step = float(FINE[1] - FINE[0])
    there = np.zeros(len(FINE), np.bool_)
    for m in fit.problem.records:
        soc = m.drive.soc[np.abs(m.drive.I) > LOADED * np.sqrt(m.drive.I2.max())]
        if len(soc):
            there |= (soc.min() - step / 2.0 <= FINE) & (soc.max() + step / 2.0 >= FINE)
    return there
