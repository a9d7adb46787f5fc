"""Pictures of records that a fit takes means of: every row of the file is there all the same."""

import csv

import numpy as np
import pytest

from bms_gateway.config.model_file import parse_model
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.records.read import Reading, read_measurements
from bms_gateway.workbench import pictures
from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.series import Shelf, drawn
from tests.support.desk_steps import done
from tests.truth.hidden import Scenario, make_log

SPIKE, AT = 5.0, 4321
NO_LOG = {"config": "", "string": "", "columns": []}


def written(path, log, every_s):
    """The rows of a log `every_s` apart, values between its seconds on straight lines, with a spike of one row."""
    t = np.arange(0.0, log.table["time_s"][-1], every_s)
    rows = {"time_s": t}
    for name, values in log.table.items():
        if name.startswith(("surface_", "current_A", "coolant_inlet")):
            rows[name] = np.interp(t, log.table["time_s"], values).round(4)
    rows["surface_1_C"][AT] += SPIKE
    with path.open("w", newline="") as file:
        write = csv.writer(file)
        write.writerow(rows)
        write.writerows(zip(*rows.values(), strict=True))
    return rows


@pytest.mark.parametrize(("cells", "hours", "every_s"), [(12, 2.0, 1.0), (2, 0.5, 0.1)])
def test_a_minute_shows_every_row_though_the_fit_takes_means(tmp_path, cells, hours, every_s):
    log = make_log(Scenario(cells=cells, sensors=(1, cells), noise=0.05, seconds=int(3600 * hours), seed=4, columns=()))
    rows, model = written(tmp_path / "long.csv", log, every_s), parse_model(log.model)
    seen = []
    (record,) = read_measurements([tmp_path / "long.csv"], model=model, reading=Reading(seen=seen.append))
    assert len(record.instants) < 0.6 * len(rows["time_s"]), "the fit takes every row: the record is too short"
    shelf = Shelf(tmp_path)
    figures = pictures.readings([measured(record, model)], shelf, [(seen[0], float(record.instants[0]))])
    shelf.save()
    at = rows["time_s"][AT]
    for figure, k, name in (
        ("surface-0-1", 0, "surface_1_C"),
        ("drive-0", 0, "current_A"),
        ("drive-0", 1, "coolant_inlet_C"),
    ):
        unit = figures[figure]["seconds"]
        shown = drawn(figures[figure], tmp_path, ((at - 30.0) / unit, (at + 30.0) / unit))["data"][k]
        t = np.array(shown["x"]) * unit
        inside = (t > at - 30.0 + 1e-3) & (t < at + 30.0 - 1e-3)
        want = (rows["time_s"] > at - 30.0 + 1e-3) & (rows["time_s"] < at + 30.0 - 1e-3)
        assert np.allclose(t[inside], rows["time_s"][want], atol=1e-3)
        assert np.allclose(np.array(shown["y"])[inside], rows[name][want], atol=1e-3)
    whole = drawn(figures["surface-0-1"], tmp_path)["data"][0]
    assert np.nanmax(whole["y"]) == pytest.approx(rows["surface_1_C"].max(), abs=1e-3)


def with_faults(log, fault, rng):
    """Rows of a log with a fault: rows without a current, rows at uneven times, a long gap, or an odd last row."""
    rows = {k: v.copy() for k, v in log.table.items() if k.startswith(("time_s", "surface_", "current_A", "coolant"))}
    n = len(rows["time_s"])
    if fault == "holes":
        rows["current_A"][rng.choice(np.arange(5, n - 5), 20, replace=False)] = np.nan
    elif fault == "uneven":
        keep = np.sort(rng.choice(n, n // 3, replace=False))
        rows = {k: v[keep] for k, v in rows.items()}
    elif fault == "gap":
        rows["time_s"][n // 2 :] += 3600.0
    else:
        rows["current_A"][-1] = -199.0
    return rows


@pytest.mark.parametrize("every_s", [1.0, 0.25])
@pytest.mark.parametrize("fault", ["holes", "uneven", "gap", "last"])
def test_current_and_inlet_are_the_rows_of_the_file_and_a_gap_is_open(tmp_path, fault, every_s):
    log = make_log(Scenario(cells=2, sensors=(1, 2), noise=0.05, seconds=1500, seed=5, columns=()))
    rows, model = with_faults(log, fault, np.random.default_rng(6)), parse_model(log.model)
    rows["time_s"] = rows["time_s"] * every_s if fault != "gap" else rows["time_s"]
    with (tmp_path / "odd.csv").open("w", newline="") as file:
        write = csv.writer(file)
        write.writerow(rows)
        write.writerows([("" if x != x else x for x in row) for row in zip(*rows.values(), strict=True)])
    seen = []
    (record,) = read_measurements([tmp_path / "odd.csv"], model=model, reading=Reading(seen=seen.append))
    shelf = Shelf(tmp_path)
    began = float(record.instants[0])
    figures = pictures.readings([measured(record, model)], shelf, [(seen[0], began)])
    shelf.save()
    unit, axis = figures["drive-0"]["seconds"], figures["drive-0"]["layout"]["xaxis"]["range"]
    for k, name in enumerate(("current_A", "coolant_inlet_C")):
        shown = drawn(figures["drive-0"], tmp_path)["data"][k]
        t, y = np.array(shown["x"]) * unit, np.array(shown["y"], np.float64)
        want = np.isfinite(rows[name])
        read = np.isfinite(y)
        assert np.allclose(t[read], rows["time_s"][want] - began, atol=1e-3)
        assert np.allclose(y[read], rows[name][want], atol=1e-3)
        assert axis[0] <= t[read][0] / unit + 1e-9
        assert t[read][-1] / unit <= axis[1] + 1e-9
        if fault == "gap":
            before, after = np.flatnonzero(read & (t < 1200.0))[-1], np.flatnonzero(read & (t > 3000.0))[0]
            opened = t[before + 1 : after]
            assert len(opened), "the gap is bridged by a line"
            if name == "current_A":
                assert opened[0] < t[before] + 60.0, "a current is held for an hour that nobody measured"


def test_the_band_of_the_sensor_holds_the_steps_of_its_readings(tmp_path):
    log = make_log(Scenario(cells=2, sensors=(1, 2), noise=0.05, step=0.1, seconds=1500, seed=5, columns=()))
    with (tmp_path / "steps.csv").open("w", newline="") as file:
        write = csv.writer(file)
        write.writerow(log.table)
        write.writerows(zip(*log.table.values(), strict=True))
    seen, model = [], parse_model(log.model)
    (record,) = read_measurements([tmp_path / "steps.csv"], model=model, reading=Reading(seen=seen.append))
    figures = pictures.readings([measured(record, model)], Shelf(tmp_path), [(seen[0], float(record.instants[0]))])
    for k in (1, 2):
        error = np.std(log.table[f"surface_{k}_C"] - log.surface[:, k - 1])
        assert error > 1.1 * 0.05
        lines = [s["y0"] for s in figures[f"surface-0-{k}"]["layout"]["shapes"] if s.get("yref") == "y2"]
        assert lines == pytest.approx([-2.0 * error, 2.0 * error], rel=0.15)  # without the steps 0.27 less


@pytest.mark.slow
def test_a_thermocouple_in_a_core_is_the_rows_of_the_file_also_after_a_restart_of_the_process(tmp_path):
    log = make_log(Scenario(cells=2, sensors=(1, 2), noise=0.05, seconds=1500, seed=7, columns=()))
    t = np.arange(0.0, log.table["time_s"][-1], 0.25)
    names = [k for k in log.table if k.startswith(("surface_", "current_A", "coolant_inlet"))]
    core = np.interp(t, log.table["time_s"], log.table["surface_1_C"]) + np.sin(t)  # faster than any step of a fit
    with (tmp_path / "core.csv").open("w", newline="") as file:
        write = csv.writer(file)
        write.writerow(["time_s", *names, "core_1_C"])
        columns = [np.interp(t, log.table["time_s"], log.table[k]) for k in names]
        write.writerows(zip(t, *(c.round(4) for c in columns), core.round(4), strict=True))
    (tmp_path / "model.toml").write_text(log.model)
    desk = Desk("rows")
    try:
        desk.open({**NO_LOG, "tables": [str(tmp_path / "core.csv")], "model": str(tmp_path / "model.toml")})
        assert done(desk)["error"] == ""
        for effect in ("coolant_delay", "radial_gradient"):
            shown = desk.figure("core-0-1", (10.0, 11.2))["data"][0]  # minutes
            at = 60.0 * np.array(shown["x"])
            inside, want = (at > 600.1) & (at < 671.9), (t > 600.1) & (t < 671.9)
            assert np.allclose(at[inside], t[want], atol=0.01)
            assert np.allclose(np.array(shown["y"])[inside], core[want], atol=1e-3)
            desk.rest()
            desk.add([effect], force=True)  # a new process reads the files, and draws the cores anew
            assert done(desk)["error"] == ""
    finally:
        desk.close()
