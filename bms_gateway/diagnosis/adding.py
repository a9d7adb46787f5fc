"""Adding effects to a model: the effects that a user names, the refit with them, and whether they may stay.

An effect may be added if `diagnose` finds it, or cannot tell it from what it finds. Any other effect is fitted alone,
and refused with the reason: an effect that lowers the error of a surface can still move the core the wrong way.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from bms_gateway.diagnosis.adding_bench import all_used, fit_with, named_by
from bms_gateway.diagnosis.bounds import at_bound, below_least
from bms_gateway.diagnosis.calibrate import UNTOLD, identify, moved, starting_with
from bms_gateway.diagnosis.candidates import INSTEAD, Candidate, candidates, excluded, places
from bms_gateway.diagnosis.core_band import posterior
from bms_gateway.diagnosis.core_known import KnownCore, judged_model, known_core
from bms_gateway.diagnosis.diagnosis import Diagnosis, diagnose
from bms_gateway.diagnosis.error_words import UNKNOWN, falls, rises, why_not
from bms_gateway.diagnosis.filed import seen_on
from bms_gateway.diagnosis.findings import tie_sentences
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.residuals import rmse, structure
from bms_gateway.diagnosis.screen import screen
from bms_gateway.diagnosis.search import Progress, refit, refit_from_nominal
from bms_gateway.diagnosis.second_search import SecondSearch
from bms_gateway.diagnosis.verdict_parts import errors
from bms_gateway.diagnosis.weighing import HALF, Settings, gate, prior_odds
from bms_gateway.errors import ConfigError, DataError, UsageError, clipped, whole_number
from bms_gateway.frames.vocabulary import INPUTS, OPTIONAL, WHOLE
from bms_gateway.identify.map_fit import MapFit, refreshed, stacked
from bms_gateway.thermal import StringModel
from bms_gateway.thermal.effects import Effect, effect_named

COLUMNS: dict[str, str] = {INPUTS[q].kind: INPUTS[q].column for q in WHOLE if q in OPTIONAL}
"""Columns of a table that an effect may need."""
FORCED = "Added by force, though"
"""Remark on the cores of a model to which an effect was added against the records."""
EARLIER = "Added by force in an earlier step, although it was said then"
"""The same remark on the models made from it: the reason is about the numbers of that step."""
CANNOT_TELL = "These records cannot tell"
LACKING = "these records lack something that is in no catalogue"
SEARCH = 0.8
"""Share of the work of an addition that is the search, where it is not known."""
MOST = 0.25
"""Largest share of the held-out error that an effect may leave, if something that no effect explains acts beside it."""
WAYS = 4
"""Number of starts and places of one effect that are refitted; the others are less promising by the screening."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """An effect that a user names; `cell` is None if it has no place, or if the best place is to be found."""

    effect: Effect
    cell: int | None = None

    @property
    def key(self) -> str:
        """The effect as the user wrote it."""
        return self.effect.name if self.cell is None else f"{self.effect.name}:{self.cell}"

    def meets(self, c: Candidate) -> bool:
        """Whether a candidate is the effect that the user names."""
        return c.name == self.effect.name and self.cell in (None, c.cell)


@dataclass(frozen=True, slots=True)
class Step:
    """Result of a refit with more effects.

    Attributes
    ----------
    added : tuple of Candidate
    after : MapFit
        From the search: its numbers are the start of the identification.
    log_odds : float
        Tempered log-odds of the model with the added effects against the model without them.
    refused : str
        Why the effects should not stay; empty if there is no reason.
    remark : str
        Further remark on these records; may be empty.
    doubts : tuple of str
        Reasons of the search why the core with these effects is not proven, a sentence each.
    tied : mapping of key to tuple of str
        Effects that these records cannot tell from each added one.
    in_part : bool
        Whether the only reason of the refusal is that something is missing which no effect explains.
    """

    added: tuple[Candidate, ...]
    after: MapFit
    log_odds: float
    refused: str
    remark: str
    doubts: tuple[str, ...] = ()
    tied: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    in_part: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Addition(Step):
    """A model with more effects, its numbers, and how well its cores are known.

    Attributes
    ----------
    model : StringModel
        The model with its numbers and their posterior, which is written if the addition is accepted.
    core : tuple of KnownCore
        Before and after: numbers and errors of both models, and their cores. A band that is not proven is never
        narrower than the band before, unless every reason against the core is measured (`exchange`); which band is that
        before, see `KnownCore.share_for`.
    """

    model: StringModel
    core: tuple[KnownCore, KnownCore]

    @property
    def fits(self) -> tuple[MapFit, MapFit]:
        """The numbers before and after, compared with all readings."""
        before, after = (c.identified.fit for c in self.core)
        return before, after


def wanted(word: str, model: StringModel) -> Wanted:
    """Parse `EFFECT` or `EFFECT:CELL`.

    Raises
    ------
    ConfigError
        There is no such effect or place, or the effect is in the model already.
    """
    name, colon, text = word.partition(":")
    effect = effect_named(name)
    if model.cells < effect.least_cells:
        raise ConfigError(f"{name} needs at least {effect.least_cells} cells; this model has {model.cells}")
    valid = places(effect, model.cells, model.sensors)
    if not valid:
        raise ConfigError(f"{name}: the model has no {effect.place} where it could sit")
    if colon and valid == (None,):
        raise ConfigError(f"{name} sits on no cell; write {name}")
    cell = whole_number(text) if colon else None
    if colon and (cell is None or cell not in valid):
        raise ConfigError(f"{clipped(word, 100)}: no place for {name}; valid: {', '.join(map(str, valid))}")
    found = Wanted(effect, cell)
    there = {e.key for e in model.effects}
    if all((name if cell is None else f"{name}:{cell}") in there for cell in valid if not colon or cell == found.cell):
        raise ConfigError(f"{word} is in the model already")
    return found


def asked_for(effects: Sequence[str], model: StringModel) -> list[Wanted]:
    """Parse the effects that are to be added together.

    Raises
    ------
    ConfigError
        As for `wanted`.
    UsageError
        No effect is named, or one is named twice.
    """
    wants = [wanted(word, model) for word in effects]
    if not wants:
        raise UsageError("add: name at least one effect of the catalogue")
    twice = next((w.key for i, w in enumerate(wants) if w.key in [x.key for x in wants[:i]]), None)
    if twice:
        raise UsageError(f"add: {twice} is there twice")
    return wants


def check_signals(wants: Sequence[Wanted], records: Sequence[Record]) -> None:
    """Refuse records that lack a column which an effect needs.

    Raises
    ------
    DataError
        Names the record and the column.
    """
    for w in wants:
        for r in records:
            for signal in w.effect.signals:
                if signal not in r.drive.known:
                    more = ", or cell.capacity_Ah in the model to count it" if signal == "soc" else ""
                    raise DataError(f"{r.source}: {w.effect.name} needs the column {COLUMNS[signal]}{more}")
        if why := next((why for r in records if (why := excluded(w.effect, r.drive))), ""):
            raise DataError(f"{records[0].source}: {w.effect.name} cannot be: {why}")
        if not any(w.effect.determined(r.drive) for r in records):
            raise DataError(f"{records[0].source}: {w.effect.name} cannot show here: it needs {w.effect.needs}")


def add_effects(
    model: StringModel,
    records: Sequence[Record],
    wants: Sequence[Wanted],
    progress: Progress | None = None,
    ask: Callable[..., Diagnosis] = diagnose,
) -> Addition:
    """Add effects to a model, refit it, and judge.

    Parameters
    ----------
    model : StringModel
    records : sequence of Record
    wants : sequence of Wanted
        Judged together.
    progress : callable, optional
        Gets the share of the work done and the present step.
    ask : callable, optional
        Returns a diagnosis as `diagnose` does; a caller that already has one can return it here.

    Returns
    -------
    Addition
        The fit starts from the priors before any data.
    """
    tell = progress or (lambda _share, _text: None)
    d = ask(model.unfitted, records, progress=lambda share, text: tell(SEARCH * share, text))
    tell(SEARCH, "finding the numbers and the core with what is added")
    added = _with_cores(weighed_step(d, wants), model, records, d)
    tell(1.0, "done")
    return added


def cores_with_named(model: StringModel, records: Sequence[Record], d: Diagnosis) -> tuple[KnownCore, ...]:
    """Return the cores of a diagnosed model and, if effects are named, those with these effects."""
    if not d.selected:
        return (known_core(model, records, d.identified[0], d.search),)
    wants = [Wanted(s.candidate.effect, s.candidate.cell) for s in d.selected]
    return _with_cores(weighed_step(d, wants), model, records, d).core


def weighed_step(d: Diagnosis, wants: Sequence[Wanted]) -> Step:
    """Add effects to the model, judged by the search that gave the verdict."""
    if d.second is not None and (d.search.baseline.problem.model.cells == 1 or not d.selected):
        found = _on_bench(d, d.second, wants)
        if found is not None:
            return found
    named = [s.candidate for s in d.selected]
    if len(named) == len(wants) and all(any(w.meets(c) for c in named) for w in wants):
        odds = min(s.log_odds for s in d.selected)
        after = d.search.final
        tied = {s.candidate.key: s.tied_with for s in d.selected}
        return Step(tuple(named), after, odds, unbelievable(after, named), "", _doubts(d), tied)
    return _fitted_alone(d, wants)


def _doubts(d: Diagnosis) -> tuple[str, ...]:
    """Return the reasons of a diagnosis why the core with the named effects is not proven."""
    said = list(d.alarms)
    if d.verdict == "undecidable":
        tied = sorted({t for s in d.selected for t in s.tied_with})
        said.append(f"{CANNOT_TELL} what was added from {', '.join(tied)}.")
    if d.unknown_remains:
        said.append(UNKNOWN)
    return tuple(said)


def _with_cores(step: Step, model: StringModel, records: Sequence[Record], d: Diagnosis) -> Addition:
    """Return the model that may be written, and the cores before and after; see `Addition.core`."""
    before = known_core(model, records, d.identified[0], d.search)
    same = bool(d.selected) and step.after is d.with_selected
    found = d.identified[1] if same else identify(starting_with(step.after, model), records)
    held_K = [errors(f).heldout_rmse_K for f in (before.identified.fit, found.fit)]
    if step.in_part and held_K[1] <= MOST * held_K[0]:
        # refused, it would leave the user with the larger error; the core stays unproven
        step = replace(step, refused="", remark=f"{step.refused[:1].upper()}{step.refused[1:]}.")
    # a later step may prove the core, but not if something was added against the records
    said = [*earlier_forced(model), *step.doubts]
    said += [f"{FORCED}: {step.refused}."] if step.refused else []
    said += [] if falls(*held_K) else ["The error where nothing was fitted does not fall with what was added."]
    written, after = judged_model(found, model, records, said, before=before)
    own = {f.name: getattr(step, f.name) for f in fields(step)}
    written = _with_ties(written, step.tied)
    own["remark"] = step.remark or " ".join(tie_sentences(written))
    return Addition(**own, model=written, core=(before, after))


def earlier_forced(model: StringModel) -> list[str]:
    """Return what was said against effects that were added to a model by force, as of the step that added them."""
    found = [why.replace(FORCED, EARLIER, 1) if why.startswith(FORCED) else why for why in model.doubts]
    return [why for why in found if why.startswith(EARLIER)]


def _on_bench(d: Diagnosis, second: SecondSearch, wants: Sequence[Wanted]) -> Step | None:
    """Return the fit of the second search, which allows for a model error; None if it has none with these effects."""
    named = named_by(second)
    keys = [next((c.key for c in named if w.meets(c)), w.key) for w in wants]
    after = fit_with(second, keys)
    if after is None:
        return None
    chosen = {c.candidate.key: c for c in second.chosen}
    tied = {name for c in second.chosen for name in c.tied}
    remark = ""
    others = [c.key for c in named if c.key not in keys]
    refused = ""
    ready = all_used(d.search.baseline.problem.records)
    seen = seen_on(second.baseline, ready), seen_on(after, ready)
    if not named:
        refused = f"{why_not(*(rmse(f, stacked(f.problem)[4]) for f in seen))}; {LACKING}"
    elif set(keys) <= set(chosen):
        remark = f"These records ask for {' and '.join(others)} as well." if others else ""
    elif not all(k in chosen or w.effect.name in tied for k, w in zip(keys, wants, strict=True)):
        refused = f"these records speak for {' and '.join(c.key for c in named)} instead"
    added = tuple(
        Candidate(w.effect, int(k.partition(":")[2]) if ":" in k else None) for w, k in zip(wants, keys, strict=True)
    )
    odds = min((chosen[k].log_odds for k in keys if k in chosen), default=0.0)
    ties = {k: chosen[k].tied for k in keys if k in chosen}
    ties |= {k: _likelier(d, k) for k, w in zip(keys, wants, strict=True) if k not in chosen and w.effect.name in tied}
    said = (*second.alarms, *([remark] if remark else []), UNKNOWN)
    return Step(added, after, odds, refused, remark, said, {} if refused else ties)


def _fitted_alone(d: Diagnosis, wants: Sequence[Wanted]) -> Step:
    s = Settings()
    before = after = d.search.baseline
    problem = before.problem
    y, _, _, _, used = stacked(problem)
    surfaces = float(np.quantile(y, 0.05)), float(np.quantile(y, 0.95))
    offered = candidates(problem.model, problem.records[0].drive, surfaces)
    named = [x.candidate for x in d.selected]
    added: list[Candidate] = []
    for w in wants:
        ways = [c for c in named if w.meets(c)] or [c for c in offered if w.meets(c)]
        if not ways:
            raise DataError(f"{problem.records[0].source}: {w.key} cannot show here: it needs {w.effect.needs}")
        c, after = _best(after, ways, s)
        added.append(c)
    inflation = structure(after).inflation
    odds = (after.log_evidence - before.log_evidence) / inflation
    odds += sum(prior_odds(c, offered) for c in added) - HALF
    refused, in_part = unbelievable(after, added), False
    remark = ""
    tied = {x.candidate.key: x.tied_with for x in d.selected if x.candidate in added}
    if all(any(w.meets(c) for c in named) for w in wants):
        keys = " and ".join(c.key for c in named)
        others = " and ".join(c.key for c in named if not any(w.meets(c) for w in wants))
        remark = f"These records ask for {others} as well."
        held_K = rmse(before, ~used), rmse(after, ~used)
        refused = refused or (why_not(*held_K) if rises(*held_K) else "")
        if refused and unbelievable(d.search.final, named):  # all at once are refused too
            refused = f"alone, {refused}; these records ask for {others} as well"
        elif refused:
            refused = f"alone, {refused}; these records ask for {others} as well: add {keys} at once"
    else:
        refused = refused or gate(before, after, odds, inflation, s)
        in_part = not refused and d.verdict == "unknown_effect"
        refused = refused or _contradiction(d, wants, before, after)
        them = ", ".join(c.key for c in named)
        remark = "" if refused else f"{CANNOT_TELL} it from {them}."
        tied = {} if refused else {c.key: _likelier(d, c.key) for c in added}
        if not refused and all(c.name in INSTEAD for c in added):
            tied = {}
            remark = f"Heat from the voltage in place of I²R_e: what that lacks is {them}."
    said = (*_doubts(d), *([remark] if remark else []))
    return Step(tuple(added), after, float(odds), refused, remark, said, tied, in_part)


def _likelier(d: Diagnosis, key: str) -> tuple[str, ...]:
    """Return the named effects that replace the one for which this one was added, and others tied with them."""
    name = key.partition(":")[0]
    of = [s for s in d.selected if name in s.tied_with] or list(d.selected)
    return tuple(dict.fromkeys(t for s in of for t in (s.candidate.name, *s.tied_with) if t != name))


def _with_ties(model: StringModel, tied: Mapping[str, tuple[str, ...]]) -> StringModel:
    """Store with each added effect the effects that these records cannot tell from it, except those in the model."""
    there = {e.name for e in model.effects}
    found = {key: tuple(t for t in names if t not in there) for key, names in tied.items()}
    return replace(model, effects=tuple(replace(e, tied_with=found.get(e.key, e.tied_with)) for e in model.effects))


def _best(current: MapFit, ways: Sequence[Candidate], s: Settings) -> tuple[Candidate, MapFit]:
    """Fit one effect from its starts and at its places, and keep the likeliest."""
    fits = [(g.candidate, refit(current, g)) for g in screen(current, ways)[:WAYS]]
    c, fit = max(fits, key=lambda x: x[1].log_evidence)
    if structure(current).z > s.strong and structure(fit).z > s.strong:
        other = refit_from_nominal(fit, current)
        fit = other if other.log_evidence > fit.log_evidence else fit
    return c, refreshed(fit)


def _contradiction(d: Diagnosis, wants: Sequence[Wanted], before: MapFit, after: MapFit) -> str:
    """Say why effects that pass the gates are still not the missing effects."""
    if d.verdict == "adequate":
        return "nothing is missing that these records could show"
    if d.verdict == "unknown_effect":
        return f"{why_not(*(rmse(f, ~stacked(f.problem)[4]) for f in (before, after)))}; {LACKING}"
    tied = {name for x in d.selected for name in (x.candidate.name, *x.tied_with)} | INSTEAD
    if all(w.effect.name in tied for w in wants):
        return ""
    return f"these records speak for {' and '.join(x.candidate.key for x in d.selected)} instead"


def unbelievable(fit: MapFit, added: Sequence[Candidate]) -> str:
    """Say which number of an added effect is not plausible; `fit` is the closest one, whose numbers are not stated."""
    sd = np.sqrt(np.diag(posterior(fit)))
    for c in added:
        if said := at_bound(fit, c) or below_least(fit, c):
            return f"closely fitted, {said}: not believed"
        told, off = [], False
        for p in c.effect.parameters:
            name = f"{c.key}.{p.name}"
            names = [x.name for x in fit.problem.coordinates]
            if name not in names:
                continue
            i = names.index(name)
            if p.neutral is not None:
                told.append(sd[i] < UNTOLD * fit.problem.coordinates[i].sd)
                off |= moved(fit.problem.coordinates[i], float(fit.theta[i]))
        if told and not any(told) and off:
            return "its size moved far from what was known of it, and is no better known: not believed"
        if told and not any(told):
            return "not identifiable: the data say no more of its size than was known before"
    return ""
