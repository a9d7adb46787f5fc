"""`--html`: a comparison, a diagnosis or an addition as one page, in the order in which an engineer asks.

What is wrong, how sure is that, how good does it get; then where and when, what else it might be, what to measure next;
last what the data themselves look like. The same content as the text on the terminal, and the numbers of the same
objects.
"""

from collections.abc import Sequence
from dataclasses import replace
from html import escape
from pathlib import Path

from bms_gateway.diagnose.candidates import Candidate
from bms_gateway.diagnose.checks import Finding
from bms_gateway.diagnose.compare import Comparison, CoreCheck, Variant
from bms_gateway.diagnose.detect import Card
from bms_gateway.diagnose.experiment import Experiment
from bms_gateway.diagnose.latent import Latent
from bms_gateway.diagnose.misfit import sensors
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.report.diagnosis_text import Told
from bms_gateway.report.html_evidence import evidence, missing_heat, summary
from bms_gateway.report.html_ranking import detectability_table, experiment_table, ranking_table
from bms_gateway.report.html_series import Shown, shown
from bms_gateway.report.html_tables import errors_table, parameters_table
from bms_gateway.report.page import amount, items, paragraph, section, write_page
from bms_gateway.thermal import Floats

VERDICTS = {
    "adequate": "✓ Adequate",
    "missing_effect": "Missing effect",
    "undecidable": "Missing effect, not decidable which",
    "unknown_effect": "Unknown effect",
    "insufficient_data": "Insufficient data",
}
AGREES, FAILS = "Where the model agrees", "Where the model fails"
AS_IT_IS = "model as it is"
Findings = Sequence[tuple[str, Finding]]
Notes = Sequence[tuple[str, str]]


def write_comparison(
    path: Path,
    comparison: Comparison,
    *,
    findings: Findings = (),
    notes: Notes = (),
    command: str = "",
    title: str = "Model against measurement",
) -> None:
    """Write a comparison as a page.

    Parameters
    ----------
    path : Path
    comparison : Comparison
        Shown as filed and refitted.
    findings : sequence of (source, Finding)
    notes : sequence of (source, str)
    command : str
        Command line that makes the page again.
    title : str

    Raises
    ------
    MissingExtraError
        No plotly.
    UsageError
        The file cannot be written.
    """
    filed, now = comparison.filed, comparison.refitted
    models = [_variant("as filed", filed), _variant("refitted", now)]
    head = f'<p class="verdict">{escape(filed.findings[0])}</p>' + _doubts(findings, comparison.sources)
    head += summary(models)
    said = [
        "<h3>The model as filed</h3>",
        items(filed.findings),
        "<h3>Refitted to these data</h3>",
        items(now.findings),
    ]
    sections = [
        section("where", "Where, when and in which regime it fails", *said),
        *evidence(models, now.core_checks),
        section("errors", "Errors", errors_table(models)),
        section("parameters", "Parameters, refitted", parameters_table(now.fit)),
        *_aside(findings, notes, comparison.sources, command),
    ]
    write_page(path, title, head, sections)


def write_diagnosis(
    path: Path,
    told: Told,
    *,
    comparison: Comparison | None = None,
    latent: Latent | None = None,
    experiment: Experiment | None = None,
    card: Card | None = None,
    command: str = "",
    title: str = "Which effect is the model missing?",
) -> None:
    """Write a diagnosis as a page.

    Parameters
    ----------
    path : Path
    told : Told
        With what the terminal shows; without a diagnosis the page says what the data lack.
    comparison : Comparison, optional
        Of the same records: adds in words where the model fails, and thermocouples in cores.
    latent : Latent, optional
        Of the model as it is: adds the heat that it misses.
    experiment : Experiment, optional
        Adds all tests with what they can be expected to bring.
    card : Card, optional
        Adds the smallest size of each effect that these data could show.
    command : str
        Command line that makes the page again.
    title : str

    Raises
    ------
    MissingExtraError
        No plotly.
    UsageError
        The file cannot be written.
    """
    d = told.diagnosis
    verdict = d.verdict if d else "insufficient_data"
    tag = VERDICTS[verdict] + (", and something unknown remains" if d and d.unknown_remains and d.selected else "")
    head = f'<p><span class="tag {verdict}">{escape(tag)}</span></p><p class="verdict">{escape(told.sentence)}</p>'
    head += _doubts(told.findings, told.sources)
    sections: list[str] = []
    if d is not None:
        before, after = d.fits
        models = [shown(AS_IT_IS, before)]
        if d.selected:
            models.append(shown("with " + " and ".join(s.candidate.key for s in d.selected), after))
        head += summary(models)
        where = items(comparison.refitted.findings) if comparison else ""
        tied = [t for s in d.selected for t in s.tied_with]
        sections = [
            section("missing", "What is missing", _effects([s.candidate for s in d.selected], tied)),
            section("where", AGREES if d.verdict == "adequate" else FAILS, where),
            *evidence(models, _core_checks(comparison, models[0].fit) if comparison else ()),
            section("latent", "The heat that is missing", missing_heat(latent, models[0].fit) if latent else ""),
            section("ranking", "What it could be, ranked", ranking_table(d)),
            section("errors", "Errors before and after" if d.selected else "Errors", errors_table(models)),
            section("parameters", f"Parameters, {models[-1].name}", parameters_table(models[-1].fit)),
        ]
    following = paragraph(told.next_experiment) if told.next_experiment else ""
    sections += [
        section("absorbed", "What a parameter absorbs", items(told.absorbed)),
        section("next", "What to measure next", following, experiment_table(experiment) if experiment else ""),
        section(
            "card", "What these data could show at all", items(told.card), detectability_table(card) if card else ""
        ),
        *_aside(told.findings, told.notes, told.sources, command),
    ]
    write_page(path, title, head, sections)


def write_addition(
    path: Path,
    added: Sequence[Candidate],
    before: MapFit,
    after: MapFit,
    sources: Sequence[str],
    *,
    seen: tuple[MapFit, MapFit] | None = None,
    core_K: tuple[Floats, Floats] | None = None,
    remarks: Sequence[str] = (),
    findings: Findings = (),
    notes: Notes = (),
    command: str = "",
    title: str = "Model with an effect added",
) -> None:
    """Write what an added effect did as a page.

    Parameters
    ----------
    path : Path
    added : sequence of Candidate
    before, after : MapFit
        Of the same records; their numbers and cores are shown.
    sources : sequence of str
        Names of the records.
    seen : tuple of MapFit, optional
        Before and after against the readings themselves, where the fits were to means of them.
    core_K : tuple of ndarray (n,), optional
        95 % half widths of the cores before and after, K, where more is known of them than the fits say.
    remarks : sequence of str
        What speaks against it, and what else the records say.
    findings : sequence of (source, Finding)
    notes : sequence of (source, str)
    command : str
        Command line that makes the page again.
    title : str

    Raises
    ------
    MissingExtraError
        No plotly.
    UsageError
        The file cannot be written.
    """
    names = " and ".join(c.key for c in added)
    models = []
    for i, (name, fit) in enumerate(((AS_IT_IS, before), (f"with {names}", after))):
        own = shown(name, fit)
        errors = own if seen is None else replace(own, fit=seen[i], sensors=sensors(seen[i]))
        models.append(errors if core_K is None else errors.with_cores(core_K[i]))
    held = [m.levels[1] for m in models]
    sentence = f"With {names} the held-out error goes from {amount(held[0].rmse_K)} to {amount(held[1].rmse_K)} K; "
    sentence += f"noise alone leaves {amount(held[1].floor_K)} K."
    sections = [
        section("missing", "What was added", _effects(added, ()), items(remarks)),
        *evidence(models),
        section("errors", "Errors before and after", errors_table(models)),
        section("parameters", f"Parameters, {models[-1].name}", parameters_table(after)),
        *_aside(findings, notes, sources, command),
    ]
    head = f'<p class="verdict">{escape(sentence)}</p>' + _doubts(findings, sources) + summary(models, after)
    write_page(path, title, head, sections)


def _variant(name: str, v: Variant) -> Shown:
    return Shown(name, v.fit, v.sensors, v.cores)


def _effects(added: Sequence[Candidate], tied: Sequence[str]) -> str:
    """Say what effects are and how they show."""
    parts = []
    for c in added:
        parts.append(f"<h3>{escape(c.key)}: {escape(c.effect.title)}</h3><pre>{escape(c.effect.equation)}</pre>")
        parts.append(paragraph(f"How it shows: {c.effect.signature}."))
    if tied:
        parts.append(paragraph(f"These data cannot tell it from {', '.join(dict.fromkeys(tied))}."))
    return "\n".join(parts)


def _doubts(findings: Findings, sources: Sequence[str]) -> str:
    """Say what casts doubt on the data, before what is concluded from them."""
    several = len(sources) > 1
    lines = [(f"{s}: " if several else "") + f.sentence for s, f in findings if f.severity == "warn"]
    return f'<div class="doubts"><p>Look at the data first:</p>{items(lines)}</div>' if lines else ""


def _core_checks(comparison: Comparison, fit: MapFit) -> list[CoreCheck]:
    """Thermocouples in the cores of a fit's records; the comparison may hold records that the fit has not."""
    sources = [m.source for m in fit.problem.records]
    checks = [(comparison.sources[c.record], c) for c in comparison.refitted.core_checks]
    return [replace(c, record=sources.index(s)) for s, c in checks if sources.count(s) == 1]


def _aside(findings: Findings, notes: Notes, sources: Sequence[str], command: str) -> list[str]:
    """Say what the data look like, and how the page was made."""
    several = len(sources) > 1
    others = [(s, f) for s, f in findings if f.severity != "warn"]
    checks = [(f"{s}: " if several else "") + f"{f.severity}: {f.sentence}" for s, f in others]
    read = [(f"{s}: " if several else "") + text for s, text in notes]
    made = f"<pre>{escape(command)}</pre>" if command else ""
    return [
        section("checks", "Direct checks of the data", items(checks)),
        section("notes", "How the data were read", items(read)),
        section("again", "From which data, and how to make this page again", items(sources), made),
    ]
