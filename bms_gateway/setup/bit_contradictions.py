"""Contradictions between a DBC and the data: sign, byte order, range."""

from dataclasses import replace
from typing import Final

import numpy as np

from bms_gateway.config.overrides import turned
from bms_gateway.errors import ConfigError
from bms_gateway.frames.signal_info import SignalInfo
from bms_gateway.setup.signal_series import Series, all_series
from bms_gateway.setup.signal_words import unit_of
from bms_gateway.setup.vehicle_logs import Traffic

SMOOTHER: Final = 0.5
"""Bits are read in another way only if this makes the mean step from sample to sample smaller than this share of it."""
NEAR: Final = 0.15
"""Share of the range of the bits that counts as one of its ends."""
BOTH_ENDS: Final = 0.002
"""Least share of the samples at each end for which the other sign is tried."""
OUTSIDE: Final = 0.01
FEWEST_JUMPS: Final = 10


def read_right(traffic: Traffic, s: Series) -> tuple[Series, dict[str, float | str | bool], list[str]]:
    """Read a signal with the sign and byte order that its data suggest.

    Returns
    -------
    series, overrides, why
        If the DBC is right: the same series, an empty dict and an empty list.
    """
    overrides: dict[str, float | str | bool] = {}
    why: list[str] = []
    other = _turned(traffic, s)
    if other is not None:
        order = "big_endian" if other.info.place.big_endian else "little_endian"
        overrides["byte_order"] = order
        why.append(f"the DBC's byte order contradicts the data: read as {order} it is smooth")
        s = other
    other = _signed(traffic, s)
    if other is not None:
        overrides["signed"] = other.info.place.signed
        kind = "a two's complement" if other.info.place.signed else "unsigned"
        why.append(f"the DBC's sign contradicts the data: it jumps from end to end unless its bits are read as {kind}")
        s = other
    return s, overrides, why


def _turned(traffic: Traffic, s: Series) -> Series | None:
    if s.info.place.size < 9 or s.info.is_float or len(s.x) < 20 or s.distinct < 3:
        return None
    unit = abs(s.info.scale)
    wide = s.high - s.low
    if wide < 200 * unit:  # the byte that is taken for the high one moves
        return None
    try:
        place = turned(s.info, not s.info.place.big_endian)
    except ConfigError:
        return None
    found = all_series(traffic, [replace(s.info, place=place, minimum=None, maximum=None)])
    if not found or found[0].distinct < 2 or found[0].constant:
        return None
    other = found[0]
    narrow = other.high - other.low
    # in the wrong order the fast low byte is the high one: all of the range is filled, and no step is like the last
    filled = wide > 0.3 * unit * 2**s.info.place.size or wide > 30 * max(narrow, unit)
    if filled and (other.roughness < SMOOTHER * s.roughness or narrow < wide / 30) and narrow < 0.5 * wide:
        return _declared(other, s)
    return None


def _signed(traffic: Traffic, s: Series) -> Series | None:
    """Read the bits with the other sign if the values lie at both ends of their range and nowhere between."""
    place = s.info.place
    unit = unit_of(s.info.unit)
    if unit is not None and unit.family not in ("current", "temperature"):
        return None  # no other signal that is used here has a sign
    if place.size < 8 or s.info.is_float or len(s.x) < FEWEST_JUMPS:
        return None
    share = ((s.x - s.info.offset) / s.info.scale - s.info.raw_limits[0]) / 2**place.size
    at_ends = ((share < NEAR).mean(), (share > 1 - NEAR).mean())
    if min(at_ends) < BOTH_ENDS:
        return None
    other_way = replace(s.info, place=replace(place, signed=not place.signed), minimum=None, maximum=None)
    found = all_series(traffic, [other_way])
    if not found or len(found[0].x) < FEWEST_JUMPS:
        return None
    other = found[0]
    whole = abs(s.info.scale) * 2**place.size
    rough, smooth = np.abs(np.diff(s.x)).mean(), np.abs(np.diff(other.x)).mean()
    if smooth < SMOOTHER * rough and (other.high - other.low) < 0.6 * whole:
        return _declared(other, s)
    return None


def _declared(other: Series, s: Series) -> Series:
    """Apply the range of the DBC to a series that was read without this range."""
    info: SignalInfo = replace(other.info, minimum=s.info.minimum, maximum=s.info.maximum)
    low, high = info.raw_valid
    raw = (other.x - info.offset) / info.scale
    return replace(other, info=info, outside=int(((raw < low) | (raw > high)).sum()))


def range_of(s: Series, plausible: tuple[float, float]) -> tuple[dict[str, float], str] | None:
    """Propose a range for the config if the range of the DBC refuses observed values.

    Parameters
    ----------
    s : Series
    plausible : tuple of float
        In the DBC's unit.

    Returns
    -------
    overrides and a sentence, or None where the DBC's range does.
    """
    if s.outside <= OUTSIDE * max(len(s.x), 1):
        return None
    low, high = s.info.minimum, s.info.maximum
    inside = s.x[(s.x >= plausible[0]) & (s.x <= plausible[1])]
    if not len(inside):
        return None
    least, most = float(inside.min()), float(inside.max())
    span = max(most - least, 10 * abs(s.info.scale))
    overrides: dict[str, float] = {}
    bits = sorted(raw * s.info.scale + s.info.offset for raw in s.info.raw_limits)
    if low is not None and least < low:
        overrides["minimum"] = max(_rounded(max(least - span, plausible[0]), -1), bits[0])
    if high is not None and most > high:
        overrides["maximum"] = min(_rounded(min(most + span, plausible[1]), 1), bits[1])
    if not overrides:
        return None
    ends = f"{'…' if low is None else f'{low:g}'} to {'…' if high is None else f'{high:g}'}"
    text = (
        f"the DBC's range contradicts the data: observed {least:g} to {most:g}, the DBC allows {ends} and would lose "
        f"{100 * s.outside / max(len(s.x), 1):.0f} %"
    )
    return overrides, text


def _rounded(x: float, direction: int) -> float:
    """Round outwards to two digits."""
    if x == 0.0:
        return 0.0
    unit = 10.0 ** (np.floor(np.log10(abs(x))) - 1)
    return float(f"{(np.ceil if direction > 0 else np.floor)(x / unit) * unit:g}")
