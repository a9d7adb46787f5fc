"""Results of `fit --cells`, as text for people and as JSON."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.identify.cell_live import CellResult
from bms_gateway.identify.cell_prior import CellSettings
from bms_gateway.identify.cells_in_words import Combination, cell_estimates, combinations
from bms_gateway.report.diagnosis_text import finite, told_aside, warned
from bms_gateway.report.show import number, ranges, text_table
from bms_gateway.thermal import KINDS


@dataclass(frozen=True, slots=True)
class CellsReport:
    """Result of `fit --cells` in the form of a report; `out` is the written model file."""

    out: str
    source: str
    result: CellResult
    settings: CellSettings
    findings: Sequence[tuple[str, Finding]]
    notes: Sequence[tuple[str, str]]


def cells_document(r: CellsReport) -> dict[str, Any]:
    """Return the document of `fit --cells --json`."""
    fit, R_el = r.result.fit, r.result.resistance
    told = cell_estimates(fit, r.settings, R_el)
    kind = KINDS["R_e"]
    return {
        "model": r.out,
        "tables": [r.source],
        "sensed": [k + 1 for k in fit.sensed],
        "cells": [
            {
                "cell": k + 1,
                "R_e": {"value": e.value / kind.to_si, "sd": e.sd / kind.to_si, "unit": e.unit},
                "electrical": finite(R_el[k] / kind.to_si),
                "status": e.status,
            }
            for k, e in enumerate(told)
        ],
        "combinations": [
            {"weights": c.weights.tolist(), "rel_sd_before": c.prior_sd, "rel_sd": c.sd, "determined": c.determined}
            for c in combinations(fit, r.settings)
        ],
        "warning": r.result.warning or None,
        "checks": [{"table": s, "kind": f.kind, "severity": f.severity, "sentence": f.sentence} for s, f in r.findings],
        "notes": [{"table": s, "note": text} for s, text in r.notes],
    }


def cells_text(r: CellsReport) -> str:
    """Write the result for people."""
    fit, R_el = r.result.fit, r.result.resistance
    heard = [k + 1 for k, x in enumerate(R_el) if x == x]
    by = [f"surfaces of cells {ranges([k + 1 for k in fit.sensed])}"]
    by += [f"voltages of cells {ranges(heard)}"] if heard else []
    kind = KINDS["R_e"]
    rows = []
    for k, (e, sd) in enumerate(zip(cell_estimates(fit, r.settings, R_el), fit.rel_sd, strict=True)):
        electrical = [number(R_el[k] / kind.to_si, 3)] if heard else []
        rows.append([str(k + 1), e.status, number(e.value / kind.to_si, 3), f"± {100 * sd:.1f} %", *electrical])
    headers = ["cell", "status", "R_e mΩ", "sd", *(["electrical mΩ"] if heard else [])]
    parts = [
        f"The cells told apart by {' and '.join(by)}.",
        *warned(r.findings, several=False),
        text_table(headers, rows, left=2),
        _told(combinations(fit, r.settings)),
    ]
    if r.result.warning:
        parts.append(r.result.warning[0].upper() + r.result.warning[1:] + ".")
    parts += told_aside(r.findings, r.notes, several=False)
    return "\n\n".join(parts)


def _told(found: Sequence[Combination]) -> str:
    lines = [f"  {c.text()}" for c in found if c.determined]
    left = len(found) - len(lines)
    if not lines:
        return "The surfaces determine no combination of the cells' R_e."
    if left:
        lines.append(f"  {left} more: not determined")
    return "\n".join(["What the surfaces determine of the cells' R_e:", *lines])
