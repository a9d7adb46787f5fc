"""Rows of a day: what they say is what `analyze` writes for the same log, and what the errors were is counted right."""

import csv
import json

import numpy as np
import pytest

from bms_gateway.cli.main import main
from bms_gateway.config.load import load_config
from bms_gateway.engine import Estimated, Judgement
from bms_gateway.engine.readings import Layout
from bms_gateway.fleet.day import Days
from bms_gateway.fleet.keys import config_key
from bms_gateway.fleet.residual import LEVEL, REGIMES, Residuals
from bms_gateway.fleet.task import Task, analyse
from bms_gateway.thermal import Prior, StringModel
from tests.fleet.packs import EPOCH_S, logs
from tests.truth.hidden import Scenario

S = 1_000_000_000
MIDNIGHT = 1_700_006_400


def rows_of(config, log, vehicle="v"):
    outcome = analyse(Task(str(log), str(config), config_key(load_config(config).files), vehicle))
    assert outcome.error is None
    return outcome.rows


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A log over midnight, its rows, and what `analyze` makes of it."""
    folder = tmp_path_factory.mktemp("day")
    config, (log,) = logs(folder, {"v": Scenario(seed=3, seconds=300)}, MIDNIGHT - 170)
    assert main(["analyze", str(log), "--config", str(config), "--out", str(folder / "out")]) == 0
    with (folder / "out" / "estimates.csv").open() as f:
        estimates = list(csv.DictReader(f))
    with (folder / "out" / "parameters.csv").open() as f:
        parameters = list(csv.DictReader(f))
    summary = json.loads((folder / "out" / "summary.json").read_text())
    return rows_of(config, log), estimates, parameters, summary


def test_a_log_over_midnight_has_a_row_for_each_day(drive):
    rows, estimates, _, summary = drive
    assert [r["day"] for r in rows] == ["2023-11-14", "2023-11-15"]
    assert [r["duration_s"] for r in rows] == [170.0, 128.0]  # the last second is not over when the log ends
    assert [r["start_s"] for r in rows] == [MIDNIGHT - 170, MIDNIGHT]
    assert sum(r["frames"] for r in rows) <= summary["frames"]
    assert sum(r["frames"] for r in rows) > 0.98 * summary["frames"]
    assert len(estimates) == 5 * sum(r["duration_s"] for r in rows)


def compared(e, what):
    """Temperature of a row of `estimates.csv`, less the sd of a core that is not known to 3 K."""
    sd = float(e["core_sd_K"])
    return float(e[what]) - (sd if sd > 3.0 else 0.0)


def test_the_worst_core_of_a_day_is_that_of_the_estimates(drive):
    rows, estimates, _, _ = drive
    for row, day in zip(rows, ((0, MIDNIGHT), (MIDNIGHT, 2 * MIDNIGHT)), strict=True):
        of_day = [e for e in estimates if day[0] < float(e["time_s"]) <= day[1] and e["core_C"]]
        point = max(of_day, key=lambda e: compared(e, "centre_C"))
        assert row["hottest_point_C"] == pytest.approx(float(point["centre_C"]), abs=6e-4)
        assert row["hottest_point_sd_K"] == pytest.approx(float(point["centre_sd_K"]), abs=6e-4)
        same = {e["cell"] for e in of_day if abs(float(e["centre_C"]) - row["hottest_point_C"]) < 6e-4}
        assert str(row["hottest_point_cell"]) in same
        hottest = max(of_day, key=lambda e: compared(e, "core_C"))
        assert row["worst_core_C"] == pytest.approx(float(hottest["core_C"]), abs=6e-4)
        assert row["worst_core_sd_K"] == pytest.approx(float(hottest["core_sd_K"]), abs=6e-4)
        same = [e for e in of_day if abs(float(e["core_C"]) - row["worst_core_C"]) < 6e-4]
        assert (f"{row['worst_core_time_s']:.3f}", str(row["worst_core_cell"])) in {
            (e["time_s"], e["cell"]) for e in same
        }


def test_a_guess_is_not_the_worst_core_of_a_day(tmp_path):
    """The rule of `analyze`: a core that is not known to 3 K counts with its value less its sd."""
    config, _ = logs(tmp_path, {"v": Scenario(seed=3, seconds=2)}, EPOCH_S)
    plan = load_config(config).plan
    n = plan.strings[0].model.cells
    layout = Layout.of([plan.strings[0].name], [n])
    core, sd, some = np.full(n, 30.0), np.full(n, 0.5), np.zeros(n)
    core[1], core[3], sd[3] = 34.0, 41.0, 11.0
    days = Days(plan)
    days.take(Estimated(EPOCH_S * S, layout, core, sd, some, np.zeros(n, np.uint8), core + 1.0, sd, some, some))
    (row,) = days.finish()
    assert (row["worst_core_cell"], row["worst_core_C"], row["worst_core_sd_K"]) == (2, 34.0, 0.5)
    assert (row["hottest_point_cell"], row["hottest_point_C"], row["hottest_point_sd_K"]) == (2, 35.0, 0.5)


def test_parameters_of_a_row_are_those_that_analyze_ends_with(drive):
    rows, _, parameters, _ = drive
    for name, column in (("R_e", "mOhm"), ("R_u", "K_W")):
        last = [p for p in parameters if p["name"] == name][-1]
        assert rows[-1][f"{name}_{column}"] == pytest.approx(float(last["value"]), rel=1e-5)
        assert rows[-1][f"{name}_sd_{column}"] == pytest.approx(float(last["sd"]), rel=1e-5)
        assert rows[-1][f"{name}_status"] == last["status"]


def test_rejected_samples_are_those_that_analyze_counts(drive):
    rows, _, _, summary = drive
    both = {k: sum(r["rejected_reasons"].get(k, 0) for r in rows) for k in summary["rejected"]}
    assert all(0.98 * n - 2 <= both[k] <= n for k, n in summary["rejected"].items())
    assert all(r["rejected"] == sum(r["rejected_reasons"].values()) for r in rows)


def test_a_stamp_of_another_century_makes_no_day_of_its_own(drive, tmp_path):
    config, (log,) = logs(tmp_path, {"v": Scenario(seed=3, seconds=60)}, EPOCH_S)
    lines = log.read_text().splitlines(keepends=True)
    at = len(lines) // 2
    stamp = lines[at].split(" ")[0]
    lines[at] = lines[at].replace(stamp, "(4100000000.000000)")
    log.write_text("".join(lines))
    assert [r["day"] for r in rows_of(config, log)] == ["2023-11-14"]


MODEL = StringModel(
    3, (1, 3), "full",
    {k: Prior(v, 0.1) for k, v in (("C_c", 268.0), ("C_s", 18.8), ("R_e", 3.5e-3), ("R_c", 1.266), ("R_u", 0.79),
                                   ("R_cc", 4.0), ("C_f", 11.33))},
)  # fmt: skip


def judgement(e, sd, current, inlet=20.0, flow=1.0):
    return Judgement("s", e, sd, current, current**2, inlet, flow, np.nan, np.nan, 1.0, ())


def test_errors_are_counted_where_they_belong():
    rng = np.random.default_rng(1)
    K = 3000
    e, sd = rng.normal(0.05, 0.1, (K, 3)), np.full((K, 3), 0.2)
    e[:, 1] = np.nan  # no sensor there
    e[rng.random(K) < 0.1, 2] = np.nan
    current = np.where(np.arange(K) // 600 % 2 == 0, 0.0, np.where(np.arange(K) < 1200, 80.0, -80.0))
    inlet = np.where(np.arange(K) < 1500, 5.0, 40.0)
    r = Residuals(MODEL)
    for k in range(K):
        r.add((EPOCH_S + k) * S, judgement(e[k], sd[k], float(current[k]), float(inlet[k]), 0.5))
    found, seconds = r.take()
    at = {(f.regime, f.cell): f for f in found}
    assert {f.cell for f in found} == {1, 3}
    used = np.arange(K) >= 120  # the observer finds the state first
    for regime, inside in (("all", used), ("cold", used & (inlet < 10)), ("hot", used & (inlet > 35)),
                           ("charging", used & (current < 0)), ("low_flow", used)):  # fmt: skip
        assert seconds[list(REGIMES).index(regime)] == inside.sum()
        for cell in (1, 3):
            x = e[inside, cell - 1]
            x = x[np.isfinite(x)]
            f = at[regime, cell]
            assert f.readings == len(x)
            assert f.mean_K == pytest.approx(x.mean())
            assert f.rms_K == pytest.approx(np.sqrt(np.mean(x**2)))
            assert f.normalised == pytest.approx(np.sqrt(np.mean((x / 0.2) ** 2)))
            # no surer than the readings' own expected noise allows, and not absurdly unsure
            assert 0.199 / np.sqrt(len(x)) <= f.sd_K < 0.4 / np.sqrt(len(x))
    high, rest = at["high_current", 1].readings, at["rest", 1].readings
    assert 1200 < high < 1400  # two spans of 600 s, and the minute that they echo
    assert 1000 < rest < 1400


def test_constant_errors_of_thermocouples_are_a_row_of_their_own():
    r = Residuals(MODEL)
    for k in range(400):
        r.add((EPOCH_S + k) * S, judgement(np.array([0.1, np.nan, np.nan]), np.full(3, 0.2), 10.0))
    found = [f for f in r.take(np.array([0.4, 0.0, -1.2]))[0] if f.regime == LEVEL]
    assert [(f.cell, f.readings, f.mean_K) for f in found] == [(1, 280, 0.4)]  # of cell 3 nothing was read
    assert not [f for f in r.take(None)[0] if f.regime == LEVEL]


def test_an_error_that_stays_for_minutes_is_not_taken_for_many():
    rng = np.random.default_rng(2)
    means, sds = [], []
    for _ in range(30):
        slow = np.repeat(rng.normal(0, 0.1, 40), 120)  # one draw every two minutes
        r = Residuals(MODEL)
        for k, x in enumerate(slow):
            r.add((EPOCH_S // 120 * 120 + k) * S, judgement(np.full(3, x), np.full(3, 0.1), 0.0))
        f = r.take()[0][0]
        means.append(f.mean_K)
        sds.append(f.sd_K)
    assert np.std(means) < 1.5 * np.mean(sds)
    assert np.mean(sds) < 2.0 * np.std(means)
