"""A session as a document: files by name, additions, results of diagnoses, and notes. It can be mailed.

Of the computed results it contains only the diagnoses, with digests of their records and model (`recall`): diagnoses
take long, and their open questions must be seen again. Additions are computed again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from bms_gateway.errors import UsageError
from bms_gateway.workbench.steps import Frame

VERSION: Final = 1
UNREACHED: Final = (
    "The session’s diagnosis of a later model is left out: its additions were not made again. Diagnose again."
)
MOST: Final = 20
"""Greatest number of additions in a session."""
LONGEST_NOTES: Final = 10_000
"""Characters: five pages."""
LARGEST: Final = 1e300
"""Greatest number in a stored diagnosis."""
NUMBER: Final = (float, int, type(None))
RANKED: Final[dict[str, Any]] = {
    "name": str,
    "effects": [str],
    "role": str,
    "group": str,
    "against": str,
    "needs": (float, int),
    "evidence": NUMBER,
    "reach": (float, int),
    "share": NUMBER,
    "error_K": NUMBER,
    "without_K": NUMBER,
    "numbers": [str],
    "tied": [str],
    "refused": str,
}
"""Stored fields of each line of a ranking, with their types."""
SAID: Final[dict[str, Any]] = {
    "verdict": str,
    "tag": str,
    "remains": bool,
    "sentence": str,
    "selected": [str],
    "offer": [str],
    "not_offered": str,
    "error": str,
    "ranking": [RANKED],
    "absorbed": [str],
    "core": {
        "proven": bool,
        "sd_K": NUMBER,
        "centre_sd_K": NUMBER,
        "why": [str],
        "rests_on": (str, type(None)),
        "sentence": str,
    },
    "card": [str],
    "next": str,
}
"""The same for a diagnosis."""
OLDER: Final[dict[str, Any]] = {
    **SAID,
    "needs": (float, int),
    "groups": {"named": str, "tied": str, "next": str, "instead": str},
    "against": {"": str, "named": str, "tied": str, "next": str, "instead": str},
    "ranking": [{k: x for k, x in RANKED.items() if k not in ("group", "against", "needs")}],
}
"""The same in older sessions."""
UNOFFERED: Final = "The session is older: diagnose again to see what of this can be added."
Addition = tuple[list[str], bool]
"""Effects added at once, and whether by force."""


@dataclass(slots=True)
class SessionRest:
    """The part of a session that must still be repeated.

    Attributes
    ----------
    to_come : list of Addition
        Additions that follow.
    recalled : dict of number of the model to diagnosis
        Diagnoses of the models after these additions.
    dropped : str
        Why diagnoses of the session are left out, a sentence; empty if none is.
    going : bool
        Whether the additions are still being repeated: until then the desk has less of the work than the session.
    confirming : bool
        Whether all of its diagnoses are being computed here.
    """

    to_come: list[Addition] = field(default_factory=list)
    recalled: dict[str, dict[str, Any]] = field(default_factory=dict)
    dropped: str = ""
    going: bool = False
    confirming: bool = False

    def diagnosed(self, number: int) -> dict[str, Any] | None:
        """Remove and return the diagnosis of model `number`, counted from 0; None if there is none."""
        return self.recalled.pop(str(number), None)

    def abandon(self) -> None:
        """Make no further additions; the diagnoses of models that are not reached are left out."""
        self.to_come, self.going, self.confirming = [], False, False
        if self.recalled:
            self.recalled, self.dropped = {}, UNREACHED


def session_of(
    files: Mapping[str, Any], frames: Sequence[Frame], notes: str = "", digest: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Write a session.

    Parameters
    ----------
    files : mapping
        With names for people. A recent window of the gateway is read anew, not stored.
    frames : sequence of Frame
    notes : str
        Notes of a person.
    digest : mapping, optional
        Of the records and the model from its file, from `recall.digests`.
    """
    recent = files.get("recent") or {}
    made = (files.get("form") or files.get("dbc")) and "/" not in files["model"]  # it is made anew
    each = files.get("each") or ()
    named = [(t, list(each[k]) if k < len(each) else []) for k, t in enumerate(files["tables"])]
    kept = [(t, pairs) for t, pairs in named if t != recent.get("table")]
    return {
        "workbench_session": VERSION,
        "files": {
            "tables": [t for t, _ in kept],
            "each": [pairs for _, pairs in kept],
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
        "digest": dict(digest or {}),
        "diagnosed": [
            {"step": i, "after": _after([f.words for f in frames[1:]], i), "said": _said(f.diagnosed)}
            for i, f in enumerate(frames)
            if f.diagnosed
        ],
        "notes": notes,
    }


def _after(additions: Sequence[list[str]], step: int) -> list[str]:
    """Return the additions of the model at a step, one text each: a diagnosis is of this model only."""
    return [" ".join(words) for words in additions[:step]]


def _said(diagnosed: Mapping[str, Any]) -> dict[str, Any]:
    """Return the result of a diagnosis without the catalogue's descriptions of effects."""
    ranking = [{**r, "effects": [e["key"] for e in r["effects"]]} for r in diagnosed["ranking"]]
    return {**{k: diagnosed[k] for k in SAID}, "ranking": [{k: r[k] for k in RANKED} for r in ranking]}


def additions_of(session: Mapping[str, Any]) -> list[Addition]:
    """Read the additions of a session.

    Raises
    ------
    UsageError
    """
    version = session.get("workbench_session")
    if isinstance(version, int) and version > VERSION:
        raise UsageError(
            f"session: it was made by a newer version of this program (workbench_session = {version}; this one reads"
            f" {VERSION}): open it with that version, or update this one"
        )
    if not _is(version, int) or version != VERSION or not isinstance(session.get("files"), dict):
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


def diagnoses_of(session: Mapping[str, Any]) -> dict[str, Any]:
    """Read the results of diagnoses in a session, their digests, and the steps whose additions are others.

    Raises
    ------
    UsageError
    """
    additions = [words for words, _ in additions_of(session)]
    digest, diagnosed = session.get("digest", {}), session.get("diagnosed", [])
    if not _is(digest, dict) or not all(_is(x, str) for x in digest.values()) or not _is(diagnosed, list):
        raise UsageError("session: digest must name texts, and diagnosed must be a list")
    said, astray = [], []
    for one in diagnosed:
        after = one.get("after") if isinstance(one, dict) else None  # older sessions do not have it
        rest = {k: x for k, x in one.items() if k != "after"} if isinstance(one, dict) else one
        read = _by_part(_resting(rest))
        if not _is(read, {"step": int, "said": SAID}) or not 0 <= read["step"] <= MOST:
            raise UsageError("session: what a diagnosis said is not as the workbench writes it")
        said.append(read)
        if after not in (None, _after(additions, read["step"])):
            astray.append(read["step"])
    return {"digest": digest, "diagnosed": said, "astray": astray}


def _resting(one: Any) -> Any:
    """Convert a diagnosis of an older session, which has neither the assumption for unsensed cells nor an offer."""
    if not _is(one, {"step": int, "said": dict}) or not isinstance(core := one["said"].get("core"), dict):
        return one
    unknown = (
        {"offer": [], "not_offered": UNOFFERED} if one["said"].get("selected") else {"offer": [], "not_offered": ""}
    )
    return {**one, "said": {**unknown, **one["said"], "core": {"rests_on": None, **core}}}


def _by_part(one: Any) -> Any:
    """Convert a diagnosis of an older session, whose bars have one scale and whose parts are named by role."""
    if not isinstance(one, dict) or not _is(one.get("said"), OLDER):
        return one
    said = one["said"]
    roles = [
        {"group": said["groups"].get(r["role"], "Weighed"), "against": said["against"].get(r["role"], "")}
        for r in said["ranking"]
    ]
    ranking = [{**r, **of, "needs": said["needs"]} for r, of in zip(said["ranking"], roles, strict=True)]
    return {**one, "said": {**{k: x for k, x in said.items() if k in SAID}, "ranking": ranking}}


def _is(x: Any, kind: Any) -> bool:
    """Whether a value is of a type, or built as a list or mapping of types; a float can hold each number."""
    if isinstance(kind, list):
        return isinstance(x, list) and all(_is(y, kind[0]) for y in x)
    if isinstance(kind, dict):
        return isinstance(x, dict) and x.keys() == kind.keys() and all(_is(x[k], kind[k]) for k in kind)
    if isinstance(x, bool) and kind is not bool:
        return False
    return isinstance(x, kind) and not (isinstance(x, float | int) and not abs(x) <= LARGEST)


def notes_of(found: Any) -> str:
    """Read notes; no notes are an empty text.

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
