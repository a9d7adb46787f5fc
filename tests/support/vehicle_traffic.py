"""Traffic of the pack of the example config."""

from bms_gateway.bus.traffic import Traffic
from bms_gateway.bus.virtual import VirtualPack
from bms_gateway.config import load_config, shipped
from bms_gateway.frames.batch import FrameBatch

SECOND = 1_000_000_000


def traffic(seconds):
    loaded = load_config(shipped("deploy/example/gateway.toml"))
    pack, bus = VirtualPack(loaded.plan, 3), Traffic(loaded.plan, loaded.database, noise_K=0.05, seed=3)
    parts = [
        bus.between([s.series for s in x], int(x[0].time_s[0]) * SECOND, int(x[0].time_s[-1]) * SECOND)
        for x in pack.segments(seconds)
    ]
    return FrameBatch.concat(parts)
