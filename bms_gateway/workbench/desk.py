"""State of one tab: open files, the models from the first to the newest, the running task; it never computes.

Everything that the page shows is in `state`. A thread that waits for a change waits for a new `version`. Each tab has
its own desk.
"""

import threading
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from bms_gateway.errors import UsageError, did_you_mean
from bms_gateway.report.step_names import FILED, REFITTED
from bms_gateway.workbench.beside import Beside, place_of, with_others
from bms_gateway.workbench.busy import TITLES, BusyError
from bms_gateway.workbench.commands import Leg, by_name, command_lines, config_lines, files_read, told_of_model
from bms_gateway.workbench.process import Worker
from bms_gateway.workbench.session import Addition, SessionRest, session_of
from bms_gateway.workbench.shared import Shared
from bms_gateway.workbench.steps import (
    TABLES,
    Frame,
    Window,
    doubt_lines,
    forget,
    joined,
    newest_diagnosed,
    recalled_of,
    reported,
    steps_of,
    way_of,
)
from bms_gateway.workbench.task_request import TaskRequest
from bms_gateway.workbench.uploads import Uploads

Document = dict[str, Any]
GONE = "the computing process ended unexpectedly (the terminal says why); try again, a fresh one is started"
REPORT_S = 600.0
LOOK_S = 120.0
"""Time to wait for a look at tables before the next task; a busy machine takes half a minute for four."""


class Desk:
    """See the module's text.

    Parameters
    ----------
    name : str
        Identifier of the tab.
    shared : Shared, optional
        Answers of all tabs; without it everything is computed here.
    """

    def __init__(self, name: str, shared: Shared | None = None) -> None:
        self.name = name
        self._request = TaskRequest(self, shared)
        self.changed = threading.Condition()
        self.version = 0
        self.uploads = Uploads()
        self.files: Document | None = None
        self._opened: Document | None = None
        self._looked: Document | None = None
        self._frames: list[Frame] = []
        self._notes = ""
        self._tracks: dict[str, Document] = {}
        self._job: Document | None = None
        self._refusal: Document | None = None
        self._error = ""
        self._report: Path | None = None
        self._to_resume = SessionRest()
        self._fitting: tuple[int, Document] = (0, {})
        self._closed = False
        self._worker = Worker(self._hear)
        import_module("bms_gateway.workbench.measures")  # NumPy is loaded while the worker starts, not with the program

    @property
    def folder(self) -> Path:
        """Folder of its uploads."""
        return self.uploads.folder

    @property
    def awake(self) -> bool:
        """Whether it has a process, which takes a hundred megabytes."""
        return self._worker.alive

    def rest(self) -> bool:
        """End its process if it is idle; the work is kept, and the next task starts another process."""
        with self.changed:
            if self._job is not None or self._closed:
                return False
            worker = self._worker
        worker.end()
        return True

    def close(self) -> None:
        """End its process, and delete its uploads."""
        with self.changed:
            self._closed = True
            self._request.leave()
            worker = self._worker
            self._told()
        worker.end()
        self.uploads.close()

    # what the page asks for

    def open(self, files: Document, kept: Document | None = None) -> None:
        """Read files anew; the present content stays until they are read; `kept`: diagnoses of a session."""
        if not files["tables"] and not files.get("recent"):
            raise UsageError("open: choose a table or a log first, or the gateway's recent window")
        if not files["model"] and not files.get("form") and not files.get("dbc"):
            raise UsageError("open: choose a model file first (TOML, as for compare --model), or describe the cell")
        before = (self.files or {}).get("recent")
        if not files.get("recent") and before and before["table"] in files["tables"]:
            files = {**files, "recent": before}  # still the one that was taken
        self._start("open", {"files": files, "kept": kept})

    def look(self, files: Document) -> None:
        """Look at the tables: their columns and possible meaning; the open files are kept."""
        if not files["tables"]:
            raise UsageError("look: choose a table first")
        self._start("look", {"files": files})

    def resume(
        self, files: Document, additions: Sequence[Addition], notes: str = "", kept: Document | None = None
    ) -> None:
        """Open the files of a session and repeat its additions one after the other, until one is refused.

        Its diagnoses are shown again with their models, if records and model are the same.
        """
        self.cancel()
        self.open(files, kept)
        with self.changed:
            self._to_resume.to_come, self._to_resume.going = list(additions), True
            self._notes = notes

    def note(self, notes: str) -> None:
        """Store a person's notes, also while a task runs."""
        with self.changed:
            self._notes = notes
            self._told()

    def compare(self) -> None:
        """Compare the newest model with the readings."""
        self._start("compare", {"files": self.files, "text": self._top.text, "name": self._top.label})

    def diagnose(self) -> None:
        """Find what the newest model lacks."""
        self._start("diagnose", {"files": self.files, "text": self._top.text})

    def add(self, words: list[str], *, force: bool = False) -> None:
        """Add effects to the newest model."""
        if not words:
            raise UsageError("add: name an effect of the catalogue")
        self._start("add", {"files": self.files, "text": self._top.text, "words": words, "force": force})

    def undo(self) -> None:
        """Go back to the model before the last addition; a refused addition is discarded."""
        with self.changed:
            self._refuse_if_busy()
            if self._refusal is None and len(self._frames) < 2:
                raise UsageError("undo: nothing has been added")
            if self._refusal is None:
                self._frames.pop()
            self._refusal, self._error = None, ""
            self._told()

    def cancel(self) -> None:
        """End the running task."""
        with self.changed:
            self._to_resume.abandon()
            if self._job is None:
                return
            self._job, self._error = None, ""
            self._request.leave()
            worker, self._worker = self._worker, Worker(self._hear)
            self._told()
        worker.end()

    def confirm(self) -> None:
        """Compute here what is only read from a session file: each diagnosis of it, one after the other."""
        if (frame := recalled_of(self._frames)) is not None:
            self._start("diagnose", {"files": self.files, "text": frame.text})
            self._to_resume.confirming = True

    def report(self, ticked: Sequence[int] | None = None) -> Path:
        """Write the report of the shown content, and wait for it; `ticked`: places of the steps that it draws.

        It contains nothing but notes that is only read from a session file: diagnoses are computed here first.

        Raises
        ------
        UsageError
            It cannot be written.
        """
        with self.changed:
            self.confirm()
            self.changed.wait_for(lambda: self._job is None, REPORT_S)
            if recalled_of(self._frames) is None:
                told = reported(self._top, self._frames, ticked, self._notes)
                command = command_lines(self._named() or {}, self._way())[-1]
                self._start("report", {"files": self.files, "command": command, **told})
                self.changed.wait_for(lambda: self._job is None, REPORT_S)
            path, self._report = self._report, None
            if path is None:
                raise UsageError(self._error or "the report was not written: it was cancelled")
        return path

    def session(self) -> Document:
        """Return files by name, additions to the model, and notes: the input of `resume`."""
        with self.changed:
            files = self._named()
            if files is None:
                raise UsageError("session: open a table and a model first")
            return self._session(files)

    def model(self) -> str:
        """Return the newest model file, with the doubts about it at its head."""
        with self.changed:
            text = self._top.text
            said = (f"# {line}\n" for line in doubt_lines(self._frames))
            return "".join(line for line in said if line not in text) + text

    def track(self, record: int, column: str) -> None:
        """Read one more column of a record's table, to be drawn as a separate track."""
        records = (self._opened or {}).get("records", [])
        if not 0 <= record < len(records):
            raise UsageError(f"track: there is no record {record + 1}")
        names = [c["name"] for c in records[record]["others"]]
        if column not in names:
            raise UsageError(f"track: the table has no column '{column[:80]}'{did_you_mean(column, names)}")
        name = f"track-{record}-{names.index(column)}"
        with self.changed:
            if name in self._tracks:
                return
        self._start("track", {"files": self.files, "record": record, "column": column, "name": name})

    def figure(self, name: str, window: Window | None = None, beside: Beside | None = None) -> Document | None:
        """Return a figure with the curves of each step, whole or in a window of its axis; None if there is none."""
        found = self._whole(name, beside)
        if found is None:
            return None
        from bms_gateway.workbench.series import drawn

        try:
            return dict(drawn(found, self.folder, window))
        except FileNotFoundError:  # other files were opened meanwhile: the page is told, and asks again
            return None

    def measures(
        self, names: Sequence[str], window: Window | None, at: Window | None, beside: Beside | None = None
    ) -> list[Document]:
        """Measure every curve of some figures: at two cursors, and in a window; see `measured_in`."""
        found = [f for f in (self._whole(name, beside) for name in names) if f is not None]
        from bms_gateway.workbench.measures import measured_in

        try:
            return [one for f in found for one in measured_in(f, self.folder, window, at)]
        except FileNotFoundError:  # as above
            return []

    def _whole(self, name: str, beside: Beside | None) -> Document | None:
        """Return a figure with keys of its series instead of numbers, and with other records if requested."""
        with self.changed:
            own = self._parts(name)
            if own is None:
                return None
            records = (self._opened or {}).get("records", [])
            shown = next((int(p) for p in name.split("-")[1:2] if p.isdecimal()), 0)
            others = []
            for r in beside.records if beside else ():
                place = place_of(name, r)
                if beside is None or place is None or r == shown or r >= len(records):
                    continue
                parts, shift = self._parts(place), beside.shift_s(records, shown, r)
                if parts is not None and shift is not None:
                    others.append((r, parts, shift))
        figure, steps = own
        spans = [x for _, (f, of_steps), _ in others for x in (f, *(d for _, _, d in of_steps))]
        found = joined(figure, steps, spans)
        laid = [
            (r, Path(records[r]["source"]).name, {**joined(f, of_steps), "seconds": f["seconds"]}, shift)
            for r, (f, of_steps), shift in others
        ]
        return with_others(found, figure, laid)

    def _parts(self, name: str) -> tuple[Document, list[tuple[str, bool, Document]]] | None:
        """Find a figure, and the curves of each step in it."""
        figure = (self._opened or {}).get("figures", {}).get(name) or self._tracks.get(name)
        if figure is None and self._frames:
            figure = self._frames[0].figures.get(name)
        if figure is None:
            return None
        return figure, [
            (step, bool(step != FILED and f.compared and f.compared["core"]["proven"]), own[name])
            for f in self._frames
            for step, own in f.drawn.items()
            if name in own
        ]

    def curves(self, name: str) -> Document | None:
        """Return the curves of an effect of the last diagnosis."""
        with self.changed:
            frame = newest_diagnosed(self._frames)
            return frame.curves.get(name) if frame else None

    def fitting(self, name: str) -> Document | None:
        """Return the present curves of a figure during an addition; None if there is none."""
        with self.changed:
            return self._fitting[1].get(name) if (self._job or {}).get("trial") else None

    def state(self) -> Document:
        """Return all that the page shows, with figures and curves by name only."""
        with self.changed:
            top, files = (self._frames[-1] if self._frames else None), self._named()
            first = self._frames[0] if self._frames else None
            opened = {
                k: v for k, v in (self._opened or {}).items() if k not in ("figures", "text", "digest", "same")
            } or None
            seen = newest_diagnosed(self._frames)
            shown = [*(first.figures if first else {}), *((self._opened or {}).get("figures", {}))]
            return {
                "version": self.version,
                "files": files,
                "opened": opened,
                "looked": self._looked,
                "steps": steps_of(self._frames),
                "compared": {k: v for k, v in top.compared.items() if k not in ("variants", *TABLES)}
                if top and top.compared
                else None,
                "figures": list(dict.fromkeys(shown)),
                "tracks": list(self._tracks),
                "diagnosed": seen.diagnosed if seen else None,
                "diagnosed_of": seen.label if seen and seen is not top else None,
                "refusal": self._refusal,
                "job": self._job,
                "error": self._error,
                "session": self._session(files) if files else None,
                "dropped": self._to_resume.dropped,
                "resuming": self._to_resume.going,
                "commands": command_lines(files, self._way()) if files else [],
                "model_told": told_of_model(files, self._way()) if files else "",
                "config": config_lines(files, len(self._frames) - 1) if files else "",
                "read": files_read(self.files, self.folder) if self.files else [],
            }

    # inside

    @property
    def _top(self) -> Frame:
        if not self._frames:
            raise UsageError("open a table and a model first")
        return self._frames[-1]

    def _named(self) -> Document | None:
        """Return the open files with names for people."""
        return None if self.files is None else by_name(self.files, self.folder)

    def _session(self, files: Document) -> Document:
        return session_of(files, self._frames, self._notes, (self._opened or {}).get("digest"))

    def _way(self) -> list[Leg]:
        return way_of(self._frames, (self._opened or {}).get("checks", []))

    def _refuse_if_busy(self) -> None:
        if self._job is not None:
            raise BusyError(self._job["title"])

    def _start(self, kind: str, request: Document) -> None:
        with self.changed:
            # a look takes a moment, and no user waits for it
            self.changed.wait_for(lambda: (self._job or {}).get("kind") != "look", LOOK_S)
            self._refuse_if_busy()
            if self._closed:
                raise UsageError("this tab was open too long ago: reload the page")
            self._job = {"kind": kind, "title": TITLES[kind], "share": 0.0, "text": ""}
            self._error = ""
            content = {"do": kind, "folder": str(self.folder), **request}
            self._request.start(content, (self._opened or {}).get("same", ""))
            if not self._request.waits:
                self._compute()
            self._told()

    def _compute(self) -> None:
        """Have the own process carry out the request."""
        self._request.waits = False
        if not self._worker.alive:
            self._worker = Worker(self._hear)
        self._worker.ask(self._request.content)

    def hear_shared(self, key: str, answer: Document | None) -> None:
        """Use another tab's answer to the same request; None: this tab must now compute it."""
        with self.changed:
            if not self._request.has(key) or self._job is None or self._closed:
                return
            if answer is None:
                self._compute()
                return
            self._heard(answer)
            self._told()

    def _hear(self, worker: Worker, answer: Document | None) -> None:
        with self.changed:
            if worker is not self._worker or self._closed or self._request.waits:
                return  # from a process that was replaced, or that has no task
            if answer is not None and self._job is not None:
                self._request.answered(answer, self.folder)
            if answer is None:  # the next task starts another: now it might end in the same way at once
                self._to_resume.abandon()
                self._request.leave()
                if self._job is None:
                    return
                self._job, self._error = None, GONE
            elif self._job is None:
                return
            else:
                self._heard(answer)
            self._told()

    def _heard(self, answer: Document) -> None:
        if "error" in answer:
            self._to_resume.abandon()
            self._job, self._error = None, answer["error"].replace(f"{self.folder}/", "")
            asked = self._request.content
            if asked["do"] == "open" and self._looked is None and asked["files"]["tables"]:
                told = self._error  # it may ask for what only the table of the columns can say
                self.look(asked["files"])
                self._error = told
        elif "done" in answer:
            self._job = None
            self._take(self._request.content, answer["done"])
        else:  # progress, in words or in errors and curves
            trial = answer.get("trial", {})
            if "curves" in trial:
                self._fitting = self._fitting[0] + 1, trial.pop("curves")
            if trial:
                trial["picture"] = self._fitting[0]
            self._job = {**(self._job or {}), **answer}

    def _take(self, request: Mapping[str, Any], done: Document) -> None:
        match request["do"]:
            case "look":
                self._looked = {**done, "files": by_name(request["files"], self.folder)}
            case "open":
                self._to_resume.recalled, self._to_resume.dropped = done.pop("recalled"), done.pop("dropped")
                self.files, self._opened, self._refusal = done.pop("files"), done, None
                first = Frame(done["text"], REFITTED, diagnosed=self._to_resume.diagnosed(0))
                self._frames, self._tracks = [first], {}
                forget(self.folder, [d["kept"]["file"] for f in done["figures"].values() for d in f["data"]])
                self.compare()
            case "compare":
                top = self._top
                top.figures, top.drawn = done.pop("figures"), done.pop("drawn")
                top.compared = done
                if top.diagnosed and top.diagnosed.get("recalled"):  # of a file that anybody may have changed
                    top.diagnosed = {**top.diagnosed, "core": done["core"]}
                if self._to_resume.to_come:
                    words, force = self._to_resume.to_come.pop(0)
                    self.add(words, force=force)
                else:
                    self._to_resume.going = False
            case "diagnose":
                self._found(request["text"], done)
            case "add":
                self._added(done)
            case "track":
                self._tracks[request["name"]] = done["figure"]
            case "report":
                self._report = Path(done["path"])

    def _found(self, text: str, done: Document) -> None:
        frame = next(f for f in reversed(self._frames) if f.text == text)
        frame.curves = done.pop("curves")
        frame.diagnosed, self._to_resume.dropped = done, ""
        if self._to_resume.confirming:
            self._to_resume.confirming = False
            self.confirm()

    def _added(self, done: Document) -> None:
        text = done.pop("text", None)
        if text is None:
            self._refusal = done
            self._to_resume.abandon()
            return
        self._refusal = None
        frame = Frame(text, done["step"], done["words"], done["forced"], done)
        frame.diagnosed = self._to_resume.diagnosed(len(self._frames))
        self._frames.append(frame)
        self.compare()

    def _told(self) -> None:
        self.version += 1
        self.changed.notify_all()
