"""What `init` takes as the coolant inlet where the logs have no signal of one."""

from bms_gateway.setup.find_temperatures import SURROUNDINGS
from bms_gateway.setup.proposal import Proposal
from bms_gateway.setup.resting import UNKNOWN_K, surroundings


def inlet_told(proposal: Proposal) -> list[str]:
    """Say for each inlet that is not the coolant's what stands for it, and what to write where this is wrong.

    Parameters
    ----------
    proposal : Proposal
        With its strings.

    Returns
    -------
    list of str
        One line for each signal of the surroundings, or one for all strings without any; none for a coolant inlet.
    """
    found = list(proposal.of("coolant_inlet"))
    if not found:
        taken = [surroundings(proposal, string) for string in range(1, len(proposal.cells) + 1)]
        values = sorted({f"{s.value_C:.1f}" for s in taken}, key=float)
        shown = values[0] if len(values) == 1 else f"{values[0]} to {values[-1]}"
        rest = " at rest" if all(s.rest for s in taken) else ""
        sd_K = max((s.sd_K for s in taken), default=UNKNOWN_K)
        return [
            f"no signal is a coolant inlet or an ambient temperature: the lowest readings of the cells{rest} stand for "
            f"it, {shown} °C with inlet_K = {sd_K:.1f}; if you know better, write it into gateway.toml: "
            "coolant_inlet = { constant_C = 22.0 }"
        ]
    lines = []
    for p in found:
        if SURROUNDINGS in p.why:
            low, high = p.observed
            sd = "" if p.sure else f", inlet_K = {UNKNOWN_K:.1f}"
            lines.append(
                f"no signal is a coolant inlet: {p.path}, {SURROUNDINGS}, is taken for it ({low:.1f} to {high:.1f} "
                f"°C{sd}). This is right for cells in that air; for a liquid coolant or a heated room "
                "write into gateway.toml what enters the pack: coolant_inlet = { constant_C = 22.0 }"
            )
    return lines
