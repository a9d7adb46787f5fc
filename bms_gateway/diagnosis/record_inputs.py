"""From rows of current, voltage, inlet, flow and charge to the means that drive a string."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from numbers import Integral
from typing import Any

import numpy as np

from bms_gateway.diagnosis.charge import state_of_charge
from bms_gateway.diagnosis.charge_level import Terminal
from bms_gateway.diagnosis.geometry import chemistry_of
from bms_gateway.diagnosis.grid import Grid, bridged, usual_interval
from bms_gateway.diagnosis.means import Path, mean, mean_magnitude, mean_product, path
from bms_gateway.diagnosis.smooth import COARSEST_K, smooth
from bms_gateway.errors import DataError, counted
from bms_gateway.frames.vocabulary import CELL, CELL_COLUMNS, INPUTS, WHOLE, Quantity
from bms_gateway.thermal import Floats, StringModel
from bms_gateway.thermal.drive import Drive

SAME_CURRENT = 0.01
"""Share of the greatest current below which two readings belong to one level, where the voltage creeps."""
BURSTS = 0.05
"""Least share of rows right after other rows at which the rows count as bursts around set points."""
BURST_S = 0.1
"""As a share of the usual interval."""
CELL_VOLTS, LITHIUM_VOLTS = (0.5, 5.5), (2.0, 4.6)
"""Limits for any chemistry, and for lithium-ion, empty to full."""
MINUTE_S = 60.0
FLOW_UNITS = {"L/s": 1e3, "L/min": 6e4, "L/h": 3.6e6, "m³/h": 3.6e3}
FLOW_WITHIN = 5.0
"""Factor about nominal within which a flow is accepted; a wrong unit gives a greater factor."""
MOVES = 0.8
"""Least share of the readings of an inlet that differ from the previous one, unless it is coarse."""
OUTLIVES = 20
"""A coarse inlet moves, too, if it has shown so many values and none of them for a twentieth of the longest time."""


@dataclass(frozen=True, slots=True)
class Sampling:
    """How well rows determine a current that changes between them.

    Attributes
    ----------
    seconds : float
        Usual time from row to row.
    doubt : float
        Relative standard deviation of a minute's mean square current, because the current between rows is unknown; 0 if
        the source states mean squares.
    missing_s : float
        Total time for which the current is missing and interpolated.
    longest_s : float
        The longest such gap.
    inlet_missing_s : float
        The longest time for which the inlet is missing while the current is known.
    inlet_still_s : (float, float)
        Longest time, from stamp to stamp, in which the readings of the inlet are one number, if otherwise they change
        from reading to reading; (0, 0) for a coarse or constant inlet.
    """

    seconds: float = 0.0
    doubt: float = 0.0
    missing_s: float = 0.0
    longest_s: float = 0.0
    inlet_missing_s: float = 0.0
    inlet_still_s: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Columns:
    """Measurements of one string, K rows: columns of a table, samples of a log, or arrays.

    NaN is a missing value, so each quantity may have its own time stamps. Lists are accepted too.

    Attributes
    ----------
    time_s : ndarray (K,)
        Increasing, s.
    current_A : ndarray (K,)
        Discharge positive.
    coolant_inlet_C : ndarray (K,)
        Temperature of the coolant where it reaches the first cell, or of the ambient air, °C.
    surface_C : mapping of cell (from 1) to ndarray (K,)
        Thermocouples on the cells, °C.
    voltage_V : ndarray (K,), optional
        Of the whole string with its cells in series, as in the gateway; it counts as the mean of the cells if its share
        per cell would be too low for lithium-ion but the value itself is not.
    soc : ndarray (K,), optional
        State of charge, 0…1.
    coolant_flow_m3_s : ndarray (K,), optional
    core_C : mapping of cell (from 1) to ndarray (K,)
        Thermocouples in the cores, °C; no choice of effects uses them.
    cell_voltage_V : mapping of cell (from 1) to ndarray (K,)
        Used only to identify single cells.
    mean_square_current : ndarray (K,), optional
        A², for the time of each row; otherwise the square of the rows.
    source : str
        Name of the measurements in reports and errors.
    refused : mapping of cell to str
        Cells whose surface was recorded and is not to be used, and why.
    assumed : mapping of quantity to str
        What stands for inputs that nobody measured, in a few words; reports and pictures tell it.

    Raises
    ------
    DataError
        A column is not a row of numbers, or has another length than `time_s`.

    Examples
    --------
    >>> drive = Columns(time_s=[0, 1, 2], current_A=[0, 9, 9], coolant_inlet_C=[25] * 3, surface_C={1: [25] * 3})
    >>> drive.current_A
    array([0., 9., 9.])
    """

    time_s: Floats
    current_A: Floats
    coolant_inlet_C: Floats
    surface_C: Mapping[int, Floats]
    voltage_V: Floats | None = None
    soc: Floats | None = None
    coolant_flow_m3_s: Floats | None = None
    core_C: Mapping[int, Floats] = field(default_factory=dict)
    cell_voltage_V: Mapping[int, Floats] = field(default_factory=dict)
    mean_square_current: Floats | None = None
    source: str = "arrays"
    assumed: Mapping[Quantity, str] = field(default_factory=dict)
    refused: Mapping[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rows = self._row("time_s", self.time_s, None)
        object.__setattr__(self, "time_s", rows)
        for name in ROWS:
            if (given := getattr(self, name)) is not None:
                object.__setattr__(self, name, self._row(name, given, len(rows)))
        for name in NEEDED:
            if getattr(self, name) is None:
                raise DataError(f"{self.source}: {name}: missing")
        for name, of_cell in ROWS_OF_CELLS.items():
            given = getattr(self, name)
            if not isinstance(given, Mapping) or not all(isinstance(k, Integral) for k in given):
                example = "{1: the row of cell 1, 3: that of cell 3}"
                raise DataError(f"{self.source}: {name}: a mapping of numbers of cells is expected, as {example}")
            columns = {k: self._row(of_cell.format(k), x, len(rows)) for k, x in getattr(self, name).items()}
            object.__setattr__(self, name, columns)

    def of(self, quantity: Quantity, cell: int | None = None) -> Floats | None:
        """Return the row of an input, of a cell if each cell has its own; None if there is none."""
        given: Any = getattr(self, INPUTS[quantity].field)
        found: Floats | None = given.get(cell) if INPUTS[quantity].of_cells else given
        return found

    def given(self) -> Iterator[tuple[Quantity, int | None, Floats]]:
        """List the given inputs: quantity, cell if each cell has its own, row."""
        for quantity in WHOLE:
            if (row := self.of(quantity)) is not None:
                yield quantity, None, row
        for quantity in CELL:
            for cell, row in getattr(self, INPUTS[quantity].field).items():
                yield quantity, cell, row

    def _row(self, name: str, given: Floats, rows: int | None) -> Floats:
        if np.iscomplexobj(given):
            raise DataError(f"{self.source}: {name}: complex numbers, expected real ones")
        try:
            x = np.ma.filled(np.ma.asarray(given, np.float64), np.nan)  # masked values are missing
        except (TypeError, ValueError):
            raise DataError(f"{self.source}: {name}: not a row of numbers") from None
        if x.ndim != 1:
            raise DataError(f"{self.source}: {name}: has the shape {x.shape}, expected one row of numbers")
        if rows is not None and len(x) != rows:
            raise DataError(f"{self.source}: {name}: {len(x)} values, but time_s has {rows}")
        return x


def all_along(quantity: Quantity, value: float) -> str:
    """Describe a constant that stands for an input.

    Examples
    --------
    >>> all_along("coolant_inlet", 22.04), all_along("soc", 0.5)
    ('22.04 °C all along', '50 % all along')
    """
    return f"{100.0 * value:.4g} % all along" if quantity == "soc" else f"{value:.4g} {INPUTS[quantity].unit} all along"


NEEDED = tuple(INPUTS[q].field for q in WHOLE if INPUTS[q].needed)
ROWS = (*(INPUTS[q].field for q in WHOLE), "mean_square_current")
"""Columns of the whole string."""
ROWS_OF_CELLS = {column.replace("_{}", ""): column for column in CELL_COLUMNS.values()}
"""Columns of single cells, and their names in a table."""


@dataclass(frozen=True, slots=True)
class Signals:
    """The inputs as paths of straight pieces.

    Attributes
    ----------
    current_s : ndarray
        Stamps at which the current is known.
    current, inlet : Path
    mean_square : Path or None
        A², if the source states it.
    voltage : Path or None
        Of one cell.
    flow : Path or None
        Ratio to nominal.
    soc : Path or None
    sampling : Sampling
        Of the current.
    terminal : Terminal or None
        The rows of the voltage.
    """

    current_s: Floats
    current: Path
    inlet: Path
    mean_square: Path | None
    voltage: Path | None
    flow: Path | None
    soc: Path | None
    sampling: "Sampling"
    terminal: Terminal | None

    def drive(self, grid: Grid, model: StringModel, notes: list[str]) -> tuple[Drive, float, str]:
        """Compute the means over the intervals of the grid, the sd of the charge's level, and where it comes from."""
        x = grid.instants
        n = len(x) - 1
        current = mean(x, self.current)
        square = mean_product(x, self.current, self.current)
        if self.mean_square is not None:
            # never below the square of the mean, to which rounding in the source could lead
            square = np.maximum(mean(x, self.mean_square), current**2)
        none = np.full(n, np.nan)
        known = {name for name, p in (("flow", self.flow), ("voltage", self.voltage)) if p is not None}
        recorded = None if self.soc is None else np.clip(mean(x, self.soc), 0.0, 1.0)
        soc, soc_sd, assumed = state_of_charge(recorded, current, grid, model.capacity_Ah, notes, self.terminal)
        if soc is not None:
            known.add("soc")
        drive = Drive(
            dt=grid.dt,
            I=current,
            I2=square,
            I_abs=mean_magnitude(x, self.current),
            T_in=mean(x, self.inlet),
            flow=np.ones(n) if self.flow is None else mean(x, self.flow),
            soc=np.full(n, 0.5) if soc is None else soc,
            V=none if self.voltage is None else mean(x, self.voltage),
            IV=none if self.voltage is None else mean_product(x, self.current, self.voltage),
            hours=(0.5 * (x[1:] + x[:-1]) - x[0]) / 3600.0,
            known=frozenset(known),
        )
        return drive, soc_sd, assumed


def draw_inputs(rows: Columns, model: StringModel, half_way: bool | None, notes: list[str]) -> Signals:
    """Make the path of every input from its plausible rows.

    Parameters
    ----------
    rows : Columns
    model : StringModel
        Cells, nominal flow.
    half_way : bool or None
        As in `make_record`.
    notes : list of str
        Notes are appended.

    Raises
    ------
    DataError
        There is no current or no inlet.
    """
    t, amps = _believable(rows, rows.current_A, "current", "current_A", notes)
    if len(t) < 2 or not amps.any():
        _refuse_unit(rows.source, "current_A", rows.current_A, "current", "A", "mA")
    if len(t) < 2:
        raise DataError(f"{rows.source}: current_A has no values: without it there is no heat to explain")
    if half_way is None:
        half_way = _in_bursts(t)
        if half_way:
            notes.append("Rows of the current come in bursts: its steps are put half-way between rows.")
    bridge = bridged(t)[0]
    gaps = np.diff(t) > bridge
    missing_s, longest_s = _tell_gaps(t, bridge, bridged(t)[1], notes)
    t_in, T_in = _believable(rows, rows.coolant_inlet_C, "coolant_inlet", "coolant_inlet_C", notes)
    if not len(t_in):
        _refuse_unit(rows.source, "coolant_inlet_C", rows.coolant_inlet_C, "coolant_inlet", "°C", "K")
        raise DataError(f"{rows.source}: coolant_inlet_C has no values: give the inlet or ambient temperature")
    inlet_missing_s = _tell_reach(t, t_in, "coolant inlet", notes)
    current = path(t, amps, gaps, half_way=half_way)
    voltage, terminal = _voltage(rows, model, t, amps, half_way, notes)
    return Signals(
        current_s=t,
        current=current,
        inlet=path(t_in, smooth(t_in, T_in, coarsest=COARSEST_K), True),
        mean_square=_mean_square(rows, half_way),
        voltage=voltage,
        flow=_flow(rows, model, notes),
        soc=_recorded_charge(rows, notes),
        sampling=Sampling(
            usual_interval(t),
            0.0 if rows.mean_square_current is not None else _doubt(t, amps, bridge),
            missing_s,
            longest_s,
            inlet_missing_s,
            _still(t_in, T_in),
        ),
        terminal=terminal,
    )


def _believable(rows: Columns, x: Floats, quantity: Quantity, name: str, notes: list[str]) -> tuple[Floats, Floats]:
    """Stamps and values within the plausible range."""
    low, high = INPUTS[quantity].plausible
    known = np.isfinite(x)
    good = known & (x >= low) & (x <= high)
    if wild := int(known.sum() - good.sum()):
        notes.append(
            f"{counted(wild, f'value of {name} is', f'values of {name} are')} outside {low:g} to {high:g} and left out."
        )
    return rows.time_s[good], x[good]


def _refuse_unit(source: str, name: str, x: Floats, quantity: Quantity, unit: str, perhaps: str) -> None:
    """Refuse a column that has no useful values after implausible values are left out.

    Raises
    ------
    DataError
        Some values are implausible, and the others show nothing.
    """
    low, high = INPUTS[quantity].plausible
    wild = x[np.isfinite(x) & ((x < low) | (x > high))]
    if len(wild):
        raise DataError(
            f"{source}: {name}: {len(wild)} of {len(x)} values are outside {low:g} to {high:g} {unit} (such as "
            f"{wild[0]:g}), and the others tell nothing: are they in {perhaps}?"
        )


def _in_bursts(t: Floats) -> bool:
    d = np.diff(t)
    return bool(np.mean(d < BURST_S * np.percentile(d, 75)) >= BURSTS)


def _doubt(t: Floats, amps: Floats, bridge: float) -> float:
    """Relative sd of a minute's mean square current, if each step is equally likely anywhere between its two rows."""
    d, square = np.diff(t), amps**2
    known = d <= bridge
    if not known.any():
        return 0.0
    d, step = d[known], np.diff(square)[known]
    seconds, charge = float(d.sum()), float(np.sum(square[:-1][known] * d))
    variance = float(np.sum((step * d) ** 2)) / 12.0  # of all the time, A⁴s²
    return float(np.sqrt(variance * seconds / MINUTE_S)) / charge if charge > 0.0 else 0.0


def _tell_gaps(t: Floats, bridge: float, part: float, notes: list[str]) -> tuple[float, float]:
    """Report missing stretches of the current that are interpolated; return their total and greatest length, s."""
    d = np.diff(t)
    d = d[(d > bridge) & (d <= part)]
    if len(d):
        notes.append(
            f"The current is missing at {counted(len(d), 'place')}, for {d.max():.0f} s at the longest and "
            f"{d.sum():.0f} s in all: bridged by straight lines."
        )
    return float(d.sum()), float(d.max(initial=0.0))


def _still(t: Floats, x: Floats) -> tuple[float, float]:
    """Return the longest time in which otherwise moving readings are constant; (0, 0) if they seldom move."""
    moves = np.flatnonzero(np.diff(x, prepend=np.nan, append=np.nan) != 0.0)
    held = np.diff(moves)
    k = int(np.argmax(held))
    others, rest = len(x) - int(held[k]), np.delete(held, k)
    lively = others > 0 and len(rest) >= MOVES * others
    if not lively and not (len(rest) >= OUTLIVES and held[k] > OUTLIVES * rest.max()):
        return 0.0, 0.0
    return float(t[moves[k]]), float(t[moves[k + 1] - 1])


def _tell_reach(t: Floats, own: Floats, name: str, notes: list[str]) -> float:
    """Report where an input is unknown while the current is known; return the longest reported time, s."""
    missing = max(own[0] - t[0], 0.0), max(t[-1] - own[-1], 0.0)
    limit = max(60.0, bridged(own)[0] if len(own) > 2 else 0.0)
    found = 0.0
    # where the current is missing too, nothing is bridged: the record is taken in parts, or the current tells
    heard = np.searchsorted(t, own[1:]) - np.searchsorted(t, own[:-1], "right") > 0
    if heard.any() and (longest := float(np.diff(own)[heard].max())) > limit:
        notes.append(f"The {name} is missing for {longest:.0f} s at the longest: bridged by straight lines.")
        found = longest
    if max(missing) > limit:
        where = "at the start" if missing[0] > missing[1] else "at the end"
        notes.append(f"The {name} is missing for {max(missing):.0f} s {where}: taken as constant there.")
        found = max(found, *missing)
    return float(found)


def _mean_square(rows: Columns, half_way: bool) -> Path | None:
    if rows.mean_square_current is None:
        return None
    known = np.isfinite(rows.mean_square_current)
    if not known.any():
        return None
    return path(rows.time_s[known], rows.mean_square_current[known], False, half_way=half_way)


def _voltage(
    rows: Columns, model: StringModel, t_I: Floats, amps: Floats, half_way: bool, notes: list[str]
) -> tuple[Path | None, Terminal | None]:
    """Return the voltage of a cell: that of the string over its cells, unless it clearly is that of a cell."""
    if rows.voltage_V is None:
        return None, None
    known = np.isfinite(rows.voltage_V)
    t, V = rows.time_s[known], rows.voltage_V[known]
    if len(t) < 2:
        return None, None
    usual = _median(V)
    low, high = LITHIUM_VOLTS
    if model.cells > 1 and usual / model.cells < low <= usual <= high:
        notes.append(f"voltage_V is {usual:.3g} V: taken as the mean of the cells, not as the whole string's.")
    else:
        V = V / model.cells
        usual /= model.cells
    low, high = CELL_VOLTS
    if not low <= usual <= high:
        share = f"voltage_V / {model.cells}" if model.cells > 1 else "voltage_V"
        notes.append(f"The voltage is not used: {share}, {usual:.4g} V, is no voltage of a cell.")
        return None, None
    if wild := int(((low > V) | (high < V)).sum()):
        notes.append(
            f"{counted(wild, 'value of voltage_V is', 'values of voltage_V are')} no voltage of a cell and left out."
        )
        keep = (low <= V) & (high >= V)
        t, V = t[keep], V[keep]
    row = np.clip(np.searchsorted(t_I, t, "right") - 1, 0, len(amps) - 1)
    creeps = np.abs(np.diff(amps[row])) <= SAME_CURRENT * float(np.abs(amps).max())
    R_e = model.priors["R_e"]
    terminal = Terminal(t, V, amps[row], float(np.mean(R_e.value)), R_e.rel_sd, chemistry_of(model))
    return path(t, V, creeps | (np.diff(t) > bridged(t)[0]), half_way=half_way), terminal


def _median(x: Floats) -> float:
    """Median; infinite if values are too large for the mean of two of them."""
    with np.errstate(over="ignore"):
        return float(np.median(x))


def _flow(rows: Columns, model: StringModel, notes: list[str]) -> Path | None:
    """Return the flow as a ratio to nominal; a unit other than m³/s is recognised by its factor."""
    if rows.coolant_flow_m3_s is None:
        return None
    known = np.isfinite(rows.coolant_flow_m3_s)
    t, flow = rows.time_s[known], rows.coolant_flow_m3_s[known]
    running = flow[flow > 0.0]
    if len(running) < 2:
        return None
    usual = _median(running)
    nominal = model.flow
    if nominal is None:
        nominal = usual
        notes.append(f"The model names no nominal coolant flow: the median of the record, {usual:.4g} m³/s, is taken.")
    ratio = usual / nominal
    if not 1.0 / FLOW_WITHIN <= ratio <= FLOW_WITHIN:
        unit, factor = min(FLOW_UNITS.items(), key=lambda item: abs(np.log(ratio / item[1])))
        if not 1.0 / FLOW_WITHIN <= ratio / factor <= FLOW_WITHIN:
            notes.append(
                f"The coolant flow is not used: {usual:.4g} m³/s is {ratio:.3g} times the model's nominal flow."
            )
            return None
        notes.append(
            f"The coolant flow is about {ratio:.3g} times the nominal one: it was taken to be in {unit} and converted."
        )
        nominal *= factor
    return path(t, np.maximum(smooth(t, flow), 0.0) / nominal, True)


def _recorded_charge(rows: Columns, notes: list[str]) -> Path | None:
    if rows.soc is None:
        return None
    t, soc = _believable(rows, rows.soc, "soc", "soc", notes)
    return path(t, soc, True) if len(t) > 1 else None
