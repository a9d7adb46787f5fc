"""The bus of the live service."""

import pytest

from tests.support.live_service import Bus


@pytest.fixture
def bus():
    bus = Bus()
    yield bus
    bus.close()
