"""One snapshot on disk: atomic, checksummed, versioned, with the generation before it.

A plain file that is replaced, not a database. There is one writer, one document of some 100 kB that is always written
whole, and no query. SQLite would bring its journal's recovery rules, files that belong together, no check sum over the
content (a flipped bit in a page is read back as data), and nothing that a rename does not give. A file can be
looked at, copied and deleted by whoever services the vehicle.

``state`` is the newest generation, ``state.previous`` the one before, ``state.new`` one that is being written::

    bms-gateway-state 1 <sha256 of the rest> <bytes of the rest>
    {"saved_ns": …, "state": {…}}

Saving writes ``state.new``, syncs it, renames ``state`` to ``state.previous`` and ``state.new`` to ``state``, and syncs
the directory. At every moment, also between the two renames, one complete generation has its name, so that a cut of
power costs at most the snapshot in progress. What cannot be trusted is renamed to ``state.<reason>`` and never read
again; the reasons are few, so the directory does not fill.

One process at a time: `lock` locks the directory itself, which leaves no file behind, needs no right to write and ends
with the process, however that ends.
"""

import errno
import fcntl
import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bms_gateway.errors import StateError
from bms_gateway.store.files import make_directory, read_file, sync_directory, write_fresh

VERSION = 1
MAGIC = b"bms-gateway-state"
# A snapshot of 8 strings takes some 100 kB: anything near this is not ours and must not be read into memory.
MAX_BYTES = 64 << 20
MAX_HEAD = 256


@dataclass(frozen=True, slots=True)
class Loaded:
    """What a start finds.

    Attributes
    ----------
    state : dict or None
        The newest snapshot that can be trusted; None starts afresh.
    saved_ns : int or None
        Wall clock when it was saved, ns since 1970; a clock that starts in 1970 makes it later than now.
    problems : tuple of StateError
        What was set aside and why, one line each; for the log.
    """

    state: dict[str, Any] | None
    saved_ns: int | None
    problems: tuple[StateError, ...]


class _RejectedError(Exception):
    """Reason (part of the quarantine name) and text."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class StateStore:
    """Snapshots in one directory, one writer.

    Parameters
    ----------
    directory : Path
        Made on the first save where it is missing. Nothing is touched before `load` or `save`.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = StateStore(Path(folder))
    ...     failed = store.save({"strings": 5}, wall_ns=1)
    ...     (failed, store.load().state)
    (None, {'strings': 5})
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._state = directory / "state"
        self._previous = directory / "state.previous"
        self._new = directory / "state.new"
        self._locked: int | None = None

    def lock(self) -> StateError | None:
        """Claim the directory for this process until it ends or calls `unlock`.

        Returns
        -------
        StateError or None
            Why it could not be locked for another reason than somebody else's lock: a value, because the service goes
            on without.

        Raises
        ------
        StateError
            Another process has it: two that save in turn would each start from the other's state.
        """
        try:
            make_directory(self.directory)
            handle = os.open(self.directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except OSError as e:
            return StateError(f"{self.directory}: no state can be kept there: {e.strerror}; estimates go on without it")
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as e:
            os.close(handle)
            if e.errno in (errno.EWOULDBLOCK, errno.EACCES):
                raise StateError(
                    f"{self.directory}: another bms-gateway keeps its state there: stop it, or give this one a [store] "
                    "path of its own"
                ) from None
            return StateError(f"{self.directory}: cannot be locked against a second process: {e.strerror}")
        self._locked = handle
        return None

    def unlock(self) -> None:
        """Let another process have the directory."""
        if self._locked is not None:
            os.close(self._locked)
            self._locked = None

    def save(self, state: Mapping[str, Any], *, wall_ns: int) -> StateError | None:
        """Write a snapshot; the generation before it stays.

        Parameters
        ----------
        state : mapping
            JSON-able. Floats come back bit for bit, NaN and infinities too.
        wall_ns : int
            Wall clock now, ns since 1970.

        Returns
        -------
        StateError or None
            None: it is on the disk. Else why not (read-only, full, …): a value, because the service goes on without.
            What was stored before is intact then.
        """
        body = json.dumps({"saved_ns": wall_ns, "state": dict(state)}, separators=(",", ":")).encode()
        if len(body) > MAX_BYTES:
            return StateError(f"{self.directory}: the state is not saved: {len(body)} bytes, at most {MAX_BYTES}")
        digest = hashlib.sha256(body).hexdigest()
        head = b"%s %d %s %d\n" % (MAGIC, VERSION, digest.encode(), len(body))
        try:
            make_directory(self.directory)
            write_fresh(self._new, head + body)
            if self._is_sound(self._state):
                self._state.replace(self._previous)
            self._new.replace(self._state)
            sync_directory(self.directory)
        except OSError as e:
            return StateError(f"{self.directory}: the state cannot be saved: {e.strerror}; estimates go on without it")
        return None

    def load(self, use: Callable[[dict[str, Any]], None] | None = None) -> Loaded:
        """Read the newest snapshot that can be trusted; set the others aside.

        Parameters
        ----------
        use : callable, optional
            Takes the snapshot up. A `StateError` from it says that this one is of no use: it is set aside like a
            damaged one, as ``state.refused``, and the generation before is tried.

        Returns
        -------
        Loaded
            Never raises for what lies on the disk.
        """
        problems: list[StateError] = []
        for path in (self._state, self._previous):
            try:
                content = _read(path)
                if use is not None:
                    use(content["state"])
            except FileNotFoundError:
                continue
            except StateError as e:
                problems.append(self._set_aside(path, _RejectedError("refused", str(e))))
                continue
            except OSError as e:
                problems.append(StateError(f"{path}: the stored state cannot be read: {e.strerror}"))
                continue
            except _RejectedError as e:
                problems.append(self._set_aside(path, e))
                continue
            return Loaded(content["state"], content["saved_ns"], tuple(problems))
        return Loaded(None, None, tuple(problems))

    def _set_aside(self, path: Path, why: _RejectedError) -> StateError:
        aside = path.with_name(f"{path.name}.{why.reason}")
        try:
            path.replace(aside)
        except OSError as e:
            return StateError(f"{path}: the stored state is not used: {why}; it cannot be set aside: {e.strerror}")
        return StateError(f"{path}: the stored state is not used: {why}; set aside as {aside.name}")

    def _is_sound(self, path: Path) -> bool:
        """Whether a generation may take the place of the previous one: a spoilt file must not push out a good one."""
        try:
            _read(path)
        except (OSError, _RejectedError):
            return False
        return True


def _read(path: Path) -> dict[str, Any]:
    """Read a snapshot file; `_RejectedError` where it is not wholly ours."""
    start = read_file(path, MAX_HEAD)
    if start is None:
        raise _RejectedError("foreign", "it is not a file")
    head = start.split(b"\n", 1)[0]
    size, digest = _head(head.split())
    body = (read_file(path, len(head) + 1 + size + 1) or b"")[len(head) + 1 :]
    if len(body) != size:
        raise _RejectedError(
            "corrupt", f"{len(body)} of {size} bytes are there" if len(body) < size else "it is too long"
        )
    if hashlib.sha256(body).hexdigest().encode() != digest:
        raise _RejectedError("corrupt", "its check sum does not match")
    try:
        content = json.loads(body)
    except (ValueError, RecursionError):
        content = None
    if not (isinstance(content, dict) and isinstance(content.get("state"), dict)):
        raise _RejectedError("foreign", "its content is not a state")
    if not isinstance(content.get("saved_ns"), int):
        raise _RejectedError("foreign", "it does not say when it was saved")
    return content


def _head(words: list[bytes]) -> tuple[int, bytes]:
    """Size and check sum that the first line promises."""
    if not words:
        raise _RejectedError("corrupt", "it is empty")
    if words[0] != MAGIC:
        raise _RejectedError("foreign", "it is not a state of this program")
    if len(words) > 1 and words[1].isdigit() and int(words[1]) > VERSION:
        raise _RejectedError("too-new", f"it has format {int(words[1])}, this version knows {VERSION}")
    if len(words) != 4 or not (words[1].isdigit() and words[3].isdigit()):
        raise _RejectedError("corrupt", "its first line is damaged")
    if int(words[3]) > MAX_BYTES:
        raise _RejectedError("corrupt", f"it claims {int(words[3])} bytes, a state has at most {MAX_BYTES}")
    return int(words[3]), words[2]
