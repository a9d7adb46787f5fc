"""A stored state on trial: one that ends the service again and again soon after it was restored is set aside.

A state that restores and then ends the process (by a bug, in a tick or in a library) would do so at every restart, for
ever. So a start notes in ``state.trying`` which state it tries, and what ends the process notes its reason there. A
service that goes on for a while removes the file. The next start reads how the tries before it ended::

    {"boot": …, "saved_ns": …, "aside": […]}
    try
    loaded
    died: KeyError: 'x'
    try

What counts against a state is what the process itself could note: an exception, a fatal signal of its own (SIGSEGV,
SIGABRT …) and a hang. `faulthandler` writes the last two, and needs no working interpreter for that. Whoever ends the
process from outside (a person, the kernel for want of memory, a watchdog after SIGSTOP) leaves no reason, and a power
cut is followed by another boot: neither says anything about the state. One end without a reason counts too: a process
that ends while it reads the state, `SILENT_MOST` times in a row. Reading takes some tenths of a second, so that nobody
ends the process just then so often by chance.

Where the service then ends in the same way without any stored state, the state was not to blame, and it is put back.

The notes are not synced to the disk: they are about processes that end, and are not used after a power cut. Where they
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
"""Without `alive` for so long it hangs: noted before a watchdog of 10 s ends it that is fed every third of them."""
MAX_BYTES: Final = 64 << 10
NEVER_NS: Final = -1
"""In place of the time at which a state was saved: of none."""
MAX_REASON: Final = 300
TRY, LOADED, WENT_ON, DIED = "try", "loaded", "went on", "died: "
HUNG: Final = "Timeout ("  # with which `faulthandler` begins
_NOTES: Final = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
_MODE: Final = 0o640


class Trial:
    """The tries of the states in one directory, which this process has locked.

    Parameters
    ----------
    directory : Path
    boot : str
        Tells boots apart; tries of another boot do not count.

    Attributes
    ----------
    told : str
        How earlier tries of the state that is tried now have ended; empty for none.
    handle : int or None
        Descriptor of the file of notes, while it is open.
    alive_s : float
        When the process last moved, by the monotonic clock.
    tries : list of list of str
        What was noted of each earlier try of this boot, in order.
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
        """States that were set aside in this trial: the name of each, and its name now."""
        found: list[list[str]] = self._head.get("aside", [])
        return found

    def against(self, saved_ns: int | None) -> str:
        """Say why a state must not be restored; empty where nothing speaks against it.

        Parameters
        ----------
        saved_ns : int or None
            Tells states apart; None: no state at all.
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
        if not faulthandler.is_enabled():  # if it is enabled already, its output belongs to somebody else
            faulthandler.enable(handle)
            self._faults = True
        self.alive_s = time.monotonic()
        self.alive()

    def set_aside(self, name: str, aside: str) -> None:
        """Remember the new name of a state, so that it can be put back if it was not to blame."""
        self._begin_anew(saved_ns=self._head.get("saved_ns"), aside=[*self.aside, [name, aside]])

    def put_back(self) -> list[Path]:
        """Put states back that were not to blame: the service ends in the same way without any state.

        Returns
        -------
        list of Path
            Those that have their own name again; this trial tries nothing any more.
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
        with suppress(OSError):  # the file is not there, or the disk is read-only now: then these tries stay noted
            self._path.unlink()

    @contextmanager
    def noting(self) -> Iterator[None]:
        """Note what ends the process; if it was told to end and does, the trial is over."""
        try:
            yield
        except GatewayError:  # a fault of configuration or bus, reported, and no matter when the bus failed
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
        """End the trial as `over` does, but remember the states that were set aside: none is proven guilty yet."""
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
                # what was written before it may have been cut off within a line
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
    """Why a try has ended; empty if it noted no reason, or went on after what looked like its end."""
    if not lines or lines[-1] in (LOADED, WENT_ON):
        return ""
    told = next(line for line in lines if line not in (LOADED, WENT_ON))
    return f"it hung for {HANG_S:g} s" if told.startswith(HUNG) else told.removeprefix(DIED)


def _times(n: int) -> str:
    return "once" if n == 1 else f"{n} times"
