"""`chaos`: inject faults of bus, sensors and time, and show how the gateway reacts."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import distinct, note, say, writable, write_json
from bms_gateway.errors import BusError, ConfigError, UsageError

if TYPE_CHECKING:
    from bms_gateway.chaos.scenario import Outcome
    from bms_gateway.config.load import LoadedConfig

EXAMPLE = """\
  bms-gateway chaos --config gateway.toml --on memory --scenario thermocouple-open --scenario parked-hours
  sudo bms-gateway chaos --config gateway.toml --on vcan0
"""
MEMORY = "memory"
LISTEN_S = 1.5  # a battery or a gateway on the bus sends something every second


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option(
        "--config",
        metavar="CONFIG",
        type=Path,
        help="the gateway's config (not needed with --list); its pack is simulated",
    )
    parser.option(
        "--on",
        metavar="CHANNEL",
        help=f"a SocketCAN interface that nothing else uses, or {MEMORY} (not needed with --list)",
    )
    parser.option(
        "--scenario", metavar="NAME", action="append", default=[], help="run only this scenario; may be repeated"
    )
    parser.option("--list", action="store_true", help="list the scenarios and end")
    parser.option("--seed", metavar="N", type=int, default=0, help="another seed is another pack and drive (default 0)")
    parser.option("--json", metavar="FILE", help="write the outcome as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Run the scenarios; status 1 when one did not hold."""
    from bms_gateway.chaos.catalogue import Chaos
    from bms_gateway.config import load_config

    if args.seed < 0:
        raise UsageError(f"chaos: --seed {args.seed}: must not be negative")
    if args.list:
        return _list(args)
    for name in ("config", "on"):
        if getattr(args, name) is None:
            raise UsageError(f"chaos: --{name} is needed (see bms-gateway chaos --help)")
    writable({"--json": args.json})
    loaded = load_config(args.config)
    distinct({"--json": args.json}, loaded.files)
    if not loaded.plan.transmit:
        raise ConfigError(f"{args.config}: bus.transmit is false: a gateway that sends nothing cannot be watched")
    channel = None if args.on == MEMORY else args.on
    chaos = Chaos(loaded.plan, loaded.database, channel, args.seed)
    names = chaos.choose(args.scenario)
    if channel is not None:
        _must_be_free(channel, loaded)
    outcomes = chaos.run_all(names, lambda o: say(_line(o), args.json))
    return _conclude(args, outcomes)


def _list(args: argparse.Namespace) -> int:
    """List the scenarios for the given config and bus, otherwise for the example in this process."""
    from bms_gateway.chaos.catalogue import Chaos
    from bms_gateway.config import load_config, shipped

    loaded = load_config(args.config or shipped("deploy/example/gateway.toml"))
    chaos = Chaos(loaded.plan, loaded.database, None if args.on in (None, MEMORY) else args.on, args.seed)
    for name in chaos.choose(args.scenario):
        s = chaos.scenarios[name]
        say(f"{name:22} {s.fault}{f' (not here: {s.unfit})' if s.unfit else ''}", args.json)
    return 0


def _must_be_free(channel: str, loaded: "LoadedConfig") -> None:
    """Refuse a bus with a battery or a gateway on it: its frames and those of the bench would be confused.

    Raises
    ------
    BusError
        It is not free, or cannot be used.
    """
    import time

    from bms_gateway.bus.access import Access
    from bms_gateway.bus.replay import SocketCanSender
    from bms_gateway.bus.socketcan import SocketCanPort
    from bms_gateway.engine import Engine

    SocketCanSender(channel).close()  # its message says what to do if the interface is missing
    engine = Engine(loaded.plan, loaded.database)
    ours = set(engine.sends)
    port = SocketCanPort(channel, Access([*engine.can_ids.tolist(), *ours]))
    try:
        end = time.monotonic() + LISTEN_S
        while time.monotonic() < end:
            for can_id in port.drain().can_id.tolist():
                who = "a gateway" if can_id in ours else "a battery"
                raise BusError(
                    f"{channel}: {who} is on this bus (0x{can_id & 0x1FFF_FFFF:X}): chaos needs a bus of its own; "
                    "stop it, or make another vcan"
                )
            time.sleep(0.05)
    finally:
        port.close()


def _line(o: "Outcome") -> str:
    verdict = ("held" if o.holds else "FAILED") if o.tried else "skipped"
    if not o.tried:
        return f"{verdict:7}  {o.scenario.name:21}  {o.seen}"
    back = "not recovered" if o.recovered_s is None else f"recovered after {o.recovered_s:.1f} s"
    expected = "; ".join(r.text for r in o.scenario.expected) or "estimates in their band"
    return (
        f"{verdict:7}  {o.scenario.name:21}  {o.scenario.fault}\n{'':9}expected: {expected}; "
        f"back within {o.scenario.recovers_s:g} s\n{'':9}seen:     {o.seen or 'nothing amiss'}; {back}"
    )


def _conclude(args: argparse.Namespace, outcomes: "list[Outcome]") -> int:
    tried = [o for o in outcomes if o.tried]
    failed = [o for o in tried if not o.holds]
    if args.json:
        write_json(args.json, {"on": args.on, "seed": args.seed, "scenarios": [_document(o) for o in outcomes]})
    say(
        f"{len(tried)} faults tried, {len(tried) - len(failed)} held, {len(failed)} failed"
        f"{': ' + ', '.join(o.scenario.name for o in failed) if failed else ''}; {len(outcomes) - len(tried)} skipped",
        args.json,
    )
    if not tried:
        note("nothing could be tried with this config on this bus")
    return 1 if failed or not tried else 0


def _document(o: "Outcome") -> dict[str, Any]:
    return {
        "name": o.scenario.name,
        "kind": o.scenario.kind,
        "fault": o.scenario.fault,
        "expected": [r.text for r in o.scenario.expected],
        "reacted_s": list(o.reacted_s),
        "in_band": o.in_band,
        "recovered_s": o.recovered_s,
        "recovers_within_s": o.scenario.recovers_s,
        "holds": o.holds,
        "skipped": o.scenario.unfit or None,
    }
