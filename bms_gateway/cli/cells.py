"""`cells`: thermal parameters of a cell that was not measured yet, each number with its source."""

import argparse
from typing import TYPE_CHECKING, Any

from bms_gateway.cli.main import Parser

if TYPE_CHECKING:
    from bms_gateway.thermal.cells import CellFacts

EXAMPLE = """
  bms-gateway cells                                        # those published, and the formats
  bms-gateway cells lg_m50
  bms-gateway cells "21700 5Ah 69g 25mOhm forced 2p"
  bms-gateway cells "pouch 290x216x7.1mm 33Ah 787g plate 1mm" --json -
"""


def arguments(parser: Parser) -> None:
    """Declare the command's words."""
    parser.option(
        "name",
        nargs="*",
        metavar="NAME",
        help="published cell or format, then what else is known: 5Ah, 69g, 25mOhm (dc | ac), 2p, gap as 2mm, "
        "still | forced | plate | liquid, standing | lying, LFP | NMC | NCA | LMO | LCO, size as 290x216x7.1mm",
    )
    parser.option("--json", metavar="FILE", help="write the result as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Print one cell with formulas and sources, or all published ones."""
    from bms_gateway.cli.output import say, writable, write_json
    from bms_gateway.thermal.cells import FORMATS, PUBLISHED, cell_of

    writable({"--json": args.json})
    words = " ".join(args.name)
    cells = [cell_of(words)] if words.strip() else [*PUBLISHED.values(), *FORMATS.values()]
    if args.json:
        write_json(args.json, {c.name: {"parameters": _parameters(c)} for c in cells})
    say(_one(cells[0]) if words.strip() else _all(cells), args.json)
    return 0


def _parameters(cell: "CellFacts") -> dict[str, dict[str, Any]]:
    from bms_gateway.thermal import KINDS
    from bms_gateway.thermal.cells import stated_parameters

    return {
        symbol: {
            "value": float(f"{s.value / KINDS[symbol].to_si:.4g}"),
            "unit": KINDS[symbol].unit,
            "rel_sd": round(s.rel_sd, 3),
            "formula": s.formula,
            "source": s.source,
        }
        for symbol, s in stated_parameters(cell).items()
    }


def _one(cell: "CellFacts") -> str:
    from bms_gateway.report.show import text_table
    from bms_gateway.thermal import KINDS
    from bms_gateway.thermal.cells import cell_priors

    found = _parameters(cell)
    rows = [
        [symbol, f"{p['value']:g}", p["unit"], f"{100 * p['rel_sd']:.0f} %", p["formula"]]
        for symbol, p in found.items()
    ]
    lines = [_described(cell), "", text_table(["", "value", "unit", "rel. sd", "formula"], rows, left=5), ""]
    lines += [f"{symbol}: {p['source']}" for symbol, p in found.items()]
    if (told := _in_parallel(cell)) is not None:
        lines += ["", told]
    capacity = [] if cell.capacity_Ah is None else [f"capacity_Ah = {cell.capacity_Ah * cell.parallel:g}"]
    lines += ["", "model file:", "[cell]", f'format = "{cell.name}"', *capacity, "", "[parameters]"]
    lines += [
        f'{symbol} = {{ value = {p.value / KINDS[symbol].to_si:.4g}, unit = "{KINDS[symbol].unit}", '
        f"rel_sd = {p.rel_sd:.3g} }}"
        for symbol, p in cell_priors(cell, conduction=True).items()
    ]
    lines += [
        "",
        "A record of the cell type with a thermocouple in the core is worth more than any prior: fit --calibrate.",
    ]
    return "\n".join(lines)


def _in_parallel(cell: "CellFacts") -> str | None:
    """Say what one cell of the model is where it stands for several in parallel."""
    n = cell.parallel
    if n == 1:
        return None
    told = f"{n} in parallel are one cell of the model, with the current and the heat of all {n}: I² R_e/{n}."
    if cell.shape != "cylinder" and cell.spacing == 0.0:
        return (
            f"{told} Their faces touch (0mm), so that all heat leaves through the outer faces of the stack: R_c, R_u "
            f"and R_cc are those of one cell of {n} times the thickness."
        )
    told += (
        f" Each gives off its 1/{n} of that heat through its own faces, so that the same core minus surface follows "
        f"from R_c/{n}, with {n} C and R_u/{n}."
    )
    return told if cell.shape == "cylinder" else f"{told} If the faces of the {n} touch, add 0mm to NAME."


def _described(cell: "CellFacts") -> str:
    size = " × ".join(f"{1e3 * x:g}" for x in cell.size)
    parts = [cell.name, f"{cell.shape} {size} mm", cell.chemistry or "chemistry not given"]
    parts.append("mass not given" if cell.mass is None else f"{1e3 * cell.mass:g} g")
    parts.append("capacity not given" if cell.capacity_Ah is None else f"{cell.capacity_Ah:g} Ah")
    if cell.parallel > 1:
        parts.append(f"{cell.parallel} in parallel")
    parts += [f"cooling: {cell.cooling}", cell.orientation]
    return ", ".join(parts)


def _all(cells: "list[CellFacts]") -> str:
    from bms_gateway.report.show import text_table

    rows = []
    for c in cells:
        p = _parameters(c)
        known = [f"{1e3 * c.mass:g}" if c.mass else "–", f"{c.capacity_Ah:g}" if c.capacity_Ah else "–"]
        numbers = [f"{p[s]['value']:g} ± {100 * p[s]['rel_sd']:.0f} %" for s in ("C_c", "C_s", "R_e", "R_c", "R_u")]
        rows.append([c.name, c.shape, c.cooling, *known, *numbers])
    headers = ["cell", "shape", "cooling", "g", "Ah", "C_c J/K", "C_s J/K", "R_e mΩ", "R_c K/W", "R_u K/W"]
    return text_table(headers, rows, left=3) + "\n\nformulas and sources of one: bms-gateway cells NAME"
