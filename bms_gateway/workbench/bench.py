"""Data of one tab of the browser: records that were read once, and the latest results from them.

Every answer follows from the request alone: files, model and words. The stored data only save work, so a worker that
was ended during a task can be replaced by a new one.
"""

import tempfile
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from bms_gateway.config.model_file import format_model, parse_model, read_model
from bms_gateway.diagnosis.adding import Addition, add_effects, asked_for, check_signals
from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.compare import Comparison, compare
from bms_gateway.diagnosis.diagnosis import Diagnosis, diagnose
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.errors import UsageError
from bms_gateway.identify.effort import heard
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.records.read import Reading, read_measurements
from bms_gateway.records.recent_signals import Stretch, given_span, state_directory, write_recent
from bms_gateway.report.add_text import AddReport
from bms_gateway.report.added import added_report, heading
from bms_gateway.report.details import details_of
from bms_gateway.report.diagnosis_text import Told
from bms_gateway.report.examine import (
    examine,
    findings_and_notes,
    long_enough,
    sound,
)
from bms_gateway.report.html import (
    Aside,
    Details,
    Road,
    verdict_tag,
    write_addition,
    write_comparison,
    write_diagnosis,
)
from bms_gateway.report.html_series import Shown
from bms_gateway.report.html_work import Work
from bms_gateway.report.step_names import FILED, REFITTED, with_added
from bms_gateway.report.table import parse_columns
from bms_gateway.report.words import named_all
from bms_gateway.thermal import StringModel
from bms_gateway.thermal.effects import effect_named
from bms_gateway.workbench import documents, pictures, whiteness
from bms_gateway.workbench.approach import Show, approach
from bms_gateway.workbench.looking import looked
from bms_gateway.workbench.moving import Moving
from bms_gateway.workbench.recall import content_of, digests, recalled
from bms_gateway.workbench.series import Shelf
from bms_gateway.workbench.tracks import about, track

MOST_MADE = 4
"""Number of models whose results are kept: fits take tens of megabytes."""
MOST_NUMBERS = 8 << 20
"""Numbers in a table or log: a million rows of eight columns. As a record they take half a gigabyte."""
MOST_LOOKED = 40
"""Number of tables whose columns are shown before they are opened."""
READING = 0.5
"""Share of the work of opening that is reading a table; what is made of it takes the rest."""
SHOWN_FITS = 0.5
"""Share of the work of an addition that goes by while its fits are shown, where the diagnosis is known."""
Tell = Callable[[float, str], None]


@dataclass(frozen=True, slots=True)
class Files:
    """The opened files, named as on a command line."""

    tables: tuple[str, ...]
    model: str
    config: str = ""
    string: str = ""
    columns: tuple[str, ...] = ()
    each: tuple[tuple[str, ...], ...] = ()

    def of_table(self, k: int) -> tuple[str, ...]:
        """Columns of one table: the common ones, and its own."""
        return (*self.columns, *(self.each[k] if k < len(self.each) else ()))

    @classmethod
    def of(cls, request: Mapping[str, Any]) -> "Files":
        """Read the names from a request."""
        config, string = request.get("config") or "", request.get("string") or ""
        if request.get("recent") and not config:
            string = ""  # it stated what to take of the gateway's signals
        columns, each = tuple(request.get("columns") or ()), tuple(tuple(x) for x in request.get("each") or ())
        return cls(tuple(request["tables"]), request["model"], config, string, columns, each)


@dataclass(slots=True)
class _Made:
    """Results of one model, kept for the report, which shows the same."""

    comparison: Comparison | None = None
    told: Told | None = None
    addition: tuple[Addition, AddReport] | None = None


class Bench:
    """See the module's text."""

    def __init__(self) -> None:
        self._files: Files | None = None
        self._filed: StringModel | None = None
        self._records: list[Record] = []
        self._probes: pictures.Probes = ()
        self._made: OrderedDict[str, _Made] = OrderedDict()

    def answer(self, request: Mapping[str, Any], tell: Tell, show: Show) -> documents.Document:
        """Carry out a request.

        Parameters
        ----------
        request : mapping
            `do`, the files, and the further inputs of the task.
        tell : callable
            Gets the share of the work done and the present step.
        show : callable
            Gets the progress of an addition.

        Raises
        ------
        GatewayError
            One line for the page.
        """
        if request["do"] == "look":
            files = Files.of(request["files"])
            return {"tables": [looked(Path(t), files.of_table(k)) for k, t in enumerate(files.tables[:MOST_LOOKED])]}
        if request["do"] == "open":
            return self._open(request["files"], Path(request["folder"]), tell, request.get("kept"))
        files = Files.of(request["files"])
        if files != self._files:
            self._read(files, Path(request["folder"]), tell)
        if request["do"] == "track":
            return self._track(request)
        moving = Moving(tell)
        with heard(moving.beat):
            return self._model(request, moving.step, show)

    def _model(self, request: Mapping[str, Any], tell: Tell, show: Show) -> documents.Document:
        """Carry out a request about a model."""
        text = request["text"]
        match request["do"]:
            case "compare":
                return self._compare(text, request["name"], Path(request["folder"]), tell)
            case "diagnose":
                return self._diagnose(text, tell)
            case "add":
                return self._add(text, request["words"], bool(request.get("force")), tell, show)
            case "report":
                return self._report(request, Path(request["folder"]), tell)
        raise UsageError(f"no such task: {request['do']}")

    def _read(self, files: Files, folder: Path, tell: Tell) -> list[tuple[Columns, float]]:
        """Read the files; return the rows of each, and its beginning on their clock, s."""
        self._files = None
        rows: list[Columns] = []
        model = read_model(Path(files.model))
        whole, own = parse_columns(files.columns), dict(enumerate(files.each))
        read = read_measurements(
            [Path(t) for t in files.tables],
            model=model,
            config=Path(files.config) if files.config else None,
            string=files.string or None,
            columns=[{**whole, **parse_columns(own.get(k, ()))} for k in range(len(files.tables))],
            reading=Reading(
                uploaded=Path(files.config).parent == folder,
                tell=lambda name, share: tell(READING * share, f"reading {name}"),
                most=MOST_NUMBERS,
                seen=rows.append,
            ),
        )
        # readers of the result do not know the folder of an upload
        self._records = [replace(r, source=_named(r.source, folder)) for r in read]
        self._files, self._filed = files, model
        self._made.clear()
        begun = [(x, float(r.instants[0])) for x, r in zip(rows, self._records, strict=True)]
        self._probes = pictures.probes_of([measured(r, model) for r in self._records], begun)
        return begun

    def _open(
        self, named: Mapping[str, Any], folder: Path, tell: Tell, kept: Mapping[str, Any] | None
    ) -> documents.Document:
        files, told = _taken(named, folder, tell)
        files, proposed = _made(files, folder, tell)
        rows = self._read(Files.of(files), folder, tell)
        assert self._filed is not None  # noqa: S101 - read just now
        findings, notes = findings_and_notes(self._filed, self._records)
        notes += tuple((files["tables"][-1], text) for text in (*told, *proposed))
        opened = Files.of(files)
        told_of = [
            {**about(Path(t), opened.of_table(k), r), "heard": _heard(rows[k][0], r)}
            for k, (t, r) in enumerate(zip(opened.tables, self._records, strict=True))
        ]
        document = documents.opened(self._filed, self._records, findings, notes, told_of)
        document["text"] = Path(files["model"]).read_text(encoding="utf-8")
        shelf = Shelf(folder)
        document["figures"] = pictures.readings(
            [measured(r, self._filed) for r in self._records],
            shelf,
            rows,
            self._filed.flow,
        )
        shelf.save()
        now = digests(self._records, self._filed)
        document["recalled"], document["dropped"] = recalled(kept, now) if kept else ({}, "")
        return {**document, "files": files, "digest": now, "same": content_of(self._records)}

    def _track(self, request: Mapping[str, Any]) -> documents.Document:
        """Draw one more column of a table."""
        assert self._files is not None  # noqa: S101 - read by `answer`
        assert self._filed is not None  # noqa: S101
        k, shelf = int(request["record"]), Shelf(Path(request["folder"]))
        record, table = self._records[k], Path(self._files.tables[k])
        figure = track(table, self._files.of_table(k), request["column"], record, measured(record, self._filed), shelf)
        shelf.save()
        return {"figure": figure}

    def _of(self, text: str) -> _Made:
        """Return the results of this model; of more than `MOST_MADE` models, the one unused for longest is removed."""
        made = self._made.setdefault(text, _Made())
        self._made.move_to_end(text)
        if len(self._made) > MOST_MADE:
            self._made.popitem(last=False)
        return made

    def _comparison(self, text: str, *, kept: bool = True) -> Comparison:
        """Compare a model; `kept`: as the newest of those whose results are kept."""
        made, model = self._of(text) if kept else self._made.get(text, _Made()), parse_model(text)
        if made.comparison is None:
            findings, _ = findings_and_notes(model, self._records)
            long_enough(findings)
            made.comparison = compare(model, self._records)
        return made.comparison

    def _compare(self, text: str, name: str, folder: Path, tell: Tell) -> documents.Document:
        tell(READING, "fitting the numbers of the model")
        c, shelf = self._comparison(text), Shelf(folder)
        tell(0.8, "drawing")
        document = documents.compared(c, name)
        steps = [(name, c.refitted)]
        if name == REFITTED:  # the first model that is compared
            steps.insert(0, (FILED, c.filed))
        drawn = {
            name: pictures.step(v, shelf) | pictures.maps(v.fit, shelf) | whiteness.step(v.fit) for name, v in steps
        }
        fit = c.refitted.fit
        figures = pictures.frames_of_cores(c, shelf, self._probes) | pictures.frames_of_maps(fit.problem.records)
        figures |= whiteness.figures(fit)
        shelf.save()
        return {**document, "figures": figures, "drawn": drawn}

    def _diagnose(self, text: str, tell: Tell) -> documents.Document:
        told = self._of(text).told = examine(parse_model(text), self._records, tell)
        document, curves = documents.diagnosed(told)
        return {**document, "curves": curves}

    def _add(self, text: str, words: list[str], force: bool, tell: Tell, show: Show) -> documents.Document:
        addition, report = self._addition(text, words, force, tell, show)
        document = documents.added(report, addition, words)
        if report.written:
            top = "".join(f"# {line}\n" for line in heading(report, words).splitlines())
            document["text"] = top + format_model(addition.model)
            self._of(document["text"]).addition = addition, report
        return document

    def _addition(self, text: str, words: list[str], force: bool, tell: Tell, show: Show) -> tuple[Addition, AddReport]:
        model = parse_model(text)
        wants = asked_for(words, model)
        findings, notes = findings_and_notes(model, self._records)
        sound(findings)
        check_signals(wants, self._records)
        known = self._known(model)
        names = named_all(w.key for w in wants)
        trials, most = count(1), SHOWN_FITS if known else 0.1  # a search, where none was made, takes most of the time

        def shown(trial: dict[str, Any]) -> None:
            show({"names": names, "step": with_added(names), **trial})
            tell(most * (1.0 - 0.8 ** next(trials)), "fitting step by step")

        tell(0.0, "fitting step by step")
        approach(model, self._records, wants, known, shown)

        def ask(unfitted: StringModel, records: Sequence[Record], progress: Tell | None = None) -> Diagnosis:
            return known or diagnose(unfitted, records, progress=progress)

        tell(most, "searching for other explanations")
        addition = add_effects(
            model, self._records, wants, lambda share, what: tell(most + (1.0 - most) * share, what), ask
        )
        return addition, added_report(
            addition, self._records, findings, notes, out="the model on this page", force=force
        )

    def _known(self, model: StringModel) -> Diagnosis | None:
        """Return the diagnosis of a model before any data, if it was already made."""
        start = repr(model.unfitted)
        told = (m.told for text, m in self._made.items() if m.told and repr(parse_model(text).unfitted) == start)
        return next((t.diagnosis for t in told if t.diagnosis), None)

    def _earlier(self, steps: Sequence[Mapping[str, Any]], fit: MapFit) -> list[Shown]:
        """Return the models of steps that are ticked, for a report, if they have the same readings."""
        found = []
        for s in (s for s in steps if s["ticked"]):
            c = self._comparison(str(s["text"]), kept=False)
            v = c.filed if s["name"] == FILED else c.refitted
            if len(v.fit.y) == len(fit.y):  # a diagnosis leaves out records of which nothing can be learnt
                found.append(Shown.of(str(s["name"]), v, c.core.proven))
        return found

    def _told(self, text: str, tell: Tell) -> Told:
        """Return the diagnosis of a model; it is made again where another process made it, or this one forgot it."""
        made = self._of(text)
        if made.told is None:
            made.told = examine(parse_model(text), self._records, tell)
        return made.told

    def _report(self, request: Mapping[str, Any], folder: Path, tell: Tell) -> documents.Document:
        """Write the page that the commands write with --html: of the last diagnosis, addition or comparison.

        All of its content is computed from the models, so it is the same in a process that was started anew.
        """
        text, kind, command, remains = (str(request[k]) for k in ("text", "kind", "command", "remains"))
        steps, seen = list(request["steps"]), request["diagnosed"]
        command = _named(command, folder)
        tell(0.0, "writing the report")
        comparison = self._comparison(text)
        work = Work(request["told"], request["notes"])
        if seen is not None:
            told = self._told(seen["text"], lambda share, what: tell(0.6 * share, what))
            work = replace(work, told=told, tag=verdict_tag(told.diagnosis), of=seen["name"])
        with tempfile.NamedTemporaryFile(suffix=".html", prefix=".report-", dir=folder, delete=False) as file:
            path = Path(file.name)
        if kind == "diagnose":
            told = self._told(text, lambda share, what: tell(0.9 * share, what))
            details = details_of(told, parse_model(text), self._records, lambda: comparison)
            d = told.diagnosis
            earlier = self._earlier(steps[:-1], d.fits[0] if d else comparison.filed.fit)
            own = replace(details or Details(), earlier=earlier, work=work)
            write_diagnosis(path, told, own, command=command, step=str(steps[-1]["name"]))
        elif kind == "add":
            made, added = self._of(text), request["added"]
            if made.addition is None:
                made.addition = self._addition(
                    steps[-2]["text"],
                    added["words"],
                    added["force"],
                    lambda share, what: tell(0.6 + 0.3 * share, what),
                    lambda _: None,
                )
            addition, report = made.addition
            earlier = self._earlier(steps[:-2], addition.fits[0])
            road = Road(str(steps[-2]["name"]), earlier, _added(steps[1:-1]), work)
            write_addition(path, report, addition, command, remains, road)
        else:
            findings, notes = findings_and_notes(parse_model(text), self._records)
            write_comparison(path, comparison, Aside(comparison.sources, findings, notes, command, remains, work))
        return {"path": str(path)}


def _added(steps: Sequence[Mapping[str, Any]]) -> list[tuple[str, Sequence[Candidate]]]:
    """Return the name of each step after the first of these, and the effects that came with it."""
    models = [parse_model(str(s["text"])) for s in steps]
    found: list[tuple[str, Sequence[Candidate]]] = []
    for s, before, after in zip(steps[1:], models, models[1:], strict=False):
        there = {e.key for e in before.effects}
        new = [Candidate(effect_named(e.name), e.cell) for e in after.effects if e.key not in there]
        found.append((str(s["name"]), new))
    return found


def _heard(rows: Columns, record: Record) -> int:
    """Count the readings of a file at the cells that a record has."""
    return sum(int(np.isfinite(rows.surface_C[k]).sum()) for k in record.cells)


def _named(text: str, folder: Path) -> str:
    """Remove the folder of a tab's uploads from a text."""
    return text.replace(f"{folder}/", "")


def _taken(files: Mapping[str, Any], folder: Path, tell: Tell) -> tuple[dict[str, Any], list[str]]:
    """Write the requested part of the gateway's recent signals as one more table; return the files and notes."""
    recent, said = files.get("recent"), list[str]()
    if not recent or recent.get("table"):
        return dict(files), said
    tell(0.05, "taking the gateway's recent signals")
    seconds = given_span(recent["last"], "recent window")
    config, store = (Path(x) if x else None for x in (files.get("config"), recent.get("store")))
    names = ("recent.csv" if k == 1 else f"recent_{k}.csv" for k in count(1))
    out = next(path for name in names if not (path := folder / name).exists())
    directory = state_directory(config, store, "recent window")
    write_recent(out, directory, Stretch(seconds), files.get("string") or None, "recent window", said.append)
    return {**files, "tables": [*files["tables"], str(out)], "recent": {**recent, "table": str(out)}}, said


def _made(files: dict[str, Any], folder: Path, tell: Tell) -> tuple[dict[str, Any], list[str]]:
    """Make the model and the config that were described instead of named; return them with notes."""
    if not files.get("dbc") and (files.get("model") or not files.get("form")):
        return files, []
    from bms_gateway.workbench.form import with_config, with_model  # the room of `init` comes when it is needed

    tell(0.1, "finding the signals of the log" if files.get("dbc") else "writing the model")
    files, said = with_config(files, folder)
    return with_model(files, folder), said
