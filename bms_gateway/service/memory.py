"""Which process the kernel ends first if memory is too small for the service and its children."""

from contextlib import suppress
from pathlib import Path
from typing import Final

FIRST_TO_GO: Final = "1000"


def first_to_go() -> None:
    """Make the kernel end this process before others of its group: if a child ends, its job is tried again."""
    with suppress(OSError):  # another system, or a sandbox that forbids it
        Path("/proc/self/oom_score_adj").write_text(FIRST_TO_GO)
