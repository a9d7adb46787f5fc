"""Sends status, alerts and estimates to an MQTT broker, and survives every fault of broker and network.

Below the topic of the gateway::

    status      one line, retained: "OK: …", "WARNING: …", "ALARM: …"; "STOPPED", or "OFFLINE" as the last will
       alert       one JSON object when an alert is raised, changes or has ended
    estimates   one JSON object every interval: hottest and coldest core, growth and flags of each string

The connection is in `service/broker.py`. Its client runs in a thread with an event loop of its own. The gateway's loop
treats every exception as a bug and ends the service. This would be too strict for a client that sometimes meets a
closed socket, and no frame may ever wait for the client. Messages are made in the gateway's loop, where the engine is,
and passed on as text.
"""

import asyncio
import json
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import Any, Literal

from bms_gateway.config.schema import Mqtt
from bms_gateway.health.alerts import Change
from bms_gateway.service import broker
from bms_gateway.service.spool import Message


class Publisher:
    """Keeps a broker informed.

    Parameters
    ----------
    settings : Mqtt
        `[mqtt]` of the config.
    files : mapping of str to Path
        `password_file`, `ca_file`, `cert_file`, `key_file`, as found.
    status : callable
        Returns the present status line.
    estimates : callable
        Returns the present results of the strings, JSON-able.

    Attributes
    ----------
    broker : Broker
    interval_s : float
        Between estimates.

    Raises
    ------
    ConfigError
        A certificate or key cannot be used.
    """

    def __init__(
        self,
        settings: Mqtt,
        files: dict[str, Path],
        *,
        status: Callable[[], str],
        estimates: Callable[[], dict[str, Any]],
    ) -> None:
        self._topic = settings.topic
        self._status, self._estimates = status, estimates
        self.interval_s = settings.interval_s
        self.broker = broker.Broker(settings, files)

    def on_change(self, change: Change) -> None:
        """Queue an alert; for `Watch.listeners`."""
        c = change.condition
        found = {
            "time": round(time.time(), 3),
            "raised": change.raised,
            "severity": c.severity.name,
            "alert": c.name,
            "string": c.string,
            "cell": c.cell,
            "text": c.text,
        }
        self.put("alert", found)

    async def run(self) -> None:
        """Collect messages and have them sent, until cancelled.

        Raises
        ------
        Exception
            The exception that has ended the client's thread: a bug.
        """
        here, ended = asyncio.get_running_loop(), asyncio.Event()
        failures: list[BaseException] = []

        def work() -> None:
            try:
                asyncio.run(self.broker.live())
            except asyncio.CancelledError:
                pass
            except BaseException as error:  # noqa: BLE001 — raised below, in the loop that must know
                failures.append(error)
            with suppress(RuntimeError):  # nobody waits any more
                here.call_soon_threadsafe(ended.set)

        self.broker.line = self._status()
        Thread(target=work, name="mqtt", daemon=True).start()
        try:
            while not await within(ended, self.interval_s):
                self.put("estimate", {"time": round(time.time(), 3), **self._estimates()})
        finally:
            self.broker.cancel()
            await within(ended, 1.5 * broker.FAREWELL_S)
        raise failures[0] if failures else RuntimeError("the client has ended")

    def put(self, kind: Literal["alert", "estimate"], found: dict[str, Any]) -> None:
        """Queue a message, with the present status.

        Raises
        ------
        ValueError
            It contains a value outside JSON: a bug of the caller.
        """
        text = json.dumps(found, ensure_ascii=False, allow_nan=False)
        topic = "alert" if kind == "alert" else "estimates"
        self.broker.spool.put(kind, Message(f"{self._topic}/{topic}", text.encode()))
        self.broker.line = self._status()
        self.broker.look()


async def within(event: asyncio.Event, seconds: float) -> bool:
    """Wait for an event; return whether it came."""
    with suppress(TimeoutError):
        await asyncio.wait_for(event.wait(), seconds)
    return event.is_set()
