"""Diagnoses in a session file, and whether they still hold: only for the same records, model and additions.

The result of a diagnosis is stored; it is not computed again. The descriptions of its effects come from the catalogue.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from bms_gateway.config.model_file import format_model
from bms_gateway.diagnosis.record import Record
from bms_gateway.errors import ConfigError
from bms_gateway.thermal import StringModel
from bms_gateway.workbench.documents import Document, effect

DRIVEN = ("I", "I2", "I_abs", "T_in", "flow", "soc", "V", "IV")

OTHERS = {"records": "the readings are not those", "model": "the model file is not the one"}
"""How a session without a diagnosis is told that its files are others."""
LEFT_OUT = {
    "records": "these are not the measurements that it was made of",
    "model": "this is not the model that it was made of",
    "added": "these are not the additions after which it was made",
    "both": "neither the measurements nor the model are those that it was made of",
}


NOT_YET: Document = {"proven": False, "sd_K": None, "centre_sd_K": None, "why": [], "rests_on": None, "sentence": ""}
"""Of the cores until they are computed here: a file can be changed by anybody."""


def digests(records: Sequence[Record], model: StringModel) -> dict[str, str]:
    """Return digests of the records and of the model, by which their diagnoses are recognised.

    They are digests of the numbers: a renamed or packed file keeps them, and so does a model with other comments. The
    last digits of a float are left out, because they differ between processors.
    """
    told = hashlib.sha256()
    for r in records:
        read = [r.surface, r.core]
        floats = [getattr(r.drive, name) for name in DRIVEN] + [r.instants] + [x for s in read for x in (s.share, s.y)]
        for x in floats:
            told.update(np.asarray(x, "<f4").tobytes())
        for s in read:
            told.update(repr(s.cells).encode())
            told.update(np.asarray(s.sensor, "<i8").tobytes() + np.asarray(s.left, "<i8").tobytes())
        told.update(repr((r.drive.dt, sorted(r.drive.known), r.segments)).encode())
    return {"records": told.hexdigest(), "model": hashlib.sha256(format_model(model).encode()).hexdigest()}


def content_of(records: Sequence[Record]) -> str:
    """Return a digest of all content of records, to the last digit: equal records give equal answers."""
    told = hashlib.sha256()

    def feed(x: Any) -> None:
        told.update(type(x).__name__.encode())
        if isinstance(x, np.ndarray):
            told.update(repr((x.dtype.str, x.shape)).encode() + np.ascontiguousarray(x).tobytes())
        elif is_dataclass(x):
            for f in fields(x):
                feed(getattr(x, f.name))
        elif isinstance(x, Mapping):
            feed([(k, x[k]) for k in sorted(x, key=repr)])
        elif isinstance(x, set | frozenset):
            feed(sorted(x, key=repr))
        elif isinstance(x, list | tuple):
            told.update(str(len(x)).encode())
            for y in x:
                feed(y)
        else:
            told.update(repr(x).encode() + b"\0")

    feed(list(records))
    return told.hexdigest()


def recalled(kept: Mapping[str, Any], now: Mapping[str, str]) -> tuple[dict[str, Document], str]:
    """Return the diagnoses of a session by the number of their step, and the reason if they are left out.

    Parameters
    ----------
    kept : mapping
        From `session.diagnoses_of`.
    now : mapping
        Digests of the open files.
    """
    other = [what for what in ("records", "model") if kept["digest"].get(what) != now[what]]
    if kept["diagnosed"] and other:
        why = LEFT_OUT["both" if len(other) > 1 else other[0]]
        return {}, f"The session’s diagnosis is left out: {why}. Diagnose again."
    if other := [OTHERS[what] for what in other if what in kept["digest"]]:
        said = " and ".join(other)
        return {}, f"{said[0].upper()}{said[1:]} with which the session was saved: what it added is fitted anew."
    astray = kept["astray"]
    why = f"The session’s diagnosis is left out: {LEFT_OUT['added']}. Diagnose again." if astray else ""
    try:
        return {str(d["step"]): _whole(d["said"]) for d in kept["diagnosed"] if d["step"] not in astray}, why
    except ConfigError as e:
        return {}, f"The session’s diagnosis is left out: {e}."


def _whole(said: Mapping[str, Any]) -> Document:
    ranking = [{**r, "effects": [effect(key) for key in r["effects"]], "drawn": False} for r in said["ranking"]]
    return {**said, "core": NOT_YET, "ranking": ranking, "recalled": True}
