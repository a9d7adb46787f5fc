"""A session as a document: files by name, what was added to the model, and notes. It is small, and can be mailed.

What was computed is not in it: going the same way again gives the same, and says so if a file has changed.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from bms_gateway.errors import UsageError
from bms_gateway.workbench.steps import Frame

VERSION: Final = 1
MOST: Final = 20
"""Additions of a session: more than any road has."""
LONGEST_NOTES: Final = 10_000
"""Characters: five pages."""
Addition = tuple[list[str], bool]
"""Effects added at once, and whether by force."""


def session_of(files: Mapping[str, Any], frames: Sequence[Frame], notes: str = "") -> dict[str, Any]:
    """Write a session.

    Parameters
    ----------
    files : mapping
        As a person knows them. A recent window of the gateway is taken anew, not kept.
    frames : sequence of Frame
    notes : str
        What a person wrote.
    """
    recent = files.get("recent") or {}
    made = (files.get("form") or files.get("dbc")) and "/" not in files["model"]  # it is made anew
    return {
        "workbench_session": VERSION,
        "files": {
            "tables": [t for t in files["tables"] if t != recent.get("table")],
            "model": files["model"] if not made else "",
            "config": (files.get("config") or "") if not files.get("dbc") else "",
            "string": files.get("string") or "",
            "columns": list(files.get("columns") or ()),
            "dbc": list(files.get("dbc") or ()),
            "form": files.get("form") or None,
            "recent": recent.get("last", ""),
            "store": recent.get("store", ""),
        },
        "added": [{"effects": f.words, "force": f.forced} for f in frames[1:]],
        "notes": notes,
    }


def additions_of(session: Mapping[str, Any]) -> list[Addition]:
    """Read what a session added.

    Raises
    ------
    UsageError
    """
    if session.get("workbench_session") != VERSION or not isinstance(session.get("files"), dict):
        raise UsageError(f"session: this is no session file of the workbench (workbench_session = {VERSION})")
    added = session.get("added", [])
    if not isinstance(added, list) or len(added) > MOST:
        raise UsageError(f"session: added must be a list of at most {MOST}")
    found = []
    for one in added:
        words = one.get("effects") if isinstance(one, dict) else None
        if not isinstance(words, list) or not words or not all(isinstance(w, str) for w in words):
            raise UsageError("session: each addition must name its effects")
        found.append((words, one.get("force") is True))
    return found


def notes_of(found: Any) -> str:
    """Read notes; none are an empty text.

    Raises
    ------
    UsageError
    """
    if not isinstance(found, str):
        raise UsageError("notes: a text is needed")
    if len(found) > LONGEST_NOTES:
        raise UsageError(f"notes: at most {LONGEST_NOTES} characters are kept, these are {len(found)}")
    try:
        found.encode()
    except UnicodeEncodeError:
        raise UsageError("notes: half a character cannot be kept") from None
    return found
