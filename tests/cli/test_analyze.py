"""`analyze`: results that are whole or untouched, and a word on everything that is odd about a log."""

import csv
import json
import re

import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log, write_log
from bms_gateway.cli.main import main
from bms_gateway.config import shipped
from bms_gateway.frames.batch import FrameBatch

S = 1_000_000_000


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Config of two strings of which the first is on the bus, and a log of half a minute."""
    folder = tmp_path_factory.mktemp("drive")
    text = shipped("deploy/example/gateway.toml").read_text()
    head, *strings = text.split("[[string]]\nname")
    one, two = (folder / name for name in ("one.toml", "two.toml"))
    one.write_text(head + "[[string]]\nname" + strings[0])
    two.write_text(head + "".join("[[string]]\nname" + s for s in strings[:2]))
    (folder / "string.toml").write_text(shipped("deploy/example/string.toml").read_text())
    log = folder / "drive.log"
    assert main(["simulate", "--config", str(one), "--out", str(log), "--duration", "30"]) == 0
    return two, log


def analyze(log, config, out, *more):
    return main(["analyze", *(str(x) for x in ([log] if not isinstance(log, list) else log)), "--config", str(config),
                 "--out", str(out), *more])  # fmt: skip


def test_a_mistyped_log_leaves_earlier_results_alone(drive, tmp_path, capsys):
    config, log = drive
    assert analyze(log, config, tmp_path) == 0
    before = {f.name: f.read_bytes() for f in tmp_path.iterdir()}
    assert set(before) == {"estimates.csv", "parameters.csv", "events.jsonl", "alerts.jsonl", "broadcast.log",
                           "summary.json"}  # fmt: skip
    assert analyze(tmp_path / "nope.log", config, tmp_path) == 2
    assert {f.name: f.read_bytes() for f in tmp_path.iterdir()} == before
    assert "no such log" in capsys.readouterr().err


def test_a_result_never_replaces_the_log_it_comes_from(drive, tmp_path, capsys):
    config, log = drive
    mine = tmp_path / "broadcast.log"
    mine.write_bytes(log.read_bytes())
    assert analyze(mine, config, tmp_path) == 2
    assert mine.read_bytes() == log.read_bytes()
    assert "this file is read by the command" in capsys.readouterr().err


def test_strings_that_are_never_heard_are_told(drive, tmp_path, capsys):
    config, log = drive
    assert analyze(log, config, tmp_path) == 0
    events = [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    unheard = [e for e in events if e["code"] == "unheard"]
    assert [e["string"] for e in unheard] == ["string_2"]
    assert "string_2_electrical.current" in unheard[0]["text"]
    assert "string_2: never received" in capsys.readouterr().err
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["strings"]["string_2"] == {
        "cells": 12, "max_core_C": None, "hottest": None, "resistance_growth_pct": None, "flags": [],
    }  # fmt: skip
    rows = (tmp_path / "parameters.csv").read_text().splitlines()
    assert sum(row.endswith("learning") for row in rows) >= 6


def test_the_numbers_of_an_added_effect_stand_beside_the_strings_own(drive, tmp_path):
    config, log = drive
    model = config.parent / "falling.toml"
    text = (config.parent / "string.toml").read_text()
    added = '[effect.resistance_temperature]\nB = { value = 3000.0, unit = "K", sd = 250.0 }\n'
    model.write_text(re.sub(r"(?m)^effects = .*$", 'effects = ["resistance_temperature"]', text) + "\n" + added)
    one = tmp_path / "one.toml"
    one.write_text((config.parent / "one.toml").read_text().replace("string.toml", str(model)))
    assert analyze(log, one, tmp_path / "out") == 0
    rows = list(csv.DictReader((tmp_path / "out" / "parameters.csv").read_text().splitlines()))
    mine = [r for r in rows if r["name"] == "resistance_temperature.B"]
    assert mine
    assert (mine[0]["string"], mine[0]["value"], mine[0]["sd"], mine[0]["unit"]) == ("string_1", "3000", "250", "K")
    assert mine[0]["status"].startswith("fixed")


def test_a_clock_that_is_set_back_is_told_and_the_duration_is_that_of_the_rows(drive, tmp_path, capsys):
    config, log = drive
    b = FrameBatch.concat(list(read_log(log)))
    time = b.time_ns + np.where(b.time_ns > 15 * S, 0, 10**6 * S)  # back by a million seconds in the middle
    write_log(tmp_path / "back.log", [FrameBatch(time, b.can_id, b.length, b.data)])
    assert analyze(tmp_path / "back.log", config, tmp_path / "out", "--json", "-") == 0
    out, err = capsys.readouterr()
    summary = json.loads(out)
    assert summary["duration_s"] == pytest.approx(30.0, abs=1.0)
    assert "clock set back 1×" in err
    assert "| sort -s -k1,1 > sorted.log" in err
    assert any(json.loads(x)["code"] == "clock" for x in (tmp_path / "out" / "events.jsonl").read_text().splitlines())


@pytest.mark.parametrize(
    ("text", "says"), [("", "no data frames"), ("(1.0) can0 123#00\n" * 9, "none of the 9 frames")]
)
def test_a_log_that_tells_nothing_is_an_error_not_an_empty_result(drive, tmp_path, capsys, text, says):
    (tmp_path / "x.log").write_text(text)
    assert analyze(tmp_path / "x.log", drive[0], tmp_path / "out") == 2
    err = capsys.readouterr().err
    assert says in err
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_broken_lines_are_counted_in_the_summary(drive, tmp_path):
    config, log = drive
    (tmp_path / "x.log").write_text(log.read_text() + "(31.0) can0 nonsense\n")
    assert analyze(tmp_path / "x.log", config, tmp_path / "out") == 0
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["rejected"]["broken_line"] == 1


def test_an_empty_name_of_the_folder_is_refused(drive, capsys):
    assert analyze(drive[1], drive[0], "") == 2
    assert "--out is empty" in capsys.readouterr().err


def test_the_hottest_core_is_told_with_its_sd_its_cell_and_its_time(drive, tmp_path, capsys):
    config, log = drive
    assert analyze(log, config, tmp_path) == 0
    with (tmp_path / "estimates.csv").open() as file:
        rows = [r for r in csv.DictReader(file) if r["core_C"] and float(r["core_sd_K"]) <= 3.0]
    top = max(rows, key=lambda r: float(r["core_C"]))
    start = read_log(log).__next__().time_ns[0] / S
    text = capsys.readouterr().out
    core, sd, after = float(top["core_C"]), float(top["core_sd_K"]), float(top["time_s"]) - start
    where = f"cell {top['cell']} of {top['string']}, {after:.0f} s after the start"
    assert f"hottest core: {core:.1f} ± {sd:.1f} °C (1 sd), {where}\n" in text
    assert "hottest core °C ± 1 sd" in text
    assert "R_e mΩ ± 1 sd" in text
    row = next(line for line in text.splitlines() if line.startswith("string_1"))
    assert f"{core:.2f} ± {sd:.2f}" in row
    assert row.split()[5:7] == [top["cell"], f"{after:.0f}"]


def test_samples_that_are_not_used_are_counted_with_the_reason_in_words(drive, tmp_path, capsys):
    config, log = drive
    lines = log.read_text().splitlines(keepends=True)
    at = next(i for i, line in enumerate(lines) if i > len(lines) // 2)
    start, _, data = lines[at].rpartition("#")
    lines[at] = f"{start}#{int(data[:2], 16) ^ 1:02X}{data[2:]}"  # the check sum is in the first byte
    (tmp_path / "flipped.log").write_text("".join(lines))
    assert analyze(tmp_path / "flipped.log", config, tmp_path / "out") == 0
    rejected = json.loads((tmp_path / "out" / "summary.json").read_text())["rejected"]
    assert rejected["crc"] > 0
    told = re.findall(r"(\d+) samples? of .* not used: the check sum of its frame is wrong\n", capsys.readouterr().out)
    assert sum(map(int, told)) == rejected["crc"]
