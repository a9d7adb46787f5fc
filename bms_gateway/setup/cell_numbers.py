"""Says which channel is which cell of the model, where the names of the channels have other numbers."""

from typing import Final

from bms_gateway.setup.proposal import Proposal, Proposed
from bms_gateway.setup.signal_words import numbers

MOST_SHOWN: Final = 12


def left_out(proposal: Proposal) -> str | None:
    """Say that the channels in use number the cells; None if the names do, or if no channel is left out."""
    counted = {p.string for p in proposal.of("surface") if p.index is not None and p.string not in proposal.numbered}
    n = len(proposal.refused)
    if not n or not counted:
        return None
    first = next(path for path, _ in proposal.unused if path in proposal.refused)
    channels = f"{n} channels of thermocouples were" if n > 1 else "a channel of a thermocouple was"
    more = f"{first} …" if n > 1 else first
    return (
        f"{channels} left out ({more}): nothing confirms how many cells there are, so the cells are numbered by the "
        "channels that are used, and not by the numbers in the names"
    )


def renumbered(proposal: Proposal, string: int) -> str | None:
    """List the channels of a string's cells if the numbers in their names differ; None otherwise.

    Numbers that begin at 0 instead of 1 are no difference.
    """
    mine = sorted((p for p in proposal.of("surface", string) if p.index is not None), key=lambda p: p.index or 0)
    own = [numbers(p.series.info.name)[1][-1:] for p in mine]
    if len(mine) < 2 or not all(own):
        return None
    apart = {n[0] - (p.index or 0) for n, p in zip(own, mine, strict=True)}
    if len(apart) == 1 and apart <= {0, -1}:
        return None
    if len(apart) == 1:
        which = f"cells {mine[0].index} to {mine[-1].index} are {_named(mine[0], mine)} to {_named(mine[-1], mine)}"
    else:
        more = " …" if len(mine) > MOST_SHOWN else ""
        which = ", ".join(f"{p.index} = {_named(p, mine)}" for p in mine[:MOST_SHOWN]) + more
    return f"string_{string}: the cells have other numbers than the names of their thermocouples: {which}"


def _named(p: Proposed, among: list[Proposed]) -> str:
    """Name a signal, with its message if another one has the same name."""
    name = p.series.info.name
    return name if sum(q.series.info.name == name for q in among) == 1 else p.path
