"""Content for all tabs: their desks, the files of the command line, uploads, the live pack."""

import secrets
import threading
from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bms_gateway.errors import UsageError
from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.shared import Shared
from bms_gateway.workbench.uploads import safe_name

if TYPE_CHECKING:  # the engine: only the live page needs it
    from bms_gateway.workbench.live_estimates import Watch

MOST_AWAKE: Final = 6
"""Number of tabs with a process. Beyond it, tabs unused for longest keep their work and lose their process until
needed."""
MOST_DESKS: Final = 40
"""Number of tabs whose work is kept; beyond it, the one unused for longest is removed."""
WARM_S: Final = 8.0
"""Time after the opening of a tab at which the process of the next one is started."""
EXAMPLE: Final = ("example: bench.csv.gz", "example: bench.toml")
"""Names of the example's files on the page."""
FORM: Final = ("cell", "cells", "sensors", "flow", "medium")
LONGEST_ENTRY: Final = 200
Stamp = tuple[str, int, int]
"""A file, its last change, ns, and its size: a difference means that it has changed."""


@dataclass(slots=True)
class Site:
    """What the page serves.

    Attributes
    ----------
    given : dict or None
        Files of the command line; every new tab opens them.
    watch : Watch or None
        The live pack, or a log being played.
    local : bool
        Bound to this machine only: the page may then open files by their path.
    grafana : str
        Address of the fleet's dashboard, from `dashboard_address`; empty if there is none.
    """

    given: dict[str, Any] | None = None
    watch: "Watch | None" = None
    local: bool = True
    grafana: str = ""
    desks: "OrderedDict[str, Desk]" = field(default_factory=OrderedDict)
    lock: threading.Lock = field(default_factory=threading.Lock)
    shared: Shared = field(default_factory=Shared)
    spare: Desk | None = None
    ahead: "list[Stamp] | None" = None
    closing: bool = False

    def warm(self, *, ahead: bool = False) -> None:
        """Prepare a desk for the next tab, with a process that has loaded its modules.

        Parameters
        ----------
        ahead : bool
            Whether it opens the files of the command line already before the browser connects.
        """
        with self.lock:
            if self.spare is None and not self.closing:
                self.spare = Desk(secrets.token_urlsafe(12), self.shared)
                if ahead and self.given is not None and not self.given.get("recent"):
                    self.ahead = _stamps(self.given)
                    self.spare.open(self.given)

    def new_desk(self) -> Desk:
        """Open a desk for a tab, with the files of the command line.

        Raises
        ------
        UsageError
            The program is ending and could not close it.
        """
        with self.lock:
            if self.closing:
                raise UsageError("the workbench is ending")
            desk, self.spare = self.spare or Desk(secrets.token_urlsafe(12), self.shared), None
            opened, self.ahead = self.ahead, None
            self.desks[desk.name] = desk
            old = [self.desks.popitem(last=False)[1] for _ in range(len(self.desks) - MOST_DESKS)]
        for one in old:
            one.close()
        self._rest()
        if self.given is not None and (opened is None or opened != _stamps(self.given)):
            desk.cancel()  # changed files are read anew
            desk.open(self.given)
        later = threading.Timer(WARM_S, self.warm)  # not now: it would take the processor from this tab
        later.daemon = True
        later.start()
        return desk

    def desk(self, name: str) -> Desk:
        """Find a tab's desk.

        Raises
        ------
        UsageError
        """
        with self.lock:
            if name not in self.desks:
                raise UsageError("this tab is not known (any more): reload the page")
            self.desks.move_to_end(name)
            found = self.desks[name]
        self._rest()
        return found

    def _rest(self) -> None:
        """Let the tabs unused for longest rest, if they are idle."""
        with self.lock:
            awake = [desk for desk in self.desks.values() if desk.awake]
        for desk in awake[: max(len(awake) - MOST_AWAKE, 0)]:
            desk.rest()

    def close(self) -> None:
        """End every process and stream."""
        with self.lock:
            self.closing = True
            all_of_them = [*self.desks.values(), *([self.spare] if self.spare else [])]
            self.desks.clear()
            self.spare = None
        for desk in all_of_them:
            desk.close()
        self.shared.close()
        if self.watch is not None:
            self.watch.signals.close()


def _stamps(given: dict[str, Any]) -> list[Stamp]:
    found = []
    for name in filter(None, (*given["tables"], given["model"], given["config"])):
        with suppress(OSError):  # reading it will report it
            told = Path(name).stat()
            found.append((name, told.st_mtime_ns, told.st_size))
    return found


def wanted_files(site: Site, desk: Desk, body: dict[str, Any]) -> dict[str, Any]:
    """Find files by name: uploaded ones, those of the command line, and by path on this machine only.

    Raises
    ------
    UsageError
    """

    def one(name: object) -> str:
        if not isinstance(name, str):
            raise UsageError("open: a file's name must be text")
        if not name.isprintable():  # for example NUL and half of a surrogate pair: no file has such a name
            raise UsageError(f"open: {name!a}: a file's name must be printable")
        uploaded = desk.folder / safe_name(name)
        if name and name == uploaded.name and uploaded.is_file():
            return str(uploaded)
        if name in EXAMPLE:
            return _shipped(name)
        given = site.given or {}
        if not name or name in (*given.get("tables", ()), given.get("model"), given.get("config")):
            return name
        if not site.local and name not in map(_shipped, EXAMPLE):
            raise UsageError(f"open: {name}: upload it; paths are taken only on the machine itself")
        return name

    tables, columns, dbc = body.get("tables", ""), body.get("columns") or [], body.get("dbc") or []
    each = body.get("each") or []
    if not isinstance(each, list) or not all(isinstance(x, list) and all(isinstance(c, str) for c in x) for x in each):
        raise UsageError("open: each must be lists of columns, one for each table")
    lists = isinstance(tables, list) and isinstance(columns, list) and isinstance(dbc, list)
    if not lists or not all(isinstance(c, str) for c in columns):
        raise UsageError("open: tables, columns and dbc must be lists")
    config = one(body.get("config") or "")
    return {
        "tables": [one(t) for t in tables],
        "model": one(body.get("model") or ""),
        "config": config,
        "recent": _recent(site, body, config),
        "string": str(body.get("string") or ""),
        "columns": columns,
        "each": each,
        "dbc": [one(d) for d in dbc],
        "form": None if body.get("model") else _form(body.get("form")),
    }


def session_files(site: Site, desk: Desk, files: dict[str, Any]) -> dict[str, Any]:
    """Find the files of a session, perhaps of another machine: if a path is missing here, an upload of that name.

    Raises
    ------
    UsageError
        The message names the files that are neither here nor uploaded.
    """
    given, missing = site.given or {}, list[str]()
    known = {*EXAMPLE, *given.get("tables", ()), given.get("model"), given.get("config")}

    def one(name: object) -> object:
        if not isinstance(name, str) or not name or not name.isprintable() or name in known:
            return name  # `wanted_files` reports wrong ones
        uploaded = safe_name(name)
        beside = bool(uploaded) and (desk.folder / uploaded).is_file()
        if beside and not (site.local and "/" in name and Path(name).is_file()):
            return uploaded
        if not site.local or not Path(name).is_file():
            missing.append(uploaded or name)
        return name

    found: dict[str, Any] = {}
    for k in ("tables", "model", "config", "dbc"):
        named = files.get(k) or ""
        found[k] = [one(x) for x in named] if isinstance(named, list) else one(named)
    if missing:
        names = " and ".join(filter(None, (", ".join(missing[:-1]), missing[-1])))
        lie = "it lies" if len(missing) == 1 else "they lie"
        raise UsageError(f"session: upload {names} too: {lie} on another machine, or under another name")
    return {**files, **found}


def _shipped(name: str) -> str:
    """Find a file of the example."""
    from bms_gateway.config.dbc_files import shipped  # not with the program: it takes a second

    return str(shipped(f"deploy/worked/{name.removeprefix('example: ')}"))


def _form(form: object) -> dict[str, str] | None:
    """Check a person's entries on the cell and the string."""
    if not form:
        return None
    if not isinstance(form, dict) or not all(isinstance(v, str) and len(v) < LONGEST_ENTRY for v in form.values()):
        raise UsageError("open: the form must be texts by name")
    return {k: form[k] for k in FORM if form.get(k)} or None


def _recent(site: Site, body: dict[str, Any], config: str) -> dict[str, str] | None:
    """Check a request for the gateway's recent signals; from another machine, only those of the command line."""
    last, store = body.get("recent") or "", body.get("store") or ""
    if not isinstance(last, str) or not isinstance(store, str):
        raise UsageError("open: the recent window and the state directory must be text")
    if not last:
        return None
    given = site.given or {}
    if not site.local and (store, config) != ((given.get("recent") or {}).get("store"), given.get("config")):
        raise UsageError("open: the gateway's recent window is opened only on the machine itself")
    return {"last": last, "store": store}
