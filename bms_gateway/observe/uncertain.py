"""The uncertain numbers of a string with effects, and their covariance.

Beyond Lin et al., whose observer treats its parameters as exact.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.observe.model import OFFSETS
from bms_gateway.observe.tangent import disturbed
from bms_gateway.thermal import Floats, StringModel
from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects import effect_named
from bms_gateway.thermal.physics import Numbers, Physics, with_effect

STEP = 0.01
"""Step of finite differences as a share of a number's standard deviation: above rounding, below curvature."""


@dataclass(frozen=True, slots=True)
class Uncertain:
    """One uncertain number.

    Attributes
    ----------
    name : str
        A symbol of the string, or `key.parameter` of an effect.
    key, parameter : str
        The effect's key and parameter; the key is empty for a symbol.
    log : bool
        Known in per cent: all fields then belong to its logarithm.
    step : float
        Of the finite differences, SI or of the logarithm; negative if a positive step is out of bounds.
    """

    name: str
    key: str
    parameter: str
    log: bool
    step: float

    def moved(self, v: Numbers) -> Numbers:
        """Numbers with this one moved by its step."""
        if not self.key:
            value = getattr(v.string, self.parameter) * np.exp(self.step)
            return replace(v, string=replace(v.string, **{self.parameter: value}))
        values = dict(v.effects[self.key])
        old = values[self.parameter]
        values[self.parameter] = old * float(np.exp(self.step)) if self.log else old + self.step
        return with_effect(v, self.key, values)


@dataclass(frozen=True, slots=True)
class EffectNumber:
    """Number of an effect in force: `key.parameter`, value and standard deviation in SI, unit as shown to people."""

    name: str
    value: float
    sd: float
    unit: str


def effect_numbers(model: StringModel, v: Numbers, numbers: Sequence[Uncertain], cov: Floats) -> list[EffectNumber]:
    """List the numbers of a model's effects in force, in the model's order; sd 0 for exact ones."""
    sd = dict(zip((u.name for u in numbers), np.sqrt(np.diag(cov)).tolist(), strict=True))
    found = []
    for added in model.effects:
        for p in effect_named(added.name).parameters:
            name, value = f"{added.key}.{p.name}", float(v.effects[added.key][p.name])
            found.append(EffectNumber(name, value, sd.get(name, 0.0) * (value if p.log else 1.0), p.unit))
    return found


def uncertain(model: StringModel) -> tuple[tuple[Uncertain, ...], Floats]:
    """List the numbers that the model does not know exactly, and their covariance.

    Returns
    -------
    numbers : tuple of Uncertain
    covariance : ndarray (p, p)
        Of the logarithms, or of the SI values for a number that is not known in per cent.
    """
    found, sd = [], []
    for symbol, prior in model.priors.items():
        if not prior.fixed:
            found.append(Uncertain(symbol, "", symbol, True, STEP * prior.rel_sd))
            sd.append(prior.rel_sd)
    for added in model.effects:
        for p in effect_named(added.name).parameters:
            width = added.sd.get(p.name, 0.0)
            if not width > 0.0:
                continue
            value, step = added.values[p.name], STEP * width
            beyond = value * np.exp(step) if p.log else value + step
            found.append(
                Uncertain(f"{added.key}.{p.name}", added.key, p.name, p.log, -step if beyond > p.upper else step)
            )
            sd.append(width)
    spread = np.array(sd)
    return tuple(found), np.outer(spread, spread) * _correlation(model, [u.name for u in found])


def _correlation(model: StringModel, names: Sequence[str]) -> Floats:
    out = np.eye(len(names))
    known: tuple[tuple[str, ...], Floats] | None = getattr(model, "correlation", None)
    if known is not None:
        there = [(i, known[0].index(name)) for i, name in enumerate(names) if name in known[0]]
        at, of = ([pair[k] for pair in there] for k in range(2))
        out[np.ix_(at, at)] = known[1][np.ix_(of, of)]
    return out


def log_change(
    old: Mapping[str, float | Floats], new: Mapping[str, float | Floats], numbers: Sequence[Uncertain]
) -> Floats:
    """Mean change (p,) of the logarithms of the string's own numbers; 0 for those of effects."""
    out = np.zeros(len(numbers))
    for j, u in enumerate(numbers):
        if not u.key:
            out[j] = float(np.mean(np.log(np.asarray(new[u.parameter]) / np.asarray(old[u.parameter]))))
    return out


Memories = Mapping[str, Mapping[str, Floats]]
"""Memories of effects: under "" with the present numbers, under a number's name with that number moved."""


def forcing(
    physics: Physics, v: Numbers, numbers: Sequence[Uncertain], u: Drive, states: Floats, carries: Memories
) -> tuple[Floats, dict[str, dict[str, Floats]]]:
    """Differentiate the rates by the uncertain numbers, as a mean over some steps.

    Parameters
    ----------
    physics : Physics
    v : Numbers
    numbers : sequence of Uncertain
    u : Drive
        The steps' inputs.
    states : ndarray (N, M)
        State in these steps, offsets last.
    carries : mapping
        At the beginning.

    Returns
    -------
    F : ndarray (M, p)
        Zero for the offsets, and where an effect lacks an input.
    moved : dict
        Memories with one number moved, at the end.
    """
    X, b, start = states[:, :-OFFSETS], states[:, -OFFSETS:], carries.get("", {})
    memory, _ = physics.memory(u, v, start or None)
    here = physics.rates(X, u, disturbed(v, b), memory)
    F, after = np.zeros((states.shape[1], len(numbers))), {}
    for k, number in enumerate(numbers):
        w, own = number.moved(v), memory
        if number.key in memory:
            mine = {**start, **carries.get(number.name, {})}
            moved, carry = physics.memory(u, w, mine or None)
            own = {**memory, number.key: moved[number.key]}
            if np.isfinite(carry[number.key]).all():
                after[number.name] = {number.key: carry[number.key]}
        slope = (physics.rates(X, u, disturbed(w, b), own) - here).mean(axis=0) / number.step
        F[:-OFFSETS, k] = np.nan_to_num(slope, posinf=0.0, neginf=0.0)
    return F, after
