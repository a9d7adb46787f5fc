"""The free numbers of a fit: coordinates with a Gaussian prior, and the readings that they are fitted to.

Coordinates are logarithms of the parameters about their prior's median, numbers of the effects, and what each record
knows on its own (start, and with several records the cooling). Scatter within the declared tolerances (cells, sensors,
inlet) and the start of each cell are nuisances: small, so that their columns need not be taken in every step.

The numbers are those of Lin et al., Eq 1 and 16-18; priors and tolerances are not in the paper.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bms_gateway.thermal import KINDS, Floats, StringModel
from bms_gateway.thermal.drive import Drive, Span
from bms_gateway.thermal.effects import EffectParameter, effect_named

Channel = tuple[Literal["surface", "core", "probe"], int]
"""What a thermocouple measures, and on which cell (from 1): its surface, the mean of its roll, or what a thermocouple
pushed into it reads, which is between mean and centre (`thermal.centre`)."""
LIMIT = 4.0
"""sd: a prior's tails end here; a number that ends there is an alarm, not an answer."""
LATE = {"T_in": 0.3, "flow": 0.5}
"""s: how late inlet and flow may be read against the current: half a logger's interval, another device's filter."""
OWN = ("R_u",)
"""Parameters that each of several records has for itself: the same cells are cooled differently."""


@dataclass(frozen=True, slots=True)
class Measured:
    """Readings of one record and what drove the string, ready for a fit.

    Attributes
    ----------
    drive : Drive, N intervals
    spans : tuple of Span
        Stretches with a start of their own.
    channels : tuple of (kind, cell), m of them
    channel, row : ndarray (M,) of int
        Channel of each reading, and the row of the trajectory (instants of all spans stacked) before it.
    share : ndarray (M,)
        Where between that row and the next the reading was taken, 0…1.
    y : ndarray (M,), °C
    used : ndarray (M,) of bool
        False for held-out blocks.
    sigma0, step : ndarray (m,), K
        White noise and resolution of each channel.
    start : tuple of ndarray (n,), °C
        Surfaces at the start of each span, from the first readings.
    start_sd : tuple of ndarray (n,), K
        How well these are known, cell by cell.
    source : str
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

    @property
    def sigma(self) -> Floats:
        """Standard deviation (M,) of each reading, noise and rounding together."""
        return np.asarray(np.sqrt(self.sigma0**2 + self.step**2 / 12.0)[self.channel])


@dataclass(slots=True)
class Draft:
    """Numbers of one record while the coordinates are put into them; its arrays are its own."""

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
        In the coordinate: the logarithm over the prior's median for parameters, of the value where the effect says so.
    step : float
        For finite differences.
    begin : float
        Where a fit starts.
    put : callable
        Puts a value into a draft.
    record : int or None
        The record it belongs to; None for all.
    effect : str or None
        Key of its effect.
    reach : float
        Longest step of a fit.
    vanishing : bool
        Its lower bound is where the effect vanishes and its other numbers mean nothing: a fit comes near by shares.
    only_start : bool
        It moves the start, or what is read, and no balance.
    sudden : bool
        It acts within single intervals, where inputs step: its column cannot be taken in longer ones.
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
    """A prior that takes the place of a coordinate's own.

    Attributes
    ----------
    prior, sd : float
        In the coordinate. Its bounds stay.
    """

    prior: float
    sd: float


def parameters(model: StringModel, records: int) -> list[Coordinate]:
    """Free parameters of a string; the cooling once for each of several records."""
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
    """Give a coordinate another prior, where there is one for its name."""
    plain, _, place = c.name.split("@")[0].partition("[")
    if plain == "T_c0" and place not in ("", "1]"):  # what is known of a rest holds where a record starts
        return c
    if c.effect is not None:
        plain = c.name.replace(c.effect, c.effect.partition(":")[0], 1)
    b = beliefs.get(plain)
    return c if b is None else replace(c, prior=b.prior, sd=b.sd)


CORE_START = (1.0, 15.0)
SURFACE_START = (0.5, 5.0)
"""K, sd and bound: how far cores are from surfaces, and surfaces from the first readings, when a record starts."""
CORE_UNDER_WAY = (10.0, 60.0)
"""K, sd and bound, for a span after a gap: nobody knows what the current did, and the cells have not rested."""
CELL_UNDER_WAY = 1.0
"""K: how far one cell's core may be from the others' there; they differ by some per cent of what stands above."""


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
    """Return what may be off within the declared tolerances; what has none is left out."""
    found = _scatter(model)
    for r, m in enumerate(records):
        tail = "" if len(records) == 1 else f"@{r + 1}"
        found += _sensors(model, r, m, tail)
        found += _lateness(r, m, tail)
        found += _cell_starts(r, m, tail)
    return [c for c in found if c.sd > 0.0]


def _scatter(model: StringModel) -> list[Coordinate]:
    """Cells that differ from their string's mean within the tolerances."""
    found = []
    for symbol in ("R_e", "R_u", "R_c") if model.cells > 1 else ():
        sd = model.tolerances.get(f"cell_{symbol}", 0.0)
        for k in range(model.cells):

            def scatter(d: Draft, z: float, symbol: str = symbol, k: int = k) -> None:
                d.string[symbol][k] *= 1.0 + z

            found.append(_nuisance(f"{symbol}[{k + 1}]", sd, scatter))
    return found


def _sensors(model: StringModel, r: int, m: Measured, tail: str) -> list[Coordinate]:
    """Thermocouples that read a little too high."""
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
    """Return what inputs may be read late by."""
    found = []
    for signal, sd in LATE.items():

        def late(d: Draft, z: float, signal: str = signal) -> None:
            d.late[signal] += z

        if np.ptp(getattr(m.drive, signal)) > 0.0:
            found.append(replace(_nuisance(f"{signal}_late{tail}", sd, late, r), sudden=True))
    return found


def _cell_starts(r: int, m: Measured, tail: str) -> list[Coordinate]:
    """Cells that start a little off what their first readings say."""
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
