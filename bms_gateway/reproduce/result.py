"""Parts of a reproduction: sections, rows with the paper's result beside ours, and figures as numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from bms_gateway.thermal import Floats

Verdict = Literal["agrees", "differs", "paper wrong", "assumed", "beyond", "missed"]
"""`agrees`: within the tolerance of the row; `differs`: outside, and the note says why; `paper wrong`: the print is
wrong, and ours is right; `assumed`: the paper does not print the number; `beyond`: the paper has no such result, and
ours is within its limit, if there is one; `missed`: ours is beyond this limit."""

VERDICTS: Mapping[Verdict, str] = MappingProxyType(
    {
        "agrees": "ours is what the paper shows",
        "differs": "ours is another number; the note says why",
        "paper wrong": "the print is in error; ours is the right form or number",
        "assumed": "the paper does not print it; this is what we took",
        "beyond": "not in the paper; ours, within its limit where it has one",
        "missed": "not in the paper; ours, beyond its limit",
    }
)


@dataclass(frozen=True, slots=True)
class Row:
    """One result of the paper, compared with ours.

    Attributes
    ----------
    id : str
        Such as ``fig7.core``; its meaning never changes.
    what : str
    paper, ours : str
        With units.
    verdict : Verdict
    note : str
        Reason and meaning; may be empty.
    values : mapping of str to float
        The numbers behind `ours`, for tests and plots.
    """

    id: str
    what: str
    paper: str
    ours: str
    verdict: Verdict
    note: str = ""
    values: Mapping[str, float] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Return the row for machines; NaN becomes null."""
        values = {k: float(v) if np.isfinite(v) else None for k, v in self.values.items()}
        return {
            "id": self.id,
            "what": self.what,
            "paper": self.paper,
            "ours": self.ours,
            "verdict": self.verdict,
            "note": self.note,
            "values": values,
        }


def agreeing(hold: bool) -> Verdict:
    """Judge a result that the paper shows."""
    return "agrees" if hold else "differs"


def disproved(hold: bool) -> Verdict:
    """Judge a result of the paper that is wrong, if the evidence for this holds."""
    return "paper wrong" if hold else "differs"


def kept(hold: bool) -> Verdict:
    """Judge a result that the paper does not have, by its limit."""
    return "beyond" if hold else "missed"


@dataclass(frozen=True, slots=True)
class Curve:
    """One line of a panel: `x`, `y` (K,); `style` is "-", "--" or "o"."""

    label: str
    x: Floats
    y: Floats
    style: str = "-"


@dataclass(frozen=True, slots=True)
class Panel:
    """Curves on common axes.

    Attributes
    ----------
    title, x_label, y_label : str
    curves : tuple of Curve
    limits : tuple of float, or None
        Limits of y, if its extremes would hide the rest.
    level : float or None
        A value to compare with, drawn as a thin line.
    """

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    limits: tuple[float, float] | None = None
    level: float | None = None


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of one or more panels; `name` is its file's."""

    name: str
    title: str
    panels: tuple[Panel, ...]


@dataclass(frozen=True, slots=True)
class Section:
    """A step of the method.

    Attributes
    ----------
    id, title : str
    text : tuple of str
        Paragraphs for a newcomer; lines that begin with two spaces are formulas and stay as they are.
    rows : tuple of Row
    figures : tuple of Figure
    """

    id: str
    title: str
    text: tuple[str, ...]
    rows: tuple[Row, ...]
    figures: tuple[Figure, ...] = ()


def several(values: Sequence[float] | Floats, form: str = ".1f") -> str:
    """Write numbers one after the other; `–` for NaN.

    Examples
    --------
    >>> several([52.86, float("nan")])
    '52.9 –'
    """
    return " ".join("–" if np.isnan(v) else format(float(v), form) for v in values)


def span(values: Sequence[float] | Floats, form: str = ".1f") -> str:
    """Write median and range of several runs.

    Examples
    --------
    >>> span([1.0, 4.0, 2.0])
    '2.0 (1.0–4.0)'
    """
    v = np.asarray(values, dtype=np.float64)
    if np.isnan(v).all():
        return "–"
    return f"{np.nanmedian(v):{form}} ({np.nanmin(v):{form}}–{np.nanmax(v):{form}})"


def braced(sensors: Sequence[int]) -> str:
    """Write a set of cells as the paper does."""
    return "{" + ",".join(map(str, sensors)) + "}"
