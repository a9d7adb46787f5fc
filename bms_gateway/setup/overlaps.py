"""Signals of one message that share bits: only one of them can be what the DBC says."""

from bms_gateway.frames.signal_info import SignalInfo
from bms_gateway.setup.proposal import Proposal, Proposed
from bms_gateway.setup.vehicle_logs import Traffic


def leave_out_overlaps(proposal: Proposal, traffic: Traffic) -> None:
    """Use the first of several signals that share bits, as not sure, and report why the others are not used.

    Signals of different multiplexer values share no bits.
    """
    kept: list[tuple[SignalInfo, Proposed]] = []
    refused: dict[str, str] = {}
    for p in proposal.signals:
        info = traffic.messages[p.series.info.message].signals[p.series.info.name]
        other = next((q for known, q in kept if q.path != p.path and _share(known, info)), None)
        if other is None:
            kept.append((info, p))
            continue
        refused[p.path] = f"shares bits with {other.path}: the DBC has lost a multiplexer, or one of them is wrong"
        other.sure = False
        if (told := f"shares bits with {p.path} and may not be what the DBC says") not in other.why:
            other.why.append(told)
    if not refused:
        return
    cells = {p.path for p in proposal.signals if p.role == "surface"}
    proposal.unused += [(path, why) for path, why in refused.items() if path not in cells]
    proposal.signals = [p for p in proposal.signals if p.path in cells or p.path not in refused]
    proposal.leave_out({path: why for path, why in refused.items() if path in cells})
    first = next(iter(refused))
    more = f" (and {len(refused) - 1} more)" if len(refused) > 1 else ""
    proposal.remarks.append(f"{first}{more}: not used: {refused[first]}")


def _share(a: SignalInfo, b: SignalInfo) -> bool:
    if a.message != b.message or not a.place.bits & b.place.bits:
        return False
    of_a = {step.signal: set(step.values) for step in a.mux}
    return all(step.signal not in of_a or of_a[step.signal] & set(step.values) for step in b.mux)
