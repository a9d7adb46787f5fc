r"""Properties of every physical effect: energy is conserved, units agree, losses cool, the neutral value has no effect.

The author of an effect puts one call into a test of the package that contains the effect:

>>> from bms_gateway.thermal.effects import Effect, EffectParameter
>>> class Radiation(Effect):
...     name, title = "radiation", "radiation from the casings to a hall of 25 °C"
...     equation = "surface heat -> surface heat - eA*sigma*(T_s^4 - T_hall^4), in kelvin"
...     signature, needs = "hot casings cool faster than the film says", "a wide span of surface temperatures"
...     node, warms, constants = "surface", -1, True
...     parameters = (EffectParameter("eA", "emissivity times area", "m2", 1.0, 0.0, 0.01, 0.0, 1.0, probe=0.01),)
...
...     def surroundings(self, z, p, at):
...         z.surface = z.surface - p["eA"] * 5.670374e-8 * ((z.T_s + 273.15) ** 4 - 298.15**4)
>>> broken_properties(Radiation)
()

With a wrong sign, or without the 273.15, the call names the error:

>>> class Reversed(Radiation):
...     def surroundings(self, z, p, at):
...         z.surface = z.surface + p["eA"] * 5.670374e-8 * (z.T_s**4 - 25.0**4)
>>> for sentence in broken_properties(Reversed):
...     print(sentence)
radiation: a warmer surface takes more heat from its surroundings: reversed sign, or °C where a law needs kelvin
radiation: says that it cools a string on discharge, and does not

The properties are tested at random temperatures, in both coolant modes, for a string of four cells. They show that the
effect is physically possible; whether a cell has this effect is not tested here.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects import Effect
from bms_gateway.thermal.parameters import AddedEffect, Coolant, Floats, Prior, StringModel
from bms_gateway.thermal.physics import Numbers, Physics
from bms_gateway.thermal.point import Point

CELLS = 4
INTERVALS = 120
BALANCE = 1e-9
"""Relative to the sum of all heat flows: rounding of a few hundred additions."""
SAME = 1e-7
"""Relative difference of two evaluations of one law in other units."""
VISIBLE = 1e-6
"""W/K or K/s: a smaller influence is rounding."""
STRING = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79, "R_cc": 4.0, "C_f": 11.33}
"""Lin et al., Table 1; five such cells along a stream of air."""

UNITS: Mapping[str, tuple[float, int, int]] = {
    "1": (1.0, 0, 0),
    "K": (1.0, 0, 0),
    "°C": (1.0, 0, 0),
    "s": (1.0, 0, 0),
    "min": (60.0, 0, 0),
    "h": (3600.0, 0, 0),
    "1/h": (1.0 / 3600.0, 0, 0),
    "1/s": (1.0, 0, 0),
    "1/K": (1.0, 0, 0),
    "m": (1.0, 0, 0),
    "mm": (1e-3, 0, 0),
    "m2": (1.0, 0, 0),
    "A": (1.0, 0, 1),
    "Ah": (3600.0, 0, 1),
    "W": (1.0, 1, 0),
    "mW": (1e-3, 1, 0),
    "J": (1.0, 1, 0),
    "kJ": (1e3, 1, 0),
    "J/K": (1.0, 1, 0),
    "W/K": (1.0, 1, 0),
    "K/W": (1.0, -1, 0),
    "V": (1.0, 1, -1),
    "mV": (1e-3, 1, -1),
    "mV/K": (1e-3, 1, -1),
    "Ohm": (1.0, 1, -2),
    "mOhm": (1e-3, 1, -2),
}
"""Unit: its size in SI, and its powers of energy and charge."""
_OF_STRING = {"C_c": (1, 0), "C_s": (1, 0), "C_f": (1, 0), "R_c": (-1, 0), "R_u": (-1, 0), "R_cc": (-1, 0)}
_OF_STRING |= {"R_e": (1, -2)}


def broken_properties(effect: Effect | type[Effect]) -> tuple[str, ...]:
    """Return the properties of physical effects that an effect violates.

    Parameters
    ----------
    effect : Effect or class derived from it
        It need not be installed.

    Returns
    -------
    tuple of str
        One sentence for each violated property; empty for a sound effect.

    Notes
    -----
    Checked are: units and their size in SI; the neutral value is no effect; heat made = heat stored + heat to the
    coolant + heat to the surroundings, to 1e-9, in each coolant mode; a warmer surface gives off no less heat, to the
    coolant and to the surroundings; one more watt in a core leaves no cell colder; the effect's own statement
    (`Effect.warms`) on discharge, above its surroundings; no special point at 0 °C; the same law in other units of
    energy and of charge. It takes some tenths of a second.
    """
    e = effect() if isinstance(effect, type) else effect
    found: dict[str, None] = {}
    with np.errstate(all="ignore"):  # values that are not finite are reported below
        for check in (_units, _neutral, _energy, _losses, _heat, _declared, _celsius, _dimensions):
            found |= dict.fromkeys(check(e))
    return tuple(f"{e.name}: {sentence}" for sentence in found)


def _model(e: Effect | None, coolant: Coolant = "bulk", scale: Mapping[str, float] | None = None) -> StringModel:
    numbers = {k: x * (scale or {}).get(k, 1.0) for k, x in STRING.items()}
    place = {"string": None}.get("string" if e is None else e.place, 2)
    added = () if e is None else (AddedEffect(e.name, place),)
    priors = {k: Prior(x) for k, x in numbers.items()}
    return StringModel(CELLS, tuple(range(1, CELLS + 1)), "full", priors, coolant, effects=added)


class _Case:
    """A string with the effect, its numbers and a drive; `point` gives its balances, `bare` those without it."""

    def __init__(
        self,
        e: Effect,
        values: Mapping[str, float],
        u: Drive,
        coolant: Coolant = "bulk",
        scale: Mapping[str, float] | None = None,
    ) -> None:
        self.effect, self.u = e, u
        self.physics = Physics(_model(e, coolant, scale), {e.name: e})
        self.without = Physics(_model(None, coolant, scale))
        key = self.physics.model.effects[0].key
        self.v: Numbers = replace(self.physics.numbers(), effects={key: values})
        self.memory, _ = self.physics.memory(u, self.v)

    def states(self, T_c: Floats, T_s: Floats) -> Floats:
        """States (N, D) with the effect's own states in balance."""
        return self.physics.start(T_c, T_s, self.v)

    def point(self, T_c: Floats, T_s: Floats) -> Point:
        return self.physics.point(self.states(T_c, T_s), self.u, self.v, self.memory)

    def rates(self, T_c: Floats, T_s: Floats) -> Floats:
        return self.physics.rates(self.states(T_c, T_s), self.u, self.v, self.memory)[:, : 2 * CELLS]

    def readings(self, T_c: Floats, T_s: Floats) -> Floats:
        return self.physics.readings(self.states(T_c, T_s), self.u, self.v, self.memory)

    def bare(self, T_c: Floats, T_s: Floats) -> Point:
        X = np.stack([T_c, T_s], axis=-1).reshape(len(T_c), -1)
        return self.without.point(X, self.u, self.without.numbers(), {})

    def bare_rates(self, T_c: Floats, T_s: Floats) -> Floats:
        return self.without.balances(self.bare(T_c, T_s), self.without.numbers())


def _probe(e: Effect) -> dict[str, float]:
    return {p.name: p.probe for p in e.parameters}


def _drive(seed: int = 0, **given: Floats) -> Drive:
    """Both directions, rests, flow that changes; everything recorded."""
    rng = np.random.default_rng(seed)
    amps = np.where(rng.random(INTERVALS) < 0.2, 0.0, rng.uniform(-80, 120, INTERVALS))
    V = rng.uniform(2.9, 3.3, INTERVALS)
    u = {
        "I": amps,
        "I2": amps * amps,
        "I_abs": np.abs(amps),
        "T_in": rng.uniform(-25, 35, INTERVALS),
        "flow": rng.uniform(0.05, 1.6, INTERVALS),
        "soc": rng.uniform(0.0, 1.0, INTERVALS),
        "V": V,
        "IV": amps * V,
        "hours": (np.arange(INTERVALS) + 0.5) / 3600.0,
    } | given
    return Drive(1.0, **u, known=frozenset({"flow", "soc", "voltage"}))


def _temperatures(low: float = -30.0, high: float = 75.0) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(1)
    return rng.uniform(low, high, (INTERVALS, CELLS)), rng.uniform(low, high, (INTERVALS, CELLS))


def _units(e: Effect) -> Iterator[str]:
    for p in e.parameters:
        if p.unit not in UNITS:
            yield f"unit {p.unit!r} of {p.name} is not known: {', '.join(UNITS)}"
        elif not np.isclose(p.to_si, UNITS[p.unit][0], rtol=1e-9):
            yield f"{p.name} is in {p.unit}, which is {UNITS[p.unit][0]:g} in SI: to_si is {p.to_si:g}"


def _neutral(e: Effect) -> Iterator[str]:
    if e.parameters[0].neutral is None:
        return
    values = {p.name: p.prior if p.neutral is None else p.neutral for p in e.parameters}
    T_c, T_s = _temperatures()
    case = _Case(e, values, _drive())
    # a neutral value that is a bound represents infinity: a thousandth of the heat may remain
    left = 1e-3 if e.parameters[0].log else BALANCE
    rates, bare = case.rates(T_c, T_s), case.bare_rates(T_c, T_s)
    same = np.allclose(rates, bare, rtol=left, atol=left * float(np.abs(bare).max()))
    if not (same and np.allclose(case.readings(T_c, T_s), T_s, rtol=0.0, atol=BALANCE)):
        yield f"{e.parameters[0].name} at its neutral value still changes something"


def _energy(e: Effect) -> Iterator[str]:
    T_c, T_s = _temperatures()
    corners = ("probe", "lower", "upper")
    modes: tuple[Coolant, ...] = ("bulk", "ntu")
    for by, coolant in ((b, c) for b in corners for c in modes):
        case = _Case(e, {p.name: getattr(p, by) for p in e.parameters}, _drive(2), coolant)
        z = case.point(T_c, T_s)
        rates = case.physics.balances(z, case.v)[:, : 2 * CELLS]
        if not (np.isfinite(rates).all() and np.isfinite(case.readings(T_c, T_s)).all()):
            yield f"not finite with {e.parameters[0].name} at its {by} value"
            continue
        stored = np.sum(z.C_c * rates[:, 0::2] + z.C_s * rates[:, 1::2], axis=1)
        made, brought = np.sum(z.core, axis=1), np.sum(np.broadcast_to(z.surface, T_s.shape), axis=1)
        carried, flows = _carried(z, coolant)
        total = np.abs(z.core).sum(axis=1) + np.abs(z.surface).sum(axis=-1) + flows
        if np.any(np.abs(stored - made - brought + carried) > BALANCE * (total + np.abs(stored) + 1.0)):
            yield "heat made is not heat stored + heat to the coolant + heat to the surroundings"


def _carried(z: Point, coolant: Coolant) -> tuple[Floats, Floats]:
    """Heat (N,) that the stream gains on its way along the string, W, and the sum of the gains' magnitudes.

    Computed here from the inlet on, with R_u, C_f, the film's exponent and the inlet as changed by the effects.
    """
    R_u, C_f = (np.broadcast_to(x, z.T_s.shape) for x in (z.R_u, z.C_f))
    stream = np.broadcast_to(z.T_in[:, 0], z.T_s.shape[:1]).astype(float)
    gained, flows = np.zeros_like(stream), np.zeros_like(stream)
    for k in range(CELLS):
        gap = z.T_s[:, k] - stream
        bend = (np.maximum(np.abs(gap), 0.05) / 5.0) ** z.film_exponent
        units = bend / (R_u[:, k] * C_f[:, k])
        after = stream + gap * (1.0 - np.exp(-units) if coolant == "ntu" else np.minimum(units, 1.0))
        gained, flows = gained + C_f[:, k] * (after - stream), flows + np.abs(C_f[:, k] * (after - stream))
        stream = after
    return gained, flows


def _losses(e: Effect) -> Iterator[str]:
    case, step = _Case(e, _probe(e), _drive(3)), 0.5
    T_c, T_s = _temperatures()
    for k in range(CELLS):
        warmer = T_s.copy()
        warmer[:, k] += step
        one, other = case.point(T_c, T_s), case.point(T_c, warmer)
        before, after = (np.sum(np.broadcast_to(z.surface, T_s.shape), axis=1) for z in (one, other))
        if np.any(after - before > VISIBLE * step):
            yield (
                "a warmer surface takes more heat from its surroundings: reversed sign, or °C where a law needs kelvin"
            )
        if np.any((other.film - one.film)[:, k] < -VISIBLE * step):
            yield "a warmer surface gives less heat to the coolant"


def _heat(e: Effect) -> Iterator[str]:
    u = _drive(4, I=np.full(INTERVALS, 20.0), I2=np.full(INTERVALS, 400.0), I_abs=np.full(INTERVALS, 20.0))
    case = _Case(e, _probe(e), u)
    T_s = np.full((1, CELLS), 32.0)
    X = case.states(T_s + 4.0, T_s)[0]
    one = _first(u)
    here = {key: m[:1] for key, m in case.memory.items()}
    J = case.physics.linearised(X, one, case.v, here)
    watt = np.zeros((len(X), CELLS))
    watt[np.arange(0, 2 * CELLS, 2), np.arange(CELLS)] = 1.0 / STRING["C_c"]
    warmed = np.linalg.lstsq(-J, watt, rcond=None)[0][: 2 * CELLS]
    if np.any(warmed < -1e-6):
        yield "a watt more in a core leaves a cell colder in the long run"


def _declared(e: Effect) -> Iterator[str]:
    """On discharge at half a C, cells 10 to 35 K above inlet and surroundings, a rising flow, SOC below a half."""
    if e.warms == 0:
        return
    ones = np.ones(INTERVALS)
    u = _drive(
        5,
        I=40.0 * ones,
        I2=1600.0 * ones,
        I_abs=40.0 * ones,
        IV=120.0 * ones,
        V=3.0 * ones,
        T_in=23.0 * ones,
        flow=1.2 * ones,
        soc=np.linspace(0.4, 0.1, INTERVALS),
        hours=np.linspace(0.1, 2.0, INTERVALS),
    )
    case = _Case(e, _probe(e), u)
    rng = np.random.default_rng(6)
    T_s = rng.uniform(45.0, 60.0, (INTERVALS, CELLS))
    T_c = T_s + rng.uniform(1.0, 15.0, T_s.shape)

    def net(z: Point) -> Floats:
        return np.asarray(np.sum(z.core + z.surface - z.film, axis=1))

    moved = (net(case.point(T_c, T_s)) - net(case.bare(T_c, T_s)))[INTERVALS // 2 :]  # memories are filled by then
    if np.any(moved * e.warms <= 0.0):
        word = "warms" if e.warms > 0 else "cools"
        yield f"says that it {word} a string on discharge, and does not"


def _celsius(e: Effect) -> Iterator[str]:
    """Test that 0 °C is no special temperature: a law in °C that needs kelvin vanishes there, or has a pole."""
    ones = np.ones(INTERVALS)

    def done(T: float, which: str) -> float:
        T_c, T_s = np.full((INTERVALS, CELLS), T), np.full((INTERVALS, CELLS), T)
        if which == "core":
            T_s = T_s - 5.0
        else:
            T_c = T_c + 5.0
        case = _Case(e, _probe(e), _drive(7, T_in=(T - 9.0) * ones))
        away = case.rates(T_c, T_s) - case.bare_rates(T_c, T_s)
        return float(np.sqrt(np.mean(away**2)))

    for which in ("core", "surface"):
        at = {T: done(T, which) for T in (-10.0, -0.01, 0.01, 10.0)}
        least, most = min(at[-10.0], at[10.0]), max(at[-10.0], at[10.0])
        for T in (-0.01, 0.01):
            if most > VISIBLE and not 0.3 * least <= at[T] <= 3.0 * most:
                yield f"0 °C of the {which} is a special point: a law needs kelvin"


def _dimensions(e: Effect) -> Iterator[str]:
    """Test with units of energy and of charge three times smaller: temperatures stay the same."""
    if e.constants or any(p.unit not in UNITS for p in e.parameters):
        return
    T_c, T_s = _temperatures(-10.0, 60.0)
    u, v = _drive(8), _probe(e)
    rates, readings = (f(T_c, T_s) for f in (_Case(e, v, u).rates, _Case(e, v, u).readings))
    for what, energy, charge in (("energy", 3.0, 1.0), ("charge", 1.0, 3.0)):

        def size(powers: tuple[int, int], energy: float = energy, charge: float = charge) -> float:
            return float(energy ** powers[0] * charge ** powers[1])

        volt = energy / charge
        other = replace(
            u,
            I=u.I * charge,
            I2=u.I2 * charge**2,
            I_abs=u.I_abs * charge,
            V=u.V * volt,
            IV=u.IV * energy,
        )
        values = {p.name: v[p.name] * size(UNITS[p.unit][1:]) for p in e.parameters}
        case = _Case(e, values, other, scale={k: size(x) for k, x in _OF_STRING.items()})
        same = np.allclose(case.rates(T_c, T_s), rates, rtol=SAME, atol=SAME * float(np.abs(rates).max()))
        if not (same and np.allclose(case.readings(T_c, T_s), readings, atol=SAME)):
            yield f"in other units of {what} it is another law: the unit of a parameter, or a constant, does not agree"


def _first(u: Drive) -> Drive:
    """Return the first interval."""
    arrays = {n: getattr(u, n)[:1] for n in ("I", "I2", "I_abs", "T_in", "flow", "soc", "V", "IV", "hours")}
    return Drive(u.dt, **arrays, known=u.known)
