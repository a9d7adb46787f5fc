"""`export`: what the gateway heard lately, as a table that the other commands read."""

import csv
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log
from bms_gateway.cli import export as command
from bms_gateway.cli.export import given_span
from bms_gateway.cli.main import main
from bms_gateway.config import shipped
from bms_gateway.errors import UsageError
from bms_gateway.records.recent_signals import Written
from bms_gateway.report.table import read_table
from tests.frames.payloads import OWN, parsed
from tests.store.ring import drove

SECONDS = 900


@pytest.fixture(scope="module")
def gateway(tmp_path_factory):
    folder = tmp_path_factory.mktemp("export")
    drove(folder, SECONDS)
    return folder


def export(gateway, name, *words):
    out = gateway / name
    assert main(["export", "--last", "1d", "--out", str(out), "--config", str(gateway / "gateway.toml"), *words]) == 0
    return out


def test_the_table_holds_what_the_bus_said_within_its_resolution(gateway):
    table = read_table(export(gateway, "all.csv", "--string", "string_2"))
    database = parsed(OWN)
    said: dict[str, list[tuple[float, float]]] = {}
    names = {"current": "current_A", "voltage": "voltage_V", "coolant_inlet": "coolant_inlet_C", "soc": "soc"}
    names |= {"surface_01": "surface_1_C", "surface_04": "surface_4_C", "coolant_flow": "coolant_flow_m3_s"}
    for batch in read_log(gateway / "drive.log"):
        for t, can_id, length, data in zip(
            batch.time_ns.tolist(), batch.can_id.tolist(), batch.length.tolist(), batch.data, strict=True
        ):
            message = database.get_message_by_frame_id(can_id & 0x1FFF_FFFF)
            if not message.name.startswith("string_2_"):
                continue
            for signal_name, value in message.decode(bytes(data)[:length], decode_choices=False).items():
                if signal_name in names:
                    said.setdefault(names[signal_name], []).append((t * 1e-9, value))
    columns = {n: getattr(table, n) for n in ("current_A", "voltage_V", "coolant_inlet_C", "soc", "coolant_flow_m3_s")}
    columns |= {f"surface_{k}_C": x for k, x in table.surface_C.items()}
    resolution = {"current_A": 1e-3, "voltage_V": 1e-4, "soc": 2e-5, "coolant_flow_m3_s": 1e-6}
    for name, pairs in said.items():
        known = np.isfinite(columns[name])
        t, v = np.array(pairs).T
        last = table.time_s[known][-1]
        t, v = t[t <= last + 1e-6], v[t <= last + 1e-6]
        assert len(t) - known.sum() <= 3, name  # the guard waits at a start until a sensor has moved
        at = np.searchsorted(t, table.time_s[known] + 2e-6) - 1
        assert np.abs(t[at] - table.time_s[known]).max() < 2e-6
        assert np.abs(v[at] - columns[name][known]).max() < resolution.get(name, 0.01), name
    assert set(said) == set(names.values())
    assert table.time_s[-1] - table.time_s[0] > SECONDS - 3


@pytest.mark.slow
def test_compare_reads_it_directly_and_agrees_with_the_log(gateway, tmp_path):
    table = export(gateway, "compare.csv", "--string", "string_1")
    model, config = str(gateway / "string.toml"), str(gateway / "gateway.toml")
    found = []
    for words in ([str(table)], [str(gateway / "drive.log"), "--config", config, "--string", "string_1"]):
        out = tmp_path / f"{len(found)}.json"
        assert main(["compare", *words, "--model", model, "--json", str(out)]) in (0, 1)
        found.append(json.loads(out.read_text()))
    a, b = ([c["train_rmse_K"] for c in f["filed"]["sensors"]] for f in found)
    assert a == pytest.approx(b, abs=0.005)


@pytest.mark.slow
def test_diagnose_reads_it_directly(gateway, tmp_path):
    table = export(gateway, "diagnose.csv", "--string", "string_1")
    out = tmp_path / "d.json"
    assert main(["diagnose", str(table), "--model", str(gateway / "string.toml"), "--json", str(out)]) in (0, 1)
    assert json.loads(out.read_text())["verdict"] in (
        "adequate", "missing_effect", "undecidable", "unknown_effect", "insufficient_data",
    )  # fmt: skip


def test_the_last_minutes_are_those_before_the_newest_signal(gateway, capsys):
    out = gateway / "short.csv"
    words = ["--store", str(gateway / "lib"), "--string", "string_1", "--json", "-"]
    assert main(["export", "--last", "2min", "--out", str(out), *words]) == 0
    told = json.loads(capsys.readouterr().out)
    with out.open() as f:
        rows = list(csv.DictReader(f))
    times = [float(r["time_s"]) for r in rows]
    assert told["rows"] == len(rows)
    assert 119.0 < times[-1] - times[0] <= 120.0
    assert (told["from_s"], told["to_s"]) == (times[0], times[-1])
    assert times[-1] > SECONDS - 3


def test_a_table_that_is_shorter_or_older_than_it_seems_says_so(gateway, capsys, monkeypatch):
    """3 min were asked for, and 1.9 min that ended 70 s ago were written without a word."""
    words = ["--out", str(gateway / "told.csv"), "--store", str(gateway / "lib"), "--string", "string_1"]
    assert main(["export", "--last", "1d", *words]) == 0
    minutes = (SECONDS - 1) / 60
    said = re.search(r"of 1d only ([\d.]+) min are recorded", capsys.readouterr().err)
    assert float(said[1]) == pytest.approx(minutes, abs=0.15)
    assert main(["export", "--last", "2min", *words]) == 0
    assert "only" not in capsys.readouterr().err
    for age_s, told in ((30.0, None), (90.0, "came 1.5 min ago")):
        newest = 1_750_000_000.0
        written = Written("string_1", ("time_s",), 10, newest - 120.0, newest)
        monkeypatch.setattr(command, "write_recent", lambda *_, w=written: w)
        monkeypatch.setattr(command.time, "time", lambda at=newest + age_s: at)
        assert main(["export", "--last", "2min", *words]) == 0
        err = capsys.readouterr().err
        assert err == "" if told is None else told in err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--last", "2"], "the unit is missing; valid: s, min, h, d"),
        (["--last", "2m"], "did you mean 2min?"),
        (["--last", "2hours"], "did you mean 2h?"),
        (["--last", "two hours"], "expected a number with its unit"),
        (["--last", "0s"], "must be above 0"),
        (["--last", "-5min"], "expected"),
        (["--last", "99999d"], "at most ten years"),
        (["--last", "2h"], "--string is needed, several are recorded; valid: string_1, string_2"),
        (["--last", "2h", "--string", "string1"], "did you mean"),
        (["--last", "2h", "--store", "nowhere"], "no such directory"),
        (["--last", "2h", "--out", "-"], "the table is a file"),
    ],
)
def test_bad_words_are_one_clear_line(gateway, capsys, words, says):
    options = {"--out": str(gateway / "bad.csv"), "--store": str(gateway / "lib")} | dict(
        zip(words[::2], words[1::2], strict=True)
    )
    assert main(["export", *(f"{k}={v}" for k, v in options.items())]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1
    assert not (gateway / "bad.csv").exists()


def test_a_directory_without_a_record_is_one_clear_line(tmp_path, capsys):
    assert main(["export", "--last", "2h", "--out", str(tmp_path / "t.csv"), "--store", str(tmp_path)]) == 2
    assert "no recent signals are recorded there" in capsys.readouterr().err


def test_damage_is_told_and_the_rest_exported(gateway, tmp_path, capsys):
    shutil.copytree(gateway / "lib", tmp_path / "lib")
    (segment,) = (tmp_path / "lib" / "recent").iterdir()
    raw = bytearray(segment.read_bytes())
    raw[len(raw) // 2] ^= 1
    segment.write_bytes(raw)
    out = tmp_path / "t.csv"
    assert main(["export", "--last=2h", f"--out={out}", f"--store={tmp_path / 'lib'}", "--string=string_1"]) == 0
    assert "damaged" in capsys.readouterr().err
    assert len(read_table(out)) > 8000


def test_spans_of_time():
    assert [given_span(w) for w in ("90s", "30min", "2h", "1d", "1.5h", "2 h")] == [90, 1800, 7200, 86400, 5400, 7200]
    with pytest.raises(UsageError):
        given_span("1e3s")


@pytest.mark.vcan
def test_the_running_service_records_what_export_reads(tmp_path):
    """Export while the service still runs, and after it ended: the second holds the first and more."""
    for name in ("gateway.toml", "string.toml"):
        (tmp_path / name).write_text(shipped(f"deploy/example/{name}").read_text())
    config, log = tmp_path / "gateway.toml", tmp_path / "drive.log"
    config.write_text(config.read_text() + '\n[store]\npath = "lib"\n')
    assert main(["simulate", "--config", str(config), "--out", str(log), "--duration", "20"]) == 0
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(120)
        environment = os.environ | {"NOTIFY_SOCKET": str(tmp_path / "notify")}
        run = [sys.executable, "-m", "bms_gateway"]
        service = subprocess.Popen([*run, "run", str(config)], stderr=subprocess.PIPE, env=environment)
        while b"READY=1" not in systemd.recv(4096):
            pass
        second = subprocess.run([*run, "run", str(config)], capture_output=True, text=True, timeout=120)
        assert second.returncode == 2
        assert "another bms-gateway keeps its state there" in second.stderr
        assert subprocess.run([*run, "replay", str(log), "--to", "vcan0"], stdout=subprocess.DEVNULL).returncode == 0
        service.send_signal(signal.SIGTERM)
        _, err = service.communicate(timeout=60)
        assert service.returncode == 0, err.decode()
    out = tmp_path / "t.csv"
    assert main(["export", "--last=1h", f"--out={out}", f"--config={config}", "--string=string_5"]) == 0
    table = read_table(out)
    assert table.time_s[-1] - table.time_s[0] > 15.0
    assert np.isfinite(table.current_A).sum() > 150
    assert Path(tmp_path / "lib" / "state").is_file()
