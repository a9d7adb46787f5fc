"""Answers that several tabs ask for: the first of them computes, the others wait for it and get the same.

Two requests are one where records, model, step and words are the same, however the files are called and wherever they
lie. A tab that cancels what others wait for leaves the work to the next of them.
"""

import hashlib
import json
import os
import re
import shutil
import threading
import traceback
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Final, Protocol

from bms_gateway.workbench.steps import SERIES
from bms_gateway.workbench.uploads import own_folder

Document = dict[str, Any]
KINDS: Final = ("compare", "diagnose", "add", "report")
"""Tasks that are shared: all that fit."""
MOST_BYTES: Final = 512 << 20
"""Of the answers that are kept for others, with their series; of more the oldest go."""
_SERIES: Final = re.compile(rf"{re.escape(SERIES)}\w+\.npz")


class Tab(Protocol):
    """Who waits for an answer."""

    @property
    def folder(self) -> Path:
        """Where the files of an answer are to lie."""

    def hear_shared(self, key: str, answer: Document | None) -> None:
        """Take what another tab's process says; None: it ended, and the work is this tab's own now."""


def key_of(request: Mapping[str, Any], same: str) -> str:
    """Name a request by its content; empty where it is not shared.

    Parameters
    ----------
    request : mapping
    same : str
        Digest of the records that are open; empty where none are.
    """
    if not same or request["do"] not in KINDS:
        return ""
    content = {k: x for k, x in request.items() if k not in ("files", "folder")}
    return hashlib.sha256(json.dumps([same, content], sort_keys=True).encode()).hexdigest()


@dataclass(slots=True)
class _Work:
    owner: Tab
    waiting: list[Tab] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class _Answer:
    text: str
    files: tuple[str, ...]
    size: int


class Shared:
    """See the module's text. Waiting tabs are told by a thread of this object, one answer after the other."""

    def __init__(self) -> None:
        self._home: tuple[Path, int] | None = None  # made when there is something to keep
        self._lock = threading.Lock()
        self._work: dict[str, _Work] = {}
        self._kept: OrderedDict[str, _Answer] = OrderedDict()
        self._told: SimpleQueue[tuple[Tab, str, str | None, tuple[str, ...]] | None] = SimpleQueue()
        self._thread: threading.Thread | None = None

    @property
    def _folder(self) -> Path:
        if self._home is None:
            self._home = own_folder()
        return self._home[0]

    def _put(self, tab: Tab, key: str, text: str | None, files: tuple[str, ...] = ()) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._tell, daemon=True)
            self._thread.start()
        self._told.put((tab, key, text, files))

    def ask(self, key: str, tab: Tab) -> bool:
        """Say whether a tab is to compute itself; otherwise it hears the answer of another one."""
        with self._lock:
            if (found := self._kept.get(key)) is not None:
                self._kept.move_to_end(key)
                self._put(tab, key, found.text, found.files)
                return False
            if (work := self._work.get(key)) is not None:
                work.waiting.append(tab)
                return False
            self._work[key] = _Work(tab)
            return True

    def answered(self, key: str, answer: Document, folder: Path) -> None:
        """Pass on what the process of the tab that computes says; what is done is kept for those who ask later."""
        ended = "done" in answer or "error" in answer
        with self._lock:
            if not ended and not (key in self._work and self._work[key].waiting):
                return  # nobody follows its progress
        text = json.dumps(answer)
        files = tuple(sorted(set(_SERIES.findall(text))))
        if "path" in answer.get("done", {}):
            files = (*files, Path(answer["done"]["path"]).name)
        with self._lock:
            if "done" in answer:
                self._keep(key, text, files, folder)
            work = self._work.pop(key, None) if ended else self._work.get(key)
            for tab in work.waiting if work else ():
                self._put(tab, key, text, files)

    def leave(self, key: str, tab: Tab) -> None:
        """Let a tab go; where it computed, the work is that of the next one who waits."""
        with self._lock:
            work = self._work.get(key)
            if work is None:
                return
            if work.owner is not tab:
                work.waiting = [t for t in work.waiting if t is not tab]
            elif work.waiting:
                work.owner = work.waiting.pop(0)
                self._put(work.owner, key, None)
            else:
                del self._work[key]

    def close(self) -> None:
        """Throw everything away."""
        self._told.put(None)
        with self._lock:
            if self._home is not None:
                shutil.rmtree(self._home[0], ignore_errors=True)
                os.close(self._home[1])
            self._home = None
            self._kept.clear()

    def _keep(self, key: str, text: str, files: tuple[str, ...], folder: Path) -> None:
        size = len(text)
        for name in files:
            with suppress(OSError):  # the tab went meanwhile: those who wait compute themselves
                _linked(folder / name, self._folder / name)
                size += (self._folder / name).stat().st_size
        self._kept[key] = _Answer(text, files, size)
        total = sum(a.size for a in self._kept.values())
        while total > MOST_BYTES and len(self._kept) > 1:
            _, old = self._kept.popitem(last=False)
            total -= old.size
            for name in old.files:
                (self._folder / name).unlink(missing_ok=True)

    def _tell(self) -> None:
        while (one := self._told.get()) is not None:
            tab, key, text, files = one
            answer = None if text is None else json.loads(text)
            try:
                for name in files:
                    _linked(self._folder / name, tab.folder / name)
            except OSError:  # what was kept has gone, or the tab has
                answer = None
            if answer and "path" in answer.get("done", {}):
                answer["done"]["path"] = str(tab.folder / files[-1])
            try:
                tab.hear_shared(key, answer)
            except Exception:  # noqa: BLE001 - a fault of one tab: the others wait for theirs
                traceback.print_exc()


def _linked(source: Path, to: Path) -> None:
    """Have a file in one more place, without a second copy where the disk can do so."""
    if to.exists():
        return
    try:
        os.link(source, to)
    except OSError:
        shutil.copyfile(source, to)
