"""`--html`: a comparison, a diagnosis or an addition as one page, in the order in which an engineer asks.

The page begins with what is wrong, how sure that is, and how much better the model becomes. Then it shows where and
when, other explanations, and what to measure next. Last come the data themselves. The content is that of the text on
the terminal, with the numbers of the same objects.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path

from bms_gateway.diagnosis.adding import Addition
from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.compare import Comparison
from bms_gateway.diagnosis.core_check import CoreCheck
from bms_gateway.diagnosis.core_known import KnownCore
from bms_gateway.diagnosis.detect import Card
from bms_gateway.diagnosis.diagnosis import Diagnosis
from bms_gateway.diagnosis.error_words import only_fitted
from bms_gateway.diagnosis.experiment import Experiment
from bms_gateway.diagnosis.latent import Latent
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.diagnosis.verdict_words import alternatives
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.report.add_text import AddReport, headline
from bms_gateway.report.core_text import core_sentence, numbers_remark, thermocouple_sentence
from bms_gateway.report.diagnosis_text import LEFT, Told, closer_numbers
from bms_gateway.report.html_correlation import correlation_table
from bms_gateway.report.html_evidence import evidence, missing_heat, summary
from bms_gateway.report.html_ranking import detectability_table, experiment_table, ranking_table
from bms_gateway.report.html_series import Shown, shown
from bms_gateway.report.html_tables import curve_table, errors_table, parameters_table
from bms_gateway.report.html_work import Work
from bms_gateway.report.page import items, paragraph, section, write_page
from bms_gateway.report.step_names import FILED, REFITTED, titled, with_added
from bms_gateway.report.words import in_words, labelled, named, named_all, parameters_labelled

VERDICTS = {
    "adequate": "✓ Adequate",
    "missing_effect": "Missing effect",
    "undecidable": "Missing effect, not decidable which",
    "unknown_effect": "Unknown effect",
    "insufficient_data": "Insufficient data",
}
ONLY_FITTED = "Perhaps an effect, not shown on held-out readings"
AGREES, FAILS = "Where the model agrees", "Where the model fails"


@dataclass(frozen=True, slots=True)
class Aside:
    """Remarks of a page on the data themselves.

    Attributes
    ----------
    sources : sequence of str
        Names of the records.
    findings : sequence of (source, Finding)
        Findings of the checks.
    notes : sequence of (source, str)
        Values that were interpolated, left out or assumed when the records were read.
    command : str
        Command line that makes the page again; may be empty.
    remains : str
        What an earlier diagnosis left open, as a sentence; may be empty.
    work : Work
        What was done on the page before.
    """

    sources: Sequence[str]
    findings: Sequence[tuple[str, Finding]] = ()
    notes: Sequence[tuple[str, str]] = ()
    command: str = ""
    remains: str = ""
    work: Work = field(default_factory=Work)

    def _by_record(self, said: Iterable[tuple[str, str]]) -> list[str]:
        """Put the name of the record before each sentence if there are several records."""
        return [f"{source}: {text}" if len(self.sources) > 1 else text for source, text in said]

    @property
    def doubts(self) -> str:
        """Earlier verdict and doubts about the data, for the head: they stand before the conclusions from the data."""
        lines = self._by_record((s, f.sentence) for s, f in self.findings if f.severity != "note")
        open_still = f'<p class="alarm">{escape(self.remains)}</p>' if self.remains else ""
        return (
            self.work.verdict
            + open_still
            + (f'<div class="doubts"><p>Look at the data first:</p>{items(lines)}</div>' if lines else "")
        )

    @property
    def sections(self) -> list[str]:
        """Remarks on the data, and how the page was made, for its end."""
        checks = ((s, f"{f.severity}: {f.sentence}") for s, f in self.findings if f.severity == "note")
        made = f"<pre>{escape(self.command)}</pre>" if self.command else ""
        return [
            section("checks", "Direct checks of the data", items(self._by_record(checks))),
            section("notes", "How the data were read", items(self._by_record(self.notes))),
            section(
                "again", "From which data, and how to make this page again", items(self.sources, verbatim=True), made
            ),
        ]


def write_comparison(path: Path, comparison: Comparison, aside: Aside) -> None:
    """Write a comparison as a page: the model from its file, and refitted.

    Raises what `write_page` raises.
    """
    filed, now = comparison.filed, comparison.refitted
    models = [Shown.of(FILED, filed, comparison.core.proven), Shown.of(REFITTED, now, comparison.core.proven)]
    head = f'<p class="verdict">{escape(filed.findings[0])}</p>'
    head += core_html(comparison.core, now.core_checks)
    head += aside.doubts + summary(models)
    said = [f"<h3>{escape(titled(name))}</h3>{items(v.findings)}" for name, v in ((FILED, filed), (REFITTED, now))]
    said.append(closest_html(comparison))
    sections = [
        *aside.work.first,
        section("where", "Where, when and in which regime it fails", *said),
        *evidence(models, now.core_checks),
        section("errors", "Errors", errors_table(models)),
        section("parameters", f"Parameters, {REFITTED}", numbers_html(now.fit, comparison.core)),
        section("correlations", "Correlation of the parameters", correlation_table(now.fit)),
        *aside.sections,
    ]
    write_page(path, "Model against measurement", head, sections)


@dataclass(frozen=True, slots=True)
class Details:
    """Parts of a diagnosis that a page shows and the terminal does not; each part may be absent.

    Attributes
    ----------
    comparison : Comparison, optional
        For the same records: where the model fails, in words, and thermocouples in cores.
    latent : Latent, optional
        For the present model: the heat that it does not explain.
    experiment : Experiment, optional
        All proposed tests, with the log-odds that they are expected to give.
    card : Card, optional
        The smallest size of each effect that these data could show.
    cores : sequence of KnownCore
        For the present model and the one with the missing effect, from `adding.cores_with_named`.
    earlier : sequence of Shown
        Models of the same readings before the present one, such as that from its file.
    work : Work
        What was done on the page before.
    """

    comparison: Comparison | None = None
    latent: Latent | None = None
    experiment: Experiment | None = None
    card: Card | None = None
    cores: Sequence[KnownCore] = ()
    earlier: Sequence[Shown] = ()
    work: Work = field(default_factory=Work)


@dataclass(frozen=True, slots=True)
class Road:
    """The way to a model of the last steps.

    Attributes
    ----------
    step : str
        Name of the model before an addition, or of the model that is compared.
    earlier : sequence of Shown
        Still earlier models that are shown too.
    added : sequence of (name of the step, effects)
        What was added in earlier steps.
    work : Work
        What was done on the page before, in the report of an addition.
    """

    step: str = REFITTED
    earlier: Sequence[Shown] = ()
    added: Sequence[tuple[str, Sequence[Candidate]]] = ()
    work: Work = field(default_factory=Work)


def write_diagnosis(
    path: Path,
    told: Told,
    details: Details | None = None,
    *,
    command: str = "",
    step: str = REFITTED,
    title: str = "Which effect is the model missing?",
) -> None:
    """Write a diagnosis as a page.

    Parameters
    ----------
    path : Path
    told : Told
        With the content of the terminal; without a diagnosis the page says what the data lack.
    details : Details, optional
        Details that the terminal does not show.
    command : str
        Command line that makes the page again.
    step : str
        Name of the model that is diagnosed.
    title : str

    Raises
    ------
    MissingExtraError, UsageError
        As for `write_page`.
    """
    d, seen = told.diagnosis, details or Details()
    comparison, latent, experiment, card = seen.comparison, seen.latent, seen.experiment, seen.card
    aside = Aside(told.sources, told.findings, told.notes, command)
    verdict = d.verdict if d else "insufficient_data"
    tag = verdict_tag(d)
    sentence = escape(in_words(told.sentence))
    head = f'<p><span class="tag {verdict}">{escape(tag)}</span></p><p class="verdict">{sentence}</p>'
    head += paragraph(told.offer.sentence) if told.offer.sentence else ""
    head += core_html(told.core, comparison.refitted.core_checks if comparison else ()) + aside.doubts
    sections: list[str] = []
    if d is not None:
        before, after = d.fits
        known = seen.cores or ([told.core] if told.core else [])
        bands = [*((c.bands, c.proven) for c in known), ((), True), ((), True)]
        models = [*seen.earlier, shown(step, before, *bands[0])]
        if d.selected:
            models.append(shown(with_added(named_all(s.candidate.key for s in d.selected)), after, *bands[1]))
        head += summary(models)
        where = items(comparison.refitted.findings) + closest_html(comparison) if comparison else ""
        tied = [t for s in d.selected for t in s.tied_with]
        sections = [
            section("missing", "What is missing", _effects([s.candidate for s in d.selected], tied)),
            section("where", AGREES if d.verdict == "adequate" else FAILS, where),
            *evidence(models, _core_checks(comparison, before) if comparison else ()),
            section("curve", "dU/dT over the SOC", curve_table(told.curve) if told.curve else ""),
            section("latent", "The heat that is missing", missing_heat(latent, before) if latent else ""),
            section("ranking", "What it could be, ranked", ranking_table(told.ranking, second=d.decided_by_second)),
            section("errors", "Errors before and after" if d.selected else "Errors", errors_table(models)),
            section("parameters", f"Parameters, {models[-1].name}", _numbers(told, known, models[-1].fit)),
            section("correlations", "Correlation of the parameters", correlation_table(models[-1].fit)),
        ]
    following = paragraph(told.next_experiment) if told.next_experiment else ""
    sections = [
        *seen.work.first,
        *sections,
        section("absorbed", "What a parameter absorbs", items(told.absorbed)),
        section("next", "What to measure next", following, experiment_table(experiment) if experiment else ""),
        section(
            "card", "What these data could show at all", items(told.card), detectability_table(card) if card else ""
        ),
        *aside.sections,
    ]
    write_page(path, title, head, sections)


def write_addition(
    path: Path,
    report: AddReport,
    addition: Addition,
    command: str = "",
    remains: str = "",
    road: Road | None = None,
) -> None:
    """Write the result of an added effect, or why it was not added, as a page.

    Parameters
    ----------
    path : Path
    report : AddReport
        With the content of the terminal.
    addition : Addition
        Its fits and the half widths of its cores are drawn.
    command : str
        Command line that makes the page again.
    remains : str
        As for `Aside`.
    road : Road, optional

    Raises
    ------
    MissingExtraError, UsageError
        As for `write_page`.
    """
    way = road or Road()
    aside = Aside(report.sources, report.findings, report.notes, command, remains, way.work)
    names = (way.step, with_added(named_all(c.key for c in addition.added), forced=report.forced))
    models = [*way.earlier]
    models += [shown(name, c.identified.fit, c.bands, c.proven) for name, c in zip(names, addition.core, strict=True)]
    kind = "added" if report.written and not report.forced and report.after.core.proven else "refused"
    against = [in_words(f"Not added: {report.refused}.")] if report.refused and not report.forced else []
    against += [in_words(text) for text in report.though]
    sections = [
        *way.work.first,
        section(
            "missing",
            "What was added" if report.written else "What was tried",
            *(_step_effects(*x) for x in (*way.added, (names[1], addition.added))),
        ),
        *evidence(models, report.after.checks),
        *way.work.ranking,
        section("errors", "Errors before and after", errors_table(models)),
        section("parameters", f"Parameters, {models[-1].name}", numbers_html(models[-1].fit, report.after.core)),
        section("correlations", "Correlation of the parameters", correlation_table(models[-1].fit)),
        *aside.sections,
    ]
    sentence = escape(in_words(headline(report)))
    head = f'<p><span class="tag {kind}">{escape(report.tag)}</span></p><p class="verdict">{sentence}</p>'
    head += core_html(report.after.core, report.after.checks)
    head += items([*against, *([in_words(report.remark)] if report.remark else [])])
    head += aside.doubts + summary(models)
    write_page(path, "Model with an effect added", head, sections)


def verdict_tag(d: Diagnosis | None) -> str:
    """Return the verdict in a few words; without a diagnosis there were too few data."""
    if d is None:
        return VERDICTS["insufficient_data"]
    held = d.baseline.heldout_rmse_K, d.after.heldout_rmse_K
    unshown = bool(d.selected) and only_fitted(held, d.second.known_K if d.second else None)
    tag = ONLY_FITTED if unshown else VERDICTS[d.verdict]
    return tag + (", and something unknown remains" if d.unknown_remains and d.selected else "")


def closest_html(comparison: Comparison) -> str:
    """Describe the error of even the closest numbers of a model; empty without closer ones."""
    v = comparison.closest
    if v is None:
        return ""
    return paragraph(f"{closer_numbers(comparison.core.identified)} {LEFT}") + items(v.findings)


def numbers_html(fit: MapFit, core: KnownCore | None, *, narrow: bool = False) -> str:
    """Return the numbers of a model, with a remark on their value if the model lacks something."""
    if core is None:
        return parameters_table(fit, narrow=narrow)
    remark = numbers_remark(core)
    said = (
        f'<p class="{"alarm" if core.numbers_doubted else "muted"}">{escape(parameters_labelled(remark))}</p>'
        if remark
        else ""
    )
    return said + parameters_table(fit, doubted=core.numbers_doubted, narrow=narrow)


def core_html(core: KnownCore | None, checks: Sequence[CoreCheck] = ()) -> str:
    """Say how well the cores are known, if computed, and what contradicts them, also thermocouples."""
    said = ""
    if core is not None:
        sentence = core_sentence(core)
        said = paragraph(sentence) if core.proven else f'<p class="alarm">{escape(sentence)}</p>'
        said += items([parameters_labelled(text) for text in core.why])
    read = [f'<p class="danger">{escape(thermocouple_sentence(c))}</p>' for c in checks if c.outside]
    return said + "".join(read)


def _numbers(told: Told, known: Sequence[KnownCore], fit: MapFit) -> str:
    """Return the numbers of the final model of a diagnosis: the present one, or that with the named effects."""
    d, core = told.diagnosis, known[-1] if known else None
    if (
        d is not None and d.selected and core is not None and len(known) == 1
    ):  # the cores with what is named are not known
        core = replace(core, identified=d.identified[-1], lacks=d.unknown_remains)
    return numbers_html(fit, core)


def _step_effects(step: str, added: Sequence[Candidate]) -> str:
    """Return the name of a step, and the equation and visible signs of each effect that came with it."""
    parts = [f"<h3>{escape(step)}</h3>"]
    for c in added:
        parts += [f"<p>{escape(named(c.key))}</p>"] if len(added) > 1 else []
        parts += [f"<pre>{escape(c.effect.equation)}</pre>", paragraph(f"How it shows: {c.effect.signature}.")]
    return "\n".join(parts)


def _effects(added: Sequence[Candidate], tied: Sequence[str]) -> str:
    """Return the equation of effects and their visible signs."""
    parts = []
    for c in added:
        parts.append(f"<h3>{escape(named(c.key))}</h3><pre>{escape(c.effect.equation)}</pre>")
        parts.append(paragraph(f"How it shows: {c.effect.signature}."))
    if tied:
        parts.append(paragraph(f"These data cannot tell it from {', '.join(labelled(t) for t in alternatives(tied))}."))
    return "\n".join(parts)


def _core_checks(comparison: Comparison, fit: MapFit) -> list[CoreCheck]:
    """Thermocouples in the cores of a fit's records; the comparison may contain further records."""
    sources = [m.source for m in fit.problem.records]
    checks = [(comparison.sources[c.record], c) for c in comparison.refitted.core_checks]
    return [replace(c, record=sources.index(s)) for s, c in checks if sources.count(s) == 1]
