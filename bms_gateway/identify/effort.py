"""Progress of a fit: a signal at every trajectory and every set of derivatives."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_HEARD: ContextVar[Callable[[], None] | None] = ContextVar("effort", default=None)


def beat() -> None:
    """Signal that one more piece of work is done."""
    if (hear := _HEARD.get()) is not None:
        hear()


@contextmanager
def heard(hear: Callable[[], None]) -> Iterator[None]:
    """Call `hear` at every piece of work within the block.

    Examples
    --------
    >>> count = []
    >>> with heard(lambda: count.append(1)):
    ...     beat()
    >>> beat()
    >>> len(count)
    1
    """
    token = _HEARD.set(hear)
    try:
        yield
    finally:
        _HEARD.reset(token)
