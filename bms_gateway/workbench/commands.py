"""Command lines with the same effect as the page, the files that they read, and the lines for the gateway's config."""

import json
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

PROGRAM = "bms-gateway"
UNNAMED = "string_1"
"""Name of a string without a known name."""
NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
"""Allowed names of strings in a config."""


def model_name(model: str, step: int) -> str:
    """Name the model file after this number of additions.

    Examples
    --------
    >>> model_name("packs/string_1.toml", 0), model_name("packs/string_1.toml", 2)
    ('packs/string_1.toml', 'string_1_with_2.toml')
    """
    return model if step == 0 else f"{Path(model).stem}_with_{step}.toml"


def fitted_name(model: str) -> str:
    """Name the file of the numbers that a fit finds.

    Examples
    --------
    >>> fitted_name("packs/string_1.toml")
    'string_1_fitted.toml'
    """
    return f"{Path(model).stem}_fitted.toml"


@dataclass(frozen=True, slots=True)
class Leg:
    """One model of the session.

    Attributes
    ----------
    words : sequence of str
        Effects added to the previous model.
    forced : bool
        Whether they were added by force.
    diagnosed : bool
        Whether it was diagnosed.
    refitted : {"", "fits", "refused"}
        Whether numbers of a refit are shown that its file does not hold, and whether `fit` would write them: it
        refuses records that the direct checks refuse. The file after an addition holds its numbers.
    """

    words: Sequence[str] = ()
    forced: bool = False
    diagnosed: bool = False
    refitted: Literal["", "fits", "refused"] = ""


def command_lines(files: Mapping[str, Any], way: Sequence[Leg]) -> list[str]:
    """Write the steps as commands.

    Parameters
    ----------
    files : mapping
        The open files, by path.
    way : sequence of Leg
        The model from its file, and the models made from it.

    Returns
    -------
    list of str
        To be entered one after the other; the last one makes the report of the shown step.
    """
    tables, model = [_plain(str(t)) for t in files["tables"]], _plain(str(files["model"]))
    columns, differ = _columns(files)
    more = [x for c in columns for x in ("--columns", c)]
    for option in ("config", "string"):
        if files.get(option) and (files.get("config") or not files.get("recent")):
            more += [f"--{option}", files[option]]
    data = [x for t in tables for x in ("--data", t)]
    lines = [_export(files)] if files.get("recent") else []
    for i, leg in enumerate(way):
        name = _plain(model_name(model, i))
        if i == 0:
            if leg.refitted == "fits":
                lines.append([PROGRAM, "fit", *tables, "--model", name, *more, "--out", _plain(fitted_name(model))])
            lines.append([PROGRAM, "compare", *tables, "--model", name, *more])
        else:
            force = ["--force"] if leg.forced else []
            before = _plain(model_name(model, i - 1))
            lines.append([PROGRAM, "add", *leg.words, "--model", before, *data, *more, "--out", name, *force])
        if leg.diagnosed:
            lines.append([PROGRAM, "diagnose", *tables, "--model", name, *more])
    if way:
        lines[-1] += ["--html", "report.html"]
    return differ + [shlex.join(words) for words in lines]


def told_of_model(files: Mapping[str, Any], way: Sequence[Leg]) -> str:
    """Say that the model file that is taken away does not hold the numbers of a refit; empty if it does.

    Parameters
    ----------
    files, way :
        As for `command_lines`.
    """
    refitted = way[-1].refitted if way else ""
    if not refitted:
        return ""
    said = "This file holds the numbers from before, not the refitted ones."
    if refitted == "refused":
        return f"{said} A check refuses these records, so no file is written with numbers that were fitted to them."
    name = fitted_name(str(files["model"]))
    return (
        f"{said} The command fit below writes the refitted numbers, with what is known of the core, to {name}. To "
        "estimate with them, name that file in the gateway's config."
    )


def _columns(files: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Return the common columns of all tables; if tables have their own, also remarks: no command takes several."""
    shared, each = list(files.get("columns") or ()), [list(x) for x in files.get("each") or ()]
    own = [*each, *([[]] * (len(files["tables"]) - len(each)))]
    if all(x == own[0] for x in own):
        return [*shared, *own[0]], []
    remarks = [f"# {t}: {', '.join(x)}" for t, x in zip(files["tables"], own, strict=True) if x]
    return shared, ["# One command takes one mapping of columns: give these tables the same names first.", *remarks]


def _export(files: Mapping[str, Any]) -> list[str]:
    recent = files["recent"]
    place = ["--store", str(recent["store"])] if recent["store"] else []
    if not place and files.get("config"):
        place = ["--config", str(files["config"])]
    string = ["--string", str(files["string"])] if files.get("string") else []
    return [PROGRAM, "export", "--last", str(recent["last"]), "--out", str(recent["table"]), *place, *string]


def _plain(name: str) -> str:
    """Prevent a shell command from reading a name as an option."""
    return f"./{name}" if name.startswith("-") else name


def files_read(files: Mapping[str, Any], folder: Path) -> list[str]:
    """Name the files of a tab's folder that the commands read: uploads, and files made from them there.

    Parameters
    ----------
    files : mapping
        The open files, by path.
    folder : Path
        Of the tab. For a config in it, all files beside it may belong to the config: models of strings, DBC files.
    """
    named = [*files["tables"], files["model"], files.get("config") or "", *(files.get("dbc") or ())]
    mine = [Path(x) for x in named if x and Path(x).parent == folder]
    if files.get("config") and Path(files["config"]).parent == folder:
        mine += sorted(p for p in folder.glob("[!.]*") if p.suffix in BESIDE)
    return list(dict.fromkeys(p.name for p in mine if p.is_file()))


BESIDE = (".toml", ".dbc", ".kcd", ".arxml", ".sym")
"""Endings of files that a config names."""


def config_lines(files: Mapping[str, Any], steps: int) -> str:
    """Write the lines of the gateway's config with which it uses the model.

    The string has the name under which it was opened; otherwise that of its model file, which `init` and the live page
    name after the string.
    """
    own = Path(str(files["model"])).stem
    name = files.get("string") or (own if NAME.fullmatch(own) and not files.get("form") else UNNAMED)
    model = Path(model_name(str(files["model"]), steps)).name
    # a JSON string is a TOML string
    return (
        f"[[string]]\nname = {json.dumps(name, ensure_ascii=False)}\nmodel = {json.dumps(model, ensure_ascii=False)}\n"
    )


def by_name(files: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return files with names for people: files in a tab's folder without the path."""

    def plain(x: Any) -> Any:
        if isinstance(x, str):
            return x.removeprefix(f"{folder}/")
        return [plain(y) for y in x] if isinstance(x, list) else x

    recent = files.get("recent")
    named = {k: plain(v) for k, v in files.items()}
    return {**named, "recent": {k: plain(v) for k, v in recent.items()} if recent else None}
