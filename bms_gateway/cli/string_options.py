"""The string of `observability` and `place`: the paper's cells or a model file, and the unknown errors."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import distinct, writable
from bms_gateway.errors import UsageError, counted, did_you_mean

if TYPE_CHECKING:
    from bms_gateway.library.placing import AskedString
    from bms_gateway.thermal import Condition, Disturbance, StringModel

MAX_CELLS = 1000
"""Most cells of a string, as in a model file."""
UNKNOWN = {
    "heat-common": ("heat_common", "W", 0.0, 1e3, "heat error that the cells share"),
    "heat-cell": ("heat_cell", "W", 0.0, 1e3, "heat error of each cell on its own"),
    "inlet": ("inlet", "K", 0.0, 50.0, "error of the coolant inlet"),
    "correlation": ("correlation", "s", 1.0, 86_400.0, "how long these errors last"),
    "noise": ("sensor", "K", 1e-4, 50.0, "noise of a thermocouple reading"),
}
"""Option, field of `thermal.Disturbance`, unit, bounds (those of the gateway's config) and meaning."""


def add_string_arguments(parser: Parser) -> None:
    """Declare the options that describe the string, and `--json`."""
    parser.option("--cells", metavar="N", type=int, help="cells of the string; with --model as many as that has")
    parser.option(
        "--condition",
        metavar="C",
        help="how cells exchange heat: full (coolant and conduction, default), natural (conduction), "
        "no-conduction (coolant) or single (neither)",
    )
    parser.option("--model", metavar="M", type=Path, help="string model (TOML) in place of the paper's cells")
    parser.option("--R_cc", metavar="K/W", type=float, help="resistance from cell to cell in place of 31.84 K/W")
    for option, (_, unit, _, _, meaning) in UNKNOWN.items():
        parser.option(f"--{option}", metavar=unit, type=float, help=f"standard deviation: {meaning}")
    parser.option("--json", metavar="FILE", help="write the result as JSON; - is standard output")


def given_string(args: argparse.Namespace) -> "AskedString":
    """Read the string from the options of `add_string_arguments`.

    Raises
    ------
    UsageError, ConfigError
        One line: option or file, what is wrong, the nearest valid choice.
    """
    from bms_gateway.thermal import CONDITIONS

    writable({"--json": args.json})
    if args.condition is not None and args.condition not in CONDITIONS:
        raise UsageError(f"--condition '{args.condition}': unknown{did_you_mean(args.condition, CONDITIONS)}")
    if args.cells is not None and not 1 <= args.cells <= MAX_CELLS:
        raise UsageError(f"--cells {args.cells}: valid: 1 to {MAX_CELLS}")
    disturbance = _disturbance(args)
    if args.model is not None:
        return _of_model(args, disturbance)
    if args.cells is None:
        raise UsageError("--cells N is needed, or --model M, a string model that says how many")
    from bms_gateway.library.placing import AskedString
    from bms_gateway.sensors.paper import R_CC, paper_string

    condition: Condition = args.condition or "full"
    R_cc = _conduction(args, condition, args.cells) or R_CC
    origin = "cells of Lin et al., Table 1"
    if args.cells > 1 and condition in ("full", "natural"):
        origin += f", {R_cc:g} K/W from cell to cell"
    return AskedString(paper_string(args.cells, condition, R_cc), condition, None, disturbance, origin)


def _of_model(args: argparse.Namespace, disturbance: "Disturbance") -> "AskedString":
    from bms_gateway.config.model_file import read_model
    from bms_gateway.library.placing import AskedString
    from bms_gateway.thermal import Prior

    distinct({"--json": args.json}, [args.model])
    model: StringModel = read_model(args.model)
    if args.cells not in (None, model.cells):
        raise UsageError(f"--cells {args.cells}: {args.model} has {counted(model.cells, 'cell')}; leave --cells away")
    if args.condition is not None:
        model = replace(model, condition=args.condition)
    R_cc = _conduction(args, model.condition, model.cells)
    for name, needed in (("R_cc", model.has_conduction and R_cc is None), ("C_f", model.has_coolant_path)):
        if needed and name not in model.priors:
            raise UsageError(f"--condition {model.condition}: {args.model} has no {name} in [parameters]")
    p = model.nominal if R_cc is None else replace(model, priors={**model.priors, "R_cc": Prior(R_cc)}).nominal
    return AskedString(p, model.condition, model.sensors, disturbance, str(args.model))


def _conduction(args: argparse.Namespace, condition: "Condition", cells: int) -> float | None:
    """Check `--R_cc`."""
    from bms_gateway.thermal import KINDS

    R_cc: float | None = args.R_cc
    if R_cc is None:
        return None
    if cells < 2 or condition not in ("full", "natural"):
        where = f"--condition {condition}" if cells > 1 else "one cell"
        raise UsageError(f"--R_cc {R_cc:g}: {where} has no conduction from cell to cell; valid: full, natural")
    low, high = KINDS["R_cc"].lower, KINDS["R_cc"].upper
    if not low <= R_cc <= high:
        raise UsageError(f"--R_cc {R_cc:g}: valid: {low:g} to {high:g} K/W")
    return R_cc


def _disturbance(args: argparse.Namespace) -> "Disturbance":
    from bms_gateway.thermal import Disturbance

    given = {}
    for option, (field, unit, low, high, _) in UNKNOWN.items():
        value = getattr(args, option.replace("-", "_"))
        if value is None:
            continue
        if not low <= value <= high:
            raise UsageError(f"--{option} {value:g}: valid: {low:g} to {high:g} {unit}")
        given[field] = value
    return Disturbance(**given)


def given_sensors(words: str, cells: int) -> tuple[int, ...]:
    """Read cells as people write them: `1,5`, `1-3,12`, `none`.

    Raises
    ------
    UsageError
        A word is not a number, a cell does not exist, or is named twice.

    Examples
    --------
    >>> given_sensors("1-3,12", 12)
    (1, 2, 3, 12)
    """
    if words.strip() == "none":
        return ()
    found: list[int] = []
    for word in words.split(","):
        first, dash, last = word.partition("-")
        try:
            low = int(first)
            high = int(last) if dash else low
        except ValueError:
            raise UsageError(
                f"--sensors '{words}': '{word}' is no cell; write them as 1,5 or 1-3,12, or none"
            ) from None
        for k in (low, high):
            if not 1 <= k <= cells:
                raise UsageError(f"--sensors '{words}': cell {k} does not exist; valid: 1 to {cells}")
        if high < low:
            raise UsageError(f"--sensors '{words}': {word} goes backwards")
        found += range(low, high + 1)
    twice = next((k for k in found if found.count(k) > 1), None)
    if twice is not None:
        raise UsageError(f"--sensors '{words}': cell {twice} is named twice")
    return tuple(sorted(found))
