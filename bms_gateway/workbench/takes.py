"""Content that can be saved from a tab: its model, its report, its session, and the files in its folder."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import quote

from bms_gateway.errors import UsageError, whole_number
from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.uploads import safe_name

KINDS: Final = ("model", "report", "session", "file")


@dataclass(frozen=True, slots=True)
class Taken:
    """One item to be saved.

    Attributes
    ----------
    name, kind : str
        Of the file, and its media type.
    body : bytes or Path
        Content, or its place.
    once : bool
        Whether the file is deleted after it was sent.
    """

    name: str
    kind: str
    body: bytes | Path
    once: bool = False


def taken(desk: Desk, query: Mapping[str, str]) -> Taken:
    """Return the requested item: `what` of `KINDS`, and a `name` if the file has none of its own.

    Raises
    ------
    UsageError
        It does not exist.
    """
    name = query.get("name", "")
    match query.get("what", ""):
        case "report":
            return Taken("report.html", "text/html; charset=utf-8", desk.report(_places(query.get("steps"))), once=True)
        case "session":
            text = json.dumps(desk.session(), ensure_ascii=False, indent=1)
            return Taken("session.json", "application/json", text.encode())
        case "file":
            path = desk.folder / safe_name(name)
            if path == desk.folder or not path.is_file():
                raise UsageError("take: this tab has no file of this name")
            return Taken(path.name, "application/octet-stream", path)
    return Taken(Path(name or "model.toml").name, "application/toml", desk.model().encode())


def _places(text: str | None) -> list[int] | None:
    """Read the places of the ticked steps from a query; None if it does not say them."""
    return None if text is None else [k for word in text.split(",") if (k := whole_number(word)) is not None]


def attached(name: str) -> str:
    r"""Write the header by which a browser saves a file under its name, also with letters beyond ASCII.

    Examples
    --------
    >>> attached("drive 1.csv")
    'attachment; filename="drive 1.csv"'
    >>> attached("Prüfstand.csv")
    'attachment; filename="Prfstand.csv"; filename*=UTF-8\'\'Pr%C3%BCfstand.csv'
    """
    safe = safe_name(name) or "file"
    plain = safe.encode("ascii", "ignore").decode()
    told = f'attachment; filename="{plain.strip() or "file"}"'
    return told if plain == safe else f"{told}; filename*=UTF-8''{quote(safe, safe='')}"
