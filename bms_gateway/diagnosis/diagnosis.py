"""Which physical effect is missing: the verdict on one or several records of a string, with its reasons.

adequate
    The declared tolerances explain the records: no effect is missing that these records could show.
missing_effect
    An effect is named, with the effects that these records cannot tell from it; `unknown_remains` if it does not
    explain everything.
undecidable
    An effect of the catalogue is missing, and several effects explain the records about equally well.
unknown_effect
    There is structure that no effect of the catalogue explains. Similar effects are named as similar, never as the
    cause.
insufficient_data
    The records cannot show an effect at all.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from bms_gateway.diagnosis.bounds import at_bound
from bms_gateway.diagnosis.calibrate import Identified, identify, starting_with
from bms_gateway.diagnosis.candidates import INSTEAD
from bms_gateway.diagnosis.coarse_rows import doubt
from bms_gateway.diagnosis.core_band import core_moved
from bms_gateway.diagnosis.error_words import course, falls, half_width, rises, why_not
from bms_gateway.diagnosis.geometry import odd_fitted
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.residuals import (
    CHANCE,
    rmse,
    structure,
    unexplained,
    within,
)
from bms_gateway.diagnosis.search import Progress, Search, search
from bms_gateway.diagnosis.second_search import SecondSearch, needs_second, second_search
from bms_gateway.diagnosis.verdict_parts import Errors, Ranked, Selected, errors, numbers
from bms_gateway.diagnosis.verdict_words import missing, nothing_missing, something_unknown
from bms_gateway.diagnosis.wandering import more_than_rows, rows_are_open
from bms_gateway.diagnosis.weighing import Settings, Trial, believed_share
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import MapFit, stacked
from bms_gateway.thermal import StringModel

Verdict = Literal["adequate", "missing_effect", "undecidable", "unknown_effect", "insufficient_data"]

ROWS_OPEN = " What the current does between its rows is not known: {:.2g} K of the error may come from that."
EXPLAINED, EXPLAINED_HELD = 0.95, 0.5
"""Least share of the structure's power, and of the held-out excess, that an effect must remove to be the named cause.
The right effect removes more, unless the noise hides the structure."""
DECIDED = 0.5
"""Posterior share of the first effect below which several explain the records about equally well."""
LEVEL_KNOWN = 0.1
"""sd of the level of a counted charge above which a law that depends on the charge gets a warning."""
HALVED = 0.5
"""Largest share of the error that effects may leave at a known charge if another record is to be proposed."""
SHORT_STRING = 5
INPUT_ONLY = (
    "Heat from the voltage explains it: that is a better input and no physics. What I²R_e lacks is none of the "
    "catalogue's laws alone; look at R_e over temperature and charge, and at entropy."
)


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The verdict and its reasons.

    Attributes
    ----------
    verdict : Verdict
    unknown_remains : bool
    said : callable
        Writes the verdict for a battery engineer, given `baseline` and `after`.
    selected : tuple of Selected
    looks_like : tuple of str
        What an unknown effect resembles.
    ranking : tuple of Ranked
        From the fits of the search, in which each model is as close to the readings as it can be.
    baseline, after : Errors
        Of the present model and with the selected effects, from their `identified` numbers; from the search's fits
        before these are known.
    search : Search
    second : SecondSearch or None
        The second search, if the model error and not the noise limits what the records can show.
    alarms : tuple of str
        Reasons why the core of the model with the selected effects is not proven, a sentence each.
    more : str
        Further sentences of the verdict.
    identified : tuple of Identified
        For the present model and, if effects are selected, with them: the numbers of every command.
    """

    verdict: Verdict
    unknown_remains: bool
    said: Callable[[Errors, Errors], str]
    selected: tuple[Selected, ...]
    looks_like: tuple[str, ...]
    ranking: tuple[Ranked, ...]
    baseline: Errors
    after: Errors
    search: Search
    second: SecondSearch | None = None
    alarms: tuple[str, ...] = ()
    more: str = ""
    identified: tuple[Identified, ...] = ()

    @property
    def sentence(self) -> str:
        """The verdict for a battery engineer."""
        return self.said(self.baseline, self.after) + self.more

    @property
    def decided_by_second(self) -> bool:
        """Whether effects and fits are those of the second search; for a string it only questions the first one."""
        return self.second is not None and self.search.baseline.problem.model.cells == 1

    @property
    def with_selected(self) -> MapFit:
        """The model with the selected effects as fitted by the deciding search."""
        return self.second.best if self.second is not None and self.decided_by_second else self.search.final

    @property
    def fits(self) -> tuple[MapFit, MapFit]:
        """The present model and the one with the selected effects: their numbers, compared with all readings."""
        return self.identified[0].fit, self.identified[-1].fit


def diagnose(
    model: StringModel,
    records: Sequence[Record],
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find the effect that a model lacks.

    Parameters
    ----------
    model : StringModel
    records : sequence of Record
        Records of one cell type; each has its own start, and its own cooling if there are several.
    settings : Settings, optional
    progress : callable, optional
        Gets the share of the work done and the present step.
    """
    tell = progress or (lambda _share, _text: None)
    d = _diagnosed(model, records, settings, lambda share, text: tell(0.9 * share, text))
    tell(0.9, "finding the numbers of the model")
    d = _with_numbers(_with_charge(d, max(r.charge_sd for r in records)), model, records)
    tell(1.0, "done")
    return d


def _diagnosed(model: StringModel, records: Sequence[Record], settings: Settings | None, tell: Progress) -> Diagnosis:
    ready = [measured(r, model) for r in records]
    doubts = [doubt(r) for r in records]
    found = search(model, ready, settings, lambda share, text: tell(0.6 * share, text), doubts)
    first = judged(found)
    if first.verdict != "adequate" and not any(doubts) and rows_are_open(found, records):
        doubts = [r.sampling.doubt for r in records]
        begun = found.baseline
        found = search(model, ready, settings, lambda share, text: tell(0.6 * share, text), doubts, baseline=begun)
        first = judged(found)
        if first.verdict == "adequate" and more_than_rows(found.baseline, records):
            # the rows allow for an error of this size, but not for this one
            unknown = partial(something_unknown, looks=())
            first = replace(first, verdict="unknown_effect", unknown_remains=True, said=unknown)
    if first.verdict == "unknown_effect" and not found.hopeless and _heat_by_voltage(ready):
        with_voltage = replace(settings or Settings(), voltage=True)
        other = search(model, ready, with_voltage, doubts=doubts, baseline=found.baseline)
        by_voltage = judged(other)
        if _only_voltage(by_voltage):
            other.physical = found.rounds
            return _with_doubt(replace(by_voltage, more=f"{by_voltage.more} {INPUT_ONLY}"))
    open_rows = found.hopeless or (found.left_open > 0.0 and first.verdict == "adequate")
    if open_rows or not needs_second(found) or (model.cells > 1 and not _doubtful(first)):
        return _with_doubt(first)
    second = second_search(model, ready, progress=lambda share, text: tell(0.6 + 0.4 * share, text))
    if model.cells > 1 and second.verdict == "missing_effect":
        return replace(first, unknown_remains=True, second=second, alarms=second.alarms)
    return judged_again(first, second)


def _with_numbers(d: Diagnosis, model: StringModel, records: Sequence[Record]) -> Diagnosis:
    """Use the errors and numbers of every command, for the present model and with the selected effects."""
    begun = d.search.baseline if model.unfitted is model else None
    found = [identify(model, records, closest=begun)]
    if d.selected:
        found.append(identify(starting_with(d.with_selected, model), records))
    selected = tuple(replace(s, parameters=numbers(found[-1].fit, s.candidate)) for s in d.selected)
    before, after = errors(found[0].fit), errors(found[-1].fit)
    before = replace(before, closest_K=d.baseline.heldout_rmse_K)
    return replace(d, identified=tuple(found), selected=selected, baseline=before, after=after)


def _heat_by_voltage(ready: Sequence[Measured]) -> bool:
    return all({"voltage", "soc"} <= m.drive.known for m in ready)


def _only_voltage(d: Diagnosis) -> bool:
    """Whether heat from the voltage explains all readings."""
    return d.verdict == "missing_effect" and not d.unknown_remains and d.selected[0].candidate.name in INSTEAD


def judged(found: Search) -> Diagnosis:
    """Return the verdict from the result of a search."""
    base, final = errors(found.baseline), errors(found.final)
    held = within(found.final)
    floor = float(np.mean(stacked(found.final.problem)[1][held] ** 2))
    structured, fails_held = unexplained(found.final, found.left_open)
    explained = 1.0 - max(final.structure.power, 0.0) / max(base.structure.power, 1e-9)
    before, after = (max(rmse(f, held) ** 2 - floor, 0.0) for f in (found.baseline, found.final))
    explained_held = 1.0 - after / max(before, 1e-9)
    noise = float(np.hypot(final.noise_floor_K, CHANCE * found.left_open))
    outside = bool(found.chosen) and final.heldout_rmse_K > max(1.3 * noise, 1.05 * base.heldout_rmse_K)
    remains = structured or fails_held or outside
    mimic = (structured and explained < EXPLAINED) or (fails_held and explained_held < EXPLAINED_HELD)
    mimic |= after > 0.0 and rises(rmse(found.baseline, held), rmse(found.final, held))
    selected = tuple(
        Selected(c.candidate, c.tied, numbers(found.final, c.candidate), c.log_odds, at_bound(found.final, c.candidate))
        for c in found.chosen
    )
    ranking = tuple(_ranked(t, r) for r in found.rounds[:1] for t in r)
    if not found.chosen:
        verdict: Verdict = "unknown_effect" if remains or found.orphan else "adequate"
    elif mimic or found.hopeless:
        verdict = "unknown_effect"
    else:
        first = next(t for t in found.rounds[0] if t.candidate is found.rounds[0][0].candidate)
        doubtful = first.share < DECIDED or any(s.bound for s in selected)
        verdict = "undecidable" if doubtful and selected[0].tied_with else "missing_effect"
    rows = ROWS_OPEN.format(found.left_open) if found.left_open else ""
    looks = tuple(dict.fromkeys(t.candidate.name for r in found.rounds[:1] for t in r[:3] if t.log_odds > 3.0))
    if verdict == "unknown_effect":
        said = partial(something_unknown, looks=looks)
        return Diagnosis(verdict, True, said, (), looks, ranking, base, base, found, more=rows)
    told = partial(
        missing,
        selected=selected,
        remains=remains,
        undecided=verdict == "undecidable",
    )
    if verdict == "adequate":
        told = partial(nothing_missing, closest=base)
    return Diagnosis(verdict, remains, told, selected, (), ranking, base, final, found, more=rows)


def _with_doubt(d: Diagnosis) -> Diagnosis:
    """Add the reasons why the core with the named effects is not proven.

    Either no cell of the format has one of the numbers, or the effects move the core by less than its band: no surface
    shows which core is nearer to the truth.
    """
    if not d.selected:
        return d
    if odd := tuple(o.says for o in odd_fitted(d.search.final)):
        d = replace(d, more=f"{d.more} {' '.join(odd)}", alarms=odd)
    moved, half_K = core_moved(d.search.baseline, d.search.final)
    if moved > half_K:
        return d
    doubt = (
        f"With what is named the core moves by {moved:.2g} K, less than the ± {half_width(half_K)} K (95 %) to which "
        "the fits of this search know it."
    )
    return replace(d, more=f"{d.more} The core is not known better by it: {doubt}", alarms=(*d.alarms, doubt))


def _with_charge(d: Diagnosis, sd: float) -> Diagnosis:
    """Warn if the law of a named effect depends on a charge whose level is uncertain."""
    names = [s.candidate.key for s in d.selected if s.candidate.follows_charge]
    if sd <= LEVEL_KNOWN or not names:
        return d
    verb = "goes" if len(names) == 1 else "go"
    doubt = (
        f"{' and '.join(names)} {verb} by the SOC, whose level is known to ± {100.0 * sd:.0f} % (1 sd) only: "
        "record it, or name the cell in the model file ([cell] format)."
    )
    return replace(d, more=f"{d.more} {doubt}")


def _doubtful(d: Diagnosis) -> bool:
    """Whether a string's first search explains too little; for a long string, a second search takes minutes."""
    left = d.after.structure.power / max(d.baseline.structure.power, 1e-9)
    return bool(d.selected) and left > 1.0 - EXPLAINED and d.search.baseline.problem.model.cells <= SHORT_STRING


def judged_again(first: Diagnosis, second: SecondSearch) -> Diagnosis:
    """Return the verdict of the second search: its effects, its errors, its doubts."""
    floor = first.baseline.noise_floor_K
    base, after = (
        Errors(rmse(seen, stacked(seen.problem)[4]), held, floor, structure(f))
        for f, seen, held in zip((second.baseline, second.best), second.blocks, second.held_K, strict=True)
    )
    predicted = f" Fitted to the first 60 %, the error in the last 40 % {course(*second.tail)}."
    if not falls(*second.tail) and second.known_K is not None:
        predicted += " The last part holds charge that the first does not."
    names = tuple(c.candidate.name for c in second.chosen)
    selected = tuple(
        Selected(c.candidate, c.tied, numbers(second.best, c.candidate), c.log_odds) for c in second.chosen
    )
    probable = {s.candidate.key: second.probability.get(s.candidate.key, 1.0) for s in selected}
    ranking = tuple(
        Ranked(
            s.candidate.name,
            s.candidate.cell,
            after.heldout_rmse_K,
            s.log_odds,
            probable[s.candidate.key],
            s.parameters,
            s.tied_with,
            "",
        )
        for s in selected
    )
    if second.verdict == "unknown_effect":
        why = why_not(base.heldout_rmse_K, after.heldout_rmse_K)
        ranking = tuple(replace(r, refused=why) for r in ranking)
        more = ""
        if second.known_K is not None and second.known_K[1] < HALVED * second.known_K[0]:
            more = (
                f" It would explain held-out readings between trained ones (error {course(*second.known_K)}), but the "
                "rest holds charge that no other reading covers: charge and discharge the cell once more, or add a "
                "record at another rate."
            )
        said = partial(something_unknown, looks=names)
        return Diagnosis(
            "unknown_effect", True, said, (), names, ranking, base, base, first.search, second, second.alarms, more
        )
    # an effect that is more probably another one is one of several
    doubtful = [s for s in selected if probable[s.candidate.key] < DECIDED]
    verdict: Verdict = "undecidable" if doubtful else "missing_effect"
    more = predicted
    for s in doubtful:
        more += f" {s.candidate.key} is one of several: its probability is {100.0 * probable[s.candidate.key]:.0f} %."
    if not second.core_claimed:
        more += f" The core is not known better by it: {' '.join(second.alarms)}"
    told = partial(
        missing,
        selected=selected,
        remains=True,
        undecided=verdict == "undecidable",
        known_K=second.known_K,
    )
    return Diagnosis(verdict, True, told, selected, (), ranking, base, after, first.search, second, second.alarms, more)


def _ranked(t: Trial, trials: Sequence[Trial]) -> Ranked:
    used = stacked(t.fit.problem)[4]
    tied = tuple(
        dict.fromkeys(
            o.candidate.name
            for o in trials
            if o.candidate.name != t.candidate.name and abs(o.log_odds - t.log_odds) < 4.6 and o.log_odds > 3.0
        )
    )
    share, why = believed_share(t)
    c, held = t.candidate, rmse(t.fit, ~used)
    return Ranked(c.name, c.cell, held, t.log_odds, share, numbers(t.fit, c), tied, why)
