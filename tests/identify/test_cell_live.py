"""Cells identified while driving: when a fit is asked for, what ends a record, and what a restart keeps."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from bms_gateway.errors import StateError
from bms_gateway.identify import PairMeans, Tick
from bms_gateway.identify.cell_live import MILESTONES_S, STALE_S, CellIdentifier
from bms_gateway.identify.contract import Posterior, log_prior
from tests.identify.cell_strings import ENDS, model
from tests.truth.unequal import drives

MINUTES = 31


@pytest.fixture(scope="module")
def pack():
    return drives([5], minutes=MINUTES, swing=5.0)


def common(m):
    names, mean, sd = log_prior(m)
    return Posterior(names, mean, np.diag(sd**2))


def ticks(d, sensors=ENDS, first=0):
    y = np.full(d.readings.shape[1:], np.nan)
    y[:, [k - 1 for k in sensors]] = d.readings[0][:, [k - 1 for k in sensors]]
    for k, current in enumerate(d.current[first:], start=first):
        yield Tick((k + 1) * 10**9, 1.0, float(current**2), np.nan, float(d.inlet[k + 1]), y[k], np.zeros(5)), k


def run(identifier, d, *, voltages=True, m=None, edit=lambda tick, k: tick, flow=1.0, first=0):
    """Drive through; the jobs asked for, with the second at which they were."""
    V, jobs, before = d.voltage(0, 0.03), [], partial(common, m or model())
    for tick, k in ticks(d, first=first):
        same = np.full(5, d.current[k])
        pairs = PairMeans(same, same**2, V[k], same * V[k]) if voltages else None
        job = identifier.add(edit(tick, k), pairs, float(d.current[k]), flow, before)
        if job is not None:
            identifier.accept(job.run())
            jobs.append((k, job))
    return jobs


def test_the_first_fit_comes_after_half_an_hour_and_finds_the_cells(pack) -> None:
    identifier = CellIdentifier(model())
    assert identifier.estimates() == ()
    assert identifier.numbers() is None
    jobs = run(identifier, pack)
    assert [k for k, _ in jobs] == [MILESTONES_S[0]]
    assert identifier.fit is not None
    off = np.log(identifier.fit.R_e / pack.R_e[0])
    assert (np.abs(off) < 3 * identifier.fit.rel_sd).all()
    numbers = identifier.numbers()
    assert numbers is not None
    assert numbers.values["R_e"][2] > 1.08 * numbers.values["R_e"][0]
    assert {e.status for e in identifier.estimates()} == {"identified"}


def test_a_fit_that_is_long_ago_is_no_longer_for_the_observer(pack) -> None:
    """The voltages have ceased; what the string has in common is followed on."""
    identifier = CellIdentifier(model())
    run(identifier, pack)
    tick, _ = next(ticks(pack))
    assert identifier.add(replace(tick, dt=900.0), None, 0.0, 1.0, lambda: common(model())) is None
    assert identifier.numbers() is not None
    for _ in range(int(STALE_S)):
        assert identifier.add(tick, None, 0.0, 1.0, lambda: common(model())) is None
    assert identifier.numbers() is None
    assert identifier.estimates()


def test_the_same_job_gives_the_same_result(pack) -> None:
    ((_, job),) = run(CellIdentifier(model()), pack)
    assert job.run().fit.mean.tobytes() == job.run().fit.mean.tobytes()


def test_without_voltages_nothing_is_fitted_and_nothing_kept(pack) -> None:
    identifier = CellIdentifier(model())
    assert run(identifier, pack, voltages=False) == []
    assert identifier.estimates() == ()


@pytest.mark.parametrize(
    "edit",
    [
        lambda t, k: replace(t, dt=900.0) if k == 1000 else t,
        lambda t, k: replace(t, mean_square_current=np.nan) if 1000 <= k < 1020 else t,
        lambda t, k: replace(t, inlet=np.nan) if 1000 <= k < 1090 else t,
    ],
    ids=["gap", "no current", "no inlet"],
)
def test_a_record_ends_where_it_would_have_to_be_made_up(pack, edit) -> None:
    assert run(CellIdentifier(model()), pack, edit=edit) == []


def test_short_holes_are_bridged(pack) -> None:
    def edit(t, k):
        t = replace(t, mean_square_current=np.nan) if 500 <= k < 505 else t
        return replace(t, inlet=np.nan) if 700 <= k < 730 else t

    assert len(run(CellIdentifier(model()), pack, edit=edit)) == 1


def test_another_flow_is_taken_for_another_C_f(pack) -> None:
    """Half the flow with twice the nominal C_f is the same stream; the result is told at nominal flow."""
    usual, halved = CellIdentifier(model()), None
    run(usual, pack)
    m = model()
    m = replace(m, priors={**m.priors, "C_f": replace(m.priors["C_f"], value=2 * m.priors["C_f"].value)})
    halved = CellIdentifier(m)
    run(halved, pack, m=m, flow=0.5)
    assert halved.fit.R_e == pytest.approx(usual.fit.R_e, rel=1e-6)
    C_f = [np.exp(i.fit.mean[i.fit.layout.at("C_f")[0]]) for i in (usual, halved)]
    assert C_f[1] == pytest.approx(2 * C_f[0], rel=1e-6)


def test_a_restart_keeps_what_was_found(pack) -> None:
    one, two = CellIdentifier(model()), CellIdentifier(model())
    run(one, pack)
    two.restore(json.loads(json.dumps(one.snapshot(), allow_nan=False)))
    assert two.estimates() == one.estimates()
    assert json.dumps(two.snapshot()) == json.dumps(one.snapshot())
    assert two.numbers().own.tobytes() == one.numbers().own.tobytes()
    nothing = CellIdentifier(model())
    nothing.restore(json.loads(json.dumps(CellIdentifier(model()).snapshot(), allow_nan=False)))
    assert nothing.estimates() == ()


def test_a_state_of_another_string_or_a_damaged_one_is_refused(pack) -> None:
    one = CellIdentifier(model())
    run(one, pack)
    state = json.loads(json.dumps(one.snapshot()))
    with pytest.raises(StateError, match="another string"):
        CellIdentifier(model((1, 4), 4)).restore(state)
    state["fit"]["cov"][0] = -1.0
    with pytest.raises(StateError, match="damaged"):
        CellIdentifier(model()).restore(state)
