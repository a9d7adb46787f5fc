"""Uploaded files of a tab: in a folder of its own, bounded in size, deleted with the tab however the program ends.

The program locks each folder for as long as it runs. A folder without a lock belongs to a program that was killed; the
next start deletes it.
"""

import fcntl
import filecmp
import os
import secrets
import shutil
import tempfile
import threading
from contextlib import suppress
from io import BufferedIOBase
from pathlib import Path
from typing import Final

from bms_gateway.errors import UsageError

PREFIX: Final = "bms-gateway-workbench-"
PER_DESK: Final = 1024**3
"""Bytes that one tab may keep."""
CHUNK: Final = 1 << 20
_NOT_IN_NAMES: Final = frozenset('/\\:*?"<>|')
_DIRECTORY = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


class Uploads:
    """Uploads of one tab; several may come at once.

    Attributes
    ----------
    folder : Path
        Made here, locked, for this user only.
    """

    def __init__(self) -> None:
        self.folder, self._handle = own_folder()
        self._lock = threading.Lock()
        self._promised = 0
        self._closed = False

    def receive(self, source: BufferedIOBase, size: int, name: str) -> bool:
        """Take a file; it is there as a whole or not at all.

        Parameters
        ----------
        source : file
        size : int
            Bytes to read from there.
        name : str
            From `safe_name`.

        Returns
        -------
        bool
            Whether it takes the place of a file of the same name and of other content.

        Raises
        ------
        UsageError
            The tab would hold too much, the upload broke off, or the disk cannot take it.
        """
        beside = self.folder / f".{secrets.token_hex(8)}"
        self._promise(size, name)
        try:
            left = size
            with beside.open("wb") as out:
                while left and (part := source.read(min(left, CHUNK))):
                    out.write(part)
                    left -= len(part)
            if left:
                raise UsageError(f"{name}: the upload broke off")
            there = self.folder / name
            other = there.is_file() and not filecmp.cmp(there, beside, shallow=False)
            beside.replace(there)
        except (ConnectionError, TimeoutError):
            raise  # of the browser, not of the disk
        except OSError as e:
            raise UsageError(f"{name}: cannot be kept: {e.strerror}") from None
        finally:
            beside.unlink(missing_ok=True)
            with self._lock:
                self._promised -= size
        return other

    def _promise(self, size: int, name: str) -> None:
        """Set room aside for a whole file before its first byte: others may be on their way beside it."""
        with self._lock:
            kept = self._promised + sum(p.stat().st_size for p in self.folder.glob("[!.]*"))
            if kept + size > PER_DESK:
                raise UsageError(
                    f"{name}: this tab holds {kept / 1024**2:.0f} MiB already: reload the page to start anew"
                )
            self._promised += size

    def close(self) -> None:
        """Throw everything away."""
        with self._lock:
            if not self._closed:
                self._closed = True
                shutil.rmtree(self.folder, ignore_errors=True)  # what is written just now is swept at the next start
                os.close(self._handle)


def safe_name(name: str) -> str:
    """Give the last part of a file's name, without what could lead elsewhere or what no system takes.

    Examples
    --------
    >>> safe_name("../../etc/passwd"), safe_name("drive 1, cold.log.gz"), safe_name("..")
    ('passwd', 'drive 1, cold.log.gz', '')
    """
    last = name.replace("\\", "/").rpartition("/")[2]
    return "".join(c for c in last if c.isprintable() and c not in _NOT_IN_NAMES).lstrip(". ").rstrip()[:120]


def sweep(prefix: str = PREFIX) -> None:
    """Throw away the folders of this name that programs of this user left which were killed."""
    for folder in Path(tempfile.gettempdir()).glob(f"{prefix}*"):
        with suppress(OSError):  # somebody else's, or another start sweeps it too
            handle = os.open(folder, _DIRECTORY)
            try:
                if os.fstat(handle).st_uid == os.getuid():
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(folder)
            finally:
                os.close(handle)


def own_folder(prefix: str = PREFIX) -> tuple[Path, int]:
    """Make a folder and lock it; a start that sweeps may come in between, and then it is made once more."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix))
        with suppress(FileNotFoundError):
            handle = os.open(folder, _DIRECTORY)
            fcntl.flock(handle, fcntl.LOCK_EX)
            if folder.exists():
                return folder, handle
            os.close(handle)
