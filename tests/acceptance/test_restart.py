"""Restart while driving, after parking and with a clock that is wrong: cores back inside their bands at once.

At the first tick after a restart no surface is believed yet (a sensor must be seen twice), so the band is what the
stored state and the gap leave; a core whose band is wider than 12 K is not sent. One tick later surfaces count.
"""

import numpy as np
import pytest

from tests.acceptance.drives import EPOCH_S
from tests.acceptance.restarts import CELLS, driven, frames, gateway, parked, restart, states_at

pytestmark = pytest.mark.slow
GAPS = (5, 30, 120, 600)
PARKED = (600, 3600, 4 * 3600, 3 * 86_400)
SEEDS = (1,)


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """Per seed: drives, frames, seconds at which power was cut, and the state on the disk then, up to a minute old."""
    loaded = gateway(tmp_path_factory.mktemp("restart"))
    found = []
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        stops = [int(s) for s in rng.integers([400, 700, 1000], [690, 990, 1300])]
        saved = {s: s - int(rng.integers(0, 61)) for s in stops}
        drives = driven(1300 + max(GAPS) + 10, seed)
        traffic = frames(loaded, drives, seed)
        states = states_at(loaded, traffic, saved.values())
        found.append((seed, drives, traffic, {s: states[t] for s, t in saved.items()}))
    return loaded, found


def told(name, results, strings=2):
    """Check that no band is too narrow, and say what was seen; so many `strings` may be out whatever their share."""
    cores = sum(r.error[1].size for r in results)
    outside = [sum(r.outside(tick) for r in results) for tick in (0, 1)]
    sent = [sum(r.sent(tick) for r in results) for tick in (0, 1)]
    all_in = sum(r.outside(1) == 0 for r in results)
    sd = float(np.nanmedian(np.concatenate([r.sd[1].ravel() for r in results])))
    worst = max(float(np.nanmax(np.abs(r.error[1] / r.sd[1]))) for r in results)
    share = 100.0 * (1.0 - outside[1] / cores)
    print(f"{name}: {len(results)} restarts, {cores} cores; first tick: {sent[0]} sent, {outside[0]} outside 2 sd")
    print(f"one tick later: {sent[1]} sent, {share:.1f} % inside 2 sd ({all_in} restarts wholly), median {sd:.2f} K")
    print(f"at worst {worst:.1f} sd")
    assert sent[1] == cores
    # the cores of a string err together, so a share is a matter of whole strings
    assert outside[1] <= max(0.05 * cores, strings * CELLS)
    assert worst < 4.0
    assert outside[0] <= 0.07 * max(sent[0], 1)
    assert sd < 3.0


def test_while_driving_current_flowing_in_the_gap(stopped):
    """Over ten seeds: of 7,200 cores 0.9 % outside two standard deviations one tick later, at worst 2.6; median 1.27 K.

    They are those of 8 of 120 restarts. At the first tick 133 of the 5,422 that are sent (2.5 %).
    """
    loaded, found = stopped
    results = [
        restart(loaded, drives, traffic, state, stop + gap)
        for _, drives, traffic, states in found
        for stop, state in states.items()
        for gap in GAPS
    ]
    told("driving on", results)


def test_after_parking_for_minutes_hours_and_days(stopped):
    loaded, found = stopped
    results = []
    for seed, drives, _, states in found:
        for (stop, state), pause in zip([*states.items()] * 2, PARKED, strict=False):
            again = driven(8, seed + 50, parked(drives, stop, pause))
            later = frames(loaded, again, seed)
            results.append(restart(loaded, again, later, state, 1, clock_s=stop + pause - 1))
    told("parked", results, strings=0)


@pytest.mark.parametrize("clock", ["starts in 1970", "went back by an hour", "was 1970 when saved"])
def test_with_a_clock_that_is_not_to_be_believed(stopped, clock):
    """Driving on after 5 and 120 s, or parked for four hours: nobody can tell which.

    With this seed and each of the three clocks alike 2 of 180 cores (1.1 %) are outside two standard deviations one
    tick later, in one restart, at worst 2.3. Over eleven seeds, before phases of an unseen drive were reckoned with, 7
    of 165 strings were. So of fifteen strings one.
    """
    loaded, found = stopped
    results = []
    for seed, drives, traffic, states in found:
        stop, state = next(iter(states.items()))
        by = {"starts in 1970": 100 - EPOCH_S, "went back by an hour": -3600, "was 1970 when saved": 0}[clock]
        if clock == "was 1970 when saved":
            state = state | {"tick_end_ns": state["tick_end_ns"] - EPOCH_S * 10**9}
        results += [restart(loaded, drives, traffic, state, stop + gap, clock_s=by) for gap in (5, 120)]
        again = driven(8, seed + 50, parked(drives, stop, 4 * 3600))
        results.append(restart(loaded, again, frames(loaded, again, seed), state, 1, clock_s=by))
    told(f"clock {clock}", results, strings=1)
