"""The proposal: the role of each signal, whether it is sure, and why."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

from bms_gateway.config.units import signal_conversion
from bms_gateway.errors import ConfigError
from bms_gateway.frames.signal_info import SignalInfo
from bms_gateway.frames.vocabulary import Quantity
from bms_gateway.setup.signal_series import Series

Role = Quantity


@dataclass(slots=True)
class Proposed:
    """One signal and its role.

    Attributes
    ----------
    series : Series
        Already read with the `overrides`.
    factor, shift : float
        SI (A discharge positive, V, °C, 0…1, m³/s) = factor · DBC's value + shift.
    string, index : int or None
        From 1; None for a signal of the whole pack, or of no string.
    overrides : dict
        Keys of the config that correct the DBC: `minimum`, `maximum`, `byte_order`, `signed`.
    statistic : str or None
        `max`, `min` or `mean` for a reading of several cells; without `index` of all cells of the string.
    against : list of str
        Reasons from other signals against it.
    way : str or None
        `discharge` or `charge` for one of the two signals of a current.
    halves : tuple of Proposed
        Both signals of such a current; `series` is then their sum.
    """

    role: Role
    series: Series
    factor: float = 1.0
    shift: float = 0.0
    string: int | None = None
    index: int | None = None
    sure: bool = False
    why: list[str] = field(default_factory=list)
    overrides: dict[str, float | str | bool] = field(default_factory=dict)
    statistic: str | None = None
    against: list[str] = field(default_factory=list)
    way: str | None = None
    halves: tuple["Proposed", ...] = ()

    @property
    def single(self) -> tuple["Proposed", ...]:
        """The signals one by one: both halves of a current that two signals carry, or this one."""
        if not self.halves:
            return (self,)
        return tuple(
            replace(h, sure=self.sure, string=self.string, why=[*self.why, *h.why], against=self.against)
            for h in self.halves
        )

    @property
    def path(self) -> str:
        """Name as the config writes it."""
        return self.series.path

    @property
    def written(self) -> tuple[float, float]:
        """Scale and offset for the config, which converts by the DBC's unit on its own."""
        return config_scale(self.role, self.series.info, self.factor, self.shift)

    @property
    def observed(self) -> tuple[float, float]:
        """Least and greatest value, SI (°C)."""
        ends = sorted(self.factor * x + self.shift for x in (self.series.x.min(), self.series.x.max()))
        return float(ends[0]), float(ends[1])

    @property
    def resolution(self) -> float:
        """Smallest step, SI (K)."""
        return abs(self.factor) * self.series.step


@dataclass(slots=True)
class Proposal:
    """The proposal for a vehicle.

    Attributes
    ----------
    signals : list of Proposed
    unused : list of (signal, why)
        Signals that were considered for a role and are not used.
    cells : list of int
        Cells of each string.
    series_cells : int or None
        Cells in series of the whole pack; None if unknown.
    series_guessed : bool
        No voltages of cells show this number: it rests on the usual voltage of a cell.
    resistance : float or None
        Resistance of the pack, Ω, from the steps of its voltage and current.
    heat_resistance : float or None
        Effective resistance of the pack for its heat over the log, Ω, polarisation included.
    against_cell : list of str
        Reasons from the log against the cell that was named.
    remarks : list of str
    refused : set of str
        Thermocouples that are not used; the reasons are in `unused`.
    numbered : set of int
        Strings whose cells are numbered as in the names; their cells without a thermocouple are kept.
    """

    signals: list[Proposed] = field(default_factory=list)
    unused: list[tuple[str, str]] = field(default_factory=list)
    cells: list[int] = field(default_factory=list)
    series_cells: int | None = None
    series_guessed: bool = False
    resistance: float | None = None
    heat_resistance: float | None = None
    against_cell: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    refused: set[str] = field(default_factory=set)
    numbered: set[int] = field(default_factory=set)

    def of(self, role: Role, string: int | None = None) -> Iterator[Proposed]:
        """Signals of a role, of one string (with those of the whole pack) or of all."""
        for p in self.signals:
            if p.role == role and (string is None or p.string in (string, None)):
                yield p

    def leave_out(self, refused: Mapping[str, str]) -> None:
        """Remove thermocouples, note the reason of each, and renumber the cells and strings that remain."""
        places: dict[tuple[int, int], tuple[int, int]] = {}
        remaining: list[int] = []
        numbered: set[int] = set()
        for string in range(1, len(self.cells) + 1):
            mine = [p for p in self.signals if p.role == "surface" and p.string == string and p.path not in refused]
            if mine:
                kept = string in self.numbered or mine[0].index is None  # cells that no name counts
                remaining.append(self.cells[string - 1] if kept else len(mine))
            for k, p in enumerate(sorted(mine, key=lambda p: p.index or 0), 1):
                places[string, p.index or 0] = len(remaining), (p.index or k) if string in self.numbered else k
            if mine and string in self.numbered:  # the voltage of a cell without a thermocouple is kept
                for k in range(1, self.cells[string - 1] + 1):
                    places.setdefault((string, k), (len(remaining), k))
                numbered.add(len(remaining))
        self.numbered = numbered
        self.unused += [(path, why) for path, why in refused.items()]
        self.refused |= set(refused)
        self.signals = [p for p in self.signals if not (p.role == "surface" and p.path in refused)]
        numbers = {old: new for (old, _), (new, _) in places.items()}
        for p in self.signals:
            if p.index is not None and p.string is not None:
                p.string, p.index = places.get((p.string, p.index), (None, p.index))
            elif p.string is not None:
                p.string = numbers.get(p.string, 0)
        self.signals = [p for p in self.signals if p.string != 0]
        self.cells = remaining


def config_scale(role: Role, info: SignalInfo, factor: float, shift: float) -> tuple[float, float]:
    """Scale and offset for a config: what remains of `factor` and `shift` after the conversion by the DBC's unit.

    Raises
    ------
    ConfigError
        The DBC's unit is that of another quantity: no config may name the signal for this role.

    Examples
    --------
    A DBC that says K needs nothing more to give °C: ``config_scale("surface", info, 1.0, -273.15)`` is (1.0, 0.0).
    """
    c, d = signal_conversion(role, info.unit)
    scale = factor / c
    offset = shift - scale * d
    return float(f"{scale:.12g}"), (0.0 if abs(offset) < 1e-9 * max(abs(d), 1.0) else float(f"{offset:.12g}"))


def fits(role: Role, info: SignalInfo) -> bool:
    """Whether a config may name the signal for the role, by the unit that the DBC prints."""
    try:
        signal_conversion(role, info.unit)
    except ConfigError:
        return False
    return True
