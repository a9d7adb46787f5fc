"""A diagnosis as text for people and as JSON, with the same content as the page of `--html`."""

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

from bms_gateway.diagnosis.calibrate import Identified
from bms_gateway.diagnosis.core_known import KnownCore
from bms_gateway.diagnosis.curve import Curve
from bms_gateway.diagnosis.detect import Card
from bms_gateway.diagnosis.diagnosis import Diagnosis
from bms_gateway.diagnosis.experiment import Experiment
from bms_gateway.diagnosis.offer import Offer
from bms_gateway.diagnosis.ranking import Standing
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.diagnosis.verdict_parts import Errors, Number, Selected, errors
from bms_gateway.diagnosis.verdict_words import alternatives
from bms_gateway.report.core_text import core_document, core_text
from bms_gateway.report.show import kelvins, number, text_table
from bms_gateway.report.step_names import REFITTED, with_added
from bms_gateway.report.words import labelled, named, named_all, parameter_named

BAR = 12
"""Length of the longest evidence bar in characters; the table then still fits a terminal."""
LINEAR = 100.0
"""Log-odds up to which bars are in proportion; beyond, likely effects would vanish beside a certain one."""
SHOWN = 8
"""Number of ranked effects in the text; JSON contains all."""


@dataclass(frozen=True, slots=True)
class Told:
    """A diagnosis with everything that is reported with it.

    Attributes
    ----------
    diagnosis : Diagnosis or None
        None if the records are insufficient.
    sentence : str
    sources : tuple of str
    findings : tuple of (source, Finding)
        Findings of the checks, the worst of each record first.
    notes : tuple of (source, str)
        Values that were interpolated, left out or assumed when the records were read.
    absorbed : tuple of str
        Effects that a parameter of the model absorbs completely.
    next_experiment : str or None
    card : tuple of str
        Effects that these records could show, a line each.
    ranking : tuple of Standing
        All compared hypotheses.
    core : KnownCore or None
        Of the present model; None if nothing can be learnt from the records.
    curve : Curve or None
        dU/dT over the SOC, if entropic heat is named.
    shows : Card or None
        Source of `card`.
    experiment : Experiment or None
        Source of `next_experiment`.
    offer : Offer
        What of the named effects `add` accepts.
    """

    diagnosis: Diagnosis | None
    sentence: str
    sources: tuple[str, ...]
    findings: tuple[tuple[str, Finding], ...] = ()
    notes: tuple[tuple[str, str], ...] = ()
    absorbed: tuple[str, ...] = ()
    next_experiment: str | None = None
    card: tuple[str, ...] = ()
    ranking: tuple[Standing, ...] = ()
    core: KnownCore | None = None
    curve: Curve | None = None
    shows: Card | None = None
    experiment: Experiment | None = None
    offer: Offer = field(default_factory=Offer)


def diagnosis_document(told: Told) -> dict[str, Any]:
    """Return the document of `diagnose --json`; keys after `next_experiment` may be added."""
    d = told.diagnosis
    return {
        "verdict": d.verdict if d else "insufficient_data",
        "unknown_remains": bool(d and d.unknown_remains),
        "selected": [{"effect": s.candidate.name, "cell": s.candidate.cell} for s in d.selected] if d else [],
        "ranking": [_ranked(r) for r in told.ranking if len(r.effects) == 1],
        "baseline": errors_document(d.baseline if d else None)
        | {"noise_floor_K": finite(d.baseline.noise_floor_K) if d else None},
        "after": errors_document(d.after if d else None),
        "absorbed": list(told.absorbed),
        "next_experiment": told.next_experiment,
        "offer": {"effects": list(told.offer.effects), "refused": told.offer.refused or None},
        "core": core_document(told.core, told.sentence),
        "sentence": told.sentence,
        "looks_like": list(d.looks_like) if d else [],
        "core_doubts": list(d.alarms) if d else [],
        "parameters": [_selected(s) for s in d.selected] if d else [],
        "hypotheses": [_together(r) for r in told.ranking if len(r.effects) > 1],
        "curves": [] if told.curve is None else [_curve(told.curve)],
        "structure": {"baseline": _structure(d.baseline), "after": _structure(d.after)} if d else None,
        "tables": list(told.sources),
        "checks": [
            {"table": source, "kind": f.kind, "severity": f.severity, "sentence": f.sentence}
            for source, f in told.findings
        ],
        "notes": [{"table": source, "note": text} for source, text in told.notes],
        "detectability": list(told.card),
    }


def _ranked(r: Standing) -> dict[str, Any]:
    effect, _, cell = r.name.partition(":")
    return {
        "effect": effect,
        "cell": int(cell) if cell else None,
        "heldout_rmse_K": finite(r.heldout_rmse_K),
        "evidence": finite(r.evidence),
        "parameters": numbers_document(r.parameters),
        "tied_with": list(r.tied_with),
        "role": r.role or None,
        "error_K": finite(r.error_K),
        "error_without_K": finite(r.without_K),
        "probability": finite(r.share),
        "refused": r.refused or None,
    }


def _together(r: Standing) -> dict[str, Any]:
    return {
        "effects": list(r.effects),
        "evidence": finite(r.evidence),
        "error_K": finite(r.error_K),
        "refused": r.refused or None,
    }


def _selected(s: Selected) -> dict[str, Any]:
    return {
        "effect": s.candidate.name,
        "cell": s.candidate.cell,
        "parameters": numbers_document(s.parameters),
        "tied_with": list(s.tied_with),
    }


def _curve(c: Curve) -> dict[str, Any]:
    return {
        "effect": c.effect,
        "name": "dUdT",
        "unit": c.unit,
        "soc": [round(float(x), 3) for x in c.soc],
        "value": [float(x) for x in c.value],
        "sd": [float(x) for x in c.sd],
    }


def errors_document(e: Errors | None) -> dict[str, Any]:
    """Return the errors of a model in the form of documents."""
    if e is None:
        return {"train_rmse_K": None, "heldout_rmse_K": None}
    return {"train_rmse_K": finite(e.train_rmse_K), "heldout_rmse_K": finite(e.heldout_rmse_K)}


def _structure(e: Errors) -> dict[str, Any]:
    return {"size_sigma": finite(e.structure.size), "z": finite(e.structure.z)}


def numbers_document(numbers: Mapping[str, Number]) -> dict[str, Any]:
    """Return numbers in the form of documents: value, sd and unit by name."""
    return {name: {"value": finite(x.value), "sd": finite(x.sd), "unit": x.unit} for name, x in numbers.items()}


def finite(x: float) -> float | None:
    """Return a number that JSON can hold; None for NaN and infinity."""
    return float(x) if math.isfinite(x) else None


def diagnosis_text(told: Told) -> str:
    """Write a diagnosis for people, the verdict first."""
    d = told.diagnosis
    several = len(told.sources) > 1
    # the sentence already says that the only record is useless
    doubts = [x for x in told.findings if d is not None or several or x[1].severity != "stop"]
    parts = [labelled(told.sentence), *warned(doubts, several)]
    if told.offer.sentence:
        parts.append(labelled(told.offer.sentence))
    if d is not None:
        if d.selected:
            parts.append(_what_is_missing(d.selected))
        if told.curve is not None:
            parts.append(_curve_text(told.curve))
        if told.ranking:
            parts.append(_ranking(told.ranking, second=d.decided_by_second))
        parts.append(_errors(d))
        parts += [text for x in d.identified[:1] if (text := closer_numbers(x))]
        # with one effect, the sentence has already named it
        tied = {x.candidate.name: x.tied_with for x in d.selected if x.tied_with and len(d.selected) > 1}
        parts += [
            labelled(f"These readings cannot tell {name} from {', '.join(alternatives(others))}.")
            for name, others in tied.items()
        ]
    if told.core is not None:
        parts.append(core_text(told.core))
    if told.absorbed:
        parts.append(
            _listed("Absorbed by a parameter of the model, and therefore not a missing effect:", told.absorbed)
        )
    if told.next_experiment:
        parts.append(labelled(f"Next: {told.next_experiment}"))
    if told.card:
        parts.append(_listed("What these readings could show at all:", told.card))
    parts += told_aside(told.findings, told.notes, several)
    return "\n\n".join(parts)


def warned(findings: Sequence[tuple[str, Finding]], several: bool) -> Iterator[str]:
    """Write what makes the data useless or doubtful, before all conclusions from the data."""
    lines = [(f"{source}: " if several else "") + f.sentence for source, f in findings if f.severity != "note"]
    if lines:
        yield _listed("Look at the data first:", lines)


def told_aside(
    findings: Sequence[tuple[str, Finding]], notes: Sequence[tuple[str, str]], several: bool
) -> Iterator[str]:
    """Write the other findings of the checks, and assumptions while reading, with the names of several records."""
    lines = [
        (f"{source}: " if several else "") + f"{f.severity}: {f.sentence}"
        for source, f in findings
        if f.severity == "note"
    ]
    if lines:
        yield _listed("Checks of the data:", lines)
    if notes:
        yield _listed("Reading the data:", [(f"{source}: " if several else "") + text for source, text in notes])


def _listed(title: str, lines: Sequence[str]) -> str:
    return "\n".join([title, *(f"  {labelled(line)}" for line in lines)])


def _what_is_missing(selected: Sequence[Selected]) -> str:
    lines = []
    for s in selected:
        lines.append(f"{named(s.candidate.key)}: {s.candidate.effect.equation}")
        lines += [f"  its numbers, {WITH_SD}:", *(f"    {x}" for x in number_lines([s.candidate.key], s.parameters))]
    return "\n".join(lines)


def _curve_text(c: Curve) -> str:
    """Write every second point of the curve: a tenth of the charge apart."""
    at = [k for k in range(len(c.soc)) if round(20 * float(c.soc[k])) % 2 == 0]
    rows = [
        ["at SOC, %", *(f"{100 * float(c.soc[k]):.0f}" for k in at)],
        [f"dU/dT, {c.unit}", *(f"{c.value[k]:+.2f}" for k in at)],
        [WITH_SD, *(f"{c.sd[k]:.2f}" for k in at)],
    ]
    return text_table(rows[0], rows[1:], left=1)


WITH_SD = "± 1 sd"
"""Text after ± in `with_sd`, for the head of a list or a table; bands are of 95 %, and state it."""


def number_lines(effects: Sequence[str], numbers: Mapping[str, Number]) -> list[str]:
    """Write each number of effects by its label, with its standard deviation and unit."""
    return [
        f"{parameter_named(effects, name)} = {with_sd(x.value, x.sd)} {x.unit if x.unit != '1' else ''}".rstrip()
        for name, x in numbers.items()
    ]


def with_sd(value: float, sd: float) -> str:
    """Write a value with the digits of its standard deviation, which has two.

    Examples
    --------
    >>> with_sd(0.49637, 0.00843), with_sd(2014.2, 210.0)
    ('0.4964 ± 0.0084', '2010 ± 210')
    """
    if not (math.isfinite(sd) and sd > 0.0):
        return f"{value:.4g}"
    digits = 1 - math.floor(math.log10(sd))
    rounded, spread = (round(x, digits) for x in (value, sd))
    return f"{rounded:.{max(digits, 0)}f} ± {spread:.{max(digits, 0)}f}"


def placed(effect: str, cell: int | None) -> str:
    """Name an effect with its cell, in the form for `add`."""
    return effect if cell is None else f"{effect}:{cell}"


CLOSEST = "errors are those of the search, the closest that each model comes to the readings"
"""Meaning of the errors of a ranking: effects are compared by them, and the stated model has its own errors."""
ROLES = {"named": "named", "tied": "or", "next": "next", "instead": "instead", "": ""}
"""Words for the roles of effects in a ranking."""


GROUPS = {
    "": "Weighed",
    "named": "Named",
    "tied": "Cannot be told from it",
    "next": "One more, beside what is named",
    "instead": "In place of what is named",
}
"""Titles of the parts of a ranking, by role."""
LOGARITHMIC = "bars are as long as the logarithm of their log-odds"
LEAST_TOP = 10.0
"""Least log-odds of a bar of full length."""


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a ranking with one model of comparison for its bars, and so one scale.

    Attributes
    ----------
    role : str
    title : str
    against : str
        Model with which its evidence is compared.
    top : float
        Log-odds of a bar of full length.
    ranked : tuple of Standing
    """

    role: str
    title: str
    against: str
    top: float
    ranked: tuple[Standing, ...]

    @property
    def logarithmic(self) -> bool:
        """Whether the lengths of its bars are the logarithm of their log-odds, and not in proportion to them."""
        return self.top > LINEAR

    @property
    def bars(self) -> str:
        """Explain the bars: the model of comparison, and a sentence about their lengths if these mislead."""
        return f"{self.against}. {LOGARITHMIC[0].upper()}{LOGARITHMIC[1:]}" if self.logarithmic else self.against


def parts_of(ranked: Sequence[Standing]) -> list[Part]:
    """Divide a ranking by role, and by the model with which its evidence is compared."""
    named = {r.effects[0] for r in ranked if r.role == "named"}
    found = []
    for (role, against), group in groupby(ranked, lambda r: (r.role, _against(r, named))):
        mine = tuple(group)
        top = max((r.evidence for r in mine if math.isfinite(r.evidence)), default=0.0)
        found.append(Part(role, GROUPS[role], against, max(top, LEAST_TOP), mine))
    return found


def _against(r: Standing, named: AbstractSet[str]) -> str:
    if r.role == "named":
        return "log-odds against leaving it out"
    if not r.beside:
        return "log-odds against the model as it is"
    return f"log-odds against {'what is named' if set(r.beside) == named else f'the model with {named_all(r.beside)}'}"


def meaning(ranked: Sequence[Standing]) -> str:
    """Explain the columns of a ranking, according to its content."""
    parts = parts_of(ranked)
    said = []
    for role, (before, after) in MEANS.items():
        against = dict.fromkeys(p.against for p in parts if p.role == role)
        if against:
            said.append(f"{before}{', or '.join(against)}{after}")
    scales = ["bars of each kind have a scale of their own"] if len(parts) > 1 else []
    if any(p.logarithmic for p in parts):
        scales.append(f"{LOGARITHMIC} in a kind that has more than {LINEAR:g}")
    return "; ".join([*said, *scales, CLOSEST])


MEANS = {
    "": ("", "; 3 (20 to 1) are needed"),
    "named": ("named: ", ", and the error of a refit without it"),
    "tied": ("or: cannot be told from what is named, ", ""),
    "next": ("next: one more beside what is named, ", ""),
    "instead": ("instead: in place of what is named, ", ""),
}
"""Text around the model of comparison for the evidence of each role."""


def _ranking(ranked: Sequence[Standing], *, second: bool) -> str:
    tops = {id(r): p.top for p in parts_of(ranked) for r in p.ranked}
    told = any(r.role for r in ranked)
    rows = [
        [
            *([ROLES[r.role]] if told else []),
            named_all(r.effects) or r.name,
            _bar(r.evidence, tops[id(r)]),
            labelled(r.refused),
            number(r.evidence, 1 if abs(r.evidence) < 1000.0 else 0),
            number(100.0 * r.share, 0) + (" %" if math.isfinite(r.share) else ""),
            kelvins(r.error_K),
            *([kelvins(r.without_K) if r.role == "named" else ""] if told else []),
        ]
        for r in ranked[:SHOWN]
    ]
    error = "error K" if second else "held-out K"
    headers = ["effect", "evidence", "why not", "log-odds", "probability", error]
    headers = ["", *headers, "without it"] if told else headers
    text = text_table(headers, rows, left=3 + told)
    if len(ranked) > SHOWN:
        text += f"\n… and {len(ranked) - SHOWN} less likely ones"
    return f"{text}\n{textwrap.fill(meaning(ranked), 100)}"


def reach(evidence: float, top: float) -> float:
    """Length of a bar, 0…1, for log-odds: in proportion, or by their logarithm if short bars would vanish."""
    if not (math.isfinite(evidence) and evidence > 0.0 and top > 0.0):
        return 0.0
    return min(math.log1p(evidence) / math.log1p(top) if top > LINEAR else evidence / top, 1.0)


def _bar(evidence: float, top: float) -> str:
    share = reach(evidence, top)
    return "█" * max(1, round(BAR * share)) if share else "·"


def _errors(d: Diagnosis) -> str:
    rows = [_error_row(REFITTED, d.baseline)]
    if d.selected:
        rows.append(_error_row(with_added(named_all(s.candidate.key for s in d.selected)), d.after))
    rows.append(["noise alone", *[kelvins(d.baseline.noise_floor_K)] * 2, "0", ""])
    return text_table(["error", "fitted K", "held-out K", "structured (noise = 1)", "z"], rows)


LEFT = "Even with them these errors remain, which show what the model lacks:"
"""Text before the remaining error of the closest numbers of a model."""


def closer_numbers(found: Identified) -> str:
    """Say how close a model can come to the surfaces by numbers that are not accepted; empty if no closer.

    A search compares effects by such numbers; the shown and written parameters are never these.
    """
    if not found.comes_closer:
        return ""
    closest = errors(found.closest)
    held = "" if math.isnan(closest.heldout_rmse_K) else f" ({closest.heldout_rmse_K:.3g} K rms on held-out blocks)"
    return (
        f"Other numbers of the same model follow the surfaces to {closest.train_rmse_K:.3g} K rms{held}, but "
        "lie farther from what was known than a model with such an error can prove, so they are not used."
    )


def _error_row(name: str, e: Errors) -> list[str]:
    return [
        name,
        kelvins(e.train_rmse_K),
        kelvins(e.heldout_rmse_K),
        number(e.structure.size),
        number(e.structure.z, 1),
    ]
