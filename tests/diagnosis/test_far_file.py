"""A file whose numbers are far off makes no core of a later model unknown for good, and no core certain either."""

import re
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import cast

import numpy as np

from bms_gateway.diagnosis.adding import UNKNOWN, Wanted, add_effects
from bms_gateway.diagnosis.core_band import UNPROVEN
from bms_gateway.diagnosis.core_known import farthest
from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.diagnosis.verdict_parts import errors
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.report.add_text import headline
from bms_gateway.report.added import added_report
from bms_gateway.report.core_text import UNKNOWN_K, core_sentence
from bms_gateway.report.show import kelvins
from tests.diagnosis.hidden_record import hidden

OFF = {"R_e": 3.0, "R_u": 4.0}
"""How far the numbers of the file are from those of the cell, which is as if a fan had not been told."""
KNOWN = {"C_c": 0.1, "C_s": 0.1, "R_e": 0.4, "R_c": 0.5, "R_u": 0.4}


@cache
def added():
    """The log, and the addition of what its cell hides."""
    log, record, model = hidden(
        "polarization",
        "strong",
        cells=1,
        sensors=(1,),
        noise=0.05,
        cycle="mixed",
        inlet="sine",
        seconds=2700,
        seed=6_771_002,
    )
    priors = {n: replace(p, value=p.value * OFF.get(n, 1.0), rel_sd=KNOWN[n]) for n, p in model.priors.items()}
    far = replace(model, priors=priors)
    d = diagnose(far, [record])
    assert [s.candidate.key for s in d.selected] == ["polarization"]
    wants = [Wanted(s.candidate.effect) for s in d.selected]
    return log, record, add_effects(far, [record], wants, ask=lambda *_, **__: d)


def test_the_band_after_an_addition_is_not_that_of_numbers_which_never_fitted():
    """It stayed ± 80 K after a model that followed surface and core to the noise."""
    log, _, found = added()
    before, after = found.core
    assert before.half_width_K.max() > UNKNOWN_K
    assert not after.proven
    assert after.half_width_K.max() < 0.5 * before.half_width_K.max()
    assert after.half_width_K.max() < UNKNOWN_K
    (band,) = after.bands
    truth = np.stack([np.interp(band.time_s, np.arange(len(c)), c) for c in log.core.T], axis=1)
    assert np.mean(np.abs(band.T_c - truth) <= 1.96 * band.total_K) > 0.95
    # an addition that nothing proves makes no core more certain than the numbers which come closest without it
    assert found.model.core_doubt >= UNPROVEN
    assert after.half_width_K.max() >= before.at_closest.half_width_K.max() * (1.0 - 1e-3)


def test_what_else_speaks_against_the_core_keeps_the_band_of_before():
    *_, found = added()
    before, after = found.core
    wide = before.cell_sd_K.max()
    assert after.widened(after.share_for(before)).cell_sd_K.max() < 0.5 * wide
    for doubted in (replace(after, lacks=True), replace(after, why=(*after.why, UNKNOWN))):
        carried = doubted.widened(doubted.share_for(before))
        assert carried.cell_sd_K.max() >= wide * (1.0 - 1e-6)
        # and it is said why the band is that wide, and what to do
        said = core_sentence(carried)
        assert "correct it in the file and begin again, or calibrate" in said
        assert "Farthest from what was known is now thermal resistance surface to coolant (R_u)" in said
    assert "calibrate" not in core_sentence(after)


def test_numbers_near_those_of_the_file_keep_the_band_of_before():
    *_, found = added()
    before, _ = found.core
    near = replace(before, identified=replace(before.identified, fit=before.identified.closest))
    assert near.at_closest is near


def test_what_other_numbers_do_is_no_merit_of_what_was_added():
    """ "With thermocouples answer late the held-out error falls from 35.728 to 1.669 K": other numbers leave 1.6 K."""
    _, record, found = added()
    report = added_report(found, [record], (), (), out="x.toml")
    said = headline(report)
    before, after = report.held_K
    closest = errors(found.core[0].identified.closest).heldout_rmse_K
    assert closest < 0.5 * before
    assert said.startswith(
        "With slow polarisation (one RC pair) (polarization) the held-out error falls from "
        f"{kelvins(before)} to {kelvins(after)} K; noise alone leaves "
    )
    assert said.endswith(f" Without it, other numbers of the same model leave {kelvins(closest)} K.")
    assert all(len(x.replace(".", "").lstrip("0")) <= 3 for x in re.findall(r"\d+\.\d+", said))
    near = replace(report, before=replace(report.before, errors=replace(report.before.errors, closest_K=before)))
    assert "other numbers" not in headline(near)


def test_only_a_number_of_the_cells_that_is_far_is_to_be_corrected_in_the_file() -> None:
    """Bug: a C_s at half an sd was to be corrected, while a number of the effect lay 3.6 sd from what was known."""
    one = SimpleNamespace(prior=0.0, sd=1.0, only_start=False)
    C_s, R_e = (SimpleNamespace(**vars(one), name=name, effect=None) for name in ("C_s", "R_e"))
    P = SimpleNamespace(**vars(one), name="core_loss.P", effect="core_loss")

    def found(**moved: float) -> str:
        theta = np.array([moved.get("C_s", 0.0), moved.get("R_e", 0.0), moved.get("P", 0.0)])
        problem = SimpleNamespace(coordinates=[C_s, R_e, P])
        return farthest(cast("MapFit", SimpleNamespace(problem=problem, theta=theta)))

    assert found(C_s=0.5, P=-3.6) == ""
    assert found(C_s=0.5, R_e=-2.9) == ""
    assert found(C_s=3.2, R_e=-4.0, P=3.6) == "R_e"
