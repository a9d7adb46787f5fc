"""The paper beside our results, on a terminal: prose for a newcomer, one table per section, and open points."""

import textwrap
from collections.abc import Sequence

from bms_gateway.errors import counted
from bms_gateway.reproduce import VERDICTS, Row, Section

WIDTH = 112
COLUMNS = (40, 20, 35, 11)
"""What, paper, ours, verdict."""
HEADERS = ("", "paper", "ours", "verdict")
TITLE = (
    "X. Lin et al., Parameterization and Observability Analysis of Scalable Battery Clusters for Onboard Thermal "
    "Management, reproduced."
)
PREFACE = (
    "The cores of a battery's cells are what ages and burns, and no sensor fits into them; thermocouples sit on a few "
    "surfaces. The paper identifies a thermal model of the cells while driving and computes the rest from it. The "
    "sections below go through that step by step.",
    "Every number under 'ours' has just been computed by the code that runs in the vehicle. The measured signals are "
    "simulated with the paper's model, as the paper's are; runs over several drives are given as median (least–most) "
    "or mean ± standard deviation.",
)


def text(sections: Sequence[Section], seeds: int) -> str:
    """Write the whole report.

    Parameters
    ----------
    sections : sequence of Section
    seeds : int
        Noise realisations per condition, as stated in the preface.
    """
    problem, numbers = PREFACE
    lines = [*_wrapped(TITLE), "", *_wrapped(problem), "", *_wrapped(f"{numbers} Noise: {seeds} seeds.")]
    lines += ["", *(f"  {name:<12} {what}" for name, what in VERDICTS.items())]
    for number, section in enumerate(sections, 1):
        lines += ["", "", f"{number}. {section.title}", ""]
        for paragraph in section.text:
            lines += [paragraph] if paragraph.startswith("  ") else _wrapped(paragraph)
        lines += ["", *_table(section.rows)]
    return "\n".join([*lines, "", "", *summary(sections)])


def summary(sections: Sequence[Section]) -> list[str]:
    """Count the verdicts and name every row that differs from the expectation."""
    rows = [r for s in sections for r in s.rows]
    counts = ", ".join(f"{sum(r.verdict == v for r in rows)} {v}" for v in VERDICTS)
    lines = [f"{counted(len(rows), 'row')}: {counts}."]
    for row in rows:
        if row.verdict in ("differs", "missed"):
            lines += _wrapped(
                f"{row.verdict}: {row.what}: paper {row.paper}, ours {row.ours}. {row.note}".rstrip(), "  "
            )
    return lines


def _table(rows: Sequence[Row]) -> list[str]:
    lines = [_line(HEADERS), "-" * WIDTH]
    for row in rows:
        cells = [
            textwrap.wrap(c, w, break_long_words=False) or [""]
            for c, w in zip((row.what, row.paper, row.ours, row.verdict), COLUMNS, strict=True)
        ]
        lines += [_line([c[i] if i < len(c) else "" for c in cells]) for i in range(max(map(len, cells)))]
        if row.note:
            lines += _wrapped(row.note, "    ")
    return lines


def _line(cells: Sequence[str]) -> str:
    return "  ".join(f"{c:<{w}}" for c, w in zip(cells, COLUMNS, strict=True)).rstrip()


def _wrapped(paragraph: str, indent: str = "") -> list[str]:
    return textwrap.wrap(paragraph, WIDTH, initial_indent=indent, subsequent_indent=indent, break_long_words=False)
