"""Words of the alarms of limits: cells, bands, trends and times as a person reads them."""

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Final

import numpy as np

NAMED: Final = 6  # most cells that a sentence names
BAND_SD: Final = 1.96  # half width of the band that is told: 95 %, as on the page and in the reports


def cells(of: Sequence[int]) -> str:
    """Name cells, from 1; the first of them if they are many."""
    named = ", ".join(map(str, of[:NAMED])) + (f" and {len(of) - NAMED} more" if len(of) > NAMED else "")
    return f"cell{'s' if len(of) > 1 else ''} {named}"


def beside(above: Sequence[int], unproven: Sequence[int]) -> str:
    """Name the other cells whose alarm stands: those above the limit, and those not known to be below it again."""
    too = f"; {cells(above)} too" if above else ""
    verb = "was" if len(unproven) == 1 else "were"
    again = "is" if len(unproven) == 1 else "are"
    return too + (f"; {cells(unproven)} {verb} above it and {again} not known to be below it again" if unproven else "")


def banded(value: float, sd: float, core: float) -> str:
    """Write a hottest point and its core, °C, with the sd, K, of the first."""
    return f"{value:.1f} ± {BAND_SD * sd:.1f} °C (95 %; core {core:.1f} °C)"


def trend(rate: float) -> str:
    """Write a rate, K/s; nothing for one that is too small."""
    per_min = 60.0 * rate
    return f", {'rising' if per_min > 0 else 'falling'} {abs(per_min):.1f} K/min" if abs(per_min) >= 0.1 else ""


def clock(time_s: float) -> str:
    """Write a bus time."""
    return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S} UTC" if np.isfinite(time_s) else "a time unknown"
