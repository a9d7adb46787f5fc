"""Details of a diagnosis that its page shows and the terminal does not; for the command and for the workbench."""

from collections.abc import Callable, Sequence

from bms_gateway.diagnosis.adding import cores_with_named
from bms_gateway.diagnosis.compare import Comparison
from bms_gateway.diagnosis.latent import latent
from bms_gateway.diagnosis.record import Record
from bms_gateway.report.diagnosis_text import Told
from bms_gateway.report.examine import usable
from bms_gateway.report.html import Details
from bms_gateway.thermal import StringModel


def details_of(
    told: Told, model: StringModel, records: Sequence[Record], compared: Callable[[], Comparison]
) -> Details | None:
    """Compute the details of a diagnosis; None if the data were not enough for a diagnosis.

    Parameters
    ----------
    told : Told
    model : StringModel
        The model that was diagnosed.
    records : sequence of Record
    compared : callable
        Returns the comparison of this model with these records; called only if there is a diagnosis.
    """
    d = told.diagnosis
    if d is None:
        return None
    return Details(
        comparison=compared(),
        latent=latent(d.search.baseline),
        experiment=told.experiment,
        card=told.shows,
        cores=cores_with_named(model, usable(records, told.findings), d),
    )
