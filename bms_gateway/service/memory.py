"""Who goes where the memory that the system gives the service is too small for it and its children."""

from contextlib import suppress
from pathlib import Path
from typing import Final

FIRST_TO_GO: Final = "1000"


def first_to_go() -> None:
    """Have the kernel end this process before any other of its group: for children, which are told and tried again."""
    with suppress(OSError):  # another system, or a sandbox that forbids it
        Path("/proc/self/oom_score_adj").write_text(FIRST_TO_GO)
