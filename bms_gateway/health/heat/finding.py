"""A finding of the watch over heat, and what a step showed."""

from dataclasses import dataclass
from typing import NamedTuple

from bms_gateway.health.heat.fault_evidence import Kind
from bms_gateway.health.heat.layout import Bools
from bms_gateway.thermal import Floats


@dataclass(slots=True)
class Finding:
    """A fault that exists now.

    Attributes
    ----------
    code : str
        `unexplained_heat`, `missing_heat`, `cooling`, `inlet`, `thermocouple`.
    cell : int or None
        1-based.
    level : int
        1 warning, 2 alarm.
    since_ns : int
    text : str
    heat, heat_sd : float
        W, if all of it is in `cell`; NaN for other faults than heat.
    warmest : float
        K, the greatest gap between the cell's surface and the coolant since heat was found.
    beside : bool
        `warmest` is that gap beside the gaps of the cells without heat.
    hottest : float
        °C, the greatest estimate of the cell's surface since heat was found.
    colder_ns : int or None
        Since when the readings show that the cell would be cooled.
    still_s : float
        s for which a frozen inlet has read the same, or, longer than is usual, the thermocouple of a fault; else 0.
    sure : float
        Probability of this cause when the finding was reported.
    """

    code: str
    cell: int | None
    level: int
    since_ns: int
    text: str = ""
    heat: float = float("nan")
    heat_sd: float = float("nan")
    kind: Kind = Kind.HEAT
    place: int = 0
    places: tuple[int, ...] = ()
    others: tuple[tuple[str, float], ...] = ()
    low_ns: int | None = None
    size: float = 0.0
    warmest: float = 0.0
    beside: bool = False
    hottest: float = -273.15
    colder_ns: int | None = None
    still_s: float = 0.0
    sure: float = 1.0


class SeenStep(NamedTuple):
    """What the last step of one string showed.

    Attributes
    ----------
    read : ndarray of bool (m,)
        Thermocouples that were used.
    gaps : ndarray (m,), K
        Surfaces over the coolant, at the thermocouples.
    cools : bool
        Whether no current flows and all thermocouples fall: few thermocouples then cannot show heat.
    age_s : float
        s since the state was found anew.
    inlet : bool
        The inlet is read.
    """

    read: Bools
    gaps: Floats
    cools: bool
    age_s: float
    inlet: bool = True


def held(since_ns: int | None, now_ns: int, dt: float, wait_s: float) -> bool:
    """Return whether what began at `since_ns`, if it has begun, has `lasted` for `wait_s`."""
    return since_ns is not None and lasted(since_ns, now_ns, dt) >= wait_s


def lasted(since_ns: int, now_ns: int, dt: float) -> float:
    """Return the s since the beginning of the step of `dt` seconds that ended at `since_ns`; steps may be long."""
    return (now_ns - since_ns) * 1e-9 + dt
