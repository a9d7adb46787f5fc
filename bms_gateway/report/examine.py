"""From records to a complete diagnosis: checks, verdict, what the parameters absorb, what to measure next."""

from collections.abc import Sequence

import numpy as np

from bms_gateway.diagnosis.candidates import candidates
from bms_gateway.diagnosis.checks import check_record
from bms_gateway.diagnosis.core_known import known_core
from bms_gateway.diagnosis.curve import Curve, entropic_curve
from bms_gateway.diagnosis.detect import Card, absorbed, detectability
from bms_gateway.diagnosis.diagnosis import Diagnosis, diagnose
from bms_gateway.diagnosis.experiment import Experiment, next_experiment
from bms_gateway.diagnosis.findings import tie_sentences
from bms_gateway.diagnosis.offer import Offer, offer
from bms_gateway.diagnosis.ranking import ranking
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.diagnosis.search import Progress
from bms_gateway.errors import DataError
from bms_gateway.identify.map_fit import MapFit, stacked
from bms_gateway.report.diagnosis_text import Told
from bms_gateway.thermal import StringModel

SEARCH = 0.85
"""Share of the work of a diagnosis that is the search."""


def findings_and_notes(
    model: StringModel, records: Sequence[Record]
) -> tuple[tuple[tuple[str, Finding], ...], tuple[tuple[str, str], ...]]:
    """Check the records, and collect the notes of their reading; each with its source."""
    findings = tuple((r.source, f) for r in records for f in check_record(r, model))
    return findings, tuple((r.source, text) for r in records for text in r.notes)


def sound(findings: Sequence[tuple[str, Finding]]) -> None:
    """Refuse records from which nothing can be learnt.

    Raises
    ------
    DataError
    """
    for source, f in findings:
        if f.severity == "stop":
            raise DataError(f"{source}: {f.sentence}")


def long_enough(findings: Sequence[tuple[str, Finding]]) -> None:
    """Refuse records that are too short, or have too few readings, even for a comparison.

    Raises
    ------
    DataError
    """
    sound([(source, f) for source, f in findings if f.kind in ("too_short", "too_few")])


def examine(model: StringModel, records: Sequence[Record], progress: Progress | None = None) -> Told:
    """Check records, and diagnose a model with the usable ones.

    Parameters
    ----------
    model : StringModel
        The model; the diagnosis starts from its numbers before any data.
    records : sequence of Record
    progress : callable, optional
        Called with the share of the work done, and the present step.
    """
    findings, notes = findings_and_notes(model, records)
    sources = tuple(r.source for r in records)
    some = usable(records, findings)
    if not some:
        why = " ".join(dict.fromkeys(f.sentence for _, f in findings if f.severity == "stop"))
        return Told(None, f"Nothing can be said from these data. {why}", sources, findings, notes)
    tell = progress or (lambda _share, _text: None)
    d = diagnose(model.unfitted, some, progress=lambda share, text: tell(SEARCH * share, text))
    tell(SEARCH, "finding which effects these records could show")
    shown, experiment = card_of(d.search.baseline), experiment_of(d)
    taken = absorbed(d.identified[0].fit)
    tell(0.9, "finding the band of the core")
    core = known_core(model, some, d.identified[0], d.search)
    tell(0.93, "finding what the records say of named effects")
    curve = curve_of(d, some)
    tell(0.95, "finding what may be added")
    may = offer_of(d, some, findings)
    tell(1.0, "done")
    return Told(
        d,
        " ".join([d.sentence, *tie_sentences(model)]),
        sources,
        findings,
        notes,
        taken.everything,
        _next(d, experiment),
        shown.sentences,
        ranking(d),
        core,
        curve,
        shown,
        experiment,
        may,
    )


def offer_of(d: Diagnosis, records: Sequence[Record], findings: Sequence[tuple[str, Finding]]) -> Offer:
    """Return what of a verdict `add` accepts with the same records, the unusable ones too."""
    try:
        sound(findings)
    except DataError as e:
        return Offer((), tuple(s.candidate.key for s in d.selected), str(e).rstrip("."))
    return offer(d, records)


def curve_of(d: Diagnosis, records: Sequence[Record]) -> Curve | None:
    """Compute dU/dT over the state of charge if entropic heat is named and the records determine a curve."""
    if all(s.candidate.name != "entropic_heat" for s in d.selected):
        return None
    charge_sd = max(r.charge_sd for r in records)
    if d.second is not None and d.decided_by_second:
        return entropic_curve(d.second.best, charge_sd, d.second.settings.fine)
    return entropic_curve(d.search.final, charge_sd)


def usable(records: Sequence[Record], findings: Sequence[tuple[str, Finding]]) -> list[Record]:
    """Leave out the records from which nothing can be learnt."""
    stopped = {source for source, f in findings if f.severity == "stop"}
    return [r for r in records if r.source not in stopped]


def card_of(fit: MapFit) -> Card:
    """Compute which effects the records of a fit could show."""
    y = stacked(fit.problem)[0]
    surfaces = float(np.quantile(y, 0.05)), float(np.quantile(y, 0.95))
    return detectability(fit, candidates(fit.problem.model, fit.problem.records[0].drive, surfaces))


ANOTHER_COOLING = (
    "Record the same cell under another cooling (with a fan, in still air) and diagnose both records together: cells "
    "that share their physics disagree where one record alone looks right with a wrong core."
)


def experiment_of(d: Diagnosis) -> Experiment | None:
    """Plan the next measurement; None if the second search of a single cell decided, or no question is left."""
    if d.second is not None and d.search.baseline.problem.model.cells == 1:
        return None
    return next_experiment(d.search, uncertain=d.unknown_remains or d.verdict in ("undecidable", "unknown_effect"))


def _next(d: Diagnosis, found: Experiment | None) -> str | None:
    if d.second is not None and len(d.second.records) == 1 and d.search.baseline.problem.model.cells == 1:
        return ANOTHER_COOLING
    return found.sentence if found else None
