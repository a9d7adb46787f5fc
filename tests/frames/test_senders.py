"""Parameter groups of J1939 are read from one sender at a time: that of the DBC, or the first that is heard."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bms_gateway.bus.filters import group_filters
from bms_gateway.frames.batch import EXTENDED, FrameBatch
from bms_gateway.frames.j1939 import Senders, parameter_group

NAMED = 0x18FEF1FE | EXTENDED
"""A broadcast group, sent by nobody."""
TO_ONE = 0x0CEF2117 | EXTENDED
"""A group with a destination."""


def batch(*can_ids):
    n = len(can_ids)
    return FrameBatch(
        np.arange(n, dtype=np.int64), np.array(can_ids, np.uint32), np.full(n, 8, np.uint8), np.zeros((n, 8), np.uint8)
    )


def sent_by(address, can_id=NAMED):
    return (can_id & ~0xFF) | address


@given(
    st.lists(st.lists(st.sampled_from([0x17, 0x56, 0x57, 0xFE]), min_size=1, max_size=6), min_size=1, max_size=6),
)
def test_one_sender_is_read_at_a_time_however_the_frames_are_cut_into_batches(rounds):
    senders, read = Senders([NAMED]), []
    for addresses in rounds:
        found = senders.named(batch(*map(sent_by, addresses)))
        read += [i == NAMED for i in found.can_id.tolist()]
    heard = [a for addresses in rounds for a in addresses]
    own = heard.index(0xFE) if 0xFE in heard else len(heard)
    assert read == [a == (heard[0] if k < own else 0xFE) for k, a in enumerate(heard)]
    assert senders.heard == ({} if 0xFE in heard else {NAMED: heard[0]})


def test_the_sender_of_the_dbc_ends_another_s_turn():
    senders = Senders([NAMED])
    assert senders.named(batch(sent_by(0x56))).can_id.tolist() == [NAMED]
    assert senders.named(batch(NAMED, sent_by(0x56))).can_id.tolist() == [NAMED, sent_by(0x56)]
    assert senders.named(batch(sent_by(0x56))).can_id.tolist() == [sent_by(0x56)]


def test_priority_and_destination_belong_to_no_group():
    senders = Senders([NAMED, TO_ONE])
    other_priority, other_place = sent_by(0x56) & ~(7 << 26), 0x0CEF4433 | EXTENDED
    assert senders.named(batch(other_priority, other_place)).can_id.tolist() == [NAMED, TO_ONE]


def test_standard_identifiers_and_other_groups_stay():
    frames = batch(0xFEF1, 0x1FE, sent_by(0x56, 0x18FEF2FE | EXTENDED))
    assert Senders([NAMED]).named(frames) is frames


def test_a_group_that_the_dbc_has_from_two_senders_is_told_by_these_only():
    both = [sent_by(0x17), sent_by(0x18)]
    frames = batch(sent_by(0x56), *both)
    assert Senders(both).named(frames) is frames
    assert Senders(both[:1], both).named(frames) is frames


@given(st.integers(0, 0x1FFF_FFFF), st.sampled_from([NAMED, TO_ONE]))
def test_the_kernel_lets_a_group_pass_and_nothing_else(can_id, wanted):
    ((base, mask),) = group_filters([wanted])
    passes = (can_id | EXTENDED) & mask == base
    assert passes == (parameter_group(can_id) == parameter_group(wanted))
    assert can_id & 0x7FF & mask != base  # no standard frame
