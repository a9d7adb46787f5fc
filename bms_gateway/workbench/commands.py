"""The command lines that do the same as the page, and what goes into the gateway's config."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

PROGRAM = "bms-gateway"


def model_name(model: str, step: int) -> str:
    """Name the model file after so many additions.

    Examples
    --------
    >>> model_name("packs/string_1.toml", 0), model_name("packs/string_1.toml", 2)
    ('packs/string_1.toml', 'string_1_with_2.toml')
    """
    return model if step == 0 else f"{Path(model).stem}_with_{step}.toml"


def command_lines(files: Mapping[str, Any], way: Sequence[tuple[Sequence[str], bool]]) -> list[str]:
    """Write what was done as commands.

    Parameters
    ----------
    files : mapping
        What is open, by path.
    way : sequence of (words, forced)
        Additions in their order.

    Returns
    -------
    list of str
        To be typed one after the other; the last one makes the report of what the page shows.
    """
    tables, model = [str(t) for t in files["tables"]], str(files["model"])
    more = [x for c in files.get("columns") or () for x in ("--columns", c)]
    for option in ("config", "string"):
        if files.get(option):
            more += [f"--{option}", files[option]]
    data = [x for t in tables for x in ("--data", t)]
    lines = [
        [PROGRAM, "compare", *tables, "--model", model, *more],
        [PROGRAM, "diagnose", *tables, "--model", model, *more],
    ]
    for i, (words, forced) in enumerate(way):
        before, after = model_name(model, i), model_name(model, i + 1)
        force = ["--force"] if forced else []
        lines.append([PROGRAM, "add", *words, "--model", before, *data, *more, "--out", after, *force])
    if way:
        lines.append([PROGRAM, "compare", *tables, "--model", model_name(model, len(way)), *more])
    lines[-1] += ["--html", "report.html"]
    return [shlex.join(words) for words in lines]


def config_lines(files: Mapping[str, Any], steps: int) -> str:
    """Write the lines of the gateway's config by which it estimates with the model."""
    name = files.get("string") or "string_1"
    return f'[[string]]\nname = "{name}"\nmodel = "{Path(model_name(str(files["model"]), steps)).name}"\n'
