"""Results of a comparison in plain sentences."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bms_gateway.diagnosis.core_band import CoreBand, half_width_K
from bms_gateway.diagnosis.error_words import falls, half_width, rises
from bms_gateway.diagnosis.misfit import Block, Sensor
from bms_gateway.diagnosis.regimes import Bin, Regime
from bms_gateway.diagnosis.together import along, cells_in_words, runs, span
from bms_gateway.diagnosis.verdict_words import alternatives
from bms_gateway.thermal import StringModel

WORTH = 0.1
"""Least share of the excess for which a regime is reported."""
SPREAD = 0.3
"""Least share of the excess in three blocks for which these times are reported."""
TOGETHER = 4
"""Least number of cells with the same pattern that share one sentence."""
TOGETHER_CONSTANT = 2
"""The same for a constant error: separate sentences would give no further information."""
MANY_SENTENCES = 2
"""Least number of sentences that one on a course along the coolant must replace."""
SHORT_S = 120.0
"""Shorter times are given in tenths of a minute."""
LARGE_CORE_K = 1.0
"""95 % half width of a core above which a warning is given although the surface agrees."""


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
        Number of records.
    """
    bad = [s for s in sensors if s.disagrees]
    fine = [s.cell for s in sensors if not s.disagrees]
    if not bad:
        return ("The model agrees with every sensor to within its noise.",)
    course = _course(bad, len(sensors))
    found = [course.text] if course else []
    rest = [s for s in bad if course is None or s.cell not in course.cells]
    found += [text for group in _patterns(rest) for text in _told(group, len(sensors))]
    if fine:
        found.append(f"The model agrees with {cells_in_words(fine)} to within the noise.")
    if explained:
        feature, share = explained[0]
        titles = {r.feature: r.title for s in bad for r in s.regimes}
        if feature in titles and share > WORTH:
            what = "comes from the mean of the error" if feature == "always" else f"follows the {titles[feature]}"
            found.append(f"{100.0 * share:.0f} % of the squared error above the noise {what}.")
    if blocks and (when := _when(blocks, records)):
        found.append(when)
    return tuple(found)


def stream_sentences(model: StringModel, sensors: Sequence[Sensor]) -> tuple[str, ...]:
    """Ask for the coolant's flow if the mean error changes sign along the string, and the model has no such flow."""
    mean = {s.cell: s.regimes[0].bins[0] for s in sorted(sensors, key=lambda s: s.cell) if s.regimes}
    if model.has_coolant_path or not along({k: b.mean_K for k, b in mean.items()}):
        return ()
    (first, one), *_, (last, other) = mean.items()
    if one.mean_K * other.mean_K > 0.0 or not (one.significant and other.significant):
        return ()
    way, end = ("grows", "") if other.mean_K > one.mean_K else ("falls", ", at the last cell first")
    return (
        f"The mean error {way} along the string, from {one.mean_K:+.2g} K (cell {first}) to {other.mean_K:+.2g} K "
        f"(cell {last}), and in the model no coolant warms from cell to cell: if one flows past the cells{end}, give "
        "its flow to the model.",
    )


def core_sentences(bands: Sequence[CoreBand], sensors: Sequence[Sensor], name: str, *, proven: bool) -> tuple[str, ...]:
    """State the possible error of the core, and warn if the surface agrees nevertheless.

    Parameters
    ----------
    bands : sequence of CoreBand
    sensors : sequence of Sensor
    name : {"filed", "refitted"}
    proven : bool
        Whether the cores are proven. The bands hold the error that is left at the surfaces, so such an error alone
        speaks only against a core that is not proven.
    """
    half = half_width_K(bands)
    k = int(np.argmax(half))
    core = f"the core of cell {k + 1}"
    if any(s.disagrees for s in sensors) and proven and name != "filed":
        said = "The bands of the cores hold the error that the model leaves at the surfaces"
        text = f"{said}: {core} may be {half_width(half[k])} K off (95 %)."
    elif any(s.disagrees for s in sensors):
        judged = ", by what refitting moves" if name == "filed" else ""
        said = "The core estimates are unreliable while the model does not explain the surfaces"
        if half[k] <= LARGE_CORE_K:
            said = "The model does not wholly explain the surfaces"
        text = f"{said}: {core} may be {half_width(half[k])} K off or more{judged}."
    elif half[k] > LARGE_CORE_K or not proven:
        more = "" if proven else ", or more"
        text = (
            f"The surfaces agree, yet {core} could be {half_width(half[k])} K wrong (95 %){more}: they alone do not "
            "settle it."
        )
    else:
        text = f"The cores are known to {half_width(half[k])} K (95 %, cell {k + 1} least)."
    if k + 1 in {s.cell for s in sensors}:
        return (text,)
    return (
        f"{text} Cell {k + 1} has no thermocouple on the surface: this holds only where its R_e is that of the other "
        "cells.",
    )


def tie_sentences(model: StringModel) -> tuple[str, ...]:
    """Say which effects of a model may be others, according to the records by which they were added."""
    return tuple(
        f"The records by which {e.key} was added cannot tell it from {', '.join(alternatives(e.tied_with))}: "
        f"{'it' if len(e.tied_with) == 1 else 'each of them'} would explain them as well."
        for e in model.effects
        if e.tied_with
    )


def refit_sentences(before: tuple[float, float], after: tuple[float, float], lacks: bool) -> tuple[str, ...]:
    """Say where a refit follows the surfaces less closely than the file, and where more; empty if nowhere less.

    Parameters
    ----------
    before, after : tuple of float, K
        Error of the numbers of the file, and of the refitted ones: on fitted readings, and on held-out ones.
    lacks : bool
        Whether the refit allows for something that the model lacks. If not, held-out errors differ by chance.
    """
    places = (" where fitted", " where nothing was fitted")
    both = [
        (f"{other:.3g} K{where}, not {one:.3g} K", one, other)
        for where, one, other in zip(places, before, after, strict=True)
        if lacks or where == places[0]
    ]
    worse, better = ([said for said, one, other in both if moved(one, other)] for moved in (rises, falls))
    if not worse:
        return ()
    said = f"The refitted numbers follow the surfaces less closely than those of the file: {'; '.join(worse)}."
    if better:
        said += f" More closely: {better[0]}."
    if lacks:
        said += (
            " The model lacks something, and the refit allows for that: its numbers are not those that come closest to "
            "these surfaces."
        )
    return (said,)


@dataclass(frozen=True, slots=True)
class _Course:
    """A mean error that grows or falls along the coolant: one pattern of these cells, whatever its signs."""

    cells: frozenset[int]
    text: str


def _course(bad: Sequence[Sensor], cells: int) -> _Course | None:
    """Find the course of the mean error along the coolant where it saves sentences; one cell may stand out of it."""
    mean = {s.cell: s.regimes[0].bins[0] for s in sorted(bad, key=lambda s: s.cell)}
    if not any(b.significant for b in mean.values()):
        return None
    way = along({k: b.mean_K for k, b in mean.items()})
    if not way and len(mean) > TOGETHER:
        line = np.polyfit(list(mean), [b.mean_K for b in mean.values()], 1)
        mean.pop(max(mean, key=lambda k: abs(mean[k].mean_K - np.polyval(line, k))))
        way = along({k: b.mean_K for k, b in mean.items()})
    same = [s for s in bad if s.cell in mean]
    if not way or len(mean) <= TOGETHER or sum(len(_told(group, cells)) for group in _patterns(same)) < MANY_SENTENCES:
        return None
    (first, one), *_, (last, other) = mean.items()
    text = (
        f"The mean error of {cells_in_words(list(mean))} {'grows' if 'growing' in way else 'falls'} along the coolant: "
        f"cell {first} reads {_amount(one.mean_K)} than the model, cell {last} {_amount(other.mean_K)}."
    )
    worst = max(same, key=lambda s: s.structured_K)
    regime, strong = _strongest(worst)
    own = f" {_misfit(worst)}" if regime is not None and strong is not None and regime.feature != "always" else ""
    return _Course(frozenset(mean), text + own)


def _patterns(bad: Sequence[Sensor]) -> list[list[Sensor]]:
    """Group sensors with the same pattern of errors, the worst pattern and its worst sensor first."""
    groups: dict[tuple[str, bool, str], list[Sensor]] = {}
    for s in sorted(bad, key=lambda s: -s.structured_K):
        regime, strong = _strongest(s)
        if regime is None or strong is None:
            key = ("", False, "")
        else:
            key = (regime.feature, strong.mean_K > 0.0, _place(regime.bins, strong))
        groups.setdefault(key, []).append(s)
    return list(groups.values())


def _told(group: Sequence[Sensor], cells: int) -> list[str]:
    """Describe sensors with the same pattern of errors; many sensors share one sentence."""
    constant = all(regime is not None and regime.feature == "always" for regime, _ in map(_strongest, group))
    if len(group) < (TOGETHER_CONSTANT if constant else TOGETHER):
        return [_misfit(s) for s in group]
    found = [(s, *_strongest(s)) for s in group]
    order = sorted(s.cell for s in group)
    who = "All cells" if len(group) == cells else f"{len(group)} cells ({runs(order)})"
    if found[0][1] is None or found[0][2] is None:
        most = span(abs(s.worst.error_K) for s in group)
        return [f"{who} are up to {most} K off over half a minute, and no single regime explains {_how_much(group)}."]
    strong = {s.cell: b for s, _, b in found if b is not None}
    size = {k: abs(b.mean_K) for k, b in strong.items()}
    amount = f"{span(size.values())} K {'more' if found[0][2].mean_K > 0.0 else 'less'}"
    labels = {b.label for b in strong.values()}
    regime = found[0][1]
    if regime.feature == "always":
        where = "on average"
    elif len(labels) == 1:
        where = next(iter(labels))
    else:
        where = f"where the {regime.title} is {_place(regime.bins, found[0][2])}"
    return [f"{who} read {amount} than the model {where}{along(size)}."]


def _place(bins: Sequence[Bin], one: Bin) -> str:
    at = [b is one for b in bins].index(True)
    return "low" if at < (len(bins) - 1) / 2 else "high" if at > (len(bins) - 1) / 2 else "in between"


def _strongest(s: Sensor) -> tuple[Regime | None, Bin | None]:
    """Find the regime that explains a sensor's error best, and its bin with the largest error; None if none does."""
    always, *others = s.regimes
    best = next((r for r in others if r.share > WORTH and any(b.significant for b in r.bins)), None)
    if best is None and always.share > WORTH and always.bins[0].significant:
        return always, always.bins[0]
    if always.share > 0.5 and always.bins[0].significant and (best is None or best.share < always.share):
        return always, always.bins[0]
    if best is None:
        return None, None
    return best, max((b for b in best.bins if b.significant), key=lambda b: abs(b.mean_K), default=None)


def _misfit(s: Sensor) -> str:
    """One sentence about one sensor: where it is worst, and where it agrees."""
    who = f"Cell {s.cell}"
    regime, strong = _strongest(s)
    if regime is None or strong is None:
        return (
            f"{who} is up to {abs(s.worst.error_K):.2g} K off over half a minute "
            f"(structured error {s.structured_K:.2g} K rms), and no single regime explains {_how_much([s])}."
        )
    if regime.feature == "always":
        return f"{who} reads {_amount(strong.mean_K)} than the model on average."
    return f"{who} reads {_amount(strong.mean_K)} than the model {strong.label}{_contrast(regime.bins, strong)}"


def _how_much(group: Sequence[Sensor]) -> str:
    """Of the error: a mean of some regime may be no chance, and yet be little of it."""
    return "much of it" if any(b.significant for s in group for r in s.regimes for b in r.bins) else "it"


def _contrast(bins: Sequence[Bin], strong: Bin) -> str:
    others = [b for b in bins if b is not strong]
    if not others:
        return "."
    opposite = [b for b in others if b.significant and b.mean_K * strong.mean_K < 0.0]
    if opposite:
        b = max(opposite, key=lambda b: abs(b.mean_K))
        return f", and {_amount(b.mean_K)} {b.label}."
    calm = min(others, key=lambda b: (b.label != "at rest" or b.significant, abs(b.mean_K)))
    if not calm.significant:
        return f"; {calm.label} they agree on average."
    return f", {_amount(calm.mean_K)} {calm.label}."


def _amount(mean_K: float) -> str:
    return f"{abs(mean_K):.2g} K {'more' if mean_K > 0.0 else 'less'}"


def _when(blocks: Sequence[Block], records: int) -> str:
    most = sorted(blocks, key=lambda b: -b.share)[:3]
    told = sum(b.share for b in most)
    if len(blocks) > 6 or told < SPREAD:
        return "The error is spread over the whole time."
    parts, places = [], 1 if min(b.last_s - b.first_s for b in most) < SHORT_S else 0
    for b in sorted(most, key=lambda b: (b.record, b.first_s)):
        where = f" of record {b.record + 1}" if records > 1 else ""
        parts.append(f"{b.first_s / 60:.{places}f} to {b.last_s / 60:.{places}f} min{where}")
    return f"{100.0 * told:.0f} % of the error lies at {', '.join(parts)}."
