"""Long series of a tab: the worker stores them whole in files, the server reads a window of them for a picture.

A trace of a figure contains the keys of its series instead of numbers. Zooming needs no worker, which may be busy, and
shows every sample of a short window.
"""

import secrets
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bms_gateway.report.page import numbers
from bms_gateway.workbench.steps import SERIES, Window

POINTS = 2400
"""Points of one trace in one picture: more than a screen has columns."""
COLUMNS = 180
"""Stretches of time in a map: at least two pixels each."""
READING = threading.Lock()
"""One thread at a time reads the header of an array: numpy parses it as Python source, and Python 3.11 mixes up the
depths of two parsers that run side by side (`SystemError: AST constructor recursion depth mismatch`)."""
Kept = dict[str, Any]
"""Location of a trace's series: `file`, `x`, `y`; on another axis, x · `scale` + `shift`."""
Floats = NDArray[np.floating[Any]]


class Shelf:
    """Stores series of one answer; equal ones only once.

    Parameters
    ----------
    folder : Path
        Of the tab.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / f"{SERIES}{secrets.token_hex(8)}.npz"
        self._series: dict[str, NDArray[Any]] = {}
        self._known: dict[bytes, str] = {}

    def keep(self, x: Floats, y: Floats) -> Kept:
        """Store one trace: `x` (K,) in order, `y` (K,) with NaN where a line is broken."""
        return {
            "file": self._path.name,
            "x": self._key(np.asarray(x, np.float64)),
            "y": self._key(np.asarray(y, np.float64)),
        }

    def save(self) -> None:
        """Write the file."""
        np.savez(self._path, **self._series)  # type: ignore[arg-type]  # numpy takes the names for its own options

    def _key(self, x: NDArray[Any]) -> str:
        content = x.tobytes()
        if content not in self._known:
            self._known[content] = f"s{len(self._series)}"
            self._series[self._known[content]] = x
        return self._known[content]


def drawn(document: Any, folder: Path, window: Window | None = None) -> Any:
    """Replace every `kept` of a document, and the `columns` of a map, by numbers.

    Parameters
    ----------
    document : JSON-able
    folder : Path
    window : tuple of float, optional
        Shown part of the axis; by default all of it.
    """

    def fill(x: Any) -> Any:
        if isinstance(x, Mapping):
            found = {k: fill(v) for k, v in x.items() if k != "kept"}
            if "columns" in x:
                at, rows = columns([shelves.series(kept) for kept in x["columns"]], window)
                return {"x": [round(v, 7) for v in at.tolist()], "y": x["y"], "z": [numbers(row, 3) for row in rows]}
            return {**found, **points(x["kept"])} if "kept" in x else found
        return [fill(v) for v in x] if isinstance(x, list) and x and isinstance(x[0], dict) else x

    def points(kept: Kept) -> dict[str, Any]:
        t, y = shelves.series(kept)
        t, y = thinned(*windowed(t, y, window), POINTS)
        return {"x": [round(v, 7) for v in t.tolist()], "y": numbers(y.astype(np.float64), 4)}

    with Shelves(folder) as shelves:
        return fill(document)


class Shelves:
    """Content of a folder, with each file opened once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._open: dict[str, Any] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for f in self._open.values():
            f.close()

    def series(self, kept: Kept) -> tuple[Floats, Floats]:
        """Return all samples of a trace, on its drawn axis."""
        name = kept["file"]
        if name not in self._open:
            self._open[name] = np.load(self._folder / name)
        with READING:
            t, y = self._open[name][kept["x"]], self._open[name][kept["y"]]
        if "scale" in kept:
            t = kept["scale"] * t + kept["shift"]
        return t, y


def windowed(t: Floats, y: Floats, window: Window | None) -> tuple[Floats, Floats]:
    """Return the samples in a window, and one more on each side, so that lines reach its edges."""
    if window is None or not len(t):
        return t, y
    first, last = np.searchsorted(t, window[0]) - 1, np.searchsorted(t, window[1], side="right") + 1
    part = slice(max(int(first), 0), int(last))
    return t[part], y[part]


def columns(
    rows: Sequence[tuple[Floats, Floats]], window: Window | None
) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
    """Average some series over the same stretches of a window: `COLUMNS` of them, or as many as there are samples.

    A stretch is not shorter than the usual time between two samples of the series with the fewest, so that a map has
    holes only where samples are missing.

    Returns
    -------
    at : ndarray (C,)
        Middle of each stretch.
    means : list of ndarray (C,)
        NaN where a series has no sample.

    Examples
    --------
    >>> t = np.arange(0.0, 1000.0)
    >>> at, means = columns([(t, t), (t[::2], t[::2])], (99.5, 109.5))
    >>> at.tolist(), means[1].tolist()
    ([100.0, 102.0, 104.0, 106.0, 108.0], [100.0, 102.0, 104.0, 106.0, 108.0])
    """
    inside = []
    for t, y in rows:
        known = np.isfinite(y) & ((t >= window[0]) & (t <= window[1]) if window else True)
        inside.append((t[known], y[known].astype(np.float64)))
    some = [t for t, _ in inside if len(t)]
    if not some:
        return np.empty(0), [np.empty(0) for _ in rows]
    first, last = min(t[0] for t in some), max(t[-1] for t in some)
    usual = max((float(np.median(np.diff(t))) for t in some if len(t) > 1), default=1.0)
    width = max((last - first + usual) / COLUMNS, usual)
    count = max(int((last - first + usual) / width + 1e-6), 1)
    began = first - usual / 2.0
    means = []
    for t, y in inside:
        at = np.clip(((t - began) / width + 1e-9).astype(np.int64), 0, count - 1)
        number = np.bincount(at, minlength=count)
        total = np.bincount(at, y, count)
        means.append(np.where(number > 0, total / np.maximum(number, 1), np.nan))
    return began + width * (np.arange(count) + 0.5), means


def thinned(t: Floats, y: Floats, most: int) -> tuple[Floats, Floats]:
    """Thin a series to about `most` points: least and greatest value of each stretch, and every break of the line.

    Examples
    --------
    >>> t = np.arange(1000.0)
    >>> y = np.where(t == 321.0, 5.0, 0.0)
    >>> len(thinned(t, y, 100)[0]) <= 100, thinned(t, y, 100)[1].max()
    (True, np.float64(5.0))
    """
    n = len(y)
    if n <= most:
        return t, y
    size = -(-n // (most // 2))
    gap = np.isnan(y)
    low, high = (np.pad(np.where(gap, x, y), (0, -n % size), constant_values=x) for x in (np.inf, -np.inf))
    stretches = size * np.arange(len(low) // size)
    ends = [stretches + low.reshape(-1, size).argmin(axis=1), stretches + high.reshape(-1, size).argmax(axis=1)]
    rows = np.unique(np.concatenate([*ends, np.flatnonzero(gap)]))
    return t[rows], y[rows]
