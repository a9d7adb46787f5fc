"""No command destroys a file that it reads, nor an older result before the new one is whole."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log, write_log
from bms_gateway.cli.main import main
from bms_gateway.cli.output import distinct, write_json
from bms_gateway.errors import UsageError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.records.once import given_once
from tests.config.files import OWN, write

TABLE = "time_s,current_A,coolant_inlet_C,surface_1_C,surface_3_C,surface_5_C\n" + "".join(
    f"{t},1,25,26,27,28\n" for t in range(20)
)


@pytest.fixture
def folder(tmp_path):
    write(tmp_path)  # gateway.toml, string_1.toml, vehicle.dbc
    (tmp_path / "bench.csv").write_text(TABLE)
    (tmp_path / "old.log").write_text("(1.000000) can0 123#AA\n")
    os.link(tmp_path / "gateway.toml", tmp_path / "hard.json")
    (tmp_path / "soft.json").symlink_to(tmp_path / "vehicle.dbc")
    return tmp_path


def contents(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


ENCODE = ["encode", "bench.csv", "--config", "gateway.toml"]
ANALYZE = ["analyze", "old.log", "--config", "gateway.toml"]
SIMULATE = ["simulate", "--config", "gateway.toml", "--duration", "5"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["check", "gateway.toml", "--json", "gateway.toml"], "--json gateway.toml: this file is read"),
        (["check", "gateway.toml", "--json", "./string_1.toml"], "this file is read"),
        (["check", "gateway.toml", "--json", "vehicle.dbc"], "this file is read"),
        (["check", "gateway.toml", "--json", "hard.json"], "this file is read"),
        (["check", "gateway.toml", "--json", "soft.json"], "this file is read"),
        ([*ENCODE, "--out", "a.log", "--json", "bench.csv"], "--json bench.csv: this file is read"),
        ([*ENCODE, "--out", "a.log", "--json", "a.log"], "--out writes to the same file"),
        ([*ENCODE, "--out", "a.log", "--json", "."], "--json .: cannot be written: is a directory"),
        ([*ENCODE, "--out", "absent/a.log"], "--out absent/a.log: cannot be written: no such folder: absent"),
        ([*SIMULATE, "--out", "a.log", "--truth", "a.log"], "--out writes to the same file"),
        ([*SIMULATE, "--out", "a.log", "--truth", "gateway.toml"], "this file is read"),
        ([*SIMULATE, "--out", "a.log", "--truth", "t.csv", "--json", "./t.csv"], "--truth writes to the same file"),
        ([*SIMULATE, "--out", "old.blf"], "candump"),
        ([*ENCODE, "--out", "bench.csv/a.log"], "cannot be written: bench.csv is a file, no folder"),
        ([*ENCODE, "--out", "."], "--out .: cannot be written: is a directory; name a file"),
        ([*ANALYZE, "--out", "bench.csv"], "--out bench.csv: is a file; name a folder for the results"),
        ([*ANALYZE, "--out", "bench.csv/a/b"], "--out bench.csv/a/b: bench.csv is a file; name a folder"),
        (["fleet", *ANALYZE[1:], "--out", "bench.csv"], "--out bench.csv: is a file; name a folder for the results"),
        (["fleet", *ANALYZE[1:], "--out", "bench.csv/a"], "bench.csv is a file; name a folder"),
        (["init", "old.log", "--out", "bench.csv/a"], "bench.csv is a file; name a folder for the config"),
        (["reproduce", "errata", "--out", "bench.csv"], "--out bench.csv: is a file; name a folder for the figures"),
        (["reproduce", "errata", "--out", "bench.csv/a"], "bench.csv is a file; name a folder for the figures"),
        (["replay", "old.log", "--to", "vcan9", "--json", "old.log"], "this file is read"),
        (["replay", "old.log", "--to", "vcan9", "--json", "no/x.json"], "no such folder: no"),
        (["demo", "--json", "no/x.json"], "no such folder: no"),
    ],
)
def test_an_output_never_takes_the_place_of_an_input_or_another_output(folder, monkeypatch, capsys, words, says):
    monkeypatch.chdir(folder)
    before = contents(folder)
    assert main(words) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1
    assert contents(folder) == before


def frames(count, broken=False):
    for k in range(count):
        yield FrameBatch(
            np.array([k * 10**9]), np.array([1], np.uint32), np.array([1], np.uint8), np.zeros((1, 8), "u1")
        )
    if broken:
        raise UsageError("the work failed")


@pytest.mark.parametrize("name", ["old.log", "old.log.gz"])
def test_a_failing_command_leaves_the_old_log_and_no_rest(tmp_path, name):
    write_log(tmp_path / name, frames(3))
    (tmp_path / name).chmod(0o640)
    before = contents(tmp_path)
    with pytest.raises(UsageError, match="the work failed"):
        write_log(tmp_path / name, frames(2, broken=True))
    assert contents(tmp_path) == before
    assert write_log(tmp_path / name, frames(2)) == 2
    assert sum(len(b) for b in read_log(tmp_path / name)) == 2
    assert (tmp_path / name).stat().st_mode & 0o777 == 0o640
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_a_failing_simulation_leaves_the_old_truth(tmp_path, monkeypatch):
    config = write(tmp_path, OWN)
    (tmp_path / "t.csv").write_text("old")
    before = contents(tmp_path)
    monkeypatch.setattr("bms_gateway.bus.logfile.format_block", lambda *_: (_ for _ in ()).throw(OSError(28, "full")))
    words = ["simulate", "--config", str(config), "--out", str(tmp_path / "a.log"), "--duration", "5"]
    assert main([*words, "--truth", str(tmp_path / "t.csv")]) == 2
    assert contents(tmp_path) == before


def test_a_packed_log_does_not_depend_on_its_name(tmp_path):
    for name in ("a.log.gz", "b.log.gz"):
        write_log(tmp_path / name, frames(3))
    assert (tmp_path / "a.log.gz").read_bytes() == (tmp_path / "b.log.gz").read_bytes()


def test_a_link_is_followed_and_a_device_stays_one(tmp_path):
    (tmp_path / "real.json").write_text("{}")
    (tmp_path / "link.json").symlink_to("real.json")
    write_json(str(tmp_path / "link.json"), {"a": 1})
    assert (tmp_path / "link.json").is_symlink()
    assert json.loads((tmp_path / "real.json").read_text()) == {"a": 1}
    distinct({"--a": "/dev/null", "--b": "/dev/null", "--c": "-", "--d": None}, [])


@pytest.mark.parametrize("name", ["a.csv", "copy.csv", "link.csv"])
def test_a_file_that_is_given_twice_is_refused_under_any_name(tmp_path, name):
    for file in ("a.csv", "copy.csv"):
        (tmp_path / file).write_text("time_s,current_A\n0,1\n")
    (tmp_path / "other.csv").write_text("time_s,current_A\n0,2\n")
    (tmp_path / "link.csv").symlink_to("a.csv")
    given_once(
        [tmp_path / "a.csv", tmp_path / "other.csv", tmp_path / "missing.csv", Path("/dev/null"), Path("/dev/null")]
    )
    with pytest.raises(UsageError, match="give each file once") as told:
        given_once([tmp_path / "a.csv", tmp_path / "other.csv", tmp_path / name])
    assert str(told.value).startswith(str(tmp_path / name))


def test_a_log_that_is_given_twice_leaves_no_results(tmp_path, capsys):
    from tests.chaos.bench import config

    write_log(tmp_path / "a.log", frames(3))
    words = ["analyze", str(tmp_path / "a.log"), str(tmp_path / "a.log"), "--config", str(config(tmp_path))]
    assert main([*words, "--out", str(tmp_path / "r")]) == 2
    assert capsys.readouterr().err == f"bms-gateway: error: {tmp_path / 'a.log'} is given twice: give each file once\n"
    assert not (tmp_path / "r").exists()
