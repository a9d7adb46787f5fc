"""A current that two signals carry, one for each direction: joined as if one signal carried it, offline and live."""

import json
from pathlib import Path

import cantools
import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log
from bms_gateway.cli.main import main
from bms_gateway.config.load import load_config
from bms_gateway.engine import Engine, Estimated, drive
from bms_gateway.errors import ConfigError
from bms_gateway.frames.quality import Quality
from tests.config.bench_cell import PARAMETERS, one_cell

DBC = """VERSION ""
BU_: X
BO_ 256 Pack: 8 X
 SG_ Net : 0|16@1- (0.1,0) [-800|800] "A" X
 SG_ Out : 16|16@1+ (0.1,0) [0|500] "A" X
 SG_ In : 32|16@1+ (0.1,0) [0|500] "A" X
BO_ 257 Temps: 8 X
 SG_ T1 : 0|16@1- (0.01,0) [-40|60] "C" X
 SG_ Inlet : 16|16@1- (0.1,0) [-40|60] "C" X
BO_ 259 Charge: 8 X
 SG_ InA : 0|16@1+ (0.1,0) [0|500] "A" X
 SG_ InMinus : 16|16@1- (0.1,0) [-500|0] "A" X
"""
ONE = 'current = "Pack.Net"'
PAIR = 'current = { discharge = "Pack.Out", charge = "Pack.In" }'
DOTTED = 'current.discharge = "Pack.Out"\ncurrent.charge = "Pack.In"'
APART = 'current = { discharge = "Pack.Out", charge = "Charge.InA" }'
MINUS = 'current = { discharge = "Pack.Out", charge = { signal = "Charge.InMinus", scale = -1 } }'
SECONDS = 120


def amps(k: int) -> float:
    """A at 10 Hz, in whole steps of the signals: discharge, rest and charge by turns."""
    return (8.0, 2.5, 0.0, -6.0, 12.3)[k // 37 % 5]


def write(folder: Path, current: str, late: float = 0.0, lost=lambda k: False) -> tuple[Path, Path]:
    """Config and log: 10 Hz of all currents; the message of the charge alone comes `late` s after the other."""
    folder.mkdir(exist_ok=True)
    (folder / "car.dbc").write_text(DBC)
    (folder / "cell.toml").write_text(one_cell(2.3, **PARAMETERS["authors"]))
    config = folder / "gateway.toml"
    config.write_text(
        '[bus]\ndbc = ["car.dbc"]\ntransmit = false\n[[string]]\nname = "s"\nmodel = "cell.toml"\n[string.signals]\n'
        f'{current}\ncoolant_inlet = "Temps.Inlet"\n[string.signals.surface]\n1 = "Temps.T1"\n'
    )
    database = cantools.database.load_string(DBC, "dbc")
    frames = []
    for k in range(10 * SECONDS):
        t, A = 1_700_000_000 + k / 10, amps(k)
        frames.append((t, 256, database.encode_message(256, {"Net": A, "Out": max(A, 0.0), "In": max(-A, 0.0)})))
        if not lost(k):
            frames.append((t + late, 259, database.encode_message(259, {"InA": max(-A, 0.0), "InMinus": min(A, 0.0)})))
        if k % 10 == 0:
            frames.append((t, 257, database.encode_message(257, {"T1": 25 + 0.01 * (k // 20), "Inlet": 24.0})))
    log = folder / "drive.log"
    frames.sort(key=lambda f: f[0])
    log.write_text("".join(f"({t:.6f}) can0 {i:03X}#{data.hex().upper()}\n" for t, i, data in frames))
    return config, log


def cores(config: Path, log: Path, *, live: bool = False) -> np.ndarray:
    """Core, its sd, and the unexplained heat by the second; live every frame comes alone."""
    loaded = load_config(config)
    engine = Engine(loaded.plan, loaded.database)
    batches = list(read_log(log))
    if live:
        batches = [batch[k : k + 1] for batch in batches for k in range(len(batch))]
    events = drive(engine, batches)
    return np.array([(e.core[0], e.core_sd[0], e.surface[0]) for e in events if isinstance(e, Estimated)])


@pytest.mark.parametrize("current", [PAIR, DOTTED, APART, MINUS])
def test_two_signals_give_the_estimates_of_one(current: str, tmp_path) -> None:
    expected = cores(*write(tmp_path / "one", ONE))
    assert np.isfinite(expected).any()
    np.testing.assert_allclose(cores(*write(tmp_path / "two", current)), expected, rtol=1e-9)


@pytest.mark.parametrize("current", [PAIR, APART])
def test_frame_by_frame_and_all_at_once_are_the_same(current: str, tmp_path) -> None:
    config, log = write(tmp_path, current, late=0.013)
    np.testing.assert_array_equal(cores(config, log, live=True), cores(config, log))


def test_a_half_that_comes_later_changes_little(tmp_path) -> None:
    expected = cores(*write(tmp_path / "one", ONE))
    late = cores(*write(tmp_path / "two", APART, late=0.02))
    assert np.nanmax(np.abs(late - expected)) < 0.02  # K, of a core that rises by some K


def said(config: Path, log: Path, folder: Path) -> tuple[int, dict]:
    status = main(["check", str(config), "--log", str(log), "--json", str(folder / "said.json")])
    return status, json.loads((folder / "said.json").read_text())["signals"]


def test_check_tells_each_direction(tmp_path, capsys) -> None:
    config, log = write(tmp_path, APART)
    status, signals = said(config, log, tmp_path)
    assert status == 0
    assert signals["Pack.Out"]["key"] == "s.current.discharge"
    assert signals["Charge.InA"]["key"] == "s.current.charge"
    for name, most in (("Pack.Out", 12.3), ("Charge.InA", 6.0)):
        assert (signals[name]["seen"], signals[name]["used"]) == (1190, 1190)  # the last second has no tick
        assert signals[name]["observed"] == [0.0, pytest.approx(most)]


def test_check_names_the_direction_that_never_comes(tmp_path, capsys) -> None:
    config, log = write(tmp_path, APART, lost=lambda k: True)
    status, signals = said(config, log, tmp_path)
    out = capsys.readouterr().out
    assert status == 1
    assert "s.current.charge: Charge.InA never comes in this log" in out
    assert signals["Charge.InA"]["seen"] == 0


def test_the_current_is_refused_while_one_direction_is_too_old(tmp_path) -> None:
    config, log = write(tmp_path, APART, lost=lambda k: k >= 300)
    loaded = load_config(config)
    engine = Engine(loaded.plan, loaded.database)
    for _ in drive(engine, read_log(log)):
        pass
    # the DBC states no cycle, so the newest charge current is held for 5 s; the last second has no tick
    counts = engine.counts[engine.wires[0].current]
    assert counts[Quality.STALE] == 10 * (SECONDS - 1 - 30 - 5)
    assert counts[Quality.GOOD] == counts.sum() - counts[Quality.STALE]


def test_a_value_out_of_the_range_of_its_half_is_refused(tmp_path, capsys) -> None:
    narrow = 'current = { discharge = { signal = "Pack.Out", maximum = 10.0 }, charge = "Pack.In" }'
    config, log = write(tmp_path, narrow)
    _, signals = said(config, log, tmp_path)
    above = sum(amps(k) > 10.0 for k in range(10 * (SECONDS - 1)))
    assert signals["Pack.Out"]["refused"] == {"out_of_range": above}
    assert signals["Pack.In"]["refused"] == {}
    assert 'current.discharge = { signal = "Pack.Out", maximum = 12.3 }' in capsys.readouterr().out


@pytest.mark.parametrize(
    ("current", "expected"),
    [
        ('current = { discharge = "Pack.Out" }', "discharge alone is half a current: name discharge and charge"),
        ('current = { discharge = "Pack.Out", charge = "Pack.Out" }', "is named for both directions"),
        ('current = { discharge = "Pack.Out", charge = "Pack.In", scale = 2 }', "scale: belongs to each"),
        ('current = { discharge = "Pack.Out", charge = { constant = 0 } }', "charge must be one signal"),
        ('current = { discharge = "Pack.Out", charge = "Pack.Inn" }', "did you mean"),
        ('current = { discharge = "Pack.Out", charge = "Temps.T1" }', "s.*unit"),
        (f'{ONE}\nvoltage = {{ discharge = "Pack.Out", charge = "Pack.In" }}', "belong to current"),
    ],
)
def test_half_a_current_is_refused_in_one_line(current: str, expected: str, tmp_path) -> None:
    config, _ = write(tmp_path, current)
    with pytest.raises(ConfigError, match=expected) as caught:
        load_config(config)
    assert "\n" not in str(caught.value)


def test_a_table_is_encoded_into_both_directions_and_read_back(tmp_path, capsys) -> None:
    config, _ = write(tmp_path, PAIR)
    rows = [f"{k},{amps(5 * k)},24.0,25.0\n" for k in range(60)]
    table = tmp_path / "bench.csv"
    table.write_text("time_s,current_A,coolant_inlet_C,surface_1_C\n" + "".join(rows))
    assert main(["encode", str(table), "--config", str(config), "--out", str(tmp_path / "bench.log")]) == 0
    database = cantools.database.load_string(DBC, "dbc")
    seen = set()
    for batch in read_log(tmp_path / "bench.log"):
        for i, data in zip(batch.can_id, batch.data, strict=True):
            if i == 256:
                values = database.decode_message(256, bytes(data)[:8])
                seen.add((round(values["Out"], 1), round(values["In"], 1)))
    assert seen == {(8.0, 0.0), (2.5, 0.0), (0.0, 0.0), (0.0, 6.0), (12.3, 0.0)}
