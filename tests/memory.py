"""The peak of a process's memory.

From VmHWM, not from getrusage's ru_maxrss: a process started from a large one takes over that one's peak in its own
ru_maxrss (the kernel keeps it across exec), so that there a small child of a large test run looks as large as the run.
"""

import re
from pathlib import Path


def peak_mib() -> float:
    """Most memory that this process has held at once since it became this program, MiB; Linux."""
    found = re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())
    assert found, "this kernel does not tell a peak"
    return int(found[1]) / 1024
