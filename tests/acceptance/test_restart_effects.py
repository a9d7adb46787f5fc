"""Restart while driving of a string whose model holds effects: one tick after the first frames its cores are in band.

The pack, its hidden effect and the cores are those of the independent truth, the model knows the effect's numbers to a
tenth. Current flows on while the gateway is off, for up to ten minutes; the state on the disk is up to a minute old.
"""

import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log
from bms_gateway.bus.traffic import SECOND
from bms_gateway.config import load_config
from bms_gateway.frames.batch import FrameBatch
from tests.acceptance.drives import EPOCH_S
from tests.acceptance.effects import config_with, encoded, hidden, models
from tests.acceptance.restarts import Restart, restart, states_at

pytestmark = pytest.mark.slow
GAPS = (5, 30, 120, 600)
STOPS = (430, 740, 1050)
SEED = 5


def restarts(name: str, seed: int, directory) -> list[Restart]:
    """Restarts at each stop, after each gap."""
    log = hidden(name, seed, max(STOPS) + max(GAPS) + 10)
    config = config_with(models(log, name)[1], "known", directory)
    config.write_text(config.read_text() + '[identify]\nmethod = "off"\n')
    loaded = load_config(config)
    b = FrameBatch.concat(list(read_log(encoded(log, config, directory))))
    frames = FrameBatch(b.time_ns + EPOCH_S * SECOND, b.can_id, b.length, b.data)
    rng = np.random.default_rng(seed)
    saved = {s: s - int(rng.integers(0, 61)) for s in STOPS}
    states = states_at(loaded, frames, saved.values())
    drives = [(None, None, log.core, None)]
    return [restart(loaded, drives, frames, states[saved[s]], s + gap) for s in STOPS for gap in GAPS]


@pytest.mark.parametrize(
    "name",
    [
        "busbar_joule",
        "cell_resistance",
        "coolant_delay",
        "entropic_heat",
        "flow_dependent_cooling",
        "polarization",
        "resistance_temperature",
        "surface_joule",
        "thermocouple_lag",
    ],
)
def test_cores_are_inside_their_bands_one_tick_after_the_first_frames(name, tmp_path):
    results = restarts(name, SEED, tmp_path)
    error, sd = (np.concatenate([getattr(r, what)[1].ravel() for r in results]) for what in ("error", "sd"))
    outside, worst, middle = int(np.sum(np.abs(error) > 2 * sd)), np.abs(error / sd).max(), float(np.median(sd))
    print(f"{name}: {len(sd)} cores after {len(results)} restarts, {outside} outside 2 sd, at worst {worst:.1f} sd")
    print(f"median {middle:.2f} K; at the first tick {sum(r.sent(0) for r in results)} were sent")
    assert np.isfinite(error).all()
    assert outside <= 0.05 * len(sd)
    assert worst < 3.0
    assert middle < 2.0
