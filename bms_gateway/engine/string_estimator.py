"""The parts of one string: its estimates at the newest tick, its identifiers, its health."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import hypot, nan

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.events import Job
from bms_gateway.engine.forecast_result import Forecast
from bms_gateway.engine.plan import Plan, StringPlan
from bms_gateway.engine.readings import Reading
from bms_gateway.engine.wiring import Wire, identifies_cells
from bms_gateway.frames.quality import Quality
from bms_gateway.health import Ageing, Mismatch, StringHealth
from bms_gateway.health.self_discharge import SelfDischarge
from bms_gateway.identify import (
    Estimate,
    Identifier,
    PairMeans,
    Tick,
    Ticks,
    VoltageHeat,
    VoltageTracker,
    build,
)
from bms_gateway.identify.cell_kept import numbers_kept
from bms_gateway.identify.cell_live import CellIdentifier
from bms_gateway.identify.contract import FIXED_AT_COMMISSIONING, IDENTIFIED, LEARNING
from bms_gateway.identify.resistance_by_cell import CellNumbers
from bms_gateway.observe import Measured
from bms_gateway.thermal import HEAT_GAIN_SD, KINDS, Floats
from bms_gateway.thermal.centre import hottest_of

GOOD_SD = 0.1  # relative sd; an electrical resistance with a larger sd is not used yet
CELL_V = (2.0, 4.6)  # V: lithium-ion, empty to full; a string's voltage shared out is not below
CAPACITY_AH = 8.0  # if the model file has none; the voltage's slope needs only its order of magnitude
LEAST_CELLS = 3  # least number of cells for which one cell does not move the median

FLAG_NAMES = {
    "ageing": ("", "R_e_watch", "R_e_warning", "R_e_alarm"),
    "cooling": ("", "cooling_warning", "cooling_alarm"),
    "thermocouple": ("", "thermocouple_warning", "thermocouple_alarm"),
    "current": ("", "current_suspected", "current_confirmed"),
    "mismatch": ("", "mismatch_suspected", "mismatch_confirmed"),
    "unexplained_heat": ("", "unexplained_heat", "unexplained_heat"),
    "missing_heat": ("", "missing_heat", "missing_heat"),
    "inlet": ("", "inlet_warning", "inlet_alarm"),
    "self_discharge": ("", "self_discharge_warning", "self_discharge_alarm"),
}
"""Names of raised flags by their word and level."""


@dataclass(slots=True)
class Newest:
    """All N cells at the newest tick, string after string in the order of the plan.

    Attributes
    ----------
    core, core_sd, surface : ndarray (N,)
        °C, K, °C; NaN where not available.
    quality : ndarray of uint8 (N,)
    centre, centre_sd : ndarray (N,)
        Hottest point of each cell, °C, K; NaN where the core is.
    heat, heat_sd : ndarray (N,), W
        Heat of a cell that no current makes; NaN if no sensor shows it.
    withheld : ndarray (3, N) or None
        Core, hottest point and its sd of cells that are too uncertain to be sent; NaN elsewhere, None without such
        cells. They are still compared with the limits, because an unknown cell may be hot.
    contradicted : ndarray of bool (N,)
        See `Contradicted`.
    """

    core: Floats
    core_sd: Floats
    surface: Floats
    quality: NDArray[np.uint8]
    centre: Floats
    centre_sd: Floats
    heat: Floats
    heat_sd: Floats
    contradicted: NDArray[np.bool_]
    withheld: Floats | None = None

    @classmethod
    def nothing(cls, cells: int) -> "Newest":
        """Create the numbers of `cells` cells, all unknown."""
        core, core_sd, surface, centre, centre_sd, heat, heat_sd = np.full((7, cells), np.nan)
        quality = np.full(cells, np.uint8(Quality.NEVER))
        return cls(core, core_sd, surface, quality, centre, centre_sd, heat, heat_sd, np.zeros(cells, np.bool_))

    def renew(self) -> None:
        """Make new arrays for the next tick; holders of the last arrays keep them unchanged.

        Heat keeps its value until a new one comes.
        """
        self.core, self.core_sd, self.surface, self.centre, self.centre_sd = np.empty((5, len(self.core)))
        self.quality = np.empty_like(self.quality)
        self.withheld = None

    def withhold(
        self,
        put: Callable[[Floats, Floats], None],
        usable: NDArray[np.bool_],
        core: Floats,
        centre: Floats,
        centre_sd: Floats,
    ) -> None:
        """Store the numbers of a group that are not `usable` (S, n); `put` writes them to their places."""
        if self.withheld is None:
            self.withheld = np.full((3, len(self.core)), nan)
        for row, values in zip(self.withheld, (core, centre, centre_sd), strict=True):
            put(row, np.where(usable, nan, values))

    def with_withheld(self) -> tuple[Floats, Floats, Floats]:
        """Core, hottest point and its sd (N,) of all cells, also those that are not sent."""
        sent = self.core, self.centre, self.centre_sd
        if self.withheld is None:
            return sent
        core, centre, sd = (np.where(np.isnan(a), b, a) for a, b in zip(sent, self.withheld, strict=True))
        return core, centre, sd


@dataclass(slots=True)
class StringEstimator:
    """The parts that belong to one string alone; the group shares the observer.

    Attributes
    ----------
    newest : Newest
        Of all strings, and `mine`: the cells of this string.
    estimates : tuple of Estimate
        Parameters of the string.
    effects : tuple of Estimate
        Numbers of its model's effects, `key.parameter`.
    health : StringHealth
        With `ageing` and `mismatch`, which are used most.
    kept : CellNumbers or None
        Numbers of the cells from the commissioning run.
    hot, burning : bool
        `hot`: a cell is above its limit, or its core is unknown because of heat. `burning`: a measured surface is above
        its limit, or a cell runs away.
    fire : tuple of int
        0-based cells that have run away.
    constant : ndarray (n,) or None
        Constant error that windows found of each cell's thermocouple, K; None if none was sought.
    forecast : Forecast or None
        The newest forecast, every ten seconds; None before anything is known.
    """

    plan: StringPlan
    wire: Wire
    identifier: Identifier
    voltage: VoltageTracker | None
    newest: Newest
    mine: slice
    health: StringHealth
    ageing: Ageing = field(init=False)
    mismatch: Mismatch = field(init=False)
    estimates: tuple[Estimate, ...] = ()
    effects: tuple[Estimate, ...] = ()
    electrical: VoltageHeat | None = None
    cells: CellIdentifier | None = None
    kept: CellNumbers | None = None
    hot: bool = False
    burning: bool = False
    fire: tuple[int, ...] = ()
    constant: Floats | None = None
    forecast: Forecast | None = None

    def __post_init__(self) -> None:
        self.ageing, self.mismatch = self.health.ageing, self.health.mismatch

    @property
    def core(self) -> Floats:
        """Newest estimate (n,), °C; NaN where not available."""
        return self.newest.core[self.mine]

    @property
    def core_sd(self) -> Floats:
        """Standard deviation of the core (n,), K."""
        return self.newest.core_sd[self.mine]

    @property
    def surface(self) -> Floats:
        """Newest estimate of the surfaces (n,), °C."""
        return self.newest.surface[self.mine]

    @property
    def own_heat(self) -> Floats:
        """Heat (n,) that no current makes, W; NaN for cells without a sensor that shows it."""
        return self.newest.heat[self.mine]

    @property
    def own_heat_sd(self) -> Floats:
        """Standard deviation of this heat (n,), W."""
        return self.newest.heat_sd[self.mine]

    @property
    def quality(self) -> NDArray[np.uint8]:
        """`Quality` of the estimates (n,)."""
        return self.newest.quality[self.mine]

    @property
    def centre(self) -> Floats:
        """Newest estimate of each cell's hottest point (n,), °C; NaN where not available."""
        return self.newest.centre[self.mine]

    @property
    def centre_sd(self) -> Floats:
        """Standard deviation of the hottest point (n,), K."""
        return self.newest.centre_sd[self.mine]

    @property
    def hottest(self) -> int | None:
        """Cell (from 0) with the hottest point; None if nothing is known."""
        return hottest_of(self.centre)

    @classmethod
    def of(
        cls, plan: StringPlan, wire: Wire, whole: Plan, newest: Newest, mine: slice, mismatch: Mismatch
    ) -> "StringEstimator":
        """Build the string from the plan; nothing is estimated yet."""
        identifier = build(plan.identify, plan.model)
        n = plan.model.cells
        cells = CellIdentifier(plan.model, whole.disturbance, whole.cells) if hears_cells(plan, wire) else None
        own = cls(
            plan,
            wire,
            identifier,
            # in a model with effects, the effects decide where the heat comes from
            VoltageTracker(plan.model.capacity_Ah or CAPACITY_AH, n)
            if wire.voltage >= 0 and not plan.model.effects
            else None,
            newest,
            mine,
            health_of(plan, identifier, mismatch),
            cells=cells,
            kept=numbers_kept(plan.model),
        )
        if cells is not None and n >= LEAST_CELLS:
            own.health.self_discharge = SelfDischarge(n, plan.model.capacity_Ah)
        own.estimates = own.known()
        return own

    @property
    def runaway(self) -> bool:
        """Whether a cell has run away."""
        return bool(self.fire)

    @property
    def wrong(self) -> tuple[int, ...]:
        """0-based cells whose thermocouple is reported to be wrong."""
        return tuple(f.cell - 1 for f in self.health.heat if f.code == "thermocouple" and f.cell is not None)

    @property
    def heating(self) -> tuple[int, ...]:
        """0-based cells that heat by themselves: no number of the model describes them."""
        return tuple(f.cell - 1 for f in self.health.heat if f.code == "unexplained_heat" and f.cell is not None)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons why the string's cores are not proven, a sentence each; with any reason they are sent as doubtful."""
        return self.plan.model.doubts + self.identifier.doubts()

    @property
    def flags(self) -> tuple[str, ...]:
        """Names of the raised flags, as in the summary of an analysis."""
        raised = (
            FLAG_NAMES[c.code][c.level] + (f":{c.cell}" if c.cell is not None else "") for c in self.health.conditions()
        )
        return tuple(raised)

    def resistance(self) -> float:
        """Electrical resistance of a mean cell, Ω, if the voltage determines it well; otherwise NaN."""
        if self.electrical is None:
            return nan
        R, sd = self.electrical.resistance, self.electrical.resistance_sd
        return R / self.plan.model.cells if R > 0.0 and sd < GOOD_SD * R else nan

    def heat(self, current: float, voltage: float, power: float, dt: float) -> float:
        """Mean heat of one cell from the tick's means, W; NaN while the open-circuit voltage is not known."""
        if self.voltage is None:
            return nan
        self.electrical = self.voltage.update(current, voltage, power, dt)
        return self.electrical.heat / self.plan.model.cells

    def known(self) -> tuple[Estimate, ...]:
        """Parameters of the identifiers; R_e comes from the voltage if the heat does."""
        common = self.identifier.estimates()
        found = common + ((self.cells.estimates() if self.cells is not None else ()) or self._as_kept(common))
        if self.electrical is None or self.electrical.heat != self.electrical.heat:
            return found
        n = self.plan.model.cells
        R, sd = self.electrical.resistance / n, self.electrical.resistance_sd / n
        sound = self.resistance() == R
        # polarisation over minutes also makes heat, and is not included
        electrical = Estimate(
            "R_e", R, hypot(sd, HEAT_GAIN_SD * R), KINDS["R_e"].unit, IDENTIFIED if sound else LEARNING
        )
        return tuple(electrical if e.name == "R_e" else e for e in found)

    def _as_kept(self, common: tuple[Estimate, ...]) -> tuple[Estimate, ...]:
        """R_e of each cell: the ratios between cells from commissioning, times the common R_e."""
        if self.kept is None:
            return ()
        now, R = next(e for e in common if e.name == "R_e"), np.asarray(self.kept.values["R_e"])
        value = now.value * R / np.exp(np.mean(np.log(R)))
        sd = value * np.hypot(now.sd / now.value, np.sqrt(self.kept.own[:, 0, 0]))
        unit = KINDS["R_e"].unit
        each = enumerate(zip(value.tolist(), sd.tolist(), strict=True), start=1)
        return tuple(Estimate(f"R_e_{k}", x, spread, unit, FIXED_AT_COMMISSIONING) for k, (x, spread) in each)

    def flow_ratio(self, flow: float) -> float:
        """Coolant flow, m³/s, over the model's nominal flow; NaN if either is unknown."""
        nominal = self.plan.model.flow
        return flow / nominal if nominal else nan

    def learn(self, tick: Tick, current: float, soc: float, flow: float, pairs: PairMeans | None) -> list[Job]:
        """Give a tick to all identifiers; return their jobs.

        Parameters
        ----------
        tick : Tick
        current, soc, flow : float
            Mean current, A; state of charge, 0…1; flow over nominal flow. NaN if unknown.
        pairs : PairMeans or None
            Voltages of its cells, paired with the current.
        """
        jobs: list[Job | None] = [self.identifier.add(tick)]
        if self.health.commissioned:
            jobs.insert(0, self.health.add(tick, current, soc, flow, self.resistance()))
        if self.cells is not None:
            jobs.insert(0, self.cells.add(tick, pairs, current, flow, self.identifier.posterior))
        return [job for job in jobs if job is not None]

    def patience(self, dt: float) -> int:
        """Count the regular ticks that may wait before `learn` must get one; `take` then gets the waiting ticks."""
        if self.cells is not None:
            return 0
        own = self.identifier.patience(dt)
        return min(own, self.health.collector.patience(dt)) if self.health.commissioned else own

    def disbelieve(self, cell: int, seconds: float) -> None:
        """Forget the readings of a cell (0-based) in the last seconds: its thermocouple is reported to be wrong."""
        self.identifier.disbelieve(cell, seconds)
        self.health.collector.ticks.disbelieve(cell, seconds)
        if self.cells is not None:
            self.cells.disbelieve(cell, seconds)

    def take(self, ticks: Ticks) -> None:
        """Give waiting regular ticks to all identifiers."""
        self.identifier.take(ticks)
        if self.health.commissioned:
            self.health.collector.take(ticks)

    def measured(self, reading: Reading) -> Measured:
        """Collect the inputs of the observer of a string with effects at a tick."""
        m, n = reading.means, self.plan.model.cells
        if m.V / n < CELL_V[0] <= m.V <= CELL_V[1]:
            n = 1  # the mean of the cells' voltages, as offline
        flow, soc = self.flow_ratio(reading.slow["coolant_flow"]), reading.slow["soc"]
        return Measured(m.I, m.I2, m.I_abs, reading.inlet, flow, soc, m.V / n, m.IV / n)


def health_of(plan: StringPlan, identifier: Identifier | None = None, mismatch: Mismatch | None = None) -> StringHealth:
    """Build the health of a string from its model."""
    method = build(plan.identify, plan.model) if identifier is None else identifier
    return StringHealth(
        plan.model,
        thermal=not plan.model.effects or method.learns,
        known=plan.model.before is not None or plan.identify == "off",
        mismatch=mismatch,
    )


def hears_cells(plan: StringPlan, wire: Wire) -> bool:
    """Whether enough cells have a voltage signal to identify single cells; the signals themselves may not come."""
    return identifies_cells(plan) and 2 * int((wire.cell_voltage >= 0).sum()) >= plan.model.cells


def unproven(doubts: Sequence[str]) -> str:
    """Make the sentence that cores are not proven, with the reason and what to do."""
    more = f" (and {len(doubts) - 1} more)" if len(doubts) > 1 else ""
    return (
        f"cores not proven, sent as doubtful: {doubts[0].rstrip('.')}{more}: record a drive and diagnose it, add what "
        "it names, or calibrate a cell with a thermocouple in its core"
    )
