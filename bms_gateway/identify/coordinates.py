"""The free numbers of a fit: coordinates with a Gaussian prior, and the readings to which they are fitted.

Coordinates are logarithms of the parameters about their prior's median, numbers of the effects, and numbers of each
record (start; cooling if there are several records). Nuisances are the scatter within the declared tolerances (cells,
sensors, inlet) and the start of each cell. They are small, so their columns are not computed in every step.

The numbers are those of Lin et al., Eq 1 and 16-18; priors and tolerances are not in the paper.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from bms_gateway.thermal import KINDS, Floats, StringModel
from bms_gateway.thermal.drive import Drive, Span
from bms_gateway.thermal.effects import EffectParameter, effect_named

Channel = tuple[Literal["surface", "core", "probe"], int]
"""Kind and cell (from 1) of a thermocouple: it measures the surface, the mean of the roll, or, pushed into the roll, a
temperature between mean and centre (`thermal.centre`)."""
LIMIT = 4.0
"""Bounds of a prior in sd; a number that ends there is an alarm, not a result."""
LATE = {"T_in": 0.3, "flow": 0.5}
"""s: delay of inlet and flow against the current: half a logger's interval, another device's filter."""
OWN = ("R_u",)
"""Parameters that each of several records has for itself, because the cooling of the same cells differs."""


@dataclass(frozen=True, slots=True)
class Measured:
    """Readings and inputs of one record, ready for a fit.

    Attributes
    ----------
    drive : Drive, N intervals
    spans : tuple of Span
        Stretches, each with its own start.
    channels : tuple of (kind, cell), m of them
    channel, row : ndarray (M,) of int
        Channel of each reading, and the row of the trajectory (instants of all spans stacked) before it.
    share : ndarray (M,)
        Position of the reading between that row and the next, 0…1.
    y : ndarray (M,), °C
    used : ndarray (M,) of bool
        False for held-out blocks.
    sigma0, step : ndarray (m,), K
        White noise and resolution of each channel.
    start : tuple of ndarray (n,), °C
        Surfaces at the start of each span, from the first readings.
    start_sd : tuple of ndarray (n,), K
        Standard deviation of these surfaces, cell by cell.
    source : str
    assumed : mapping of str to str
        Inputs that nobody measured, and what stands for them.
    """

    drive: Drive
    spans: tuple[Span, ...]
    channels: tuple[Channel, ...]
    channel: np.ndarray
    row: np.ndarray
    share: Floats
    y: Floats
    used: np.ndarray
    sigma0: Floats
    step: Floats
    start: tuple[Floats, ...]
    start_sd: tuple[Floats, ...]
    source: str = "record"
    assumed: Mapping[str, str] = field(default_factory=dict)

    @property
    def sigma(self) -> Floats:
        """Standard deviation (M,) of each reading, from noise and rounding."""
        return np.asarray(np.sqrt(self.sigma0**2 + self.step**2 / 12.0)[self.channel])


@dataclass(slots=True)
class Draft:
    """Numbers of one record while coordinates are entered; it owns its arrays."""

    string: dict[str, Floats]
    effects: dict[str, dict[str, float]]
    inlet_offset: float
    surface_offset: Floats
    late: dict[str, float]
    core_start: list[Floats]
    surface_start: list[Floats]


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One free number.

    Attributes
    ----------
    name : str
        Symbol, `effect.parameter`, `T_c0`, …; with `@r` for record r of several.
    prior, sd, lower, upper : float
        In units of the coordinate: for parameters the logarithm over the prior's median; of the value if the effect
        says so.
    step : float
        For finite differences.
    begin : float
        First value of a fit.
    put : callable
        Puts a value into a draft.
    record : int or None
        The record to which it belongs; None for all.
    effect : str or None
        Key of its effect.
    reach : float
        Longest step of a fit.
    vanishing : bool
        At its lower bound the effect vanishes and its other numbers have no meaning: a fit approaches it in shares.
    only_start : bool
        It changes only the start or the readings, no balance.
    sudden : bool
        It acts within single intervals, at steps of inputs: its column cannot be computed in longer intervals.
    """

    name: str
    prior: float
    sd: float
    lower: float
    upper: float
    step: float
    begin: float
    put: Callable[[Draft, float], None]
    record: int | None = None
    effect: str | None = None
    reach: float = np.inf
    vanishing: bool = False
    only_start: bool = False
    sudden: bool = False


@dataclass(frozen=True, slots=True)
class Belief:
    """A prior that replaces that of a coordinate.

    Attributes
    ----------
    prior, sd : float
        In units of the coordinate, whose bounds are kept.
    """

    prior: float
    sd: float


def parameters(model: StringModel, records: int) -> list[Coordinate]:
    """Free parameters of a string; with several records, each has its own cooling parameters."""
    found = []
    for name, prior in model.priors.items():
        if prior.fixed:
            continue
        kind, value = KINDS[name], np.asarray(prior.value)
        low = max(float(np.log(kind.lower / value.min())), -LIMIT * prior.rel_sd)
        high = min(float(np.log(kind.upper / value.max())), LIMIT * prior.rel_sd)

        def put(d: Draft, z: float, name: str = name) -> None:
            d.string[name] = d.string[name] * np.exp(z)

        one = Coordinate(name, 0.0, prior.rel_sd, low, high, min(0.02, 0.1 * prior.rel_sd), 0.0, put)
        if records > 1 and name in OWN:
            found += [replace(one, name=f"{name}@{r + 1}", record=r) for r in range(records)]
        else:
            found.append(one)
    return found


def effect_numbers(key: str, name: str, values: Mapping[str, float], sd: Mapping[str, float]) -> list[Coordinate]:
    """Free numbers of one effect."""
    found = []
    for p in effect_named(name).parameters:
        if sd.get(p.name, p.sd) == 0.0:
            continue
        found.append(_effect_coordinate(key, p, values.get(p.name, p.probe)))
    return found


def _effect_coordinate(key: str, p: EffectParameter, value: float) -> Coordinate:
    def to(x: float) -> float:
        return float(np.log(x)) if p.log else x

    def put(d: Draft, z: float) -> None:
        d.effects[key][p.name] = float(np.exp(z)) if p.log else z

    return Coordinate(
        f"{key}.{p.name}",
        to(p.prior),
        p.sd,
        to(p.lower),
        to(p.upper),
        0.02 * p.sd if p.log else min(0.02 * p.sd, 0.02 * (p.upper - p.lower)),
        min(max(to(value), to(p.lower)), to(p.upper)),
        put,
        effect=key,
        reach=p.reach,
        vanishing=p.neutral == p.lower,
    )


def believed(c: Coordinate, beliefs: Mapping[str, Belief]) -> Coordinate:
    """Give a coordinate another prior if `beliefs` has one for its name."""
    plain, _, place = c.name.split("@")[0].partition("[")
    if plain == "T_c0" and place not in ("", "1]"):  # a belief about rest holds only at the start of a record
        return c
    if c.effect is not None:
        plain = c.name.replace(c.effect, c.effect.partition(":")[0], 1)
    b = beliefs.get(plain)
    return c if b is None else replace(c, prior=b.prior, sd=b.sd)


CORE_START = (1.0, 15.0)
SURFACE_START = (0.5, 5.0)
"""K, sd and bound at the start of a record: core minus surface, and surfaces minus first readings."""
CORE_UNDER_WAY = (10.0, 60.0)
"""K, sd and bound, for a span after a gap: the current in the gap is unknown, and the cells have not rested."""
CELL_UNDER_WAY = 1.0
"""K: difference between the cells' cores there, some per cent of the values above."""


def starts(r: int, m: Measured, records: int) -> list[Coordinate]:
    """Return the common start of the cores and of the whole string, for each span of a record."""
    found = []
    for i in range(len(m.spans)):
        tail = ("" if len(m.spans) == 1 else f"[{i + 1}]") + ("" if records == 1 else f"@{r + 1}")

        def core(d: Draft, z: float, i: int = i) -> None:
            d.core_start[i] = d.core_start[i] + z

        def both(d: Draft, z: float, i: int = i) -> None:
            d.core_start[i] = d.core_start[i] + z
            d.surface_start[i] = d.surface_start[i] + z

        sd, limit = CORE_UNDER_WAY if i else CORE_START
        found.append(Coordinate(f"T_c0{tail}", 0.0, sd, -limit, limit, 0.1, 0.0, core, r, only_start=True))
        sd, limit = SURFACE_START
        found.append(Coordinate(f"T_s0{tail}", 0.0, sd, -limit, limit, 0.1, 0.0, both, r, only_start=True))
    return found


def nuisances(model: StringModel, records: Sequence[Measured]) -> list[Coordinate]:
    """Return the errors within the declared tolerances; those without a tolerance are left out."""
    found = _scatter(model)
    for r, m in enumerate(records):
        tail = "" if len(records) == 1 else f"@{r + 1}"
        found += _sensors(model, r, m, tail)
        found += _lateness(r, m, tail)
        found += _cell_starts(r, m, tail)
    return [c for c in found if c.sd > 0.0]


def _scatter(model: StringModel) -> list[Coordinate]:
    """Differences of the cells from their string's mean within the tolerances."""
    found = []
    for symbol in ("R_e", "R_u", "R_c") if model.cells > 1 else ():
        sd = model.tolerances.get(f"cell_{symbol}", 0.0)
        for k in range(model.cells):

            def scatter(d: Draft, z: float, symbol: str = symbol, k: int = k) -> None:
                d.string[symbol][k] *= 1.0 + z

            found.append(_nuisance(f"{symbol}[{k + 1}]", sd, scatter))
    return found


def _sensors(model: StringModel, r: int, m: Measured, tail: str) -> list[Coordinate]:
    """Offsets of the thermocouples."""
    found = []
    for k in sorted({cell for kind, cell in m.channels if kind == "surface"}):

        def offset(d: Draft, z: float, k: int = k) -> None:
            d.surface_offset[k - 1] += z

        found.append(
            _nuisance(f"surface_offset[{k}]{tail}", model.tolerances.get("surface_offset_K", 0.0), offset, r, True)
        )

    def inlet(d: Draft, z: float) -> None:
        d.inlet_offset += z

    found.append(_nuisance(f"inlet_offset{tail}", model.tolerances.get("inlet_offset_K", 0.0), inlet, r))
    return found


def _lateness(r: int, m: Measured, tail: str) -> list[Coordinate]:
    """Return the possible delays of inputs."""
    found = []
    for signal, sd in LATE.items():

        def late(d: Draft, z: float, signal: str = signal) -> None:
            d.late[signal] += z

        if np.ptp(getattr(m.drive, signal)) > 0.0:
            found.append(replace(_nuisance(f"{signal}_late{tail}", sd, late, r), sudden=True))
    return found


def _cell_starts(r: int, m: Measured, tail: str) -> list[Coordinate]:
    """Differences of the cells' start from their first readings."""
    found = []
    for i, sds in enumerate(m.start_sd):
        for k, sd in enumerate(sds):

            def start(d: Draft, z: float, i: int = i, k: int = k) -> None:
                d.core_start[i][k] += z
                d.surface_start[i][k] += z

            found.append(_nuisance(f"T_0[{k + 1}]{tail}", float(sd), start, r, True))

            def core(d: Draft, z: float, i: int = i, k: int = k) -> None:
                d.core_start[i] = d.core_start[i] + z * (np.arange(len(d.core_start[i])) == k)

            if i and len(sds) > 1:
                found.append(_nuisance(f"T_c0[{i + 1}][{k + 1}]{tail}", CELL_UNDER_WAY, core, r))
    return found


def _nuisance(
    name: str, sd: float, put: Callable[[Draft, float], None], record: int | None = None, only_start: bool = False
) -> Coordinate:
    return Coordinate(name, 0.0, sd, -LIMIT * sd, LIMIT * sd, sd, 0.0, put, record, only_start=only_start)
