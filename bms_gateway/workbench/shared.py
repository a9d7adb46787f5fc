"""Answers for several tabs: the first one computes, the others wait and get the same answer.

Two requests are equal if records, model, step and words are the same, for any names and places of the files. If a tab
cancels work for which others wait, the next of them takes it over.
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
"""Shared tasks: all tasks that fit."""
MOST_BYTES: Final = 512 << 20
"""Size of the answers that are kept for others, with their series; beyond it, the oldest are removed."""
_SERIES: Final = re.compile(rf"{re.escape(SERIES)}\w+\.npz")


class Tab(Protocol):
    """A tab that waits for an answer."""

    @property
    def folder(self) -> Path:
        """Folder for the files of an answer."""

    def hear_shared(self, key: str, answer: Document | None) -> None:
        """Use the answer of another tab's process; None: that process ended, and this tab must compute."""


def key_of(request: Mapping[str, Any], same: str) -> str:
    """Return the key of a request by its content; empty if it is not shared.

    Parameters
    ----------
    request : mapping
    same : str
        Digest of the open records; empty if none are open.
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
    """See the module's text. A thread of this object informs waiting tabs, one answer after the other."""

    def __init__(self) -> None:
        self._home: tuple[Path, int] | None = None  # made when there is something to store
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
        """Return whether a tab must compute itself; otherwise it gets the answer of another one."""
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
        """Pass on the answer of the computing tab's process; final answers are kept for later requests."""
        ended = "done" in answer or "error" in answer
        with self._lock:
            if not ended and not (key in self._work and self._work[key].waiting):
                return  # no other tab follows its progress
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
        """Remove a tab; if it computed, the next waiting tab takes over the work."""
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
        """Delete everything."""
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
            with suppress(OSError):  # the tab was closed meanwhile: waiting tabs compute themselves
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
            except OSError:  # the stored answer is deleted, or the tab is closed
                answer = None
            if answer and "path" in answer.get("done", {}):
                answer["done"]["path"] = str(tab.folder / files[-1])
            try:
                tab.hear_shared(key, answer)
            except Exception:  # noqa: BLE001 - a fault of one tab: the others wait for theirs
                traceback.print_exc()


def _linked(source: Path, to: Path) -> None:
    """Link a file at one more place, without a second copy if the disk allows it."""
    if to.exists():
        return
    try:
        os.link(source, to)
    except OSError:
        shutil.copyfile(source, to)
