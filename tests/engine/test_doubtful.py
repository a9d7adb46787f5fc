"""Cores that are not proven: sent as doubtful with the wider band, and everything else of the string as ever."""

from dataclasses import replace

import numpy as np

from bms_gateway.frames.quality import Quality
from bms_gateway.thermal import Posterior
from tests.engine.doubtful_runs import run
from tests.engine.packs import plan
from tests.frames.payloads import OWN, parsed

WHY = ("The model does not explain the surfaces.",)


def doubted(share=0.0, why=WHY):
    """Plan whose first string is not proven."""
    p = plan(2)
    first = p.strings[0]
    m = replace(first.model, posterior=Posterior(*first.model.free_numbers, 0.1, share, False, why))
    return replace(p, strings=(replace(first, model=m), p.strings[1]))


def test_estimates_of_a_string_that_is_not_proven_are_doubtful_and_those_beside_it_are_not():
    plain, _ = run(plan(2))
    found, _ = run(doubted())
    assert (plain[-1].quality[0], plain[-1].quality[1]) == (Quality.GOOD, Quality.ESTIMATED)
    assert (found[-1].quality[:4] == Quality.DOUBTFUL).all()
    assert np.array_equal(found[-1].quality[4:], plain[-1].quality[4:])
    for a, b in zip(found, plain, strict=True):
        assert np.array_equal(a.core, b.core, equal_nan=True)
        assert np.array_equal(a.core_sd, b.core_sd, equal_nan=True)


def test_a_fault_of_a_sensor_is_told_before_the_doubt():
    plain, doubt = run(plan(2), 2)[0][0], run(doubted(), 2)[0][0]
    faults = ~np.isin(plain.quality, [Quality.GOOD, Quality.ESTIMATED])
    assert np.array_equal(doubt.quality[faults], plain.quality[faults])


def test_what_may_be_wrong_of_core_minus_surface_is_in_the_band():
    plain, _ = run(plan(2))
    found, _ = run(doubted(0.4))
    gap = plain[-1].core[:4] - plain[-1].surface[:4]
    assert np.abs(gap).max() > 0.5
    assert np.allclose(found[-1].core_sd[:4], np.hypot(plain[-1].core_sd[:4], 0.4 * gap))
    assert np.array_equal(found[-1].core_sd[4:], plain[-1].core_sd[4:])
    assert np.array_equal(found[-1].core, plain[-1].core)
    above = plain[-1].centre[:4] - plain[-1].surface[:4]
    assert np.allclose(found[-1].centre_sd[:4], np.hypot(plain[-1].centre_sd[:4], 0.4 * above))
    assert np.array_equal(found[-1].centre_sd[4:], plain[-1].centre_sd[4:])
    assert np.array_equal(found[-1].centre, plain[-1].centre)


def test_the_bus_says_doubtful():
    """By the DBC as another tool reads it."""
    _, frames = run(doubted())
    db = parsed(OWN)
    for number, words in ((1, {"doubtful"}), (2, {"good", "estimated"})):
        message = db.get_message_by_name(f"string_{number}_core")
        mine = frames.data[frames.can_id & 0x1FFFFFFF == message.frame_id][-4:]
        told = [db.decode_message(message.frame_id, bytes(row.tobytes())) for row in mine]
        assert {str(v) for one in told for k, v in one.items() if k.startswith("quality_")} == words
