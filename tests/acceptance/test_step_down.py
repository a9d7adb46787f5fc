"""A thermocouple that steps and freezes while the watch over heat finds its state anew: the cell is never dark unsaid.

The package's example drive, with a silence of the bus of 20 s before the fault, as it was found in a vehicle.
"""

import csv
import gzip
import json
import re
from pathlib import Path

import pytest

from bms_gateway.cli.main import main
from bms_gateway.config.dbc_files import shipped

AT, START_S = 700, 1_772_373_600
LINE = re.compile(r"\((\d+\.\d+)\) (\S+) ([0-9A-F]+)#([0-9A-F]*)")
FILES = ("gateway.toml", "pack.toml", "vehicle.dbc")


def analysed(tmp_path: Path, step_K: float) -> tuple[list[dict], list[dict[str, str]]]:
    """Alerts, and the rows of cell 3, of the drive whose thermocouple 3 steps by `step_K` and stays there."""
    lines, stands = [], None
    with gzip.open(shipped("deploy/worked/drive.log.gz"), "rt") as log:
        for text in log:
            found = LINE.match(text)
            assert found is not None
            t, channel, frame, payload = float(found[1]), found[2], found[3], bytearray.fromhex(found[4])
            if frame == "122" and t > AT:
                if stands is None:
                    stands = int.from_bytes(payload[4:6], "big", signed=True) + round(10 * step_K)
                payload[4:6] = stands.to_bytes(2, "big", signed=True)
            if not 620 < t < 640:
                lines.append(f"({START_S + t:.6f}) {channel} {frame}#{payload.hex().upper()}\n")
    for name in FILES:
        (tmp_path / name).write_bytes(shipped(f"deploy/worked/{name}").read_bytes())
    (tmp_path / "drive.log").write_text("".join(lines))
    out = tmp_path / "out"
    assert (
        main(["analyze", str(tmp_path / "drive.log"), "--config", str(tmp_path / "gateway.toml"), "--out", str(out)])
        == 0
    )
    with (out / "estimates.csv").open() as f:
        rows = [r for r in csv.DictReader(f) if r["cell"] == "3"]
    return [json.loads(line) for line in (out / "alerts.jsonl").read_text().splitlines()], rows


def raised(alerts: list[dict], name: str) -> list[tuple[float, int | None]]:
    """Times since the fault, s, and cells at which an alert was raised."""
    return [(a["time_s"] - START_S - AT, a["cell"]) for a in alerts if a["name"] == name and a["state"] == "raised"]


@pytest.mark.parametrize("step_K", [-5.0, pytest.param(-3.5, marks=pytest.mark.slow)])
def test_one_that_steps_down_and_freezes_stays_reported_and_its_core_goes_on(tmp_path: Path, step_K: float) -> None:
    # Bug: it was good again after 6 s, its core then unknown for minutes, and no alert said anything; with the watch
    # over heat awake, "cell 3 heats by itself: 25 W, stop" was raised.
    alerts, rows = analysed(tmp_path, step_K)
    ((after_s, cell),) = raised(alerts, "sensor")
    assert 0.0 < after_s <= 10.0
    assert cell == 3
    assert [a["state"] for a in alerts if a["name"] == "sensor"] == ["raised"]
    assert {a["name"] for a in alerts} == {"sensor"}
    # bug: it was said to jump, long after it had done so
    assert "not used: it has jumped down beside its neighbours and not come back" in alerts[0]["text"]
    late = [r for r in rows if float(r["time_s"]) > START_S + AT + 2]
    assert len(late) > 150
    assert {r["quality"] for r in late} <= {"jumpy", "stuck"}
    assert all(r["core_C"] and float(r["core_sd_K"]) < 4.0 for r in late)


@pytest.mark.parametrize("step_K", [5.0, pytest.param(-2.4, marks=pytest.mark.slow)])
def test_a_core_that_is_dark_because_of_its_own_thermocouple_says_so(tmp_path: Path, step_K: float) -> None:
    alerts, rows = analysed(tmp_path, step_K)
    dark = [float(r["time_s"]) - START_S - AT for r in rows if float(r["time_s"]) > START_S + AT and not r["core_C"]]
    ((after_s, cell),) = raised(alerts, "estimate")
    assert cell == 3
    assert dark[0] + 180.0 <= after_s <= dark[0] + 190.0
    told = next(a["text"] for a in alerts if a["name"] == "estimate")
    assert "core of cell 3 not known to 12 K: the thermocouple left what" in told
