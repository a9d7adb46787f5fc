"""The decoded signals of the live page, in a ring of its own on disk, of which a window can be diagnosed.

The ring is that of the service (`store.recent`). It lies in a folder of this program and is deleted with it.
"""

import os
import shutil
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from bms_gateway.config.model_file import write_model
from bms_gateway.engine import Decoded, Engine
from bms_gateway.errors import UsageError
from bms_gateway.records.recent_signals import Stretch, write_recent
from bms_gateway.store.recent import Recent
from bms_gateway.workbench.uploads import own_folder

RING_MB: Final = 200.0
"""Several hours of a bus of sixty cells."""
EVERY_NS: Final = 20_000_000_000
"""Bus time between two writes."""
COMMAND: Final = "window"


class Signals:
    """The ring; ticks come from the engine's thread, other threads request windows.

    Parameters
    ----------
    engine : Engine
        It is set to report its accepted samples.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        engine.recording = True
        self.folder, self._handle = own_folder()
        self._recent = Recent(self.folder / "recent", RING_MB)
        self._lock = threading.Lock()
        self._written_ns = 0

    def take(self, event: Decoded) -> None:
        """Add the samples of one tick."""
        self._recent.add(event, self._engine)
        if abs(event.time_ns - self._written_ns) > EVERY_NS:
            self._written_ns = event.time_ns
            self._write()

    def _write(self) -> None:
        with self._lock:
            if (problem := self._recent.flush()) is not None:
                raise problem

    def table(
        self, string: int, last_s: float, until_ns: int | None, out: Path, refused: Mapping[int, str] | None = None
    ) -> Path:
        """Write the signals of one string (from 0) in a stretch of time as a table; 0: all stored ones.

        `refused` as of `Stretch`.

        Raises
        ------
        GatewayError
            There are no signals in this time.
        """
        self._write()
        name = self._name(string)
        stretch = Stretch(last_s or 1e9, None if until_ns is None else until_ns // 1000, refused or {})
        write_recent(out, self.folder, stretch, name, COMMAND, lambda _: None)
        return out

    def model(self, string: int, out: Path) -> Path:
        """Write the model with which a string is estimated."""
        write_model(self._engine.plan.strings[string].model, out, f"Of {self._name(string)}, as the live page has it.")
        return out

    def _name(self, string: int) -> str:
        strings = self._engine.plan.strings
        if not 0 <= string < len(strings):
            raise UsageError(f"{COMMAND}: string: valid are 0 to {len(strings) - 1}")
        return strings[string].name

    def close(self) -> None:
        """Delete the ring."""
        shutil.rmtree(self.folder, ignore_errors=True)
        os.close(self._handle)
