"""A number that a fit leaves wider than it was known before says so, and why."""

import numpy as np
import pytest

from bms_gateway.config.model_file import parse_model
from bms_gateway.diagnosis.core_band import posterior
from bms_gateway.diagnosis.core_known import known_core
from bms_gateway.diagnosis.record import make_record
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.report.core_text import numbers_remark, wider_than_known
from bms_gateway.workbench.contours import known
from tests.truth.hidden import Scenario, make_logs

WIDE = (
    "Wider than known before: R_e and R_u. These readings do not settle them, and they may have changed since then; "
    "an electrical resistance also changes with the temperature of its core."
)


@pytest.mark.parametrize(
    ("effect", "said"), [("sun_load", WIDE), ("core_loss", "")], ids=["settles nothing", "settles"]
)
def test_contours_that_are_wider_than_what_was_known_say_why(effect, said):
    # Bug: "R_e 10.1 to 54.5, known before 10.7 to 51.3", without a word
    (log,) = make_logs([Scenario({effect: ("strong", None)}, cells=1, sensors=(1,), seconds=1500, seed=5)])
    told = {name: np.array(values, np.float64) for name, values in log.table.items()}
    inputs = {k: told[k] for k in ("time_s", "current_A", "coolant_inlet_C", "coolant_flow_m3_s", "soc")}
    model = parse_model(log.model)
    core = known_core(model, [make_record(Columns(**inputs, surface_C={1: told["surface_1_C"]}), model)])
    fit = core.identified.fit
    sd, before = np.sqrt(np.diag(posterior(fit))), np.array([c.sd for c in fit.problem.coordinates])
    assert bool((sd[: len(before)] > 1.01 * before).any()) is bool(said)
    assert wider_than_known(fit) == said
    assert numbers_remark(core).endswith(said)
    assert known(fit)["wider"].startswith(
        "Wider than known before: internal electrical resistance (R_e) and " if said else ""
    )
    assert bool(known(fit)["wider"]) is bool(said)
