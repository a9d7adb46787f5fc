"""A greatest, least or mean reading in place of thermocouples: the model gets several cells for it."""

from dataclasses import replace
from typing import Final

from bms_gateway.frames.own_dbc import MAX_CELLS
from bms_gateway.setup.find_temperatures import Surfaces
from bms_gateway.setup.proposal import Proposal, Proposed

ENOUGH: Final = "a comment in gateway.toml: for the hottest core the greatest is enough"


def of_several(proposal: Proposal, warm: Surfaces) -> list[Proposed]:
    """Assign the only surface of a proposal to several cells; the number of cells in series decides how many.

    Parameters
    ----------
    proposal : Proposal
        With current and voltage; its only surface and the number of its cells are changed.
    warm : Surfaces

    Returns
    -------
    list of Proposed
        The other statistics of these cells.
    """
    mine = [p for p in proposal.signals if p.role == "surface"]
    count = proposal.series_cells or 1
    if warm.statistic is None or len(mine) != 1 or count < 2:
        return []
    first = mine[0]
    proposal.cells = [min(count, MAX_CELLS)]
    if count > MAX_CELLS:
        first.why.append(f"{MAX_CELLS} cells of the model stand for the {count} in series")
    first.index, first.sure = None, warm.said and not first.series.constant
    return [
        replace(
            first,
            series=s,
            statistic=kind,
            sure=warm.said and not s.constant,
            why=[f"the {kind} beside {first.path}", *([ENOUGH] if warm.statistic == "max" else [])],
            overrides={},
        )
        for kind, s in warm.beside.items()
    ]
