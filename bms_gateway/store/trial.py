"""Sets a stored state aside that ends the service again and again soon after it was restored.

A state that restores and then ends the process (by a bug, in a tick or in a library) would do so at every restart, for
ever. So a start notes in ``state.trying`` which state it tries, and what ends the process notes its reason there. A
service that runs for a while removes the file. The next start reads from it how earlier tries ended::

    {"boot": …, "saved_ns": …, "aside": […]}
    try
    loaded
    died: KeyError: 'x'
    try

Only reasons that the process itself could note count against a state: an exception, a fatal signal of its own (SIGSEGV,
SIGABRT …) and a hang. `faulthandler` writes the last two, and needs no working interpreter for that. An end from
outside (by a person, by the kernel for lack of memory, by a watchdog after SIGSTOP) leaves no reason, and a power cut
is followed by another boot: both are no evidence about the state. One end without a reason counts too: a process that
ends while it reads the state, `SILENT_MOST` times in a row. Reading takes some tenths of a second, so that an end from
outside rarely falls into this time by chance. If the service then ends in the same way without any stored state, the
state was not the cause, and it is put back.

The notes are not synced to the disk: they are about processes that end, and are not used after a power cut. If they
cannot be written, there is no trial; no state can be saved there either, and this is reported.
"""

import faulthandler
import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from bms_gateway.errors import GatewayError
from bms_gateway.store.files import read_file

NOTED_MOST: Final = 3
SILENT_MOST: Final = 5
HANG_S: Final = 5.0
"""A process without `alive` for this time hangs. The time is short enough for a note before a watchdog of 10 s, which
is fed every 3.3 s, ends the process."""
MAX_BYTES: Final = 64 << 10
NEVER_NS: Final = -1
"""Stands for the saving time of a missing state."""
MAX_REASON: Final = 300
TRY, LOADED, WENT_ON, DIED = "try", "loaded", "went on", "died: "
HUNG: Final = "Timeout ("  # the first words of `faulthandler`
_NOTES: Final = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
_MODE: Final = 0o640


class Trial:
    """The tries of the states in one directory, which this process has locked.

    Parameters
    ----------
    directory : Path
    boot : str
        Identifies the boot; tries of another boot do not count.

    Attributes
    ----------
    told : str
        How earlier tries of the present state ended; empty without tries.
    handle : int or None
        Descriptor of the file of notes, while it is open.
    alive_s : float
        Time of the last `alive`, by the monotonic clock.
    tries : list of list of str
        Notes of each earlier try of this boot, in order.
    """

    def __init__(self, directory: Path, boot: str) -> None:
        self._path = directory / "state.trying"
        self._boot = boot
        self.told = ""
        self.handle: int | None = None
        self._faults = False
        self.alive_s = 0.0
        self._head: dict[str, Any] = {"boot": boot}
        self.tries: list[list[str]] = []
        self._read()

    @property
    def noting_now(self) -> bool:
        """Whether the file of notes is open."""
        return self.handle is not None

    @property
    def aside(self) -> list[list[str]]:
        """States that were set aside in this trial: original and present name of each."""
        found: list[list[str]] = self._head.get("aside", [])
        return found

    def against(self, saved_ns: int | None) -> str:
        """Say why a state must not be restored; empty if it may be restored.

        Parameters
        ----------
        saved_ns : int or None
            Identifies the state; None: no state.
        """
        self.told = ""
        if self._head.get("acquitted"):
            return ""
        if self._head.get("saved_ns") != saved_ns:
            self._begin_anew(saved_ns=saved_ns)
        if reasons := self._reasons():
            self.told = f"the service has ended {_times(len(reasons))} soon after it was restored: {reasons[-1]}"
        if len(reasons) >= NOTED_MOST:
            return self.told
        if len(self.tries) >= SILENT_MOST and not any(self.tries[-SILENT_MOST:]):
            return f"the service was gone {_times(SILENT_MOST)} in a row while it was restored"
        return ""

    def begin(self) -> None:
        """Note that the service now restores the state; from here on, note also what ends the process."""
        handle = None if self._head.get("acquitted") else self._open()
        if handle is None:
            return
        self._note(TRY)
        if not faulthandler.is_enabled():  # if it is enabled already, its output belongs to another part of the program
            faulthandler.enable(handle)
            self._faults = True
        self.alive_s = time.monotonic()
        self.alive()

    def set_aside(self, name: str, aside: str) -> None:
        """Remember the new name of a state, so that it can be put back if it was not the cause."""
        self._begin_anew(saved_ns=self._head.get("saved_ns"), aside=[*self.aside, [name, aside]])

    def put_back(self) -> list[Path]:
        """Put states back that were not the cause: the service ends in the same way without any state.

        Returns
        -------
        list of Path
            States that have their original name again; this trial is over.
        """
        if not self.aside or self._head.get("saved_ns") is not None or len(self._reasons()) < NOTED_MOST:
            return []
        back = []
        for name, aside in self.aside:
            path = self._path.with_name(name)
            if not os.path.lexists(path):
                with suppress(OSError):  # moved or deleted by a person
                    self._path.with_name(aside).rename(path)
                    back.append(path)
        self._begin_anew(acquitted=True)
        self._let_go()
        return back

    def loaded(self) -> None:
        """Note that the state is restored, and that ticks follow."""
        self._note(LOADED)
        self.alive()

    def alive(self) -> None:
        """Note that the process is alive; while the trial lasts, call this more often than every `HANG_S`."""
        now_s = time.monotonic()
        if now_s - self.alive_s > HANG_S:
            self._note(WENT_ON)  # it was not a hang
        self.alive_s = now_s
        if self._faults and self.handle is not None:
            faulthandler.dump_traceback_later(HANG_S, file=self.handle)

    def over(self) -> None:
        """End the trial: all went well, or the service was told to end."""
        self._let_go()
        with suppress(OSError):  # the file is missing, or the disk is read-only: then the notes of these tries remain
            self._path.unlink()

    @contextmanager
    def noting(self) -> Iterator[None]:
        """Note the reason for the end of the process; if it was told to end, the trial is over."""
        try:
            yield
        except GatewayError:  # a reported fault of configuration or bus, at any time
            if time.monotonic() - self.alive_s > HANG_S:
                self._note(WENT_ON)
            self._let_go()
            raise
        except Exception as error:
            self._note(f"{DIED}{type(error).__name__}: {' '.join(str(error).split())[:MAX_REASON]}")
            self._let_go()
            raise
        except BaseException:
            if time.monotonic() - self.alive_s > HANG_S:
                self._let_go()
            else:
                self._stopped()
            raise

    def _stopped(self) -> None:
        """End the trial like `over`, but remember the states that were set aside: none is proven to be the cause."""
        if self.handle is None or not self.aside:
            self.over()
        else:
            self._begin_anew(saved_ns=self._head.get("saved_ns"))
            self._let_go()

    def _reasons(self) -> list[str]:
        return [why for lines in self.tries if (why := _reason(lines))]

    def _read(self) -> None:
        try:
            text = read_file(self._path, MAX_BYTES)
        except OSError:
            return
        if text is None or len(text) == MAX_BYTES:
            return
        first, *lines = [line for line in text.decode(errors="replace").splitlines() if line] or [""]
        with suppress(ValueError, RecursionError):
            head = json.loads(first)
            if _is_head(head) and head["boot"] != self._boot:  # tries of another boot do not count; states set aside do
                self._head = {"boot": self._boot, "aside": head.get("aside", []), "saved_ns": NEVER_NS}
            elif _is_head(head):
                self._head = head
                for line in lines:
                    if line == TRY:
                        self.tries.append([])
                    elif self.tries:
                        self.tries[-1].append(line)

    def _begin_anew(self, **head: object) -> None:
        """Forget the earlier tries."""
        self._head = {"boot": self._boot, "aside": self.aside} | head
        self.tries = []
        if (handle := self._open()) is not None:
            with suppress(OSError):
                os.ftruncate(handle, 0)
            self._note(json.dumps(self._head))

    def _open(self) -> int | None:
        if self.handle is None:
            with suppress(OSError):
                self.handle = os.open(self._path, _NOTES, _MODE)
        return self.handle

    def _note(self, line: str) -> None:
        if self.handle is not None:
            with suppress(OSError):
                # the text before it may be cut within a line
                os.write(self.handle, f"\n{line}\n".encode(errors="replace"))

    def _let_go(self) -> None:
        if self._faults:
            faulthandler.cancel_dump_traceback_later()
            faulthandler.disable()
            self._faults = False
        if self.handle is not None:
            os.close(self.handle)
            self.handle = None


def _is_head(head: object) -> bool:
    if not (isinstance(head, dict) and isinstance(head.get("boot"), str)):
        return False
    aside = head.get("aside", [])
    return isinstance(aside, list) and all(
        isinstance(pair, list) and len(pair) == 2 and all(isinstance(n, str) and n == Path(n).name for n in pair)
        for pair in aside
    )


def _reason(lines: list[str]) -> str:
    """Reason for the end of a try; empty if it noted none, or if it went on after the note."""
    if not lines or lines[-1] in (LOADED, WENT_ON):
        return ""
    told = next(line for line in lines if line not in (LOADED, WENT_ON))
    return f"it hung for {HANG_S:g} s" if told.startswith(HUNG) else told.removeprefix(DIED)


def _times(n: int) -> str:
    return "once" if n == 1 else f"{n} times"
