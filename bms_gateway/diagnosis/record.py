"""One record of measurements for comparison and diagnosis: inputs on one grid, readings at their own time stamps.

Conversion of rows to a signal, decided only here:

* A current holds from its row to the next, as in tables of tests and simulations and in `encode`. If rows come in
bursts
  (a tester that logs around each set point) or from a bus, whose frames do not know the steps, a step is put half-way
  between its two rows.
* A voltage steps where its current does and is linear elsewhere; temperatures, flow and charge are always linear.
* Gaps are interpolated and reported. A gap of the current that is too long for this divides the record: both parts are
in
  one row of intervals, separated by one interval for the gap, and each has its own start.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bms_gateway.diagnosis.cell_rows import CellRows
from bms_gateway.diagnosis.grid import Grid, lay_grid
from bms_gateway.diagnosis.record_inputs import Columns, Sampling, Signals, draw_inputs
from bms_gateway.diagnosis.surface_readings import FEWEST, Readings, gather_readings
from bms_gateway.errors import DataError, counted
from bms_gateway.frames.vocabulary import Quantity
from bms_gateway.identify.sensor_noise import Noise, estimate_noise
from bms_gateway.thermal import Floats, StringModel
from bms_gateway.thermal.drive import Drive

HELD_OUT = ((0.22, 0.32), (0.55, 0.65), (0.88, 1.0))
"""Parts of a record, in shares of its length, that are never fitted. The last part tests extrapolation, the inner ones
test interpolation; together they are a third of a record, which leaves enough for the fit."""


@dataclass(frozen=True, slots=True)
class Record:
    """N intervals and N + 1 instants of one string.

    Attributes
    ----------
    source : str
        Name in reports.
    drive : Drive
        Means of the inputs over the intervals.
    instants : ndarray (N + 1,)
        s, on the clock of the source; `drive.dt` apart except across a gap between segments.
    surface : Readings
        Of the m sensors of the model for which the source has data.
    grid : ndarray (N + 1, m)
        The surfaces at the instants, from the readings on both sides; NaN if no reading is near.
    held : ndarray of bool (M,)
        Readings that lie in a held-out part.
    noise : Noise
        Of each sensor.
    core : Readings
        Readings of thermocouples in cores, which no choice of effects may use; empty in most records.
    segments : tuple of int
        Instants, the first being 0, at which the state is unknown. The interval before each, except the first,
        represents a gap and has no information.
    notes : tuple of str
        Sentences on values that were found, interpolated, left out or assumed.
    sampling : Sampling
        Of the current.
    voltages : CellRows or None
        Voltages of single cells, if there were any.
    charge_sd : float
        sd of the level of the state of charge, 0…1; 0 if the charge was recorded.
    unused : tuple of int
        Cells whose surface is in the source, but without a sensor in the model.
    assumed : mapping of quantity to str
        Inputs that nobody measured, and what stands for them, in a few words.
    refused : mapping of cell to str
        Cells whose thermocouple is not to be used, and why.
    unread : mapping of str to tuple of int
        Cells without usable readings of `surface` (although the model has a sensor) or of `core` (although the source
        has a column); quantities that are read on all cells are left out.
    """

    source: str
    drive: Drive
    instants: Floats
    surface: Readings
    grid: Floats
    held: NDArray[np.bool_]
    noise: Noise
    core: Readings
    segments: tuple[int, ...]
    notes: tuple[str, ...]
    sampling: Sampling
    voltages: CellRows | None = None
    charge_sd: float = 0.0
    unused: tuple[int, ...] = ()
    assumed: Mapping[Quantity, str] = field(default_factory=dict)
    refused: Mapping[int, str] = field(default_factory=dict)
    unread: Mapping[str, tuple[int, ...]] = field(default_factory=dict)

    @staticmethod
    def of(rows: Columns, model: StringModel, half_way: bool | None = None) -> "Record":
        """Make a record from columns; see `make_record`.

        Examples
        --------
        >>> from bms_gateway.thermal import Prior
        >>> numbers = {"C_c": 60.0, "C_s": 5.0, "R_e": 0.025, "R_c": 2.0, "R_u": 8.0}
        >>> model = StringModel(1, (1,), "single", {name: Prior(value, 0.3) for name, value in numbers.items()})
        >>> t = np.arange(601.0)
        >>> warm = 25.0 + 3.0 * (1.0 - np.exp(-t / 300.0))
        >>> inlet = np.full(601, 25.0)
        >>> drive = Columns(time_s=t, current_A=15.0 * (t < 300), coolant_inlet_C=inlet, surface_C={1: warm})
        >>> record = Record.of(drive, model)
        >>> record.cells, record.drive.N, record.drive.dt
        ((1,), 600, 1.0)
        """
        return make_record(rows, model, half_way)

    @property
    def cells(self) -> tuple[int, ...]:
        """Cells (from 1) whose surface was measured."""
        return self.surface.cells

    @property
    def sensor(self) -> NDArray[np.intp]:
        """Index into `cells` of each reading (M,)."""
        return self.surface.sensor

    @property
    def left(self) -> NDArray[np.intp]:
        """Instant before each reading (M,)."""
        return self.surface.left

    @property
    def share(self) -> Floats:
        """Position of each reading between its two instants, 0…1 (M,)."""
        return self.surface.share

    @property
    def y(self) -> Floats:
        """The readings, °C (M,)."""
        return self.surface.y


def in_held_out(share: Floats) -> NDArray[np.bool_]:
    """Whether these shares of a record's length lie in a part that is held out."""
    inside = np.zeros(share.shape, np.bool_)
    for first, end in HELD_OUT:
        inside |= (share >= first) & ((share < end) | (end == 1.0))
    return inside


def make_record(rows: Columns, model: StringModel, half_way: bool | None = None) -> Record:
    """Make a record from rows.

    Parameters
    ----------
    rows : Columns
    model : StringModel
        Its sensors, nominal flow and capacity.
    half_way : bool, optional
        Whether a step is half-way between its rows, or at the later one. Default: by the pattern of the stamps.

    Raises
    ------
    DataError
        Time does not increase, or the current, inlet or surface is missing.
    """
    notes: list[str] = []
    source, time_s = rows.source, rows.time_s
    _check_time(source, time_s)
    signals: Signals = draw_inputs(rows, model, half_way, notes)
    grid: Grid = lay_grid(source, signals.current_s, model.cells, notes)
    drive, charge_sd, counted_from = signals.drive(grid, model, notes)
    surface = gather_readings(time_s, rows.surface_C, model.sensors, grid, notes)
    if not len(surface.y):
        wanted = ", ".join(f"surface_{k}_C" for k in model.sensors)
        raise DataError(f"{source}: no sensor of the model ({wanted}) has {FEWEST} readings while the current is known")
    core = gather_readings(time_s, rows.core_C, tuple(range(1, model.cells + 1)), grid, [], what="core")
    noise = estimate_noise(surface.at(grid.instants), surface.y, surface.sensor, len(surface.cells))
    held = in_held_out((surface.left + surface.share) / drive.N)
    return Record(
        source,
        drive,
        grid.instants,
        surface,
        surface.on_grid(grid.instants, drive.dt),
        held,
        noise,
        core,
        grid.segments,
        tuple(notes),
        signals.sampling,
        CellRows(time_s, rows.current_A, rows.cell_voltage_V) if rows.cell_voltage_V else None,
        charge_sd,
        tuple(sorted(set(rows.surface_C) - set(model.sensors))),
        {**rows.assumed, **({"soc": counted_from} if counted_from else {})},
        {k: rows.refused[k] for k in sorted(set(rows.refused) & set(model.sensors))},
        _unread(
            surface=set(model.sensors) - set(surface.cells) - set(rows.refused), core=set(rows.core_C) - set(core.cells)
        ),
    )


def _unread(**cells: set[int]) -> dict[str, tuple[int, ...]]:
    return {what: tuple(sorted(some)) for what, some in cells.items() if some}


def _check_time(source: str, time_s: Floats) -> None:
    if len(time_s) < 2:
        raise DataError(f"{source}: {counted(len(time_s), 'row')}: nothing can be learnt from them")
    back = np.flatnonzero(~(np.diff(time_s) > 0.0))
    if len(back):
        k = int(back[0]) + 1
        raise DataError(f"{source}: row {k + 1}: time_s does not increase ({time_s[k - 1]:.10g} then {time_s[k]:.10g})")
