"""`encode`: bench data as CAN frames."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import distinct, note, say, writable, write_json
from bms_gateway.errors import DataError, UsageError, counted, did_you_mean
from bms_gateway.frames.vocabulary import CELL_COLUMNS, INPUTS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bms_gateway.bus.traffic import Key, Series, Traffic
    from bms_gateway.config.load import LoadedConfig
    from bms_gateway.engine.plan import Plan
    from bms_gateway.frames.batch import FrameBatch
    from bms_gateway.report.table import Table

_SAID = {
    needed: ", ".join(
        i.column.format("K") + (f" ({i.said})" if i.said else "")
        for i in INPUTS.values()
        if (i.needed and not i.of_cells) is needed
    )
    for needed in (True, False)
}
EXAMPLE = f"""\
  bms-gateway encode bench.csv --config gateway.toml --out bench.log
  bms-gateway encode cell.csv --config gateway.toml --out cell.log --columns time_s=t_s --columns current_A=-I_A

columns of TABLE (K is a cell, from 1; blanks are missing values):
  needed    time_s (increasing), {_SAID[True]}
  optional  {_SAID[False]}, {CELL_COLUMNS["core"].format("K")} (for comparison)
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("table", metavar="TABLE", help="measurements of one string: CSV, Parquet or MF4 of decoded signals")
    parser.option("--config", metavar="CONFIG", required=True, help="gateway config: which signals carry what")
    parser.option("--out", metavar="LOG", required=True, help="candump log to write (.log or .log.gz)")
    parser.option("--string", metavar="NAME", help="string that the table belongs to, where the config has several")
    parser.option(
        "--columns",
        metavar="NAME=COLUMN",
        action="append",
        default=[],
        help="the table's own name of a column, once per column, or several separated by commas; "
        "a minus before COLUMN changes the sign",
    )
    parser.option(
        "--series",
        metavar="N",
        type=int,
        help="cells in series that voltage_V is measured over, where they are more than those of the string",
    )
    parser.option("--json", metavar="FILE", help="write what was done as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Write the log."""
    from bms_gateway.bus.logfile import write_log
    from bms_gateway.bus.traffic import SECOND, Traffic
    from bms_gateway.cli.pack_voltage import share_of_string
    from bms_gateway.cli.table_checks import (
        not_carried,
        refuse_log,
        refuse_made_up,
        refuse_nothing,
        refuse_other_units,
    )
    from bms_gateway.config import load_config
    from bms_gateway.records.kind import check_time
    from bms_gateway.report.progress import progress
    from bms_gateway.report.table import parse_columns, read_table

    columns = parse_columns(args.columns)
    refuse_log(Path(args.table))
    outputs = {"--out": args.out, "--json": args.json}
    writable(outputs)
    loaded = load_config(Path(args.config))
    distinct(outputs, [*loaded.files, args.table])
    plan = loaded.plan
    index = _string(plan, args.string)
    table = share_of_string(read_table(Path(args.table), columns), plan.strings[index], args.series)
    check_time(table)
    if len(table) < 2:
        raise DataError(f"{table.source}: one row is too short: a value holds from its row to the next")
    if table.notes:
        note(f"{table.source}: {'; '.join(table.notes)}")
    refuse_nothing(plan.strings[index], table)
    refuse_other_units(plan.strings[index], loaded.database, table)
    feed = _feed(plan, index, table)
    traffic = Traffic(plan, loaded.database, [index])
    refuse_made_up(plan.strings[index], table, traffic.made_up([feed]))
    # The last row is an instant as well, so the frames end just after it.
    start_ns, stop_ns = (round(float(t) * SECOND) for t in table.time_s[[0, -1]])
    with progress("encoding", (stop_ns - start_ns) / SECOND) as advance:

        def shown() -> "Iterator[FrameBatch]":
            for batch in traffic.stream([feed], start_ns, stop_ns + 1):
                yield batch
                advance(float(batch.time_ns[-1] - batch.time_ns[0]) / SECOND if len(batch) else 0.0)

        frames = write_log(args.out, shown())
    name, seconds = plan.strings[index].name, (stop_ns - start_ns) / SECOND
    lost = not_carried(plan.strings[index], loaded.database, table)
    said = _tell(loaded, index, table, traffic, lost, feed)
    if args.json:
        numbers = {"frames": frames, "duration_s": seconds, "string": name, "not_carried": lost}
        write_json(args.json, {"log": args.out, **numbers})
    say(f"{args.out}: {counted(frames, 'frame')}, {seconds:.1f} s of {name}", args.json)
    for told in said:
        say(told, args.json)
    return 0


def _tell(
    loaded: "LoadedConfig",
    index: int,
    table: "Table",
    traffic: "Traffic",
    lost: "list[dict[str, Any]]",
    feed: "dict[Key, Series]",
) -> list[str]:
    """Report values of the table that the log lacks; return the entries for signals that the user did not name."""
    import numpy as np

    from bms_gateway.cli.pack_voltage import of_a_pack
    from bms_gateway.cli.table_checks import empty, far_apart

    string = loaded.plan.strings[index]
    volts = table.voltage_V
    if volts is not None and (told := of_a_pack(string, volts[np.isfinite(volts)])) is not None:
        note(f"{table.source}: voltage_V is {told}")
    for x in lost:
        note(
            f"{table.source}: {x['column']}: {x['rows']} of {len(table)} rows, the first at {x['first']}, do not fit "
            f"{x['signal']} ({x['lowest']:.6g} to {x['highest']:.6g}) and are sent as {x['sent_as']}"
        )
    stated = loaded.config.string[index].signals is not None
    lacks = empty(string, loaded.database, table, traffic.in_place([feed]))
    for missing, told in lacks:
        if stated or not missing:
            note(f"{table.source}: {told}")
    for message, count in traffic.left_out.items():
        left = counted(count, f"frame of {message} is", f"frames of {message} are")
        note(
            f"{table.source}: {left} left out with all that they carry, because a value in them is blank and its "
            "signal cannot say so"
        )
    if (spacing := far_apart(table)) is not None:
        note(
            f"{table.source}: current_A steps between rows that are {spacing:.4g} s apart; the frames repeat each "
            "value until the next row, so the heat in between is not that of the cells: cores and alerts of this log "
            "are no test of the gateway"
        )
    return [told for missing, told in lacks if missing and not stated]


def _string(plan: "Plan", name: str | None) -> int:
    names = [s.name for s in plan.strings]
    if name is None:
        if len(names) > 1:
            raise UsageError(f"encode: --string is needed, the config has several; valid: {', '.join(names)}")
        return 0
    if name not in names:
        raise UsageError(f"encode: --string '{name}' is not in the config{did_you_mean(name, names)}")
    return names.index(name)


def _feed(plan: "Plan", index: int, table: "Table") -> "dict[Key, Series]":
    """Give the series of the string's inputs. A sensor without a column is an error; an unused column is a remark."""
    from bms_gateway.bus.traffic import feed_of

    string = plan.strings[index]
    feed = feed_of(table, string)
    wanted = {(c.quantity, c.cell) for c in string.channels if c.signal is not None}
    missing = sorted(k for q, k in wanted if q == "surface" and ("surface", k) not in feed and k is not None)
    if missing:
        have = [f"surface_{k}_C" for k in table.surface_C]
        name = f"surface_{missing[0]}_C"
        raise DataError(
            f"{table.source}: no column '{name}', a sensor of {string.name}"
            f"{did_you_mean(name, have)} (map it: --columns {name}=COLUMN)"
        )
    spare = [f"{quantity}_{k}" for quantity, k in feed if k is not None and (quantity, k) not in wanted]
    if spare:
        note(f"{table.source}: not sent, {string.name} does not take it: {', '.join(spare)}")
    if table.ignored:
        note(f"{table.source}: columns with unknown names are not used: {', '.join(table.ignored)}")
    return feed
