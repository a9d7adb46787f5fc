"""The scores of the benchmark of honesty against oracles of their own, and what it takes for "told"."""

import json

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from tests.benchmarks.honesty_road import ROOT, drive_through, stated
from tests.benchmarks.honesty_scores import crps, score
from tests.config.bench_cell import write_bench_cell


@pytest.mark.parametrize(
    ("mean", "sd", "true"), [(0.0, 1.0, 0.0), (30.0, 2.5, 33.0), (20.0, 0.3, 14.0), (5.0, 8.0, 4.0)]
)
def test_crps_is_the_integral_that_defines_it(mean, sd, true):
    below = quad(lambda x: norm.cdf(x, mean, sd) ** 2, min(mean, true) - 12 * sd, true, epsabs=1e-10, limit=200)[0]
    above = quad(lambda x: norm.sf(x, mean, sd) ** 2, true, max(mean, true) + 12 * sd, epsabs=1e-10, limit=200)[0]
    assert crps(mean, sd, true) == pytest.approx(below + above, abs=1e-7)


def test_crps_without_a_band_is_the_distance():
    assert crps(np.array([20.0, 31.0]), np.array([0.0, 1e-9]), np.array([23.5, 30.0])) == pytest.approx([3.5, 1.0])


def test_the_band_that_is_right_scores_best():
    rng = np.random.default_rng(1)
    error = 1.7 * rng.normal(size=200_000)
    mean = {sd: crps(0.0, sd, error).mean() for sd in (0.8, 1.3, 1.7, 2.2, 4.0)}
    assert min(mean, key=mean.get) == 1.7
    assert mean[1.7] == pytest.approx(1.7 / np.sqrt(np.pi), rel=0.01)  # its expectation for a calibrated Gaussian


def test_a_score_counted_by_hand():
    true = np.zeros((4, 2))
    core = np.array([[1.0, 0.0], [1.0, 0.0], [-3.0, 0.0], [np.nan, 0.0]])
    sd = np.array([[1.0, 0.5], [1.0, 0.5], [1.0, 0.5], [1.0, 0.5]])
    told = np.zeros((4, 2), bool)
    told[1:3, 0] = True
    s = score(core, sd, true, told)
    assert s.known == pytest.approx(7 / 8)
    assert s.rmse == pytest.approx(np.sqrt(11 / 7))
    assert s.bias == pytest.approx(-1 / 7)
    assert (s.inside, s.inside_worst) == (pytest.approx(6 / 7), pytest.approx(2 / 3))
    assert s.sd == 0.5
    assert s.error_sd == pytest.approx(3.0)
    assert s.sd_ratio == pytest.approx(np.sqrt((3 * 1.0 + 4 * 0.25) / 11))
    assert s.told == pytest.approx(2 / 8)
    assert s.untold == 0.0  # the one that lies outside had been told
    assert score(core, sd, true, np.zeros_like(told)).untold == pytest.approx(1 / 7)


def test_no_core_at_all_is_no_score():
    with pytest.raises(ValueError, match="no core"):
        score(np.full((3, 1), np.nan), np.ones((3, 1)), np.zeros((3, 1)))


def results(folder, *, events=(), alerts=None, quality=lambda k, cell: "good"):
    """A folder as `analyze` leaves it: two cells, 20 minutes, a row a minute."""
    rows = [f"{60 * k}.000,s,{c},25.0,1.0,24.0,{quality(k, c)}" for k in range(21) for c in (1, 2)]
    (folder / "estimates.csv").write_text("\n".join(["time_s,string,cell,core_C,core_sd_K,surface_C,quality", *rows]))
    (folder / "events.jsonl").write_text("".join(json.dumps(e) + "\n" for e in events))
    if alerts is not None:
        (folder / "alerts.jsonl").write_text("".join(json.dumps(a) + "\n" for a in alerts))
    return stated(folder)


def event(minute, code, level, cell=None):
    return {"time_s": 60.0 * minute, "level": level, "code": code, "string": "s", "cell": cell, "text": ""}


def alert(minute, name, state, cell=None):
    return {"time_s": 60.0 * minute, "name": name, "state": state, "severity": "warning", "string": "s", "cell": cell}


def test_a_flag_stands_until_it_is_taken_back(tmp_path):
    s = results(tmp_path, events=[event(12, "mismatch", "warning"), event(15, "mismatch", "notice")])
    assert s.told[:, 0].nonzero()[0].tolist() == [12, 13, 14]
    assert (s.told[:, 0] == s.told[:, 1]).all()  # of the string: of all its cells
    assert s.since == {"mismatch": 720.0}


def test_a_flag_that_rose_before_is_told_as_long_as_it_stands(tmp_path):
    s = results(tmp_path, events=[event(2, "thermocouple", "warning", 2), event(3, "mismatch", "warning"),
                                  event(5, "mismatch", "warning"), event(8, "mismatch", "notice")])  # fmt: skip
    assert s.told[:, 1].nonzero()[0].tolist() == list(range(2, 21))
    assert s.told[:, 0].nonzero()[0].tolist() == [3, 4, 5, 6, 7]
    assert s.since == {"thermocouple": 120.0}  # the other was over when judging began


def test_alerts_and_doubtful_cores_are_told_and_what_is_no_doubt_is_not(tmp_path):
    s = results(
        tmp_path,
        events=[event(11, "ageing", "info"), event(12, "baseline", "notice")],
        alerts=[alert(13, "unproven", "raised", 1), alert(14, "unproven", "changed", 1),
                alert(16, "unproven", "over", 1),
                alert(17, "forecast", "raised")],
        quality=lambda k, cell: "doubtful" if cell == 2 and k >= 18 else "estimated" if cell == 2 else "good",
    )  # fmt: skip
    assert s.told[:, 0].nonzero()[0].tolist() == [13, 14, 15]
    assert s.told[:, 1].nonzero()[0].tolist() == [18, 19, 20]
    assert s.since == {"alert unproven": 780.0, "quality doubtful": 1080.0}


def test_the_road_says_what_went_wrong(tmp_path):
    config = write_bench_cell(tmp_path)
    table = tmp_path / "cell.csv"
    table.write_text("time_s,current_A,coolant_inlet_C\n0,1,20\n1,1,20\n")
    with pytest.raises(RuntimeError, match="no column 'surface_1_C'"):
        drive_through(ROOT, table, config, tmp_path / "out")


def test_the_road_from_a_table_to_what_is_stated(tmp_path):
    config = write_bench_cell(tmp_path, method="off")
    table = tmp_path / "cell.csv"
    rows = [f"{k},10,20,{20 + 0.004 * k:.3f}" for k in range(90)]
    table.write_text("\n".join(["time_s,current_A,coolant_inlet_C,surface_1_C", *rows]))
    s = drive_through(ROOT, table, config, tmp_path / "out")
    assert s.core.shape == s.sd.shape == s.told.shape == (len(s.time_s), 1)
    assert (s.time_s[0], s.time_s[-1]) == (1.0, 89.0)
    assert s.told[0, 0]  # not available before anything was received
    assert not s.told[30:].any()
    assert 20.0 < s.core[-1, 0] < 25.0
    assert s.sd[-1, 0] > 0.0
    assert s.since == {}
