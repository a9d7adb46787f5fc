"""A message that our node sends: its signals with their layouts, descriptions and values."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import nan
from typing import Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.own_layout import SignalLayout
from bms_gateway.thermal import Floats

__all__ = ["BY_CELL", "Message", "Part", "Value", "part"]

Value = float | Floats | NDArray[np.uint8]
"""One value; in a message of cells, one value for each cell."""
S = TypeVar("S")
T = TypeVar("T")


BY_CELL: Final = (16, 8, "Number of the cell, from 1.")


@dataclass(frozen=True, slots=True)
class Part(Generic[S]):
    """Signals that are sent in the same frame.

    Attributes
    ----------
    signals : tuple of SignalLayout
    values : callable
        Returns a value for each signal from the string or the gateway; NaN is sent as not available.
    """

    signals: tuple[SignalLayout, ...]
    values: Callable[[S], Sequence[Value]]


@dataclass(frozen=True, slots=True)
class Message(Generic[S]):
    """One message that our node sends; in comments, `{k}` is the number of the string and `{c}` that of the cell.

    Attributes
    ----------
    name : str
        For a message of strings, what follows `string_K_`.
    group : int
        Low byte of the J1939 parameter group of string 0; that of string k is k more.
    cycle_ms : int
    parts : tuple of Part
        The first has multiplexer value 0, the next 1, and so on; without a multiplexer there is one.
    mux : (int, int, str) or None
        Lowest bit, bits and comment of the multiplexer.
    """

    name: str
    group: int
    cycle_ms: int
    comment: str
    parts: tuple[Part[S], ...]
    mux: tuple[int, int, str] | None = None

    @property
    def of_cells(self) -> bool:
        """Whether the multiplexer is the number of the cell; each cell has the signals of the one part."""
        return self.mux == BY_CELL


def part(of: Callable[[S], T | None], *rows: tuple[SignalLayout, Callable[[T], Value]]) -> Part[S]:
    """Signals whose values are read from what `of` returns; if that is None, all of them are not available."""
    values = tuple(value for _, value in rows)

    def content(source: S) -> Sequence[Value]:
        found = of(source)
        return (nan,) * len(values) if found is None else [value(found) for value in values]

    return Part(tuple(layout for layout, _ in rows), content)
