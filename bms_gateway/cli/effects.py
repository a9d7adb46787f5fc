"""`effects`: the catalogue of physical effects that a string model may lack."""

import argparse
import math
import textwrap
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import say, writable, write_json
from bms_gateway.errors import DataError
from bms_gateway.whole import whole_text

if TYPE_CHECKING:
    from bms_gateway.thermal.effects import Effect, EffectParameter

EXAMPLE = """\
  bms-gateway effects
  bms-gateway effects entropic_heat
  bms-gateway effects --json -
  bms-gateway effects --write notes.md    # between the lines <!-- effects --> and <!-- /effects -->

An effect of your own is a class derived from bms_gateway.thermal.effects.Effect, in a package that names it in the
entry point group bms_gateway.effects. bms_gateway.thermal.properties.broken_properties(YourEffect) lists the laws of
energy, units and signs that it breaks; () is a sound effect. The docstring of that module has an example to copy.
"""
START, END = "<!-- effects -->", "<!-- /effects -->"
WIDTH = 110
MARGIN = 26  # the longest name and two spaces
_SIGNALS = {"flow": "coolant flow", "soc": "SOC", "voltage": "voltage"}
_PLACES = {
    "string": "the whole string",
    "cell": "one cell",
    "sensor": "one thermocouple",
    "gap": "the coolant after one cell",
}


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("name", metavar="NAME", nargs="?", help="show this effect in detail")
    parser.option("--write", metavar="FILE", help=f"put the table into a Markdown FILE, between {START} and {END}")
    parser.option("--json", metavar="FILE", help="write the result as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Print the catalogue, or one effect."""
    from bms_gateway.thermal.effects import catalogue, effect_named

    writable({"--json": args.json, "--write": args.write})
    if args.write is not None:
        say(_written(args.write), args.json)
    chosen = list(catalogue().values()) if args.name is None else [effect_named(args.name)]
    if args.json:
        write_json(args.json, {"effects": [_document(e) for e in chosen]})
    if args.write is None:
        say("\n".join(_overview(chosen) if args.name is None else _detail(chosen[0])), args.json)
    return 0


def _written(path: str) -> str:
    """Put the table into a Markdown file, and say whether it has changed.

    Raises
    ------
    DataError
        The file cannot be read, or does not have the two lines once each, in their order.
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as e:
        raise DataError(f"{path}: cannot be read: {e}") from None
    before, start, rest = text.partition(f"{START}\n")
    _, end, after = rest.partition(f"\n{END}")
    if not (start and end) or text.count(START) != 1 or text.count(END) != 1:
        raise DataError(f"{path}: the table goes between a line {START} and a later line {END}, each once")
    new = f"{before}{start}{catalogue_table()}{end}{after}"
    if new != text:
        with whole_text(file) as text_file:
            text_file.write(new)
    return f"{path}: the table was " + ("brought up to date" if new != text else "up to date already")


def catalogue_table() -> str:
    """Write the catalogue as a Markdown table, as it stands in the README of `thermal/effects`."""
    from bms_gateway.thermal.effects import catalogue

    lines = ["| effect | equation | parameters: prior ± sd (bounds) | needs | looks like |", "|---|---|---|---|---|"]
    for e in catalogue().values():
        equation = e.equation.replace("|", "\\|")
        like = ", ".join(f"`{name}`" for name in e.confused_with) or "–"
        lines.append(f"| `{e.name}` | `{equation}` | {'; '.join(_priors(e))} | {_needs(e)} | {like} |")
    return "\n".join(lines)


def _overview(effects: "Iterable[Effect]") -> Iterator[str]:
    yield f"{'effect':<{MARGIN}}equation; parameters: prior ± sd (bounds); needs; looks like"
    for e in effects:
        yield ""
        yield from _entry(e.name, e.equation)
        yield from _entry("", "; ".join(_priors(e)))
        yield from _entry("", f"needs {_needs(e)}")
        yield from _entry("", f"looks like {', '.join(e.confused_with)}" if e.confused_with else "")
    yield ""
    yield "bms-gateway effects NAME shows one in detail."


def _detail(e: "Effect") -> Iterator[str]:
    yield f"{e.name}: {e.title}"
    yield ""
    yield from _entry("equation", e.equation)
    yield from _entry("how it shows", e.signature)
    yield from _entry("needs", _needs(e))
    yield from _entry("sits on", _PLACES[e.place])
    yield from _entry("looks like", ", ".join(e.confused_with) or "nothing else")
    if e.least_cells > 1:
        yield from _entry("cells", f"at least {e.least_cells}")
    for i, p in enumerate(e.parameters):
        yield from _entry("parameters" if i == 0 else "", f"{p.name}: {p.description}, {_prior(p)}")
    yield ""
    yield "in a model file:"
    yield f'  effects = ["{e.name}"]'
    yield f"  [effect.{e.name}]"
    if e.place != "string":
        yield f'  cell = 1  # several of them: [effect."{e.name}:1"], [effect."{e.name}:2"]'
    for p in e.parameters:
        sd = f"rel_sd = {_number(p.sd)}" if p.log else f"sd = {_number(p.sd / p.to_si)}"
        yield f'  {p.name} = {{ value = {_number(p.probe / p.to_si)}, unit = "{p.unit}", {sd} }}'


def _entry(label: str, text: str) -> list[str]:
    """Yield a text beside its label, wrapped; nothing for an empty text."""
    lines = textwrap.wrap(text, WIDTH - MARGIN, break_on_hyphens=False)
    return [f"{label if i == 0 else '':<{MARGIN}}{line}" for i, line in enumerate(lines)]


def _priors(e: "Effect") -> list[str]:
    """Yield the priors of an effect's parameters; consecutive parameters with the same prior share a line."""
    found: list[tuple[str, list[str]]] = []
    for p in e.parameters:
        prior = _prior(p)
        if found and found[-1][0] == prior:
            found[-1][1].append(p.name)
        else:
            found.append((prior, [p.name]))
    return [f"{names[0] if len(names) == 1 else f'{names[0]} to {names[-1]}'} {prior}" for prior, names in found]


def _prior(p: "EffectParameter") -> str:
    unit = "" if p.unit == "1" else f" {p.unit}"
    low, centre, high = (_number(x / p.to_si) for x in (p.lower, p.prior, p.upper))
    if p.log:
        return f"{centre}{unit} times or over {math.exp(p.sd):.1f} ({low} to {high})"
    return f"{centre} ± {_number(p.sd / p.to_si)}{unit} ({low} to {high})"


def _number(x: float) -> str:
    return f"{x:.6g}"


def _needs(e: "Effect") -> str:
    recorded = [_SIGNALS[s] for s in e.signals]
    return "; ".join([*([f"recorded: {', '.join(recorded)}"] if recorded else []), *([e.needs] if e.needs else [])])


def _document(e: "Effect") -> dict[str, Any]:
    return {
        "name": e.name,
        "title": e.title,
        "equation": e.equation,
        "signature": e.signature,
        "needs": e.needs,
        "signals": list(e.signals),
        "node": e.node,
        "place": e.place,
        "least_cells": e.least_cells,
        "confused_with": list(e.confused_with),
        "parameters": [
            {
                "name": p.name,
                "description": p.description,
                "unit": p.unit,
                "prior": p.prior / p.to_si,
                ("rel_sd" if p.log else "sd"): p.sd if p.log else p.sd / p.to_si,
                "bounds": [p.lower / p.to_si, p.upper / p.to_si],
            }
            for p in e.parameters
        ],
    }
