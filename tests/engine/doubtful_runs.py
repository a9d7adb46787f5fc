"""A string whose cores are doubted, driven for a while."""

from bms_gateway.engine import Engine, Estimated, SendFrames
from bms_gateway.frames.batch import FrameBatch
from tests.engine.packs import database, traffic

S = 1_000_000_000


def run(the_plan, seconds=30):
    """Newest estimate of each tick, and all frames sent."""
    engine = Engine(the_plan, database())
    engine.receive(traffic(seconds), now_ns=2_000_000_000 * S)
    found, sent = [], []
    while (event := engine.next_output()) is not None:
        if isinstance(event, Estimated):
            found.append(event)
        if isinstance(event, SendFrames):
            sent.append(event.batch)
    return found, FrameBatch.concat(sent)
