"""Calls of the MQTT client in a thread of their own: their result, their error, and what was cancelled."""

import threading
from concurrent.futures import CancelledError
from types import SimpleNamespace

import aiomqtt
import pytest

from bms_gateway.service import broker
from bms_gateway.service.broker import Threads
from tests.service.mqtt_parts import publisher, running
from tests.support.live_service import come


def test_a_call_in_a_thread_of_its_own_gives_its_result_or_its_error():
    threads = Threads()
    assert threads.submit(divmod, 7, 3).result(30.0) == (2, 1)
    assert threads.submit(int, "11", base=2).result(30.0) == 3
    with pytest.raises(ZeroDivisionError):
        threads.submit(divmod, 1, 0).result(30.0)
    seen = []
    threads.submit(lambda: seen.append((threading.current_thread().name, threading.current_thread().daemon))).result(
        30.0
    )
    assert seen == [("mqtt-connect", True)]


def test_a_call_that_was_cancelled_before_it_began_is_not_made(monkeypatch):
    begun = []
    monkeypatch.setattr(broker, "Thread", lambda target, **_: SimpleNamespace(start=lambda: begun.append(target)))
    called = []
    future = Threads().submit(called.append, 1)
    assert future.cancel()
    begun[0]()
    assert called == []
    with pytest.raises(CancelledError):
        future.result(0)


def test_a_client_connects_in_a_thread_for_which_no_end_of_the_program_waits(monkeypatch):
    seen = []

    def connect(_):
        seen.append((threading.current_thread().name, threading.current_thread().daemon))
        raise OSError("no route")

    monkeypatch.setattr(aiomqtt.Client, "_client_connect", connect)

    async def until():
        await come(lambda: seen)

    running(publisher(), until)
    assert seen == [("mqtt-connect", True)]
