"""`workbench`: a local page on which a model is compared with measurements, and a live page of the pack."""

import argparse
import signal
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import note, say
from bms_gateway.errors import UsageError

if TYPE_CHECKING:
    from bms_gateway.config.load import LoadedConfig
    from bms_gateway.engine import Engine
    from bms_gateway.workbench.server import Server
    from bms_gateway.workbench.site import Site
    from bms_gateway.workbench.sources import Listening

EXAMPLE = """\
  bms-gateway workbench bench.csv --model string_1.toml
  bms-gateway workbench drive.log.gz --model string_1.toml --config gateway.toml --string string_1
  bms-gateway workbench --recent 2h --config gateway.toml --string string_1 --model string_1.toml
  bms-gateway workbench --live vcan0 --config gateway.toml
  bms-gateway workbench --live drive.log.gz --config gateway.toml

the page works without internet; it is at http://127.0.0.1:8420/ until the program is stopped (Ctrl-C)
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("table", nargs="*", metavar="TABLE", help="tables, and logs with --config; one record each")
    parser.option("--model", metavar="M", help="string model (TOML)")
    parser.option("--config", metavar="C", help="gateway config: which signals of a log or a bus carry what")
    parser.option("--string", metavar="NAME", help="string that a log is read for, where the config has several")
    parser.option(
        "--columns", metavar="NAME=COLUMN", action="append", default=[], help="a table's own name of a column"
    )
    parser.option("--recent", metavar="SPAN", help="the running gateway's recent signals, as export: 90s, 30min, 2h")
    parser.option("--store", metavar="DIR", help="its state directory (default: as --config says)")
    parser.option(
        "--live", metavar="CHANNEL", help="show the pack on this CAN interface, listen only; or play this log"
    )
    parser.option("--grafana", metavar="URL", help="the live page links to this Grafana, or dashboard of it")
    parser.option("--bitrate", type=float, default=500e3, metavar="B", help="of the bus, for its load (default 500000)")
    parser.option(
        "--host",
        default="127.0.0.1",
        metavar="H",
        help="address to serve on (default: this machine only; 0.0.0.0: all; others need the printed token)",
    )
    parser.option(
        "--name",
        metavar="NAME[:PORT]",
        action="append",
        default=[],
        help="another name by which browsers call this machine",
    )
    parser.option("--port", type=int, default=8420, metavar="P", help="port to serve on (default 8420; 0: any)")


def run(args: argparse.Namespace) -> int:
    """Serve until stopped."""
    from bms_gateway.cli.output import needs_plotly
    from bms_gateway.workbench.server import Server
    from bms_gateway.workbench.site import Site
    from bms_gateway.workbench.uploads import sweep

    needs_plotly("workbench", "workbench")
    sweep()
    signal.signal(signal.SIGTERM, _stop)  # as after Ctrl-C: uploads and processes must be removed too
    if args.bitrate <= 0:
        raise UsageError(f"workbench: --bitrate {args.bitrate:g}: must be above 0")
    given = _given(args)
    site = Site(given=given, grafana=_grafana(args))
    if args.live is not None:
        return _live(args, site)
    server = Server(site, args.host, args.port, args.name, _say_now)
    site.warm(ahead=True)
    return _serve(site, server)


def _grafana(args: argparse.Namespace) -> str:
    from bms_gateway.workbench.grafana import dashboard_address

    if args.grafana is None:
        return ""
    if args.live is None:
        raise UsageError("workbench: --grafana goes with --live: the live page links to it")
    return dashboard_address(args.grafana)


def _serve(site: "Site", server: "Server") -> int:
    import threading

    from bms_gateway.report.page import plotly_script

    _tell(server)
    # packing takes a part of a second, so it is done before the first request
    threading.Thread(target=plotly_script, daemon=True).start()
    try:
        server.serve_forever()
    finally:
        site.close()
        server.server_close()
    return 0


def _stop(_number: int, _frame: object) -> None:
    sys.exit(0)


def _given(args: argparse.Namespace) -> dict[str, Any] | None:
    if args.store is not None and args.recent is None:
        raise UsageError("workbench: --store goes with --recent: how much of what was recorded there")
    if not args.table and args.recent is None:
        if args.model:
            raise UsageError("workbench: --model goes with a TABLE or --recent; else choose both on the page")
        return None
    if not args.model:
        raise UsageError("workbench: --model is needed with a TABLE or --recent (TOML, as for compare)")
    for name in (*args.table, args.model, *([args.config] if args.config else [])):
        if not Path(name).is_file():
            raise UsageError(f"workbench: {name}: no such file")
    return {
        "tables": list(args.table),
        "model": args.model,
        "config": args.config or "",
        "string": args.string or "",
        "columns": list(args.columns),
        "recent": _recent(args),
    }


def _recent(args: argparse.Namespace) -> dict[str, str] | None:
    if args.recent is None:
        return None
    from bms_gateway.records.recent_signals import given_span, state_directory

    given_span(args.recent, "workbench: --recent")
    config, store = (Path(x) if x else None for x in (args.config, args.store))
    state_directory(config, store, "workbench")
    return {"last": args.recent, "store": args.store or ""}


def _tell(server: "Server") -> None:
    _say_now(f"workbench at {server.door.url} (stop with Ctrl-C)")
    if not server.door.local:
        note("the token in this address is good for one browser; what is sent is not encrypted")


def _say_now(text: str) -> None:
    """Print without delay: the program goes on, and a reader of its redirected output needs the address."""
    say(text)
    sys.stdout.flush()


def _live(args: argparse.Namespace, site: "Site") -> int:
    from bms_gateway.config.load import load_config
    from bms_gateway.engine import Engine
    from bms_gateway.workbench.live_estimates import Watch
    from bms_gateway.workbench.server import Server
    from bms_gateway.workbench.sources import Playback

    if not args.config:
        raise UsageError("workbench: --live needs --config: it says which signals carry what")
    loaded = load_config(Path(args.config))
    engine = Engine(replace(loaded.plan, transmit=False), loaded.database)
    log = Path(args.live)
    if log.is_file():
        playback = Playback([log])
        watch = Watch(engine, "log", log.name, args.bitrate, playback.traffic)
        site.watch = watch
        server = Server(site, args.host, args.port, args.name, _say_now)
        playback.start(engine, watch)
        return _serve(site, server)
    if log.suffix or len(log.parts) > 1:
        raise UsageError(f"workbench: --live {args.live}: no such log (a CAN interface is named as vcan0)")
    return _on_the_bus(args, site, loaded, engine)


def _on_the_bus(args: argparse.Namespace, site: "Site", loaded: "LoadedConfig", engine: "Engine") -> int:
    """Serve from threads, and run the gateway's own loop in this one."""
    import threading

    from bms_gateway.service.live import Gateway
    from bms_gateway.workbench.live_estimates import Watch
    from bms_gateway.workbench.server import Server

    port = _listening(loaded, args.live)
    site.watch = watch = Watch(engine, "live", args.live, args.bitrate, port.traffic)
    try:
        server = Server(site, args.host, args.port, args.name, _say_now)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        _tell(server)
        try:
            Gateway(engine, port, watch=watch.take).serve()
        finally:
            site.close()
            server.shutdown()
            server.server_close()
    finally:
        port.close()
    return 0


def _listening(loaded: "LoadedConfig", channel: str) -> "Listening":
    """Open the interface for all frames, because the load of the bus is shown; the port may send none."""
    from bms_gateway.workbench.sources import Listening

    bus = loaded.config.bus
    if bus.interface == "socketcan":
        from bms_gateway.bus.socketcan import SocketCanPort

        return Listening(SocketCanPort(channel, receive_buffer=bus.receive_buffer))
    from bms_gateway.bus.pythoncan import PythonCanPort

    return Listening(PythonCanPort(bus.interface, channel))
