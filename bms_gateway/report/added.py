"""The report of an addition: what `add` prints and the workbench shows."""

from collections.abc import Sequence
from dataclasses import replace

from bms_gateway.diagnosis.adding import Addition
from bms_gateway.diagnosis.calibrate import changes, channel_errors
from bms_gateway.diagnosis.core_check import core_checks
from bms_gateway.diagnosis.core_known import KnownCore
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.diagnosis.verdict_parts import errors
from bms_gateway.report.add_text import AddReport, Side
from bms_gateway.report.core_text import file_heading
from bms_gateway.report.words import in_words


def added_report(
    addition: Addition,
    records: Sequence[Record],
    findings: tuple[tuple[str, Finding], ...],
    notes: tuple[tuple[str, str], ...],
    *,
    out: str,
    force: bool = False,
) -> AddReport:
    """Make the report of an addition.

    Parameters
    ----------
    addition : Addition
    records : sequence of Record
        The records to which it was fitted.
    findings, notes : tuple of (source, …)
    out : str
        Model file that is written if the measurements support the addition.
    force : bool
        Whether it is written in any case.
    """
    before, after = (_side(records, core) for core in addition.core)
    return AddReport(
        out,
        addition.added,
        not addition.refused or force,
        bool(addition.refused) and force,
        addition.refused,
        addition.remark,
        addition.log_odds,
        before,
        after,
        changes(addition.fits[1], doubted=after.core.numbers_doubted),
        tuple(m.source for m in addition.after.problem.records),
        findings,
        notes,
    )


def heading(report: AddReport, words: Sequence[str]) -> str:
    """Write the heading of the model file: what was added, fitted to which data, and whether by force."""
    text = f"{' '.join(words)} added, fitted to {', '.join(report.sources)}"
    return file_heading("\n".join([text, *(in_words(t) for t in report.though)]), report.after.core)


def _side(records: Sequence[Record], core: KnownCore) -> Side:
    fit = core.identified.fit
    found = replace(errors(fit), closest_K=errors(core.identified.closest).heldout_rmse_K)
    return Side(found, channel_errors(fit), core, core_checks(records, fit, core.bands))
