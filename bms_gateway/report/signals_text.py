"""The table of signals: samples seen, used and refused, with the reason."""

from collections.abc import Mapping
from typing import Any

from bms_gateway.report.show import text_table

MOST = 40


def signals_table(documents: Mapping[str, Mapping[str, Any]]) -> str:
    """Write the signals as text, those with refused samples first if there are many.

    Parameters
    ----------
    documents : mapping of signal to what `records.signal_use.Use.document` gives
    """
    ordered = list(documents.items())
    if len(ordered) > MOST:
        ordered.sort(key=lambda item: -_lost(item[1]))
    rows = []
    for signal, d in ordered[:MOST]:
        refused = ", ".join(f"{reason} {n}" for reason, n in sorted(d["refused"].items(), key=lambda r: -r[1]))
        if not refused:
            refused = d.get("note", "never seen" if not d["seen"] else "–")
        rows.append(
            [d["key"], signal, refused, d["seen"], d["used"], _ends(d["observed"]), _ends(d["allowed"]), d["unit"]]
        )
    headers = ["what", "signal", "refused", "seen", "used", "observed", "allowed", "unit"]
    text = text_table(headers, rows, left=3)
    if len(ordered) > MOST:
        text += f"\n… and {len(ordered) - MOST} more"
    return text


def _lost(d: Mapping[str, Any]) -> float:
    return 1.0 - d["used"] / d["seen"] if d["seen"] else 0.5


def _ends(ends: list[float | None] | None) -> str:
    if ends is None:
        return "–"
    return " … ".join("∞" if x is None else f"{x:.5g}" for x in ends)
