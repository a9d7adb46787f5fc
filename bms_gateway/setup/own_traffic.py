"""Traffic of the gateway's own DBC, in which the role of each signal is known."""

import numpy as np

from bms_gateway.frames.own_dbc import MAX_CELLS, MAX_STRINGS, input_messages, own_signal
from bms_gateway.frames.vocabulary import INPUTS, WHOLE
from bms_gateway.setup.proposal import Proposal, Proposed, Role
from bms_gateway.setup.signal_series import Series, all_series
from bms_gateway.setup.signal_words import unit_of
from bms_gateway.setup.vehicle_logs import Traffic


def own_signals(traffic: Traffic, proposal: Proposal) -> None:
    """Take the signals of our own DBC: names are known, so nothing is guessed."""
    by_path = {s.path: s for s in all_series(traffic)}
    for number in range(1, MAX_STRINGS + 1):
        if not any(name in traffic.messages for name in input_messages(number)):
            continue
        string = len(proposal.cells) + 1
        surfaced = [k for k in range(1, MAX_CELLS + 1) if len(_x(by_path, own_signal(number, "surface", k)))]
        volted = [k for k in range(1, MAX_CELLS + 1) if len(_x(by_path, own_signal(number, "cell_voltage", k)))]
        cells = max([*surfaced, *volted], default=0)
        if not surfaced:
            continue
        wanted: list[tuple[Role, int | None]] = [(q, None) for q in WHOLE if INPUTS[q].own is not None]
        wanted += [("surface", k) for k in surfaced] + [("cell_voltage", k) for k in volted]
        for role, index in wanted:
            path = own_signal(number, role, index)
            s = by_path.get(path)
            if s is None or not len(s.x):
                continue
            unit = unit_of(s.info.unit)
            factor, shift = (unit.factor, unit.offset) if unit is not None else (1.0, 0.0)
            why = ["a signal of the gateway's own DBC"]
            proposal.signals.append(Proposed(role, s, factor, shift, string, index, True, why))
        proposal.cells.append(cells)


def _x(by_path: dict[str, Series], path: str) -> np.ndarray:
    s = by_path.get(path)
    return np.empty(0) if s is None else s.x
