"""Our DBC takes half a second to parse; the tests of a run share the result."""

import functools

import pytest

from bms_gateway.frames import database


@pytest.fixture(autouse=True)
def _parsed_once(monkeypatch):
    monkeypatch.setattr(database, "_parse", _parse)


_original = database._parse


@functools.lru_cache(maxsize=4)
def _parse(name, text):
    return tuple(_original(name, text))
