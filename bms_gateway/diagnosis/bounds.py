"""Numbers of an effect that a fit left at their bound: they do not prove the effect, even if they fit well."""

from math import nan

import numpy as np

from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.weighing import Trial
from bms_gateway.identify.map_fit import MapFit


def at_bound(fit: MapFit, c: Candidate) -> str:
    """Say which number of an effect ends at a bound at which it does not vanish; empty if none does."""
    free = {x.name: float(z) for x, z in zip(fit.problem.coordinates, fit.theta, strict=True)}
    for p in c.effect.parameters:
        name = f"{c.key}.{p.name}"
        if name not in free or not fit.at_bound(name):
            continue
        value = float(np.exp(free[name])) if p.log else free[name]
        if value != p.neutral:
            unit = "" if p.unit == "1" else f" {p.unit}"
            return f"{p.description} ({p.name}) ends at its bound, {value / p.to_si:.4g}{unit}"
    return ""


def believed_share(t: Trial) -> tuple[float, str]:
    """Probability of a trial, and why it is refused; NaN if one of its numbers is at its bound."""
    said = at_bound(t.fit, t.candidate)
    return (nan, "; ".join(filter(None, (t.why, f"{said}: no proof")))) if said else (t.share, t.why)
