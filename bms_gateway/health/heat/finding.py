"""What the watch over heat has found."""

from dataclasses import dataclass

from bms_gateway.health.heat.fault_evidence import Kind


@dataclass(slots=True)
class Finding:
    """Something that is wrong now.

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
        W, of all cells in which it may sit; NaN but for heat.
    sure : float
        Share of the evidence that this cause had when it was told.
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
    sure: float = 1.0
