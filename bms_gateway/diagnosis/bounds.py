"""Numbers of an effect that do not prove it, however well they fit: at their bound, or below what a body can have."""

import numpy as np

from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.residuals import structure
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.thermal.effects import EffectParameter, effect_named

CERTAIN = 2.0
"""Standard deviations by which a number must lie below its least value to exclude the effect."""

NEAR_ZERO = 1e-3
"""Number in its own unit (s, mΩ, W/K …) below which no reading shows its size."""


def at_bound(fit: MapFit, c: Candidate) -> str:
    """Say which number of an effect ends at a bound at which it does not vanish; empty if none does."""
    free = {x.name: float(z) for x, z in zip(fit.problem.coordinates, fit.theta, strict=True)}
    for p in c.effect.parameters:
        name = f"{c.key}.{p.name}"
        if name not in free or not fit.at_bound(name):
            continue
        value = float(np.exp(free[name])) if p.log else free[name]
        if value != p.neutral:
            return f"{p.description} ({p.name}) ends at its bound, {_shown(p, value, 4)}"
    return ""


def below_least(fit: MapFit, only: Candidate | None = None) -> str:
    """Say which number of a fit's effects (or of one) is certainly below what a body can have; empty if none is.

    Two effects that look alike can fit together with a negative conductance of one, which the other makes up for.
    """
    for i, (c, z) in enumerate(zip(fit.problem.coordinates, fit.theta.tolist(), strict=True)):
        if c.effect is None or (only is not None and c.effect != only.key):
            continue
        p = effect_named(c.effect.partition(":")[0]).parameter(c.name.rpartition(".")[2])
        if not z < p.least:
            continue
        sd = float(np.sqrt(fit.covariance[i, i] * max(1.0, structure(fit).inflation)))
        if z < p.least - CERTAIN * sd:
            value, least = _shown(p, z, 3), _shown(p, p.least, 3)
            return f"{p.description} ({c.name}) comes out as {value}, and nothing has less than {least}"
    return ""


def _shown(p: EffectParameter, value: float, digits: int) -> str:
    """Write a number without a power of ten; a bound near zero stands for zero, so its digits mean nothing."""
    shown = value / p.to_si
    near = 0.0 < shown < NEAR_ZERO
    text = f"less than {NEAR_ZERO:g}" if near else np.format_float_positional(float(f"{shown:.{digits}g}"), trim="-")
    return text.replace("-", "−") + ("" if p.unit == "1" else f" {p.unit}")
