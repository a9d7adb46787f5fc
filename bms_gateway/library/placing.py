"""Where to put surface sensors: `place`, with the numbers and words of the command."""

from dataclasses import dataclass
from typing import Any

from bms_gateway.errors import UsageError
from bms_gateway.report.sensors_text import PlaceReport, place_document, place_text
from bms_gateway.sensors.placement import Placement, PlacementProblem, observable_sets
from bms_gateway.thermal import Condition, Disturbance, StringModel, StringParameters

__all__ = ["AskedString", "Placed", "place", "placed_on"]


@dataclass(frozen=True, slots=True)
class AskedString:
    """A string on which sensors are to be placed.

    Attributes
    ----------
    parameters : StringParameters
    condition : Condition
    sensors : tuple of int or None
        Of the model file.
    disturbance : Disturbance
    origin : str
        Source of the numbers, for the text.
    """

    parameters: StringParameters
    condition: Condition
    sensors: tuple[int, ...] | None
    disturbance: Disturbance
    origin: str


@dataclass(frozen=True, slots=True)
class Placed:
    """Places for sensors. `str()` is the text that the command `place` prints.

    Attributes
    ----------
    report : PlaceReport
    """

    report: PlaceReport

    @property
    def best(self) -> tuple[Placement, ...]:
        """Sets of sensors, best first: `sensors` (cells from 1), `core_sd` (n,) K, `worst_cell`, `worst_sd`."""
        return self.report.placements.best

    @property
    def reached(self) -> bool:
        """Whether the wanted standard deviation can be reached; True if none was given."""
        r = self.report
        return r.wanted is None or r.enough is None or r.enough.worst_sd <= r.wanted

    def document(self) -> dict[str, Any]:
        """Return what `place --json` writes."""
        return place_document(self.report)

    def __str__(self) -> str:
        return place_text(self.report)


def place(
    model: StringModel,
    sensors: int | None = None,
    *,
    wanted_K: float | None = None,
    disturbance: Disturbance | None = None,
) -> Placed:
    """Find the cells on which sensors leave the least certain core best known, as the command `place` does.

    Parameters
    ----------
    model : StringModel
        Its numbers and condition; its own sensors do not count.
    sensors : int, optional
        How many to place.
    wanted_K : float, optional
        Standard deviation that no core should exceed, K: tells how many sensors it takes.
    disturbance : Disturbance, optional
        What is unknown: heat, inlet, noise of the readings.

    Returns
    -------
    Placed

    Raises
    ------
    UsageError
        Neither number is given, or the string cannot have this number.

    Examples
    --------
    >>> from bms_gateway.library.models import cell_model
    >>> pack = cell_model("21700 5Ah 69g 25mOhm", cells=5, sensors=(), condition="natural")
    >>> place(pack, 2).best[0].sensors
    (2, 4)
    """
    if sensors is None and wanted_K is None:
        raise UsageError("place: how many sensors, or wanted_K, how well every core is to be known")
    if wanted_K is not None and not 0.0 < wanted_K <= 1e3:
        raise UsageError(f"place: wanted_K {wanted_K:g}: a standard deviation in K, above 0")
    unknown = Disturbance() if disturbance is None else disturbance
    asked = AskedString(model.nominal, model.condition, model.sensors, unknown, "the model")
    return placed_on(asked, sensors, wanted_K)


def placed_on(asked: AskedString, sensors: int | None, wanted_K: float | None) -> Placed:
    """Place sensors on a string; `place` has checked the arguments."""
    problem = PlacementProblem(asked.parameters, asked.disturbance)
    enough = None if wanted_K is None else problem.fewest(wanted_K)
    count = sensors if sensors is not None else max(1, len(enough.sensors) if enough else 1)
    placements = problem.best(count)
    exact, paper = observable_sets(asked.parameters, count)
    report = PlaceReport(placements, exact, paper, wanted_K, enough, asked.condition, asked.disturbance, asked.origin)
    return Placed(report)
