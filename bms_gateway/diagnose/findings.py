"""What a comparison found, in plain sentences."""

from collections.abc import Sequence

import numpy as np

from bms_gateway.diagnose.core_band import CoreBand, half_width_K
from bms_gateway.diagnose.misfit import Block, Sensor
from bms_gateway.diagnose.regimes import Bin

WORTH = 0.1
"""Share of the excess from which a regime is worth a sentence."""
SPREAD = 0.3
"""Share of the excess in three blocks below which no time stands out."""
LARGE_CORE_K = 1.0
"""95 % half width of a core from which one is warned although the surface looks fine."""


def sensor_sentences(
    sensors: Sequence[Sensor],
    blocks: Sequence[Block],
    explained: Sequence[tuple[str, float]],
    records: int,
) -> tuple[str, ...]:
    """Say where, in which regime and when a model fails.

    Parameters
    ----------
    sensors : sequence of Sensor
    blocks : sequence of Block
    explained : sequence of (feature, share)
    records : int
        How many there are.
    """
    bad = [s for s in sensors if s.disagrees]
    fine = [s.cell for s in sensors if not s.disagrees]
    if not bad:
        return ("The model agrees with every sensor to within its noise.",)
    found = [_misfit(s) for s in sorted(bad, key=lambda s: -s.structured_K)]
    if fine:
        found.append(f"The model agrees with {_cells(fine)} to within the noise.")
    if explained:
        feature, share = explained[0]
        titles = {r.feature: r.title for s in bad for r in s.regimes}
        if feature in titles and share > WORTH:
            what = "is a constant offset" if feature == "always" else f"follows the {titles[feature]}"
            found.append(f"{100.0 * share:.0f} % of the squared error above the noise {what}.")
    if blocks and (when := _when(blocks, records)):
        found.append(when)
    return tuple(found)


def core_sentences(bands: Sequence[CoreBand], sensors: Sequence[Sensor], name: str) -> tuple[str, ...]:
    """Say how wrong the core could be, and warn where a good surface hides it."""
    half = half_width_K(bands)
    k = int(np.argmax(half))
    core = f"the core of cell {k + 1}"
    if any(s.disagrees for s in sensors):
        judged = ", by what refitting moves" if name == "filed" else ""
        text = (
            "The core estimates are unreliable while the model does not explain the surfaces: "
            f"{core} may be {half[k]:.2g} K off or more{judged}."
        )
    elif half[k] > LARGE_CORE_K:
        text = f"The surfaces agree, yet {core} could be {half[k]:.2g} K wrong (95 %): they alone do not settle it."
    else:
        text = f"The cores are known to {half[k]:.2g} K (95 %, cell {k + 1} least)."
    return (text,)


def _misfit(s: Sensor) -> str:
    """One sentence about one sensor: where it is worst, and where it agrees."""
    always, *others = s.regimes
    who = f"Cell {s.cell}"
    best = next((r for r in others if r.share > WORTH), None)
    if always.share > 0.5 and always.bins[0].significant and (best is None or best.share < always.share):
        return f"{who} reads {_amount(always.bins[0].mean_K)} than the model all along."
    if best is not None:
        strong = max((b for b in best.bins if b.significant), key=lambda b: abs(b.mean_K), default=None)
        if strong is not None:
            other = _contrast(best.bins, strong)
            return f"{who} reads {_amount(strong.mean_K)} than the model {strong.label}{other}"
    return (
        f"{who} departs from the model by {abs(s.worst.error_K):.2g} K (structured error {s.structured_K:.2g} K), "
        "and no single regime explains it."
    )


def _contrast(bins: Sequence[Bin], strong: Bin) -> str:
    others = [b for b in bins if b is not strong]
    if not others:
        return "."
    opposite = [b for b in others if b.significant and b.mean_K * strong.mean_K < 0.0]
    if opposite:
        b = max(opposite, key=lambda b: abs(b.mean_K))
        return f", and {_amount(b.mean_K)} {b.label}."
    calm = min(others, key=lambda b: (b.label != "at rest" or b.significant, abs(b.mean_K)))
    if abs(calm.mean_K) < 0.3 * abs(strong.mean_K):
        return f"; {calm.label} they agree."
    return f", {_amount(calm.mean_K)} {calm.label}."


def _amount(mean_K: float) -> str:
    return f"{abs(mean_K):.2g} K {'more' if mean_K > 0.0 else 'less'}"


def _when(blocks: Sequence[Block], records: int) -> str:
    most = sorted(blocks, key=lambda b: -b.share)[:3]
    told = sum(b.share for b in most)
    if len(blocks) > 6 or told < SPREAD:
        return "The error is spread over the whole time."
    parts = []
    for b in sorted(most, key=lambda b: (b.record, b.first_s)):
        where = f" of record {b.record + 1}" if records > 1 else ""
        parts.append(f"{b.first_s / 60:.0f}-{b.last_s / 60:.0f} min{where}")
    return f"{100.0 * told:.0f} % of the error lies at {', '.join(parts)}."


def _cells(cells: Sequence[int]) -> str:
    return f"cell {cells[0]}" if len(cells) == 1 else "cells " + ", ".join(str(k) for k in cells)
