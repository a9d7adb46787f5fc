"""A worker process, seen by its owner: one request at a time, answers by a callback, ended at once on demand."""

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

START = (
    "import sys; sys.path.append(sys.argv[1]); "
    "from bms_gateway.workbench.worker import main; main()"
)  # imports this package from where it lies, and nothing from the user's folder
PACKAGE = str(Path(__file__).resolve().parents[2])
PATIENCE_S = 5.0
"""Longest time that the kernel takes to end a killed process, s."""


class Worker:
    """A process that computes.

    Parameters
    ----------
    hear : callable
        Gets each answer, in a thread of this object, and None when the process has ended.
    """

    def __init__(self, hear: "Callable[[Worker, dict[str, Any] | None], None]") -> None:
        self._hear = hear
        self._process = subprocess.Popen(  # noqa: S603 - our own interpreter with our own words
            [sys.executable, "-P", "-c", START, PACKAGE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            encoding="utf-8",
        )
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether requests can be sent."""
        return self._process.poll() is None

    def ask(self, request: Mapping[str, Any]) -> None:
        """Send a request; if the process has ended, the listener reports it."""
        assert self._process.stdin is not None  # noqa: S101 - opened above
        with suppress(BrokenPipeError, ValueError):
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()

    def end(self) -> None:
        """End the process now, also within a computation."""
        self._process.kill()
        if threading.current_thread() is not self._thread:
            self._thread.join(PATIENCE_S)

    def _listen(self) -> None:
        out = self._process.stdout
        assert out is not None  # noqa: S101 - opened above
        with out:
            for line in out:
                # the incomplete output of a killed process is no answer
                if line.endswith("\n"):
                    self._hear(self, json.loads(line))
        self._process.wait()
        with suppress(OSError):  # a request that it never read
            if self._process.stdin is not None:
                self._process.stdin.close()
        self._hear(self, None)
