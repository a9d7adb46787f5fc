"""Counts of the samples of a log that are not used: of which signals, how many, and why."""

from collections.abc import Iterator, Mapping

from bms_gateway.engine.reasons import unused, why_not
from bms_gateway.errors import counted
from bms_gateway.frames.quality import Quality
from bms_gateway.records.signal_use import Use

_OF_SAMPLES = {q.name.lower() for q in Quality}


def refused_samples(uses: Mapping[str, Use], rejected: Mapping[str, int]) -> Iterator[str]:
    """Write one line for each quantity and reason, the greatest count first; then the reasons that concern frames.

    Parameters
    ----------
    uses : mapping of signal to Use
    rejected : mapping of reason to int
        Counters of the engine.
    """
    found: dict[tuple[str, Quality], list[Use]] = {}
    for use in uses.values():
        for reason in use.refused:
            found.setdefault((use.channel.quantity, Quality[reason.upper()]), []).append(use)
    lines = []
    for (quantity, quality), of in found.items():
        count = sum(use.refused[quality.name.lower()] for use in of)
        lines.append((count, f"{counted(count, 'sample')} of {_named(of)} not used: {why_not(quantity, quality)}"))
    yield from (line for _, line in sorted(lines, key=lambda x: (-x[0], x[1])))
    for reason, count in unused({key: n for key, n in rejected.items() if key not in _OF_SAMPLES}).items():
        yield f"{counted(count, 'sample')} not used: {reason}"


def _named(of: list[Use]) -> str:
    """Name the signals: the quantity, or how many of the cells'."""
    c, count = of[0].channel, len(of)
    what = {"surface": "thermocouple", "cell_voltage": "cell voltage"}.get(c.quantity)
    if what is None:
        return f"the {c.quantity.replace('_', ' ')}"
    if count > 1:
        return counted(count, what)
    return f"the {what}" + ("" if c.cell is None else f" of cell {c.cell}")
