"""Effect of an addition on a model's errors, as text for people and as JSON."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bms_gateway.diagnosis.adding import FORCED
from bms_gateway.diagnosis.calibrate import Change, ChannelError
from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.core_check import CoreCheck
from bms_gateway.diagnosis.core_known import KnownCore
from bms_gateway.diagnosis.error_words import course
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.diagnosis.verdict_parts import Errors
from bms_gateway.diagnosis.verdict_words import by_numbers
from bms_gateway.report.core_text import NOT_PROVEN, core_document, core_text, numbers_remark
from bms_gateway.report.diagnosis_text import errors_document, finite, told_aside, warned
from bms_gateway.report.fit_text import change_document, changes_table
from bms_gateway.report.show import kelvins, number, text_table
from bms_gateway.report.step_names import REFITTED, with_added
from bms_gateway.report.words import labelled, named_all


@dataclass(frozen=True, slots=True)
class Side:
    """A model before or after.

    Attributes
    ----------
    errors : Errors
    channels : tuple of ChannelError
    core : KnownCore
    checks : tuple of CoreCheck
        Thermocouples in cores that no fit has used.
    """

    errors: Errors
    channels: tuple[ChannelError, ...]
    core: KnownCore
    checks: tuple[CoreCheck, ...] = ()


@dataclass(frozen=True, slots=True)
class AddReport:
    """An addition in the form of a report.

    Attributes
    ----------
    out : str
    added : tuple of Candidate
    written, forced : bool
        Whether the model was written, and whether despite a reason against it.
    refused, remark : str
    log_odds : float
    before, after : Side
    changes : tuple of Change
    sources : tuple of str
    findings, notes : tuple of (source, …)
    """

    out: str
    added: tuple[Candidate, ...]
    written: bool
    forced: bool
    refused: str
    remark: str
    log_odds: float
    before: Side
    after: Side
    changes: tuple[Change, ...]
    sources: tuple[str, ...]
    findings: tuple[tuple[str, Finding], ...]
    notes: tuple[tuple[str, str], ...]

    @property
    def held_K(self) -> tuple[float, float]:
        """Error before and after on readings that were not fitted."""
        return self.before.errors.heldout_rmse_K, self.after.errors.heldout_rmse_K

    @property
    def tag(self) -> str:
        """The outcome in two or three words."""
        if not self.written:
            return "Not added"
        how = "Added by force" if self.forced else "Added"
        return how if self.after.core.proven else f"{how}, {NOT_PROVEN}"

    @property
    def though(self) -> tuple[str, ...]:
        """What speaks against effects that were added by force, unless it is a reason against the core already."""
        said = f"{FORCED}: {self.refused}."
        return (said,) if self.forced and said not in self.after.core.why else ()

    @property
    def names(self) -> str:
        """Names of the added effects, for a sentence."""
        return " and ".join(c.key for c in self.added)


def add_document(r: AddReport) -> dict[str, Any]:
    """Return the document of `add --json`."""
    return {
        "added": r.written,
        "forced": r.forced,
        "refused": r.refused or None,
        "remark": r.remark or None,
        "model": r.out if r.written else None,
        "effects": [{"effect": c.name, "cell": c.cell} for c in r.added],
        "evidence": finite(r.log_odds),
        "before": errors_document(r.before.errors),
        "after": errors_document(r.after.errors),
        "noise_floor_K": finite(r.before.errors.noise_floor_K),
        "sensors": [
            {
                "table": b.source,
                "kind": b.kind,
                "cell": b.cell,
                "before": {"train_rmse_K": finite(b.trained_K), "heldout_rmse_K": finite(b.held_K)},
                "after": {"train_rmse_K": finite(a.trained_K), "heldout_rmse_K": finite(a.held_K)},
                "noise_floor_K": finite(b.floor_K),
            }
            for b, a in zip(r.before.channels, r.after.channels, strict=True)
        ],
        "core": core_document(r.after.core),
        "core_before": core_document(r.before.core),
        "core_95_K": {
            "before": [finite(x) for x in r.before.core.half_width_K.tolist()],
            "after": [finite(x) for x in r.after.core.half_width_K.tolist()],
        },
        "core_measured": [
            {"table": r.sources[b.record], "cell": b.cell, "before": _measured_core(b), "after": _measured_core(a)}
            for b, a in zip(r.before.checks, r.after.checks, strict=True)
        ],
        "parameters": [change_document(c) for c in r.changes],
        "tables": list(r.sources),
        "checks": [{"table": s, "kind": f.kind, "severity": f.severity, "sentence": f.sentence} for s, f in r.findings],
        "notes": [{"table": s, "note": text} for s, text in r.notes],
    }


def _measured_core(c: CoreCheck) -> dict[str, Any]:
    return {"rmse_K": finite(c.rmse_K), "mean_K": finite(c.bias_K)}


def add_text(r: AddReport) -> str:
    """Write the result of the addition for people: errors, cores, numbers."""
    several = len(r.sources) > 1
    parts = [
        labelled(f"{r.tag}. {headline(r)}"),
        *warned(r.findings, several),
        f"Before: {REFITTED}. After: {with_added(named_all(c.key for c in r.added), forced=r.forced)}.",
        _errors(r, several),
        _cores(r),
        labelled(core_text(r.after.core)),
        *_core_errors(r, several),
        changes_table(r.changes),
        *([remark] if (remark := numbers_remark(r.after.core)) else []),
    ]
    if r.remark:
        parts.append(labelled(r.remark))
    parts += [labelled(text) for text in r.though]
    parts += told_aside(r.findings, r.notes, several)
    return "\n\n".join(parts)


def headline(r: AddReport) -> str:
    """Say what the addition does to the error, and what other numbers of the model before it do alone."""
    where = "held-out error"
    before, after = r.held_K
    if np.isnan(after):  # nothing was held out
        where, before, after = "error", r.before.errors.train_rmse_K, r.after.errors.train_rmse_K
    names = named_all(c.key for c in r.added)
    return (
        f"With {names} the {where} {course(before, after, kelvins)}; "
        f"noise alone leaves {kelvins(r.before.errors.noise_floor_K)} K."
        f"{by_numbers(r.before.errors, len(r.added), kelvins)}"
    )


def _errors(r: AddReport, several: bool) -> str:
    rows = [
        [
            *([b.source] if several else []),
            f"{b.kind} {b.cell}",
            *_numbers(b.trained_K, a.trained_K, b.held_K, a.held_K, b.floor_K),
        ]
        for b, a in zip(r.before.channels, r.after.channels, strict=True)
    ]
    b, a = r.before.errors, r.after.errors
    total = _numbers(b.train_rmse_K, a.train_rmse_K, *r.held_K, b.noise_floor_K)
    rows.append([*([""] if several else []), "all", *total])
    headers = ["error K", "fitted before", "after", "held-out before", "after", "noise"]
    return text_table((["table"] if several else []) + headers, rows, left=2 if several else 1)


def _numbers(*values: float) -> Sequence[str]:
    return [kelvins(x) for x in values]


def _cores(r: AddReport) -> str:
    pairs = zip(r.before.core.half_width_K.tolist(), r.after.core.half_width_K.tolist(), strict=True)
    rows = [[f"cell {k}", number(b), number(a)] for k, (b, a) in enumerate(pairs, start=1)]
    return text_table(["core, ± 95 % K", "before", "after"], rows)


def _core_errors(r: AddReport, several: bool) -> Iterator[str]:
    """Say how the models agree with thermocouples in cores, which were not fitted."""
    if not r.after.checks:
        return
    rows = [
        [
            *([r.sources[b.record]] if several else []),
            f"cell {b.cell}",
            *_numbers(b.rmse_K, a.rmse_K, b.bias_K, a.bias_K),
        ]
        for b, a in zip(r.before.checks, r.after.checks, strict=True)
    ]
    headers = ["core thermocouple, not used", "error K before", "after", "mean K before", "after"]
    yield text_table((["table"] if several else []) + headers, rows, left=2 if several else 1)
