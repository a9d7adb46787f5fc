"""A comparison of measurement and model, as text for people and as JSON."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bms_gateway.diagnosis.calibrate import Identified, changes
from bms_gateway.diagnosis.compare import Comparison, Variant
from bms_gateway.diagnosis.core_band import CoreBand, half_width_K, typical_K
from bms_gateway.diagnosis.core_check import CoreCheck
from bms_gateway.diagnosis.misfit import Level
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.diagnosis.regimes import Regime
from bms_gateway.report.core_text import UNKNOWN_K, core_document, core_text
from bms_gateway.report.diagnosis_text import LEFT, closer_numbers, finite, told_aside, warned
from bms_gateway.report.fit_text import change_document
from bms_gateway.report.show import kelvins, number, text_table
from bms_gateway.report.step_names import FILED, REFITTED, titled

STEPS: Mapping[str, str] = {"filed": FILED, "refitted": REFITTED}
"""Of the documents' keys, which stay as they are."""
NOT_REFITTED = "Refitted to these data the model is not shown: nothing can be learnt from them."
LEAST_SHARE = 0.05
"""Least share of the excess error for which a regime is listed."""


def comparison_document(
    c: Comparison, findings: Sequence[tuple[str, Finding]], notes: Sequence[tuple[str, str]]
) -> dict[str, Any]:
    """Return the document of `compare --json`."""
    return {
        "tables": list(c.sources),
        "filed": _variant(c.filed),
        "refitted": _variant(c.refitted),
        "closest": _variant(c.closest) if c.closest else None,
        "parameters": [change_document(x) for x in changes(c.refitted.fit, doubted=c.core.numbers_doubted)],
        "core": core_document(c.core),
        "checks": [{"table": s, "kind": f.kind, "severity": f.severity, "sentence": f.sentence} for s, f in findings],
        "notes": [{"table": s, "note": text} for s, text in notes],
    }


def _variant(v: Variant) -> dict[str, Any]:
    return {
        "train_rmse_K": finite(v.trained.rmse_K),
        "heldout_rmse_K": finite(v.held.rmse_K),
        "noise_floor_K": finite(v.trained.floor_K),
        "structure": {"size_sigma": finite(v.structure.size), "z": finite(v.structure.z)},
        "sensors": [
            {
                "cell": s.cell,
                "train_rmse_K": finite(s.trained.rmse_K),
                "heldout_rmse_K": finite(s.held.rmse_K),
                "noise_floor_K": finite(s.trained.floor_K),
                "structured_K": finite(s.structured_K),
                "z": finite(s.z),
                "share_of_excess": finite(s.share),
                "worst": {
                    "table": s.worst.record,
                    "time_s": finite(s.worst.time_s),
                    "error_K": finite(s.worst.error_K),
                },
                "regimes": [_regime(r) for r in s.regimes],
            }
            for s in v.sensors
        ],
        "explained_by": dict(v.explained),
        "blocks": [
            {
                "table": b.record,
                "first_s": finite(b.first_s),
                "last_s": finite(b.last_s),
                "share_of_excess": finite(b.share),
                "rmse_K": finite(b.rmse_K),
            }
            for b in v.blocks
        ],
        "core": [
            {
                "table": b.record,
                "max_C": _column(b.T_c.max(axis=0)),
                "sd_K": _column(typical_K([x.total_K for x in v.cores])),
                "centre_max_C": _column(b.T_centre.max(axis=0)),
                "centre_sd_K": _column(typical_K([x.centre_sd_K for x in v.cores])),
            }
            for b in v.cores
        ],
        "core_measured": [_core(x) for x in v.core_checks],
        "findings": list(v.findings),
    }


def _regime(r: Regime) -> dict[str, Any]:
    return {
        "feature": r.feature,
        "unit": r.unit,
        "share_of_excess": finite(r.share),
        "bins": [
            {
                "label": b.label,
                "low": finite(b.low),
                "high": finite(b.high),
                "readings": b.readings,
                "mean_K": finite(b.mean_K),
                "sd_K": finite(b.sd_K),
                "rmse_K": finite(b.rmse_K),
            }
            for b in r.bins
        ],
    }


def _core(x: CoreCheck) -> dict[str, Any]:
    return {
        "table": x.record,
        "cell": x.cell,
        "rmse_K": finite(x.rmse_K),
        "bias_K": finite(x.bias_K),
        "inside_95": finite(x.covered),
    }


def _column(x: np.ndarray) -> list[float | None]:
    return [finite(v) for v in x.tolist()]


def comparison_text(c: Comparison, findings: Sequence[tuple[str, Finding]], notes: Sequence[tuple[str, str]]) -> str:
    """Write a comparison for people: the findings, per sensor, per regime, and the cores."""
    several = len(c.sources) > 1
    parts = [*warned(findings, several), _variant_text(c.filed, several)]
    if {source for source, f in findings if f.severity == "stop"}.issuperset(c.sources):
        parts.append(NOT_REFITTED)
    else:
        parts.append(_variant_text(c.refitted, several))
        parts += [_closest_text(c.closest, c.core.identified)] if c.closest else []
    parts.append(core_text(c.core))
    parts += told_aside(findings, notes, several)
    return "\n\n".join(parts)


def _variant_text(v: Variant, several: bool) -> str:
    parts = [f"{titled(STEPS[v.name])}.", *_where(v), "", _cores(v.cores, several)]
    if v.core_checks:
        parts += ["", _measured_cores(v.core_checks, several)]
    return "\n".join(parts)


def _closest_text(v: Variant, found: Identified) -> str:
    return "\n".join([f"{closer_numbers(found)} {LEFT}", *_where(v)])


def _where(v: Variant) -> list[str]:
    """Write at which sensor, when and in which regime a model fails."""
    parts = [*v.findings, "", _sensors(v)]
    regimes = [r for r in v.explained if r[1] >= LEAST_SHARE]
    if regimes:
        titles = {r.feature: r.title for s in v.sensors for r in s.regimes}
        rows = [[titles.get(feature, feature), f"{100 * share:.0f} %"] for feature, share in regimes]
        parts += ["", text_table(["the error above the noise follows", "share"], rows)]
    return parts


def _sensors(v: Variant) -> str:
    rows = [
        [
            f"cell {s.cell}",
            kelvins(s.trained.rmse_K),
            kelvins(s.held.rmse_K),
            kelvins(s.trained.floor_K),
            kelvins(s.structured_K),
            number(s.z, 1),
            f"{s.worst.error_K:+.2f} at {s.worst.time_s / 60:.0f} min",
        ]
        for s in v.sensors
    ]
    if len(v.sensors) > 1:
        rows.append(["all", *(kelvins(x.rmse_K) for x in (v.trained, v.held)), _floor(v.trained), "", "", ""])
    headers = ["surface", "fitted K", "held-out K", "noise K", "structured K", "z", "worst K"]
    return text_table(headers, rows)


def _floor(level: Level) -> str:
    return kelvins(level.floor_K)


def _cores(bands: Sequence[CoreBand], several: bool) -> str:
    """Hottest core of each cell with its 95 % band; for a core that is not known only the band, as on the page."""
    rows, half = [], half_width_K(bands)
    for b in bands:
        for k in range(b.T_c.shape[1]):
            where = ([str(b.record + 1)] if several else []) + [f"cell {k + 1}"]
            known = bool(half[k] <= UNKNOWN_K)
            core, centre = (number(x[:, k].max()) if known else "not known" for x in (b.T_c, b.T_centre))
            rows.append([*where, core, number(half[k]), centre])
    headers = (["record"] if several else []) + ["core", "hottest °C", "± 95 % K", "its centre °C"]
    return text_table(headers, rows, left=2 if several else 1)


def _measured_cores(checks: Sequence[CoreCheck], several: bool) -> str:
    rows = [
        [
            *([str(x.record + 1)] if several else []),
            f"cell {x.cell}",
            number(x.rmse_K),
            f"{x.bias_K:+.2f}",
            f"{100 * x.covered:.0f} %",
        ]
        for x in checks
    ]
    headers = (["record"] if several else []) + ["core thermocouple", "error K", "mean K", "inside the band"]
    return text_table(headers, rows, left=2 if several else 1)
