"""Without a DBC: each field of a message is proposed once, by the cut that has all of its digits and nothing else."""

import tempfile
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.setup.bit_cuts import likeliest_cuts
from bms_gateway.setup.bit_fields import fields_of, name_of
from bms_gateway.setup.vehicle_logs import read_traffic
from bms_gateway.setup.without_dbc import guess
from tests.setup.every_vehicle import EVERY
from tests.setup.vehicles import write

FIELDS = {
    "german": ("0x120 bits 7|16@0+", "0x120 bits 23|16@0+"),
    "terse": ("0x100 bits 7|16@0-", None),
    "french": ("0x400 bits 7|16@0+", "0x400 bits 23|16@0+"),
    "bus": ("0x18FF50F4 bits 0|16@1+", "0x18FF50F4 bits 16|16@1+"),
    "chinese": ("0x444 bits 16|16@1+", "0x444 bits 0|16@1+"),
    "storage": ("0x356 bits 16|16@1-", "0x356 bits 0|16@1+"),
    "worded": ("0x191 bits 12|12@1+", None),
}
"""Where their DBC has current and voltage."""


@pytest.fixture(scope="module")
def guesses():
    done = {}

    def of(name):
        if name not in done:
            with tempfile.TemporaryDirectory() as folder:
                log, _ = write(EVERY[name](), Path(folder))
                done[name] = guess(read_traffic([log], []).frames)
        return done[name]

    return of


@pytest.mark.parametrize("name", EVERY)
def test_no_bit_is_in_two_proposals(guesses, name):
    fields = [f for g in guesses(name) for f in (g.field, *g.beside)]
    assert [(name_of(a), name_of(b)) for a, b in combinations(fields, 2) if a.overlaps(b)] == []


@pytest.mark.parametrize("name", FIELDS)
def test_the_likeliest_cut_is_the_whole_field(guesses, name):
    current, voltage = FIELDS[name]
    found = {role: [name_of(g.field) for g in guesses(name) if g.role == role] for role in ("current", "voltage")}
    assert found["current"][0] == current
    if voltage is not None:
        assert found["voltage"][0] == voltage


def cuts(tmp_path, payloads):
    log = tmp_path / "made.log"
    log.write_text("".join(f"({1e9 + k / 10:.6f}) can0 100#{bytes(p).hex()}\n" for k, p in enumerate(payloads)))
    return {name_of(f).split()[-1][:-1] for f in likeliest_cuts(list(fields_of(read_traffic([log], []).frames)))}


def wandering(seed, low, high, step):
    """Wander between two ends."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.normal(0, step, 4000))
    return np.round(low + (high - low) * (0.5 + 0.5 * np.sin(x / (high - low) * 6.0))).astype(int)


@pytest.mark.parametrize("step", [3, 40, 400], ids=["slow", "as usual", "fast"])
def test_twelve_bits_beside_a_counter_a_state_or_nothing(tmp_path, step):
    x = wandering(1, 300, 3800, step)
    k = np.arange(len(x))
    for nibble in (k % 16, 5 + 0 * k, 1 + (k > 2500)):
        found = cuts(tmp_path, np.column_stack([x >> 4, (x & 15) << 4 | nibble]).tolist())
        assert found == {"7|12@0"}, nibble[-20:]


@pytest.mark.parametrize("step", [3, 40, 400, 4000], ids=["slow", "as usual", "fast", "wild"])
def test_sixteen_bits_in_either_order(tmp_path, step):
    x = wandering(2, 2000, 60000, step)
    assert cuts(tmp_path, np.column_stack([x & 255, x >> 8]).tolist()) == {"0|16@1"}
    assert cuts(tmp_path, np.column_stack([x >> 8, x & 255]).tolist()) == {"7|16@0"}


def test_two_temperatures_of_a_byte_each_stay_two(tmp_path):
    one, other = wandering(3, 60, 90, 0.3), wandering(4, 60, 90, 0.3)
    assert {"0|8@1", "8|8@1"} <= cuts(tmp_path, np.column_stack([one, other]).tolist())
