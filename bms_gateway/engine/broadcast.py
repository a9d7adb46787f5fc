"""The frames that our node sends each tick: layouts and columns are looked up once, then filled as numpy arrays."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import nan
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.estimators import Estimators
from bms_gateway.engine.plan import Plan
from bms_gateway.engine.sent import GATEWAY_MESSAGES, STRING_MESSAGES
from bms_gateway.engine.sent_message import Message, Value
from bms_gateway.engine.sent_values import Counts, Gateway, State
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.frames.encode import Encoder
from bms_gateway.frames.own_dbc import string_message

__all__ = ["Broadcast", "Counts", "State"]

S = TypeVar("S")


@dataclass(frozen=True, slots=True)
class _Rows:
    """Rows of the encoder that one part of a message fills, and the columns to fill.

    The part itself stays in the table: its functions cannot be pickled, and an engine goes to other processes.

    Attributes
    ----------
    single : bool
        Whether there is one row, with numbers as values; otherwise a value may be an array, one entry per cell.
    """

    rows: NDArray[np.intp]
    columns: tuple[int, ...]
    cycle_ns: int
    single: bool


class Broadcast:
    """Frames of our node for a plan.

    Parameters
    ----------
    plan : Plan
    database : Database
        Must hold our DBC.

    Attributes
    ----------
    cycles : dict of int to int
        Identifiers that we send and their cycles, ns: the only ones that a port may put on the bus for us.
    """

    def __init__(self, plan: Plan, database: Database) -> None:
        names = [string_message(s.number, m.name) for s in plan.strings for m in STRING_MESSAGES]
        names += [m.name for m in GATEWAY_MESSAGES]
        self._encoder = Encoder(database, names)
        self._cycle = {name: database.message(name).cycle_ns or plan.tick_ns for name in names}
        self.cycles = {database.message(name).can_id: self._cycle[name] for name in names}
        self._strings = [
            [r for m in STRING_MESSAGES for r in self._rows(m, string_message(s.number, m.name), s.model.cells)]
            for s in plan.strings
        ]
        self._gateway = [r for m in GATEWAY_MESSAGES for r in self._rows(m, m.name)]

    def _rows(self, message: Message[S], name: str, cells: int = 0) -> Iterator[_Rows]:
        """Look up the rows of each part of a message, in the order in which they are sent."""
        for number, part in enumerate(message.parts):
            if message.of_cells:
                muxes: list[tuple[int, ...]] = [(k,) for k in range(1, cells + 1)]
            else:
                muxes = [()] if message.mux is None else [(number,)]
            rows = [self._encoder.row(name, *mux) for mux in muxes]
            columns = tuple(self._encoder.column(rows[0], s.name.format(c=1)) for s in part.signals)
            yield _Rows(np.array(rows, np.intp), columns, self._cycle[name], not message.of_cells)

    def encode(self, t1: int, estimators: Estimators, state: State, counts: Counts) -> FrameBatch:
        """Frames that are due at the tick `t1`, stamped with it, in the order of the strings."""
        of_string, of_gateway, gateway = _values(STRING_MESSAGES), _values(GATEWAY_MESSAGES), Gateway(state, counts)
        due = [
            (rows, values(s))
            for parts, s in zip(self._strings, estimators.strings, strict=True)
            for rows, values in zip(parts, of_string, strict=True)
            if t1 % rows.cycle_ns == 0
        ]
        due += [
            (rows, values(gateway))
            for rows, values in zip(self._gateway, of_gateway, strict=True)
            if t1 % rows.cycle_ns == 0
        ]
        if not due:
            return FrameBatch.empty()
        at = np.concatenate([filled.rows for filled, _ in due])
        table = np.full((len(at), self._encoder.width), nan)
        start = 0
        for filled, content in due:
            end = start + len(filled.rows)
            where = start if filled.single else slice(start, end)  # writing a single number is faster
            for column, value in zip(filled.columns, content, strict=True):
                table[where, column] = value
            start = end
        can_id, length, data = self._encoder.encode(at, table)
        return FrameBatch(np.full(len(can_id), t1, np.int64), can_id, length, data)


def _values(messages: Iterable[Message[S]]) -> list[Callable[[S], Sequence[Value]]]:
    """Functions that give the values of each part, in the order of the rows."""
    return [part.values for message in messages for part in message.parts]
