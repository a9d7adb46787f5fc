"""Pictures of records that a fit takes means of: every row of the file is there all the same."""

import csv

import numpy as np
import pytest

from bms_gateway.config.model_file import parse_model
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.records.read import Reading, read_measurements
from bms_gateway.workbench import pictures
from bms_gateway.workbench.series import Shelf, drawn
from tests.truth.hidden import Scenario, make_log

SPIKE, AT = 5.0, 4321


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
