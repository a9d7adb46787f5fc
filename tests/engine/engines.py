"""An engine of a small plan."""

from bms_gateway.engine import Engine
from tests.engine.packs import database, plan


def engine(strings: int = 2) -> Engine:
    return Engine(plan(strings), database())
