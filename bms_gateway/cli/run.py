"""`run`: the service. It reads frames from SocketCAN and sends estimates until it is told to stop."""

import argparse
import gc
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bms_gateway.cli.main import Parser
from bms_gateway.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from bms_gateway.bus.port import Port
    from bms_gateway.config.load import LoadedConfig
    from bms_gateway.engine import Engine, Event
    from bms_gateway.service.live import Gateway
    from bms_gateway.store import StateStore, Trial
    from bms_gateway.store.recent import Recent

END_MOST_S = 4.0  # a second more than the gateway needs if every part that it waits for at the end hangs
INTERRUPT_MOST_S = 1.5  # the same after Ctrl-C
EXAMPLE = """
  bms-gateway run /etc/bms-gateway/gateway.toml
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("config", type=Path, metavar="CONFIG", help="the gateway's config")
    parser.option("--seconds", type=float, default=None, help="end after so long (default: run until stopped)")


def run(args: argparse.Namespace) -> int:
    """Run until SIGTERM or SIGINT; after SIGINT the exit status is that of every interrupted command."""
    if args.seconds is not None and not args.seconds > 0:
        raise UsageError(f"run: --seconds {args.seconds:g}: must be above 0")
    # The objects made here last. Searching them for garbage would take an eighth of the start, and later, every other
    # minute, tens of milliseconds in which no frame is processed.
    gc.disable()
    from bms_gateway.service.signals import Signals

    signals = Signals(END_MOST_S, INTERRUPT_MOST_S)
    signals.listen()  # a disk that does not answer delays the start too
    try:
        gateway, port, store, trial = _assembled(args.config)
    except BaseException:
        signals.close()
        raise
    finally:
        gc.enable()
    gc.freeze()
    try:
        with nullcontext() if trial is None else trial.noting():
            gateway.serve(seconds=args.seconds, signals=signals)
        if trial is not None:
            trial.over()
    finally:
        gc.unfreeze()
        port.close()
        if store is not None:
            store.unlock()
        signals.close()
    return 0


def _assembled(config: Path) -> "tuple[Gateway, Port, StateStore | None, Trial | None]":
    """Make the gateway of a config with all parts that run beside it: port, store, and trial of the state."""
    import logging

    from bms_gateway.config.load import load_config
    from bms_gateway.engine import Decoded
    from bms_gateway.service.baseline import BaselineRequests
    from bms_gateway.service.boot import boot_id
    from bms_gateway.service.fit_process import Aside
    from bms_gateway.service.journal import start_logging
    from bms_gateway.service.live import Gateway, Jobs
    from bms_gateway.service.on_trial import prove
    from bms_gateway.service.reporting import accompany
    from bms_gateway.store import StateStore, Trial

    start_logging()
    log = logging.getLogger("bms_gateway.run")
    loaded = load_config(config)
    store = StateStore(loaded.store) if loaded.store else None
    if store is not None and (problem := store.lock()) is not None:
        log.warning("%s", problem)
    recent = _recent(loaded)
    trial = None if store is None else Trial(store.directory, boot_id())
    engine = started(loaded, store, log, trial)
    engine.recording = recent is not None
    port = _port(loaded, engine)

    async def reload() -> "Engine":
        nonlocal engine
        engine = await reloaded(config, engine, log, loaded)
        engine.recording = recent is not None
        return engine

    def watch(event: "Event") -> None:
        if isinstance(event, Decoded) and recent is not None:
            recent.add(event, engine)

    save = saver(store, recent) if store else None
    fits = Aside()
    gateway = Gateway(
        engine,
        port,
        save=save,
        reload=reload,
        watch=watch if recent else None,
        jobs=Jobs(fits.run, fits.close),
    )
    accompany(gateway, loaded, lambda: engine)
    if store is not None:
        gateway.unread = lambda: store.unread
        gateway.beside["baseline"] = BaselineRequests(store.directory, lambda: engine).run
    if trial is not None:
        gateway.beside["trial"] = partial(prove, gateway, trial)
    log.info("listening on %s: %d strings", loaded.config.bus.channel, len(loaded.plan.strings))
    return gateway, port, store, trial


def started(loaded: "LoadedConfig", store: "StateStore | None", log: Any, trial: "Trial | None" = None) -> "Engine":
    """Make the engine with the newest stored state that is valid, and log a line on each state that is not."""
    from bms_gateway.service.boot import on_this_line

    engine = loaded.engine()
    if store is None:
        return engine

    def use(state: "Mapping[str, Any]") -> None:
        nonlocal engine
        fresh = loaded.engine()  # an engine that refuses a state may be half filled
        moved, sure = on_this_line(state)
        fresh.restore(moved, sure=sure)
        engine = fresh

    found = store.load(use, trial)
    for problem in found.problems:
        log.warning("%s", problem)
    if trial is not None and trial.told and found.state is not None:
        log.warning("%s: %s; it is tried once more", store.directory, trial.told)
    if found.problems and found.state is None:
        log.warning("%s: no stored state can be used: starting from the model files", store.directory)
    return engine


def continued(fresh: "Callable[[], Engine]", state: "Mapping[str, Any]", log: Any) -> "Engine":
    """Make an engine that goes on from a state. If the state cannot be used, make a fresh engine, and log why."""
    from bms_gateway.errors import StateError

    engine = fresh()
    try:
        engine.restore(state)
    except StateError as e:
        log.warning("%s; starting from the model files", e)
        return fresh()
    return engine


async def reloaded(config: Path, running: "Engine", log: Any, started: "LoadedConfig | None" = None) -> "Engine":
    """Make the engine of the present config, which goes on from the running one.

    Parameters
    ----------
    config : Path
    running : Engine
        The running engine; it goes on while the config is read.
    log : Logger
    started : LoadedConfig, optional
        Config with which the service was started; the parts beside the engine must be the same.

    Raises
    ------
    ConfigError
        The config is wrong, or needs another port than the one that is open.
    """
    from bms_gateway.errors import ConfigError
    from bms_gateway.service.reporting import same_beside
    from bms_gateway.service.reread import reread

    found = await reread(config)
    if started is not None:
        same_beside(started.config, found.config, config)
    engine = continued(found.engine, running.snapshot(), log)
    engine.alerts.go_on_from(running.alerts)
    heard, before = ((e.can_ids.tolist(), e.any_sender) for e in (engine, running))
    if heard != before or engine.sends != running.sends:
        raise ConfigError(f"{config}: reads or sends other identifiers than before: restart the service")
    return engine


def _recent(loaded: "LoadedConfig") -> "Recent | None":
    """Open the ring of the recent signals; None if no state is kept, or no space is given to the ring."""
    from bms_gateway.store.recent import Recent

    if loaded.store is None or not loaded.config.store.recent_MB:
        return None
    return Recent(loaded.store / "recent", loaded.config.store.recent_MB)


def saver(store: "StateStore", recent: "Recent | None" = None) -> "Callable[[Mapping[str, object]], None]":
    """Make the function that saves: first the state, in case the disk is nearly full, then the recent signals."""
    import time

    def save(state: "Mapping[str, object]") -> None:
        problems = [store.save(state, wall_ns=time.time_ns())]
        if recent is not None:
            problems.append(recent.flush())
        for problem in problems:
            if problem is not None:
                raise problem  # the gateway reports and counts the failure, and goes on

    return save


def _port(loaded: "LoadedConfig", engine: "Engine") -> "Port":
    from bms_gateway.bus.access import Access

    bus, access = loaded.config.bus, Access(engine.can_ids.tolist(), engine.any_sender, engine.sends)
    if bus.interface == "socketcan":
        from bms_gateway.bus.socketcan import SocketCanPort

        return SocketCanPort(bus.channel, access, receive_buffer=bus.receive_buffer)
    from bms_gateway.bus.pythoncan import PythonCanPort

    return PythonCanPort(bus.interface, bus.channel, access)
