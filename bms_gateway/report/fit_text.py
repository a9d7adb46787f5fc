"""Results of a fit, as text for people and as JSON."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bms_gateway.diagnosis.calibrate import UNIDENTIFIABLE, Change, ChannelError
from bms_gateway.diagnosis.core_known import KnownCore
from bms_gateway.diagnosis.detect import Combination
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.diagnosis.verdict_parts import Errors
from bms_gateway.identify.contract import FIXED
from bms_gateway.report.core_text import core_document, core_text, numbers_remark
from bms_gateway.report.diagnosis_text import WITH_SD, closer_numbers, finite, told_aside, warned, with_sd
from bms_gateway.report.show import kelvins, text_table

HOLDS = 1.2
"""Greatest error over noise for which a model explains the readings, as in the diagnosis."""


@dataclass(frozen=True, slots=True)
class FitReport:
    """A fit in the form of a report.

    Attributes
    ----------
    out : str
        The written model file.
    sources : tuple of str
    calibrated : bool
    changes : tuple of Change
    products : tuple of Combination
        Products of parameters that are better known than the parameters themselves.
    channels : tuple of ChannelError
    errors : Errors
        Over all thermocouples.
    model_error_K : float
        Model error; 0 if the model explains the readings.
    findings, notes : tuple of (source, …)
    core : KnownCore
        Of the fitted model.
    worse : tuple of str
        Says that the fitted numbers follow the surfaces less closely than those of the earlier model; else empty.
    """

    out: str
    sources: tuple[str, ...]
    calibrated: bool
    changes: tuple[Change, ...]
    products: tuple[Combination, ...]
    channels: tuple[ChannelError, ...]
    errors: Errors
    model_error_K: float
    findings: tuple[tuple[str, Finding], ...]
    notes: tuple[tuple[str, str], ...]
    core: KnownCore
    worse: tuple[str, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether the fitted model explains the readings to within their noise."""
        worst = np.nanmax([self.errors.train_rmse_K, self.errors.heldout_rmse_K])
        return bool(worst <= HOLDS * self.errors.noise_floor_K)


def fit_document(r: FitReport) -> dict[str, Any]:
    """Return the document of `fit --json`."""
    return {
        "model": r.out,
        "tables": list(r.sources),
        "calibrated": r.calibrated,
        "parameters": [change_document(c) for c in r.changes],
        "products": [{"names": list(p.symbols), "rel_sd": p.rel_sd, "apart": dict(p.apart)} for p in r.products],
        "train_rmse_K": finite(r.errors.train_rmse_K),
        "heldout_rmse_K": finite(r.errors.heldout_rmse_K),
        "noise_floor_K": finite(r.errors.noise_floor_K),
        "core": core_document(r.core),
        "model_error_K": finite(r.model_error_K),
        "worse": list(r.worse),
        "sensors": [
            {
                "table": c.source,
                "kind": c.kind,
                "cell": c.cell,
                "train_rmse_K": finite(c.trained_K),
                "heldout_rmse_K": finite(c.held_K),
                "noise_floor_K": finite(c.floor_K),
            }
            for c in r.channels
        ],
        "checks": [{"table": s, "kind": f.kind, "severity": f.severity, "sentence": f.sentence} for s, f in r.findings],
        "notes": [{"table": s, "note": text} for s, text in r.notes],
    }


def change_document(c: Change) -> dict[str, Any]:
    """Return one number of a fit in the form of documents."""
    return {
        "name": c.name,
        "table": c.of or None,
        "unit": c.unit,
        "before": {"value": finite(c.before), "sd": finite(c.before_sd)},
        "after": {"value": finite(c.after), "sd": finite(c.after_sd)},
        "status": c.status,
    }


def fit_text(r: FitReport) -> str:
    """Write the results of a fit for people."""
    several = len(r.sources) > 1
    parts = [_headline(r), *r.worse, *warned(r.findings, several), changes_table(r.changes)]
    if remark := numbers_remark(r.core):
        parts.append(remark)
    if closer := closer_numbers(r.core.identified):
        parts.append(closer)
    if all(c.status == FIXED or c.status.startswith(UNIDENTIFIABLE) for c in r.changes):
        parts.append("These readings teach nothing: no number is known better than before.")
    if r.products:
        parts.append("\n".join(p.sentence for p in r.products))
    parts.append(_errors(r.channels, several))
    parts.append(core_text(r.core))
    if several:
        parts.append(
            "Each record has its own cooling; the model file holds the geometric mean of R_u, and a sd for it "
            "that covers another record's."
        )
    parts += told_aside(r.findings, r.notes, several)
    return "\n\n".join(parts)


def _headline(r: FitReport) -> str:
    e = r.errors
    held = "" if np.isnan(e.heldout_rmse_K) else f", {e.heldout_rmse_K:.3g} K on blocks held out"
    text = f"The error is {e.train_rmse_K:.3g} K{held}; noise alone leaves {e.noise_floor_K:.3g} K."
    if r.holds:
        return f"{text} The fitted model explains these readings."
    return (
        f"{text} The fitted model does not explain these readings: compare shows where, diagnose names what is missing."
    )


def changes_table(changes: Sequence[Change]) -> str:
    """Write numbers before and after."""
    rows = [
        [
            c.name + (f" ({c.of})" if c.of else ""),
            c.unit,
            c.status,
            with_sd(c.before, c.before_sd),
            with_sd(c.after, c.after_sd),
        ]
        for c in changes
    ]
    return text_table(["parameter", "unit", "status", f"before, {WITH_SD}", f"after, {WITH_SD}"], rows, left=3)


def _errors(channels: Sequence[ChannelError], several: bool) -> str:
    rows = [
        [
            *([c.source] if several else []),
            f"{c.kind} {c.cell}",
            kelvins(c.trained_K),
            kelvins(c.held_K),
            kelvins(c.floor_K),
        ]
        for c in channels
    ]
    headers = (["table"] if several else []) + ["error", "fitted K", "held-out K", "noise K"]
    return text_table(headers, rows, left=2 if several else 1)
