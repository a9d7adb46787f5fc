"""The folder of a test run for tables of parsed DBC files; what killed runs left goes at the next start.

A run locks its folder for as long as it lasts. A folder without a lock belongs to a run that was killed.
"""

import atexit
import fcntl
import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

PREFIX = "bms-gateway-tables-"


def swept():
    """Throw away what runs of this user left that were killed."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):  # somebody else's, one that is in use, or another start sweeps it too
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder)
            finally:
                os.close(handle)


class Tables:
    """A folder that is there until `close`, the end of this process, or the next start after it was killed."""

    def __init__(self):
        swept()
        self._pid = os.getpid()
        while True:
            self.folder = Path(tempfile.mkdtemp(prefix=PREFIX))
            with suppress(FileNotFoundError):
                self._handle = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY)
                fcntl.flock(self._handle, fcntl.LOCK_EX)
                if self.folder.exists():
                    break
                os.close(self._handle)  # a start that sweeps came before the lock
        atexit.register(self.close)

    def close(self):
        """Throw it away; children of this process do not."""
        if os.getpid() == self._pid:
            shutil.rmtree(self.folder, ignore_errors=True)
