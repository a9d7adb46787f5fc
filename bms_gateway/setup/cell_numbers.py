"""Says which channel is which cell of the model, where the names of the channels have other numbers."""

from itertools import pairwise
from typing import Final

from bms_gateway.setup.proposal import Proposal, Proposed
from bms_gateway.setup.signal_words import numbers

MOST_SHOWN: Final = 12
MOST_EACH: Final = 1.5
"""Greatest number of cells for each thermocouple in a model that has the cells without a thermocouple too."""


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
        f"{channels} left out ({more}): {_why(proposal)}, so the cells are numbered by the "
        "channels that are used, and not by the numbers in the names"
    )


def _why(proposal: Proposal) -> str:
    """Say why the numbers in the names are not those of the cells."""
    volted = sum(1 for _ in proposal.of("cell_voltage"))
    used = sum(p.index is not None for p in proposal.of("surface"))
    if volted > MOST_EACH * used:
        return f"{used} thermocouples are too few for a model of all {volted} cells that have a voltage"
    if volted > 1:
        return f"the numbers in the names do not fit those of the {volted} cell voltages"
    if proposal.series_cells and not proposal.series_guessed:
        return "no voltages of single cells confirm the numbers in the names"
    return "nothing confirms how many cells there are"


def renumbered(proposal: Proposal, string: int) -> str | None:
    """List the channels of a string's cells if the numbers in their names differ; None otherwise.

    Numbers that begin at 0 instead of 1 are no difference.
    """
    mine = sorted((p for p in proposal.of("surface", string) if p.index is not None), key=lambda p: p.index or 0)
    own = [numbers(p.series.info.name)[1][-1:] for p in mine]
    if len(mine) < 2 or not all(own):
        return None
    offset = [n[0] - (p.index or 0) for n, p in zip(own, mine, strict=True)]
    if len(set(offset)) == 1 and offset[0] in (0, -1):
        return None
    begins = [k for k in range(len(mine)) if k == 0 or offset[k] != offset[k - 1]]
    runs = [mine[first:end] for first, end in pairwise([*begins, len(mine)])]
    shown = ", ".join(_run(run, mine) for run in runs[:MOST_SHOWN]) + (" …" if len(runs) > MOST_SHOWN else "")
    return f"string_{string}: the cells have other numbers than the names of their thermocouples: {shown}"


def _run(run: list[Proposed], among: list[Proposed]) -> str:
    """Say which cells the channels are whose numbers follow each other."""
    if len(run) == 1:
        return f"{run[0].index} = {_named(run[0], among)}"
    return f"{run[0].index} to {run[-1].index} = {_named(run[0], among)} to {_named(run[-1], among)}"


def _named(p: Proposed, among: list[Proposed]) -> str:
    """Name a signal, with its message if another one has the same name."""
    name = p.series.info.name
    return name if sum(q.series.info.name == name for q in among) == 1 else p.path
