"""What `analyze` leaves behind is what the contract says, and readable by any CSV or JSON reader."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.engine.events import Cells, Estimated, Level, Notice, Parameters, SendFrames
from bms_gateway.engine.readings import Layout
from bms_gateway.errors import UsageError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.quality import Quality
from bms_gateway.identify.contract import Estimate
from bms_gateway.report.csv_out import ResultFolder
from bms_gateway.report.hottest import hottest_sentence
from bms_gateway.report.show import cells_table, text_table

S = 1_000_000_000


def estimated(t, core, quality=(0, 11)):
    core, half, q = np.array(core, float), np.full(2, 0.5), np.array(quality, np.uint8)
    return Estimated(
        t,
        Layout.of(["string_1"], [2]),
        core,
        half,
        core - 5.0,
        q,
        core + np.array([4.0, 2.5]),
        2.0 * half,
        *np.full((2, 2), np.nan),
    )


def test_numbers_of_effects_are_written_in_their_own_units(tmp_path):
    with ResultFolder(tmp_path / "out", {"string_1": 2}) as folder:
        told = (
            Estimate("resistance_drift.a", 0.05 / 3600, 0.01 / 3600, "1/h", "fixed"),
            Estimate("entropic_heat.dUdT", 4e-4, 1e-5, "mV/K", "fixed"),
            Estimate("cell_cooling:2.a", 0.25, 0.0, "1", "fixed"),
        )
        folder.write(Parameters(S, "string_1", told))
        folder.write_summary(frames=10, duration_s=2.0, dropped=0, rejected={})
    rows = list(csv.DictReader((tmp_path / "out" / "parameters.csv").read_text().splitlines()))
    assert [(r["name"], r["value"], r["sd"], r["unit"]) for r in rows] == [
        ("resistance_drift.a", "0.05", "0.01", "1/h"),
        ("entropic_heat.dUdT", "0.4", "0.01", "mV/K"),
        ("cell_cooling:2.a", "0.25", "0", "1"),
    ]


def test_the_files_hold_the_events(tmp_path):
    with ResultFolder(tmp_path / "new" / "out", {"string_1": 2}) as folder:
        folder.write(estimated(S, [30.0, 31.25]))
        folder.write(estimated(1_500_000_001, [np.nan, 33.0], (Quality.NEVER, Quality.STALE)))
        folder.write(SendFrames(S, FrameBatch.empty()))
        folder.write(
            Parameters(
                S,
                "string_1",
                (
                    Estimate("R_e", 0.0035, 0.0001, "mOhm", "identified"),
                    Estimate("R_c", np.nan, np.nan, "K/W", "not identifiable: flat, no excitation"),
                ),
            )
        )
        folder.write(Notice(2 * S, Level.WARNING, "sensor", "thermistor of cell 2 ±3 K is open", "string_1", 2))
        folder.write_summary(frames=10, duration_s=2.0, dropped=0, rejected={"stale": 2, "open": 1})
    out = tmp_path / "new" / "out"
    rows = list(csv.DictReader((out / "estimates.csv").read_text().splitlines()))
    assert rows[0] == {
        "time_s": "1.000",
        "string": "string_1",
        "cell": "1",
        "core_C": "30.000",
        "core_sd_K": "0.500",
        "surface_C": "25.000",
        "quality": "good",
        "centre_C": "34.000",
        "centre_sd_K": "1.000",
        "heat_W": "",
        "heat_sd_W": "",
    }
    assert [r["quality"] for r in rows] == ["good", "estimated", "never", "stale"]
    assert rows[2]["core_C"] == rows[2]["surface_C"] == rows[2]["centre_C"] == ""
    assert rows[2]["time_s"] == "1.500000001"
    parameters = list(csv.DictReader((out / "parameters.csv").read_text().splitlines()))
    assert list(parameters[0]) == ["time_s", "string", "name", "value", "sd", "unit", "status"]
    assert (parameters[0]["value"], parameters[0]["sd"], parameters[0]["unit"]) == ("3.5", "0.1", "mOhm")
    assert parameters[1]["value"] == ""
    assert parameters[1]["status"] == "not identifiable: flat, no excitation"
    events = [json.loads(line) for line in (out / "events.jsonl").read_text().splitlines()]
    assert events == [
        {
            "time_s": 2.0,
            "level": "warning",
            "code": "sensor",
            "string": "string_1",
            "cell": 2,
            "text": "thermistor of cell 2 ±3 K is open",
        }
    ]
    assert json.loads((out / "summary.json").read_text()) == {
        "frames": 10,
        "duration_s": 2.0,
        "strings": {
            "string_1": {
                "cells": 2,
                "max_core_C": 33.0,
                "hottest": {"cell": 2, "core_C": 33.0, "core_sd_K": 0.5, "centre_C": 35.5, "time_s": 1.500000001},
                "resistance_growth_pct": None,
                "flags": [],
            }
        },
        "dropped": 0,
        "rejected": {"open": 1, "stale": 2},
        "signals": {},
    }


def test_a_string_without_any_estimate_has_no_hottest_core(tmp_path):
    with ResultFolder(tmp_path, {"string_1": 2}) as folder:
        folder.write(estimated(S, [np.nan, np.nan]))
    assert folder.strings["string_1"].max_core_C is None
    assert folder.strings["string_1"].hottest is None


def test_the_hottest_point_need_not_be_in_the_cell_with_the_hottest_core(tmp_path):
    with ResultFolder(tmp_path, {"string_1": 2}) as folder:
        folder.write(estimated(S, [30.0, 31.0]))
        folder.write(estimated(2 * S, [29.0, 31.2]))
    one = folder.strings["string_1"]
    assert one.max_core_C == 31.2
    assert one.hottest == {"cell": 1, "core_C": 30.0, "core_sd_K": 0.5, "centre_C": 34.0, "time_s": 1.0}


def test_the_hottest_core_is_no_vague_guess(tmp_path):
    """For one moment a core of 46.9 ± 20 °C was good, and it was told as the hottest of the drive."""
    with ResultFolder(tmp_path, {"string_1": 2}) as folder:
        for t, core, sd in ((1, [46.9, 33.0], [20.0, 3.1]), (2, [31.0, 46.5], [0.5, 20.0]), (3, [30.0, 28.0], [2, 1])):
            e = estimated(t * S, core)
            folder.write(replace(e, core_sd=np.array(sd, float)))
    one = folder.strings["string_1"]
    assert one.max_core_C == 46.9
    assert (one.hottest["cell"], one.hottest["core_sd_K"], one.hottest["time_s"]) == (1, 0.5, 2.0)


def test_a_cell_that_burns_is_the_hottest_however_vague_its_core_is(tmp_path):
    with ResultFolder(tmp_path, {"string_1": 2}) as folder:
        folder.write(replace(estimated(S, [150.0, 43.0]), core_sd=np.array([12.0, 0.5])))
        folder.write(replace(estimated(2 * S, [42.0, 41.0]), core_sd=np.array([0.5, 0.5])))
    hottest = folder.hottest["string_1"]
    assert (hottest.cell, hottest.core_C, folder.strings["string_1"].hottest["cell"]) == (1, 150.0, 1)
    assert hottest_sentence(hottest, 0) == (
        "hottest core: 150.0 ± 12.0 °C (1 sd), cell 1 of string_1, 1 s after the start (its core is not known to 3 K)"
    )


def test_a_place_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="cannot write results there"):
        ResultFolder(tmp_path / "file" / "out", {})


def test_a_run_that_fails_leaves_the_results_of_the_one_before(tmp_path):
    with ResultFolder(tmp_path, {"string_1": 2}) as folder:
        folder.write(estimated(S, [30.0, 31.0]))
    before = {f.name: f.read_bytes() for f in tmp_path.iterdir()}

    def fail():
        with ResultFolder(tmp_path, {"string_1": 2}) as folder:
            folder.write(estimated(2 * S, [30.0, 31.0]))
            raise UsageError("no such log")

    with pytest.raises(UsageError):
        fail()
    assert {f.name: f.read_bytes() for f in tmp_path.iterdir()} == before


def test_a_run_that_fails_leaves_no_new_folder(tmp_path):
    with pytest.raises(UsageError), ResultFolder(tmp_path / "new", {}):
        raise UsageError("no such log")
    assert not (tmp_path / "new").exists()


def test_tables_for_people_align_and_show_dashes_for_nothing():
    values = {"core": np.array([30.0, np.nan]), "core_sd": np.array([0.1, 0.2]), "surface": np.array([25.0, 26.0])}
    nothing = dict.fromkeys(("centre_sd", "heat", "heat_sd"), np.zeros(2))
    cells = Cells(0, "s", quality=np.array([0, 11], np.uint8), centre=np.array([31.0, np.nan]), **values, **nothing)
    text = cells_table(cells, np.ones(2))
    first, second = text.splitlines()[1:]
    assert first.split() == ["s", "1", "good", "30.00", "0.10", "25.00", "31.00", "1.00", "29.00"]
    assert second.split() == ["s", "2", "estimated", "–", "0.20", "26.00", "–", "1.00", "–"]
    assert len({len(line) for line in text_table(["a", "bb"], [[1, 2], [33, 44]]).splitlines()}) == 1
