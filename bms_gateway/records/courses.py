"""Collects current, voltage and SOC of each string while an engine reads a log, and reports their contradictions."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from bms_gateway.engine import Decoded, Engine, Event
from bms_gateway.frames.ammeter import mean_voltage
from bms_gateway.frames.database import Database
from bms_gateway.records.current_witness import witness
from bms_gateway.thermal import Floats

UNLIKE: Final = 1.5
"""Factor between the capacity from current and SOC and that of the model, above which they contradict each other: an
SOC may refer to the usable part only, and a cell ages."""


class Courses:
    """Means at each tick.

    Parameters
    ----------
    engine : Engine
        Before the traffic; it is configured to give the samples of each tick.
    database : Database
    """

    def __init__(self, engine: Engine, database: Database) -> None:
        engine.recording = True
        self._engine, self._database = engine, database
        of_pack = (i for w in engine.wires for i in (w.current, w.voltage, w.whole["soc"]))
        self._inputs = sorted({i for i in of_pack if i >= 0})
        self._voltages = sorted({w.voltage for w in engine.wires if w.voltage >= 0})
        self._rows: list[Floats] = []

    def take(self, event: Event) -> bool:
        """Take the samples of a tick; return whether the event contained samples."""
        if not isinstance(event, Decoded):
            return False
        if self._inputs:
            n = self._inputs[-1] + 1
            mine = event.input < n
            count = np.bincount(event.input[mine], minlength=n)[self._inputs]
            total = np.bincount(event.input[mine], event.value[mine], minlength=n)[self._inputs]
            row = np.where(count > 0, total / np.maximum(count, 1), np.nan)
            for i in self._voltages:
                row[self._inputs.index(i)] = mean_voltage(event.value[event.input == i])
            self._rows.append(row)
        return True

    def contradictions(self) -> Iterator[str]:
        """List the currents that contradict their voltage or their SOC, each once."""
        table = np.array(self._rows).reshape(len(self._rows), len(self._inputs))
        told: set[int] = set()
        for string, w in zip(self._engine.plan.strings, self._engine.wires, strict=True):
            if w.current < 0 or w.current in told:
                continue
            told.add(w.current)
            by_quantity = {c.quantity: c for c in string.channels if c.signal is not None}
            volts = by_quantity.get("voltage")
            step = 0.0 if volts is None else abs(volts.scale) * self._database.resolve(volts.signal or "").resolution
            I, V, soc = (self._column(table, i) for i in (w.current, w.voltage, w.whole["soc"]))  # noqa: E741
            said = witness(I, V, soc, self._engine.plan.tick_ns * 1e-9, step)
            where = f"{string.name}.current ({by_quantity['current'].source})"
            for text in said.against:
                yield f"{where}: {text}"
            has_Ah = string.model.capacity_Ah
            if said.capacity_Ah is None or has_Ah is None or 1.0 / UNLIKE < said.capacity_Ah / has_Ah < UNLIKE:
                continue
            yield (
                f"{where}: with the SOC it gives {said.capacity_Ah:.3g} Ah, and the model file says {has_Ah:.3g} Ah: "
                "its scale is wrong, or it is another cell, or another number in parallel"
            )

    def _column(self, table: Floats, i: int) -> Floats:
        return table[:, self._inputs.index(i)] if i >= 0 else np.full(len(table), np.nan)
