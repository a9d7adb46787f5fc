"""Heat leaves casings, cores, or both: the band of the core holds every share of the two, and no more than that."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.config.model_file import format_model, parse_model
from bms_gateway.diagnosis.calibrate import identify
from bms_gateway.diagnosis.core_known import judged_model, known_core
from bms_gateway.report.core_text import EXCHANGED, core_sentence
from bms_gateway.thermal import AddedEffect
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import Scenario, make_log

LOSS = AddedEffect("", None, {"G": 0.06, "P": 0.6}, {"G": 0.2, "P": 2.0})


def packs():
    """What a pack loses, of which size, what the model calls it, and the largest sd of a core that is still of use."""
    core, both = {"core_loss": "strong"}, {"core_loss": "medium", "ambient_loss": "medium"}
    return [
        (core, "core_loss", 1, 31, 1.5),
        (both, "ambient_loss", 1, 41, 3.0),
        (both, "core_loss", 1, 41, 4.0),
        ({"ambient_loss": "strong"}, "ambient_loss", 1, 32, 1.5),
        ({"core_loss": "medium"}, "core_loss", 5, 33, 1.5),
        ({"core_loss": "medium"}, "ambient_loss", 5, 33, 2.0),
        ({"ambient_loss": "medium"}, "ambient_loss", 5, 34, 1.5),
        (both, "core_loss", 5, 42, 4.5),
        (both, "ambient_loss", 5, 42, 3.0),
    ]


@pytest.mark.plain_cases(2)
@pytest.mark.parametrize(("hidden", "called", "cells", "seed", "most_sd"), packs())
def test_the_band_holds_every_share_of_the_two_losses(hidden, called, cells, seed, most_sd):
    """It was a third of core minus surface, 3 to 7 K, whatever the readings told of it."""
    sensors = (1,) if cells == 1 else (1, 3, 5)
    effects = {name: (size, None) for name, size in hidden.items()}
    log = make_log(Scenario(effects, cells=cells, sensors=sensors, seed=seed, noise=0.05))
    record, model = record_of(log)
    lost = replace(model, effects=(replace(LOSS, name=called),))
    found = identify(lost, [record])
    core = known_core(lost, [record], found)
    (band,) = core.bands
    truth = np.stack([np.interp(band.time_s, np.arange(len(c)), c) for c in log.core.T], axis=1)
    assert np.mean(np.abs(band.T_c - truth) <= 2.0 * band.total_K) > 0.95
    assert core.sd_K < most_sd
    assert not core.proven
    # the file carries it, and gives it again
    written, stated = judged_model(found, lost, [record], before=known_core(model, [record]))
    assert written.core_doubt == core.exchanged
    again = known_core(parse_model(format_model(written)), [record])
    assert again.sd_K == pytest.approx(stated.sd_K, rel=0.02)
    assert again.why == core.why
    # a band that may be narrower than before although nothing is proven says what it holds
    assert core_sentence(core).startswith("Core not proven: ")
    assert all(EXCHANGED in core_sentence(c) for c in (core, stated, again))


def test_what_speaks_against_the_core_beside_the_losses_keeps_the_wide_band():
    """A loss of the casings called one of the cores: the capacities end far from what was known."""
    log = make_log(Scenario({"ambient_loss": ("strong", None)}, cells=1, sensors=(1,), seed=32, noise=0.05))
    record, model = record_of(log)
    core = known_core(replace(model, effects=(replace(LOSS, name="core_loss"),)), [record])
    assert core.exchanged is None
    assert len(core.why) > 1
    assert core.sd_K > 3.0
    assert EXCHANGED not in core_sentence(core)
