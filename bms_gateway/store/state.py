"""One snapshot on disk: atomic, checksummed, versioned, with the generation before it.

The state is a plain file that is replaced, and not a database. There is one writer, one document of some 100 kB that is
always written as a whole, and no query. SQLite would bring recovery rules of its journal, several files that belong
together, and no check sum over the content (a flipped bit in a page is read back as data), and no advantage over a
rename. A person who services the vehicle can read, copy and delete a plain file.

``state`` is the newest generation, ``state.previous`` the one before, ``state.new`` one that is being written::

    bms-gateway-state 1 <sha256 of the rest> <bytes of the rest>
    {"saved_ns": …, "state": {…}}

Saving writes ``state.new``, syncs it, renames ``state`` to ``state.previous`` and ``state.new`` to ``state``, and syncs
the directory. At every moment, also between the two renames, one complete generation has its name, so that a power cut
loses at most the snapshot in progress.

A file that cannot be used is renamed to ``state.<reason>`` and never read again. A file that is damaged or of another
program replaces an earlier one of the same reason. A file that may still be a good state (not readable, of a newer
version, refused by the engine, on `trial` and found to end the service) replaces no other: the next one becomes
``state.<reason>.2``. If all such names are used, or the disk does not allow the rename, nothing is saved. So the
directory does not fill up, and no state is lost that a person could still restore.

`look` only reads and renames nothing, because the service may be writing. Only one process may write: `lock` locks the
directory itself. This lock leaves no file behind, needs no right to write, and ends with the process, however the
process ends.
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
from bms_gateway.store.dear import is_dear
from bms_gateway.store.files import make_directory, read_on, reading, sync_directory, write_fresh
from bms_gateway.store.trial import Trial

VERSION = 1
MAGIC = b"bms-gateway-state"
# A snapshot of 8 strings takes some 100 kB: a file of nearly this size is of another program and must not be read into
# memory.
MAX_BYTES = 64 << 20
MAX_HEAD = 256
GARBAGE = ("corrupt", "foreign")  # for these reasons a file has no value, and the next one may replace it
UNREAD = "unread"
CRASHED = "crashed"
TOLD = {
    UNREAD: "a stored state could not be read and was kept as {}: stop the service and move it back, once it can be "
    "read, or delete it",
    CRASHED: "the service ended again and again soon after it had restored a stored state, which was kept as {}: "
    "report it with the lines of the journal; after an update stop the service and move it back, or delete it",
}
KEPT_MOST = 5  # files set aside for one reason: a fault that recurs at every start must not fill the disk
SHORT_OF = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)  # the file may be sound, and readable a minute later


@dataclass(frozen=True, slots=True)
class Loaded:
    """The stored state that a start finds.

    Attributes
    ----------
    state : dict or None
        The newest snapshot that can be trusted; None: there is none.
    saved_ns : int or None
        Wall clock when it was saved, ns since 1970; a clock that starts in 1970 makes it later than now.
    problems : tuple of StateError
        The files that are not used, with the reason, one line each.
    """

    state: dict[str, Any] | None
    saved_ns: int | None
    problems: tuple[StateError, ...]


class _RejectedError(Exception):
    """A file that is not used: the reason (part of its new name), a text, and its new place once it is set aside."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason
        self.aside: Path | None = None


class StateStore:
    """Snapshots in one directory, one writer.

    Parameters
    ----------
    directory : Path
        Made on the first save where it is missing. Nothing is touched before `load` or `save`.

    Attributes
    ----------
    unread : str
        For people: which stored state could not be read or ended the service, where it is, and what to do; empty if
        there is none.

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
        self._stuck: dict[Path, _RejectedError] = {}  # `load` could not set these aside
        self.unread = ""

    def lock(self) -> StateError | None:
        """Claim the directory for this process until it ends or calls `unlock`.

        Returns
        -------
        StateError or None
            The reason, other than the lock of another process, why it could not be locked: a value, because the service
            goes on without a lock.

        Raises
        ------
        StateError
            Another process has locked it: two processes that save in turn would each start from the other's state.
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
        """Release the lock of the directory."""
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
            None: the snapshot is on the disk. Otherwise the reason (read-only, full, …) as a value, because the service
            goes on without it. The earlier snapshot is then intact.
        """
        body = json.dumps({"saved_ns": wall_ns, "state": dict(state)}, separators=(",", ":")).encode()
        if len(body) > MAX_BYTES:
            return StateError(f"{self.directory}: the state is not saved: {len(body)} bytes, at most {MAX_BYTES}")
        if is_dear(body):
            return StateError(f"{self.directory}: the state is not saved: it has too many values")
        digest = hashlib.sha256(body).hexdigest()
        head = b"%s %d %s %d\n" % (MAGIC, VERSION, digest.encode(), len(body))
        try:
            make_directory(self.directory)
            write_fresh(self._new, head + body)
            self._make_room()
            self._new.replace(self._state)
            sync_directory(self.directory)
            self.unread = ""
            self._note_unread()
        except StateError as e:
            return StateError(f"{e}: the state is not saved; estimates go on without it")
        except OSError as e:
            return StateError(f"{self.directory}: the state cannot be saved: {e.strerror}; estimates go on without it")
        return None

    def load(self, use: Callable[[dict[str, Any]], None] | None = None, trial: Trial | None = None) -> Loaded:
        """Read the newest snapshot that can be trusted; set the others aside.

        Parameters
        ----------
        use : callable, optional
            Restores the snapshot. A `StateError` from it means that the snapshot cannot be used: it is set aside like a
            damaged one, as ``state.refused``, and the generation before is tried.
        trial : Trial, optional
            A snapshot that the trial refuses is set aside in the same way, as ``state.crashed``.

        Returns
        -------
        Loaded
            Never raises for what lies on the disk.
        """
        self._stuck.clear()
        if trial is None:
            found = self._newest(use, self._try_to_set_aside)
        else:
            with trial.noting():
                found = self._tried(use, trial)
        self._note_unread()
        return found

    def _tried(self, use: Callable[[dict[str, Any]], None] | None, trial: Trial) -> Loaded:
        """Load a state on trial. Once a state was set aside in a trial, a start without any state is on trial too."""
        back = trial.put_back()

        def reject(path: Path, why: _RejectedError) -> StateError:
            problem = self._try_to_set_aside(path, why)
            if why.reason == CRASHED and why.aside is not None:
                trial.set_aside(path.name, why.aside.name)
            return problem

        found = self._newest(use, reject, trial)
        if found.state is None and trial.aside:
            trial.against(None)
            trial.begin()
        if found.state is None and not trial.aside:
            trial.over()
        else:
            trial.loaded()
        told = tuple(
            StateError(f"{path}: put back: the service ends again and again without a stored state, too")
            for path in back
        )
        return Loaded(found.state, found.saved_ns, told + found.problems)

    def look(self) -> Loaded:
        """Read the newest snapshot that can be trusted, and change nothing: for processes other than the one writer.

        Returns
        -------
        Loaded
            Never raises for what lies on the disk.
        """
        return self._newest(None, lambda path, why: StateError(f"{path}: the stored state is not used: {why}"))

    def _newest(
        self,
        use: Callable[[dict[str, Any]], None] | None,
        reject: "Callable[[Path, _RejectedError], StateError]",
        trial: Trial | None = None,
    ) -> Loaded:
        problems: list[StateError] = []
        for path in (self._state, self._previous):
            try:
                content = _read(path)
                if trial is not None:
                    if why := trial.against(content["saved_ns"]):
                        raise _RejectedError(CRASHED, why)  # noqa: TRY301 (handled as what `_read` raises)
                    trial.begin()
                if use is not None:
                    use(content["state"])
            except FileNotFoundError:
                continue
            except StateError as e:
                problems.append(reject(path, _RejectedError("refused", str(e))))
                continue
            except OSError as e:
                # the file stays where it is: at the next start it may be readable again. `save` does not overwrite it
                problems.append(StateError(f"{path}: the stored state cannot be read: {e.strerror}"))
                self.unread = str(problems[-1])
                continue
            except _RejectedError as e:
                problems.append(reject(path, e))
                continue
            return Loaded(content["state"], content["saved_ns"], tuple(problems))
        return Loaded(None, None, tuple(problems))

    def _make_room(self) -> None:
        """Free the name of the newest generation; a sound one replaces the one before.

        Raises
        ------
        StateError
            The file must not be replaced, and cannot be set aside.
        OSError
            It cannot be looked at now.
        """
        for path, why in list(self._stuck.items()):
            self._set_aside(path, why)
            del self._stuck[path]
        if self._is_sound(self._state):
            self._is_sound(self._previous)  # one that cannot be read is set aside
            self._state.replace(self._previous)

    def _is_sound(self, path: Path) -> bool:
        """Whether a generation is complete; any other file of this name is set aside.

        Raises
        ------
        StateError, OSError
            As `_make_room`.
        """
        try:
            _read(path)
        except FileNotFoundError:
            return False
        except _RejectedError as why:
            self._set_aside(path, why)
            return False
        except OSError as e:
            if e.errno in SHORT_OF:
                raise
            self._set_aside(path, _RejectedError(UNREAD, f"it cannot be read: {e.strerror}"))
            return False
        return True

    def _try_to_set_aside(self, path: Path, why: "_RejectedError") -> StateError:
        try:
            aside = self._set_aside(path, why)
        except StateError as e:
            self._stuck[path] = why
            return e
        return StateError(f"{path}: the stored state is not used: {why}; set aside as {aside.name}")

    def _set_aside(self, path: Path, why: "_RejectedError") -> Path:
        """Rename a file that cannot be used; raise `StateError` if it cannot be renamed."""
        first = path.with_name(f"{path.name}.{why.reason}")
        more = () if why.reason in GARBAGE else (first.with_name(f"{first.name}.{k}") for k in range(2, KEPT_MOST + 1))
        aside = first if why.reason in GARBAGE else next((n for n in (first, *more) if not os.path.lexists(n)), None)
        if aside is None:
            raise StateError(
                f"{path}: {why}; {KEPT_MOST} others are kept as {first.name}*: look at them, delete or move"
            )
        try:
            path.replace(aside)
        except OSError as e:
            raise StateError(f"{path}: {why}; it cannot be set aside: {e.strerror}") from None
        why.aside = aside
        return aside

    def _note_unread(self) -> None:
        """List the good states that were set aside, in this run or an earlier one, and not yet removed by a person."""
        try:
            names = sorted(f.name for f in self.directory.iterdir())
        except OSError:
            return  # a directory that cannot be listed gives no names
        kept = {reason: [name for name in names if f".{reason}" in name] for reason in TOLD}
        told = [text.format(", ".join(kept[reason])) for reason, text in TOLD.items() if kept[reason]]
        if told:
            self.unread = f"{self.directory}: {'; '.join(told)}"


def _read(path: Path) -> dict[str, Any]:
    """Read a snapshot file; raise `_RejectedError` if it is damaged or of another program."""
    try:
        with reading(path) as handle:
            if handle is None:
                raise _RejectedError("foreign", "it is not a file")
            start = read_on(handle, MAX_HEAD)
            head, _, body = start.partition(b"\n")
            size, digest = _head(head.split())
            body += read_on(handle, len(head) + 1 + size + 1 - len(start))
    except FileNotFoundError:
        if path.is_symlink():  # for example to a disk that is not mounted
            raise OSError(errno.ENOLINK, "it is a link to what is not there") from None
        raise
    if len(body) != size:
        raise _RejectedError(
            "corrupt", f"{len(body)} of {size} bytes are there" if len(body) < size else "it is too long"
        )
    if hashlib.sha256(body).hexdigest().encode() != digest:
        raise _RejectedError("corrupt", "its check sum does not match")
    if is_dear(body):
        raise _RejectedError("foreign", "it has far more values than a state of this program")
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
