"""One self-contained HTML page: its parts are joined as text, and plotly's own script in it draws the figures.

Figures are specifications of plotly in plain dictionaries. A page contains plotly's script and the specifications,
compressed by LZMA, and a script of its own that unpacks them: 1.5 of 4.8 MB, and a sixth of the specifications, which
are compressed together because they are similar. Browsers unpack gzip by themselves, but plotly's script then takes 2.0
MB. The content security policy of the page forbids any request.
"""

import base64
import gzip
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_gateway.errors import MissingExtraError, UsageError
from bms_gateway.report.words import in_words
from bms_gateway.whole import whole_text

Figure = dict[str, Any]
"""`data` and `layout` in the form of plotly."""
PACKING = {"preset": 6, "lc": 3, "lp": 0, "pb": 0}
"""Settings of LZMA that `unlzma.js` can read."""
IN_PLACE_OF_LESS = ","
"""Separator in base 85, which has no comma of its own."""
SMALLER = "\\u003c"
"""Form of a "<" in JSON within a page, so that no text of a figure ends its element."""
MOST_DIGITS = 6
"""Most decimals of numbers that are written as steps."""
_SPECIFICATION = re.compile(r'<script type="application/json" id="([\w-]+)-data">(.*?)</script>\n?', re.DOTALL)
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "form-action 'none'; base-uri 'none'"
)


@dataclass(frozen=True, slots=True)
class Card:
    """One important number: its name, the number, and a line that explains it."""

    title: str
    value: str
    line: str


def amount(x: float, digits: int = 3) -> str:
    """Write a number for people with `digits` significant digits, a dash for none.

    Examples
    --------
    >>> amount(0.03284), amount(2716.4), amount(-1.5), amount(float("nan")), amount(0.09998)
    ('0.0328', '2716', '−1.50', '–', '0.100')
    """
    if not np.isfinite(x):
        return "–"
    if x == 0.0:
        return "0"
    size = int(np.floor(np.log10(abs(float(f"{x:.{digits - 1}e}")))))
    if size < -4 or size > 6:
        return f"{x:.{digits - 1}e}".replace("-", "−")
    return f"{x:.{max(digits - 1 - size, 0)}f}".replace("-", "−")


def numbers(y: NDArray[np.float64], digits: int = 3) -> list[float | None]:
    """Return plain numbers with `digits` decimals; None for NaN."""
    return [x if x == x else None for x in np.round(y, digits).tolist()]


def table(
    headers: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    words: Sequence[int] = (0,),
    caption: str = "",
) -> str:
    """Return a table.

    Parameters
    ----------
    headers : sequence of str
        Plain text.
    rows : sequence of sequence of str
        HTML.
    words : sequence of int
        Columns with words; the others have numbers, which are aligned to the right.
    caption : str
    """

    def cell(j: int, html: str, tag: str = "td") -> str:
        side = "" if j in words else ' class="n"'
        scope = ' scope="row"' if j == 0 and tag == "td" else ' scope="col"' if tag == "th" else ""
        tag = "th" if j == 0 else tag
        return f"<{tag}{scope}{side}>{html}</{tag}>"

    head = "".join(cell(j, escape(h), "th") for j, h in enumerate(headers))
    body = "\n".join("<tr>" + "".join(cell(j, c) for j, c in enumerate(row)) + "</tr>" for row in rows)
    below = f"<caption>{escape(caption)}</caption>" if caption else ""
    return f"<table>{below}<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table>"


def grouped(groups: Sequence[tuple[str, Sequence[str]]], rows: Sequence[Sequence[str]], *, caption: str = "") -> str:
    """Return a table of numbers whose columns are in groups, each with a title over it.

    Parameters
    ----------
    groups : sequence of (title, headers)
        Plain text; the first header is that of the rows' names.
    rows : sequence of sequence of str
        HTML.
    """
    over = "".join(f'<th scope="colgroup" class="over" colspan="{len(h)}">{escape(t)}</th>' for t, h in groups)
    plain = table([h for _, headers in groups for h in headers], rows, caption=caption)
    return plain.replace("<table>", '<table class="grouped">', 1).replace("<thead>", f"<thead><tr>{over}</tr>", 1)


def cards(some: Sequence[Card]) -> str:
    """Return cards in a row."""

    def one(c: Card) -> str:
        words = "" if re.search(r"\d", c.value) or len(c.value) < 12 else " words"
        return (
            f'<dl class="card"><dt>{escape(c.title)}</dt><dd class="value{words}">{escape(c.value)}</dd>'
            f"<dd>{escape(c.line)}</dd></dl>"
        )

    return f'<div class="cards">{"".join(one(c) for c in some)}</div>'


def items(sentences: Sequence[str], *, verbatim: bool = False) -> str:
    """Return sentences as a list, or nothing without sentences; names of files `verbatim`."""
    if not sentences:
        return ""
    return (
        '<ul class="found">'
        + "".join(f"<li>{escape(s if verbatim else in_words(s))}</li>" for s in sentences)
        + "</ul>"
    )


def paragraph(text: str) -> str:
    """Return one paragraph."""
    return f"<p>{escape(in_words(text))}</p>"


def section(name: str, title: str, *parts: str) -> str:
    """Return a section of the page, or nothing if it would be empty."""
    inside = "\n".join(p for p in parts if p)
    if not inside:
        return ""
    head = f'<h2 id="{name}-title">{escape(title)}</h2>'
    return f'<section id="{name}" aria-labelledby="{name}-title">{head}\n{inside}\n</section>'


def figure(name: str, spec: Figure, caption: str, *, described: str, time: int | None = None) -> str:
    """Return the element of a figure and its specification.

    Parameters
    ----------
    name : str
        Of the element; one of its kind on the page.
    spec : Figure
    caption : str
        Below it.
    described : str
        Description of its content for people who cannot see it.
    time : int, optional
        Record on its time axis: figures of one record are zoomed together.
    """
    linked = "" if time is None else f' data-time="{time}"'
    height = spec["layout"]["height"]
    return (
        f'<figure><div class="plot" id="{name}" role="group" aria-label="{escape(described)}"{linked} '
        f'style="height:{height}px"></div>\n{_aside(name, spec)}\n'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def _aside(name: str, spec: Figure) -> str:
    """Return a specification as a part of the page's text, until `write_page` compresses all of them together."""
    spec = {**spec, "data": [{k: differences(v) if k in "xy" else v for k, v in d.items()} for d in spec["data"]]}
    return f'<script type="application/json" id="{name}-data">{to_json(spec).replace("<", SMALLER)}</script>'


def differences(values: Any) -> Any:
    """Write numbers as their differences, which take half the space when compressed; other values are kept.

    `page.js` adds them up again, to the same numbers: a whole number over a power of ten equals its decimals.

    Examples
    --------
    >>> differences([21.5, 21.52, None, 21.49])
    {'digits': 2, 'steps': [2150, 2, None, -3]}
    >>> differences(["1", "2"])
    ['1', '2']
    """
    if not isinstance(values, list) or not all(x is None or isinstance(x, float) for x in values):
        return values
    texts = [repr(x) for x in values if x is not None]
    digits = max((len(t.partition(".")[2]) for t in texts), default=0)
    if not texts or digits > MOST_DIGITS or any("e" in t for t in texts):
        return values
    steps, last = list[int | None](), 0
    for x in values:
        whole = None if x is None else round(x * 10**digits)
        steps.append(None if whole is None else whole - last)
        last = last if whole is None else whole
    return {"digits": digits, "steps": steps}


def _figures_apart(body: str) -> tuple[str, str]:
    """Take the specifications out of a page's text; give the text, and all of them packed, by the names of figures."""
    parts: list[str] = []

    def take(found: re.Match[str]) -> str:
        parts.append(f'"{found[1]}":{found[2]}')
        return ""

    rest = _SPECIFICATION.sub(take, body)
    return rest, packed("figures", f"{{{','.join(parts)}}}".encode()) if parts else ""


def to_json(spec: Mapping[str, Any]) -> str:
    """Write a specification in the form of plotly.

    Examples
    --------
    >>> to_json({"y": [1.0, None]})
    '{"y":[1.0,null]}'
    """
    return json.dumps(spec, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def packed(name: str, content: bytes) -> str:
    """Return an element with content for the page's script: LZMA in base 85, and its unpacked length.

    Raises
    ------
    UsageError
        This Python was built without LZMA, as a person may have compiled it.
    """
    try:
        import lzma
    except ImportError:
        raise UsageError(
            "an HTML report needs the module lzma, which this Python was built without: "
            "install liblzma-dev (xz-devel) and build Python again, or take the system's"
        ) from None
    filters = [{"id": lzma.FILTER_LZMA1, **PACKING}]
    text = base64.b85encode(lzma.compress(content, format=lzma.FORMAT_RAW, filters=filters)).decode()
    text = text.replace("<", IN_PLACE_OF_LESS)  # which could begin a mark of HTML
    return f'<script type="application/x-lzma" id="{name}" data-length="{len(content)}">{text}</script>'


def write_page(path: Path, title: str, head: str, sections: Sequence[str]) -> None:
    """Write a page.

    Parameters
    ----------
    path : Path
    title : str
    head : str
        HTML of the top.
    sections : sequence of str
        HTML; empty ones are left out.

    Raises
    ------
    MissingExtraError
        plotly is not installed.
    UsageError
        The file cannot be written.
    """
    script = _packed_once("plotly", plotly_source())
    own = files("bms_gateway.report")
    names = ("page.css", "unlzma.js", "page.js", "told.js")
    css, unlzma, js, told = (own.joinpath(name).read_text(encoding="utf-8") for name in names)
    body, figures = _figures_apart("\n".join(s for s in sections if s))
    wide = (
        '<div class="wide" tabindex="0" role="group" aria-label="table">'  # on a phone tables are wider than the page
    )
    body = body.replace("<table", f"{wide}<table").replace("</table>", "</table></div>")
    text = (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{css}</style></head>\n<body>\n"
        f"<header><h1>{escape(title)}</h1>\n{head}</header>\n<main>\n{body}\n</main>\n"
        '<footer><p id="damaged" class="alarm" role="alert" hidden>The figures cannot be unpacked: this file is '
        "damaged, or the browser is very old. All tables can be read.</p>"
        "<noscript>The figures need JavaScript; all tables can be read without.</noscript></footer>\n"
        f"{script}\n{figures}\n<script>{unlzma}{js}</script>\n<script>{told}</script>\n</body></html>\n"
    )
    try:
        with whole_text(path) as file:
            file.write(text)
    except OSError as e:
        raise UsageError(f"{path}: cannot be written: {e.strerror}") from None


@cache
def _packed_once(name: str, content: bytes) -> str:
    return packed(name, content)  # a second and a half for plotly's script


@cache
def plotly_script() -> bytes:
    """Return the script of the installed plotly, compressed by gzip; raises as `plotly_source`."""
    return gzip.compress(plotly_source(), mtime=0)


@cache
def plotly_source() -> bytes:
    """Return the script of the installed plotly.

    Raises
    ------
    MissingExtraError
        plotly is not installed.
    """
    spec = find_spec("plotly")  # not imported: only its script is needed
    for place in (spec.submodule_search_locations or []) if spec else []:
        path = Path(place) / "package_data" / "plotly.min.js"
        if path.is_file():
            return path.read_bytes()
    raise MissingExtraError("an HTML report", "report")
