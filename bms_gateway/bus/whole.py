"""Files that come to be as a whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole(target: Path) -> Iterator[Path]:
    """Give a file beside the target to write to; it takes the target's place when all went well.

    Parameters
    ----------
    target : Path
        A link is followed. What is no plain file, such as a pipe or ``/dev/null``, is written in place.

    Yields
    ------
    Path
        Where to write.

    Raises
    ------
    OSError
        The target is a folder, or cannot be replaced. After any exception the old target is as it was.

    Examples
    --------
    >>> import tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> target = Path(folder.name) / "a.txt"
    >>> with whole(target) as beside:
    ...     _ = beside.write_text("all of it")
    >>> target.read_text()
    'all of it'
    >>> folder.cleanup()
    """
    real = Path(os.path.realpath(target))
    if real.exists() and not real.is_file():
        yield real
        return
    beside = real.with_name(f".{real.name[:200]}.{os.getpid()}.tmp")
    try:
        yield beside
        if real.exists():
            beside.chmod(real.stat().st_mode & 0o777)
        beside.replace(real)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
