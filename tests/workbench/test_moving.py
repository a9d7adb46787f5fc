"""The bar moves with the work, never back, and the parameters' correlation is that of the physics."""

import numpy as np
import pytest

from bms_gateway.config.model_file import read_model
from bms_gateway.diagnosis.compare import compare
from bms_gateway.identify.effort import beat, heard
from bms_gateway.records.read import read_measurements
from bms_gateway.report.html_correlation import correlation_table, correlations
from bms_gateway.thermal import KINDS
from bms_gateway.workbench.moving import Moving
from tests.truth.packs import pack as make_pack

R_E, R_U = "internal electrical resistance (R_e)", f"{KINDS['R_u'].description} (R_u)"


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    pack = make_pack(tmp_path_factory.mktemp("pack"))
    model = read_model(pack.model)
    return compare(model, read_measurements([pack.clean], model=model))


def test_the_bar_moves_between_steps_and_never_back(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("bms_gateway.workbench.moving.time.monotonic", lambda: now[0])
    told = []
    moving = Moving(lambda share, text: told.append((share, text)))
    moving.step(0.1, "fitting")
    with heard(moving.beat):
        for _ in range(2000):
            now[0] += 0.05
            beat()
    moving.step(0.12, "screening")  # less than what the pieces had moved it to
    moving.step(0.98, "judging")
    for _ in range(2000):
        now[0] += 0.05
        moving.beat()
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert 0.17 < max(share for share, text in told if text.startswith("fitting")) <= 0.2
    assert shares[-1] < 1.0
    assert len([t for _, t in told if t.startswith("fitting")]) == pytest.approx(2000 * 0.05 / 0.25, rel=0.2)
    beat()  # nobody listens any more


def test_a_fit_tells_its_pieces(compared):
    count = []
    problem = compared.refitted.fit.problem
    with heard(lambda: count.append(1)):
        problem.predict(compared.refitted.fit.theta)
        problem.columns(compared.refitted.fit.theta, compared.refitted.fit.prediction, problem.coordinates)
    assert len(count) >= 2


def test_what_only_a_product_tells_is_correlated(compared):
    """At rest the surface tells R_e·R_u: a larger R_e goes with a smaller R_u."""
    names, r = correlations(compared.refitted.fit)
    assert np.allclose(np.diag(r), 1.0)
    assert np.allclose(r, r.T)
    assert r[names.index(R_E), names.index(R_U)] < -0.3
    table = correlation_table(compared.refitted.fit)
    assert table.count("<tr>") == 1 + len(names)
    place = 1 + names.index(R_U)
    assert f">{place} {R_U}</th>" in table
    assert f'aria-label="{R_U}">{place}</th>' in table
