"""Contradictions between a DBC's multiplexing and the data: selectors, and signals that jump with another byte."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.signal_info import MessageInfo
from bms_gateway.setup.signal_series import Series
from bms_gateway.setup.signal_words import CURRENT, TEMPERATURE, VOLTAGE, has, named, unit_of
from bms_gateway.setup.vehicle_logs import Traffic
from bms_gateway.thermal import Floats

FEWEST: Final = 20
ROUNDS: Final = 3
"""Frames per value of a selector from which a value that never comes is reported."""
MOST_PAGES: Final = 64
OF_A_PAGE: Final = 8
"""Least frames of each value of a byte that may select."""
EVEN: Final = 0.2
"""Least number of frames of one value, relative to the most frequent value."""
MOVES: Final = 0.5
"""Least share of the frames in which a selector differs from the frame before."""
EXPLAINED: Final = 0.95
"""Least share of a signal's variance between the groups of frames with equal byte, if the byte selects the signal."""
APART: Final = 4.0
"""Least ratio of the step from frame to frame to the step between frames with equal byte, if the byte selects the
signal."""
SHOWN: Final = 4


def told_of_selectors(traffic: Traffic) -> Iterator[str]:
    """Report values of a selector that the DBC does not know, and known values without a frame in the traffic."""
    for message in traffic.messages.values():
        if any(_matters(message, name) for name in message.signals):
            for selector in {step.signal: None for s in message.signals.values() for step in s.mux}:
                yield from _told_of(traffic, message, selector)


def jumps_with(traffic: Traffic, s: Series) -> str | None:
    """Find the byte with which a signal jumps that the DBC has in every frame; None if there is no such byte."""
    info = s.info
    if info.mux or info.is_multiplexer or s.distinct < 3 or len(s.x) < 2 * OF_A_PAGE:
        return None
    samples = traffic.decode([info])
    data = traffic.frames.data[samples.frame]
    x = samples.value
    length = traffic.messages[info.message].length
    own = {k // 8 for k in info.place.bits}
    for byte in range(min(length, data.shape[1])):
        if byte in own:
            continue
        for what, values in (("byte", data[:, byte]), ("low bits of byte", data[:, byte] & 15),
                             ("high bits of byte", data[:, byte] >> 4)):  # fmt: skip
            pages = _selects(values, x)
            if pages is not None:
                shown = ", ".join(map(str, pages[:SHOWN])) + (" …" if len(pages) > SHOWN else "")
                return (
                    f"the DBC's multiplexing contradicts the data: it jumps with the {what} {byte} of its frame "
                    f"({shown}), and stays for each value of this byte; the DBC has one signal for all of them"
                )
    return None


def _told_of(traffic: Traffic, message: MessageInfo, selector: str) -> Iterator[str]:
    info = message.signals.get(selector)
    if info is None or info.scale == 0.0:
        return
    x = traffic.decode([info]).value
    taken, counts = np.unique(
        np.rint((x[np.isfinite(x)] - info.offset) / info.scale).astype(np.int64), return_counts=True
    )
    frames = int(counts.sum())
    by_value: dict[int, list[str]] = {}
    for name, s in message.signals.items():
        for step in s.mux:
            for value in step.values if step.signal == selector else ():
                by_value.setdefault(value, []).append(name)
    if frames < FEWEST:
        return
    known = by_value.keys() | info.choices.keys()
    strange = [k for k, v in enumerate(taken.tolist()) if v not in known]
    if strange:
        times = int(counts[strange].sum())
        yield (
            f"{message.name}: the DBC's multiplexing contradicts the data: {selector} takes "
            f"{_list(taken[strange].tolist())} in {times} of {frames} frames, and the DBC has no signal for that"
        )
    absent = [v for v in by_value if v not in taken]
    if absent and frames >= ROUNDS * len(by_value):
        names = [name for v in absent for name in by_value[v]]
        more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        come = "never comes" if len(names) == 1 else "never come"
        shown = f"{', '.join(names[:SHOWN])}{more}"
        yield f"{message.name}: {selector} never takes {_list(absent)}: {shown} {come} in {frames} frames"


def _list(values: list[int]) -> str:
    values = sorted(values)
    return ", ".join(map(str, values[:SHOWN])) + (f" and {len(values) - SHOWN} more" if len(values) > SHOWN else "")


def _matters(message: MessageInfo, name: str) -> bool:
    """Whether a multiplexed signal may be one that is used here."""
    s = message.signals[name]
    if not s.mux:
        return False
    unit = unit_of(s.unit)
    return has(named(s), CURRENT, VOLTAGE, TEMPERATURE) if unit is None else unit.family != "other"


def _selects(values: NDArray[np.integer[Any]], x: Floats) -> list[int] | None:
    """Give the values of a byte that may select signals; None if the byte cannot be a selector."""
    pages, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    if not 2 <= len(pages) <= MOST_PAGES or counts.min() < max(OF_A_PAGE, EVEN * counts.max()):
        return None
    if (np.diff(which) != 0).mean() < MOVES:
        return None
    middle = np.bincount(which, x) / counts
    total = float(np.square(x - x.mean()).sum())
    between = float((counts * np.square(middle - x.mean())).sum())
    if not np.isfinite(total) or total == 0.0 or between < EXPLAINED * total:
        return None
    order = np.argsort(which, kind="stable")
    inside = np.abs(np.diff(x[order]))[np.diff(which[order]) == 0].mean()
    return pages.tolist() if np.abs(np.diff(x)).mean() > APART * inside else None
