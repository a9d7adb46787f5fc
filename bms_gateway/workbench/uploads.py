"""Uploaded files of a tab: in their own folder, limited in size, deleted with the tab however the program ends.

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
        Created here, locked, for this user only.
    """

    def __init__(self) -> None:
        self.folder, self._handle = own_folder()
        self._lock = threading.Lock()
        self._promised = 0
        self._closed = False

    def receive(self, source: BufferedIOBase, size: int, name: str) -> bool:
        """Receive a file completely or not at all.

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
            Whether it replaces a file with the same name and other content.

        Raises
        ------
        UsageError
            The tab would exceed its limit, the upload broke off, or the disk refuses it.
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
            raise  # from the browser, not from the disk
        except OSError as e:
            raise UsageError(f"{name}: cannot be kept: {e.strerror}") from None
        finally:
            beside.unlink(missing_ok=True)
            with self._lock:
                self._promised -= size
        return other

    def _promise(self, size: int, name: str) -> None:
        """Reserve room for a whole file before its first byte, because other uploads may be in progress."""
        with self._lock:
            kept = self._promised + sum(p.stat().st_size for p in self.folder.glob("[!.]*"))
            if kept + size > PER_DESK:
                raise UsageError(
                    f"{name}: this tab holds {kept / 1024**2:.0f} MiB already: reload the page to start anew"
                )
            self._promised += size

    def close(self) -> None:
        """Delete everything."""
        with self._lock:
            if not self._closed:
                self._closed = True
                shutil.rmtree(self.folder, ignore_errors=True)  # a file being written now is deleted at the next start
                os.close(self._handle)


def safe_name(name: str) -> str:
    """Return the last part of a file's name, without characters that lead elsewhere or that systems refuse.

    Examples
    --------
    >>> safe_name("../../etc/passwd"), safe_name("drive 1, cold.log.gz"), safe_name("..")
    ('passwd', 'drive 1, cold.log.gz', '')
    """
    last = name.replace("\\", "/").rpartition("/")[2]
    return "".join(c for c in last if c.isprintable() and c not in _NOT_IN_NAMES).lstrip(". ").rstrip()[:120]


def sweep(prefix: str = PREFIX) -> None:
    """Delete the folders with this prefix of killed programs of this user."""
    for folder in Path(tempfile.gettempdir()).glob(f"{prefix}*"):
        with suppress(OSError):  # another user's, or another start deletes it too
            handle = os.open(folder, _DIRECTORY)
            try:
                if os.fstat(handle).st_uid == os.getuid():
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(folder)
            finally:
                os.close(handle)


def own_folder(prefix: str = PREFIX) -> tuple[Path, int]:
    """Make a folder and lock it; if another start deletes it in between, make it again."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix))
        with suppress(FileNotFoundError):
            handle = os.open(folder, _DIRECTORY)
            fcntl.flock(handle, fcntl.LOCK_EX)
            if folder.exists():
                return folder, handle
            os.close(handle)
