"""The second search: for records in which the model error, and not the noise of thermocouples, limits the result.

All single effects are fitted, then the most promising pairs and triples by a linear step, each with its own
discrepancy; plausibility counts. An effect is kept only if no hypothesis without it comes within 20 to 1. The found
effects must explain half of the misfit and, fitted to the first part of the record, remove half of the error in the
rest. For a law of the charge, this rest counts as far as the first part of some record contains its charge. A discharge
from full to empty has no such rest: charge and time are equivalent in it, and it alone proves no law of the charge.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.coverage import covered
from bms_gateway.diagnosis.filed import held_out, seen_on
from bms_gateway.diagnosis.hypotheses import Board, Hypothesis, freed
from bms_gateway.diagnosis.model_error import REFINEMENTS, Bench, Fit, ModelError, averaged, first_part, fit
from bms_gateway.diagnosis.residuals import LEAST_Z, rmse, structure, structured
from bms_gateway.diagnosis.search import Chosen, Search
from bms_gateway.diagnosis.witness import Witness, agreement, by_voltage, witnesses
from bms_gateway.identify.coordinates import Coordinate, Measured
from bms_gateway.identify.map_fit import TO_THE_END, FitEffort, MapFit, stacked
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import Floats, StringModel
from bms_gateway.thermal.effects import effect_named

Progress = Callable[[float, str], None]
TIED = 3.0
"""Log-odds within which another effect in the same place explains equally well."""
ENOUGH_KNOWN = 0.2
"""Share of held-out readings at a trained charge above which a law of the charge is judged by them alone."""
HALF = 0.8
"""Share of the structure's power that an explanation must remove."""


@dataclass(frozen=True, slots=True)
class SecondSettings:
    """Constants of the second search.

    Attributes
    ----------
    error : ModelError
    singles, pairs, triples : int
        Number of fitted hypotheses with one, two, three effects, for a single cell …
    string_singles, string_pairs : int
        … and for a string, whose fits cost more and whose effects have many places.
    parents, string_parents, pair_parents : int
        Number of singles, singles of a string, and pairs that are extended.
    again : int
        Number of best ones that are fitted again from nominal.
    gain : float
        Log-odds that every effect must gain over the best hypothesis without it: 3 is 20 to 1.
    digits : float
        Accuracy of the cost in the fits of the best hypotheses.
    explained : float
        Share of the misfit above the noise that the chosen hypothesis must explain.
    train, tail : float
        First part of the record, and greatest share of the error that may remain in the rest.
    """

    error: ModelError = field(default_factory=ModelError)
    singles: int = 40
    pairs: int = 24
    triples: int = 6
    string_singles: int = 14
    string_pairs: int = 8
    parents: int = 12
    string_parents: int = 4
    pair_parents: int = 3
    again: int = 5
    gain: float = 3.0
    digits: float = 1e-3
    explained: float = 0.5
    train: float = 0.6
    tail: float = 0.5

    @property
    def fine(self) -> ModelError:
        """Regime in which the numbers of the chosen hypothesis are fitted."""
        return self.error.fine


@dataclass(frozen=True, slots=True)
class Ranked:
    """One hypothesis for people.

    Attributes
    ----------
    effects : tuple of str
        Keys as in model files; empty for the model as it is.
    log_odds : float
        Against the chosen hypothesis: 0 for itself, positive only if refused or not parsimonious.
    share : float
        Probability among those not refused.
    refused : str
    """

    effects: tuple[str, ...]
    log_odds: float
    share: float
    refused: str


@dataclass(frozen=True, slots=True)
class SecondSearch:
    """Result of the second search.

    Attributes
    ----------
    baseline, best : MapFit
        The model as it is and with the chosen effects, on the averaged records.
    chosen : tuple of Chosen
        Surest first. With the verdict "unknown_effect", the unknown effect resembles it; it is never the cause.
    verdict : {"missing_effect", "unknown_effect"}
    unknown_remains : bool
        Always true: this search is only made if the two-node model itself has an error.
    core_claimed : bool
        Whether the core is better known than before.
    alarms : tuple of str
        Reasons against the core, each a sentence.
    witnesses : tuple of Witness
        All witnesses, with their statements.
    ranking : tuple of Ranked
    explained : float
        Share of the surface's misfit above the noise.
    blocks : tuple of MapFit
        Without and with the chosen effects, fitted without the held-out blocks, compared with the readings as they
        came: the errors that `compare` states for the same models.
    tail : tuple of float
        RMSE in the last part of a fit to the first, without and with the chosen effects, K.
    known_K : tuple of float or None
        As `held_K`, at trained charges only; given if a law depends on the charge and a part of the held-out readings
        is at other charges.
    discrepancy : tuple of float
        Size of the slow model error without and with the chosen effects, K.
    records : sequence of Measured
        As given.
    hypotheses : tuple of Hypothesis
        Hypotheses that are not refused, the chosen one first.
    settings : SecondSettings
    probability : mapping of key to float
        Of each chosen effect: the sum over all hypotheses with it that are not refused.
    """

    baseline: MapFit
    best: MapFit
    chosen: tuple[Chosen, ...]
    verdict: Literal["missing_effect", "unknown_effect"]
    unknown_remains: bool
    core_claimed: bool
    alarms: tuple[str, ...]
    witnesses: tuple[Witness, ...]
    ranking: tuple[Ranked, ...]
    explained: float
    blocks: tuple[MapFit, MapFit]
    tail: tuple[float, float]
    discrepancy: tuple[float, float]
    records: Sequence[Measured]
    hypotheses: tuple[Hypothesis, ...]
    settings: SecondSettings
    probability: Mapping[str, float] = field(default_factory=dict)
    known_K: tuple[float, float] | None = None

    @property
    def held_K(self) -> tuple[float, float]:
        """RMSE on the held-out blocks without and with the chosen effects."""
        before, after = (_error_held(f) for f in self.blocks)
        return before, after


def needs_second(first: Search) -> bool:
    """Whether the first search leaves unexplained structure: much, half of it, or a number at its bound.

    A number at its bound with white readings is at a natural limit: a full share, or no loss.
    """
    if first.orphan:
        return True
    f = first.final
    left = structure(f)
    if left.z <= LEAST_Z:
        return False
    if structured(f) or any(f.at_bound(c.name) for c in f.problem.coordinates if _bounded(c)):
        return True
    before = structure(first.baseline).power
    return bool(first.chosen) and left.power > (1.0 - HALF) * before


def _bounded(c: Coordinate) -> bool:
    """Whether a coordinate is a number of an effect and no shape parameter, which may end anywhere."""
    if c.effect is None:
        return False
    effect = effect_named(c.effect.partition(":")[0])
    return effect.parameter(c.name.rpartition(".")[2]).neutral is not None


def second_search(
    model: StringModel,
    records: Sequence[Measured],
    settings: SecondSettings | None = None,
    progress: Progress | None = None,
) -> SecondSearch:
    """Search for missing effects with an assumed model error.

    Parameters
    ----------
    model : StringModel
        With the priors of its fit.
    records : sequence of Measured
        From `prepare.measured`; all readings are used, also held-out ones.
    settings : SecondSettings, optional
    progress : callable, optional
        Gets the share of the work done and the present step.

    Returns
    -------
    SecondSearch
        The same for the same arguments, to the last bit.
    """
    s = settings or SecondSettings()
    tell = progress or (lambda _share, _text: None)
    bench = Bench([averaged(m, s.error) for m in records], s.error)
    tell(0.0, "fitting the model as it is, with an error of its own")
    board = Board(model, bench)
    _explore(board, s, tell)
    best = _parsimonious(board, s)
    if best.special and not _clean(best, records):
        board.refuse_special()
        best = _parsimonious(board, s)
    fine = Bench([averaged(m, s.fine) for m in records], s.fine)
    tell(0.85, "fitting the numbers of the best hypothesis")
    final = _finished(best, fine, s)
    base = board.base.fit
    tell(0.9, "predicting the last part from the first")
    late = _tail(bench, base, s), _tail(bench, best.fit, s)
    tail = late[0].rmse(), late[1].rmse()
    explained = _explained(records, base.map, best.fit.map)
    noise = _noise(records, best.fit.map)
    kept = _removed(tail, noise, s)
    blocks = (_blocks(bench, base, records, anew=True), _blocks(bench, best.fit, records))
    known_K = None
    if any(c.follows_charge for c in best.effects):
        held = tuple(Predicted.of(f) for f in blocks)
        known_K = (held[0].rmse(known=True), held[1].rmse(known=True)) if held[0].splits else None
        if not kept and late[0].splits:
            kept = _removed((late[0].rmse(known=True), late[1].rmse(known=True)), noise, s)
    believed = bool(best.effects) and explained >= s.explained and kept
    said = (*witnesses(final.map, records, tail if best.effects else None), *_by_voltage(board, best))
    if len(records) > 1:
        tell(0.95, "fitting each record alone")
        said += agreement(final.map, [_alone(final, m, fine.settings) for m in fine.records])
    alarms = tuple(w.says for w in said if w.alarm)
    tell(1.0, "done")
    accepted = tuple(board.accepted())
    chosen = _chosen(board, best)
    if best is not accepted[0]:
        accepted = (best, *(h for h in accepted if h is not best))
    return SecondSearch(
        baseline=base.map,
        best=final.map,
        chosen=chosen,
        probability={c.candidate.key: probability(board, c.candidate.name) for c in chosen},
        verdict="missing_effect" if believed else "unknown_effect",
        unknown_remains=True,
        core_claimed=believed and not alarms,
        alarms=alarms,
        witnesses=said,
        ranking=_ranking(board, best),
        explained=explained,
        blocks=blocks,
        tail=tail,
        known_K=known_K,
        discrepancy=(base.discrepancy.size, final.discrepancy.size),
        records=records,
        hypotheses=accepted,
        settings=s,
    )


def _explore(board: Board, s: SecondSettings, tell: Progress) -> None:
    one = board.base.fit.map.problem.model.cells == 1
    counts = (s.singles, s.pairs, s.triples) if one else (s.string_singles, s.string_pairs, s.triples)
    parents = (1, s.parents if one else s.string_parents, s.pair_parents)
    begin = 0.05
    for effects, share in enumerate((0.3, 0.3, 0.1)):
        todo = board.prospects(board.of(effects)[: parents[effects]], counts[effects])
        for i, (h, g) in enumerate(todo):
            names = ", ".join([*h.names, g.candidate.key])
            tell(begin + share * i / len(todo), f"refitting with {names}")
            board.add(h, g.candidate, g.values)
        begin += share
    tell(0.75, "refitting the best hypotheses")
    for h in board.accepted()[: s.again]:
        board.finish(h, s.digits)


def _parsimonious(board: Board, s: SecondSettings) -> Hypothesis:
    """Best hypothesis in which each effect is needed."""
    best = board.accepted()[0]
    while best.effects:
        value, without = min(
            ((best.score - w.score, w) for c in best.effects for w in [board.without(best, c)]), key=lambda x: x[0]
        )
        if value >= s.gain:
            break
        best = without
    return best


def _clean(best: Hypothesis, records: Sequence[Measured]) -> bool:
    """Whether the residuals of all readings, as they were recorded, have no structure under a hypothesis.

    If they have structure, the two-node model still has an error. An effect that reduces this error a little need not
    exist. Then an effect that every cell has may be named, but not one that needs a special cause.
    """
    return not structured(seen_on(best.fit.map, [replace(m, used=np.ones_like(m.used)) for m in records]))


def _finished(best: Hypothesis, fine: Bench, s: SecondSettings) -> Fit:
    problem = Problem(best.fit.map.problem.model, fine.records, fine.beliefs)
    effort = FitEffort(60, least_gain=s.digits, refinements=REFINEMENTS)
    return fit(fine, problem, best.fit.map.theta, effort, guess=best.fit.map.prediction.X)


def _by_voltage(board: Board, best: Hypothesis) -> list[Witness]:
    """Fit the heat from the voltage without any effect, and compare its cores."""
    heat = freed(Candidate(effect_named("voltage_heat")), board.bench.records)
    if not all(heat.effect.determined(m.drive) for m in board.bench.records):
        return []
    other = board.fitted(board.base, heat, {})
    return [
        by_voltage(best.fit.map, other.fit.map, r, other.fit.log_evidence - best.fit.log_evidence)
        for r in range(len(board.bench.records))
    ]


def _alone(joint: Fit, m: Measured, settings: ModelError) -> MapFit:
    """Fit one record with the common model."""
    bench = Bench([m], settings)
    problem = Problem(joint.map.problem.model, bench.records, bench.beliefs)
    theta = problem.begin
    known = {c.name: float(z) for c, z in zip(joint.map.problem.coordinates, joint.map.theta, strict=True)}
    for i, c in enumerate(problem.coordinates):
        theta[i] = known.get(c.name, theta[i])
    return fit(bench, problem, theta, FitEffort(40, refinements=REFINEMENTS)).map


@dataclass(frozen=True, slots=True)
class Predicted:
    """Predictions of held-out readings.

    Attributes
    ----------
    error : ndarray (H,), K
    known : ndarray (H,) of bool
        Whether the heat behind each was made at a trained charge.
    """

    error: Floats
    known: np.ndarray

    @classmethod
    def of(cls, f: MapFit) -> "Predicted":
        """Take the held-out readings of a fit."""
        y, _, _, _, used = stacked(f.problem)
        return cls((y - f.y)[~used], covered(f.problem.records)[~used])

    @property
    def splits(self) -> bool:
        """Whether some are beyond the trained charges, and enough are within to judge."""
        return bool(not self.known.all() and self.known.mean() >= ENOUGH_KNOWN)

    def rmse(self, *, known: bool = False) -> float:
        """Root mean square, K; with `known`, only at trained charges."""
        return float(np.sqrt(np.mean(self.error[self.known] ** 2 if known else self.error**2)))


def _removed(errors: tuple[float, float], noise: float, s: SecondSettings) -> bool:
    """Whether enough of the error above the noise has been explained."""
    before, after = (x**2 - noise**2 for x in errors)
    return max(after, 0.0) <= s.tail * max(before, 1e-9)


def _tail(bench: Bench, f: Fit, s: SecondSettings) -> Predicted:
    """Predict the last part by a fit to the first."""
    part = Bench([first_part(m, s.train) for m in bench.records], bench.settings)
    problem = Problem(f.map.problem.model, part.records, bench.beliefs)
    return Predicted.of(fit(part, problem, f.map.theta, guess=f.map.prediction.X).map)


def _blocks(bench: Bench, f: Fit, records: Sequence[Measured], *, anew: bool = False) -> MapFit:
    """Fit without the held-out blocks, and compare with the readings as they came.

    With `anew`, the fit starts from the priors before any data, as `calibrate.identify` does for the present model.
    """
    part = Bench([held_out(m) for m in bench.records], bench.settings)
    problem = Problem(f.map.problem.model, part.records, bench.beliefs)
    if anew:
        found = fit(part, problem, problem.begin, TO_THE_END)
    else:
        found = fit(part, problem, f.map.theta, guess=f.map.prediction.X)
    return seen_on(found.map, records)


def _error_held(f: MapFit) -> float:
    return rmse(f, ~stacked(f.problem)[4])


def _explained(records: Sequence[Measured], base: MapFit, best: MapFit) -> float:
    y = stacked(base.problem)[0]
    noise = _noise(records, base)
    before, after = (max(float(np.mean((y - f.y) ** 2)) - noise**2, 0.0) for f in (base, best))
    return 1.0 - after / max(before, 1e-9)


def _noise(records: Sequence[Measured], f: MapFit) -> float:
    """Error, K, that the thermocouples' noise alone leaves in the averaged readings."""
    raw = sum(float(np.sum(m.sigma**2)) for m in records)
    count = sum(len(m.y) for m in records)
    return float(np.sqrt(raw / count / (count / sum(len(m.y) for m in f.problem.records))))


def _chosen(board: Board, best: Hypothesis) -> tuple[Chosen, ...]:
    near = [h for h in board.accepted() if h.score > best.score - TIED and len(h.effects) == len(best.effects)]
    found = []
    for c in best.effects:
        others = set(best.names) - {c.name}
        tied = {n for h in near if others < set(h.names) for n in h.names} - set(best.names)
        found.append(Chosen(c, tuple(sorted(tied)), best.score - board.without(best, c).score))
    return tuple(sorted(found, key=lambda c: -c.log_odds))


def probability(board: Board, name: str) -> float:
    """Probability of an effect, with any other effects, among the hypotheses that are not refused."""
    accepted = board.accepted()
    weight = np.exp(np.array([h.score for h in accepted]) - accepted[0].score)
    has = np.array([name in h.names for h in accepted])
    return float(weight[has].sum() / weight.sum())


def _ranking(board: Board, best: Hypothesis) -> tuple[Ranked, ...]:
    accepted = board.accepted()
    weight = np.exp(np.array([h.score for h in accepted]) - accepted[0].score)
    share = dict(zip((h.key for h in accepted), (weight / weight.sum()).tolist(), strict=True))
    ranked = sorted(board.found.values(), key=lambda h: (-h.score, h.key))
    return tuple(
        Ranked(tuple(c.key for c in h.effects), h.score - best.score, share.get(h.key, 0.0), h.refused) for h in ranked
    )
