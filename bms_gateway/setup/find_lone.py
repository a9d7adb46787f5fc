"""A single temperature of the battery besides those of the cells: their mean, greatest, least, or another sensor.

`BatteryTemperature` may be any of these; the data show which. The signal is reported in one line and is not used: a
statistic of the cells adds nothing to their readings, and the place of another sensor is unknown.
"""

from typing import Final

import numpy as np

from bms_gateway.setup.find_temperatures import Surfaces, elsewhere, is_temperature, lives, reading
from bms_gateway.setup.groups import alike
from bms_gateway.setup.signal_series import Series
from bms_gateway.setup.signal_words import PACK, SENSED, has, named, statistic, unit_of
from bms_gateway.thermal import Floats

SAME: Final = 0.9
"""Least share of the samples that must agree with a statistic to within the steps of both signals."""
LAG_K: Final = 0.3
"""K: greatest difference, beyond their steps, of two readings of one temperature that are sent at different times."""
NAMES: Final = {"max": "greatest", "mean": "mean", "min": "least"}


def lone_temperatures(warm: Surfaces, series: list[Series]) -> list[tuple[Series, str]]:
    """Describe each single temperature of the battery that is not used, as the data show it.

    Parameters
    ----------
    warm : Surfaces
        The thermocouples that are used, and those that were refused for another reason.
    series : list of Series
        All signals.

    Returns
    -------
    list of (Series, why)
    """
    others = [m.series for m in warm.members] + list(warm.beside.values())
    named_already = {s.path for s in others} | {s.path for s, _ in (*warm.refused, *warm.passed)}
    if len(others) < 2 and warm.statistic is None:
        return []
    references = _references(warm)
    of = "the cells" if warm.statistic is not None else f"the {len(others)} readings of cells"
    temperatures = [s for s in series if is_temperature(s) and not elsewhere(s)]
    found = []
    for group in alike(temperatures):
        s = group[0].series
        if len(group) > 1 or s.path in named_already or statistic(s.info) is not None or s.constant:
            continue
        if has(named(s.info), PACK, SENSED) and lives(s):
            found.append((s, _what(s, references, of)))
    return found


def _references(warm: Surfaces) -> dict[str, tuple[Floats, Floats, float]]:
    """Time, °C and step, K, of the known ones of greatest, least and mean of the cells."""

    def celsius(s: Series) -> tuple[Floats, Floats, float]:
        return s.t, warm.factor * s.x + warm.shift, abs(warm.factor) * s.step

    if warm.statistic is not None:
        return {k: celsius(s) for k, s in {warm.statistic: warm.members[0].series, **warm.beside}.items()}
    each = [celsius(m.series) for m in warm.members]
    t = max((t for t, _, _ in each), key=len)
    rows, step = np.array([np.interp(t, when, T) for when, T, _ in each]), max(s for _, _, s in each)
    return {
        "max": (t, rows.max(axis=0), step),
        "min": (t, rows.min(axis=0), step),
        "mean": (t, rows.mean(axis=0), step),
    }


def _what(s: Series, references: dict[str, tuple[Floats, Floats, float]], of: str) -> str:
    factor, shift, _ = reading(s, unit_of(s.info.unit))
    T, step = factor * s.x + shift, abs(factor) * s.step
    apart = {kind: T - np.interp(s.t, t, x) for kind, (t, x, _) in references.items()}
    within = {kind: (step + references[kind][2]) / 2.0 + LAG_K for kind in apart}
    far = {kind: float(np.abs(d).mean()) for kind, d in apart.items()}
    same = sorted((k for k, d in apart.items() if (np.abs(d) <= within[k]).mean() >= SAME), key=far.__getitem__)
    if same:
        others = " and ".join(f"the {NAMES[k]}" for k in same[1:])
        also = f"; {others} of them read too alike to be told from it" if others else ""
        return f"by the data the {NAMES[same[0]]} of {of} ({far[same[0]]:.2g} K from it on the mean{also}): not used"
    above = float(np.quantile(apart["max"], 0.95)) if "max" in apart else -np.inf
    below = float(np.quantile(apart["min"], 0.05)) if "min" in apart else np.inf
    if above > within.get("max", 0.0):
        where = f", up to {above:.2g} K above the greatest of {of}"
    elif below < -within.get("min", 0.0):
        where = f", up to {-below:.2g} K below the least of {of}"
    elif {"max", "min"} <= set(apart):
        where = f", between the least and the greatest of {of}"
    else:
        kind, d = next(iter(apart.items()))
        side = "above" if d.mean() > 0.0 else "below"
        where = f", {abs(d.mean()):.2g} K {side} the {NAMES[kind]} of {of} on the mean"
    return f"a sensor of an unknown place{where}: not used"
