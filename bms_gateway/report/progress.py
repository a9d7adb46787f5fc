"""A progress bar for long work: on a terminal only, on standard error, so that pipes and JSON stay clean."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress(title: str, total: float | None) -> Iterator[Callable[[float], None]]:
    """Show the progress of long work.

    Parameters
    ----------
    title : str
    total : float or None
        Total of the amounts for `advance`; None if unknown: only activity is then shown.

    Yields
    ------
    callable
        `advance(amount)`; does nothing if standard error is not a terminal.

    Examples
    --------
    >>> with progress("reading", 2) as advance:
    ...     advance(1)
    """
    if not sys.stderr.isatty():
        yield _nothing
        return
    # Loaded here: a third of the start-up time of the whole program, for a bar that most runs never draw.
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    amount = TextColumn("{task.completed:,.0f}") if total is None else TextColumn("{task.percentage:>3.0f} %")
    columns = (TextColumn("{task.description}"), BarColumn(), amount)
    console = Console(stderr=True)
    with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console, transient=True) as bar:
        task = bar.add_task(title, total=total)
        yield lambda amount: bar.advance(task, amount)


@contextmanager
def share_of(title: str) -> Iterator[Callable[[float, str], None]]:
    """Show the progress of long work that reports its own share.

    Yields
    ------
    callable
        `tell(share, what)`, with a share from 0 to 1.
    """
    with progress(title, 1.0) as advance:
        done = 0.0

        def tell(share: float, _what: str) -> None:
            nonlocal done
            advance(share - done)
            done = share

        yield tell


def _nothing(_amount: float) -> None:
    """Nothing is drawn if the output is not a terminal."""
