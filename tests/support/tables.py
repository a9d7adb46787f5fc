"""The folder of a test run for tables of parsed DBC files; what killed runs left goes at the next start.

A run locks its folder for as long as it lasts, as the program does with uploads.
"""

import atexit
import os
import shutil

from bms_gateway.workbench.uploads import own_folder, sweep

PREFIX = "bms-gateway-tables-"


class Tables:
    """A folder that is there until `close`, the end of this process, or the next start after it was killed."""

    def __init__(self):
        sweep(PREFIX)
        self._pid = os.getpid()
        self.folder, self._handle = own_folder(PREFIX)
        atexit.register(self.close)

    def close(self):
        """Throw it away; children of this process do not."""
        if os.getpid() == self._pid:
            shutil.rmtree(self.folder, ignore_errors=True)
