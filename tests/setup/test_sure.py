"""What `init` calls sure, and what it must not: signs that contradict, short logs, rests."""

import numpy as np
import pytest

from bms_gateway.cli.main import main
from bms_gateway.setup.find_charge import sign_by_charge
from bms_gateway.setup.propose import propose
from bms_gateway.setup.vehicle_logs import read_traffic
from tests.setup.charged_vehicle import charged
from tests.setup.proposals import proposed
from tests.setup.vehicles import SECONDS, drive, plain, write


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_charge_tells_the_sign_where_the_voltage_does_not(sign: float, tmp_path) -> None:
    found = proposed(charged(sign, voltage=None), tmp_path)
    current = next(found.of("current"))
    assert current.factor == sign
    assert any("the SOC" in why for why in current.why)


def test_voltage_and_charge_that_contradict_make_neither_sure(tmp_path) -> None:
    found = proposed(charged(1.0, voltage=-1.0), tmp_path)
    for role in ("current", "soc"):
        p = next(found.of(role))
        assert not p.sure
        assert any("contradict each other" in why for why in p.why)
    agreed = proposed(charged(-1.0), tmp_path)
    assert all(next(agreed.of(role)).sure for role in ("current", "soc"))
    assert next(agreed.of("current")).factor == -1.0


def test_a_charge_that_hardly_moves_tells_no_sign(tmp_path) -> None:
    found = proposed(charged(-1.0, voltage=None, soc=0.05), tmp_path)
    current = next(found.of("current"))
    assert not current.sure
    assert any("the data do not show its sign" in why for why in current.why)
    assert sign_by_charge([], None, np.arange(9.0)) is None


def test_the_noise_of_rests_is_no_second_sign(tmp_path) -> None:
    vehicle = charged(1.0)
    vehicle.values["Elec.PackCurrent"] = np.abs(drive(8).current) - 0.4
    assert "has both signs" not in next(proposed(vehicle, tmp_path).of("current")).why
    vehicle.values["Elec.PackCurrent"] = drive(8).current
    assert "has both signs" in next(proposed(vehicle, tmp_path).of("current")).why


def test_a_short_log_makes_nothing_sure(tmp_path) -> None:
    log, dbc = write(charged(1.0), tmp_path)
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[: len(lines) * 40 // SECONDS]))
    found = propose(read_traffic([log], [dbc]))
    assert found.signals
    assert not any(p.sure for p in found.signals)
    assert any("no proposal is sure below 60 s" in remark for remark in found.remarks)


def test_a_config_that_is_written_over_is_kept(tmp_path, capsys) -> None:
    log, dbc = write(charged(1.0), tmp_path)
    out = tmp_path / "v"
    out.mkdir()
    for k, (text, kept) in enumerate((("# mine", "gateway.toml.bak"), ("# mine too", "gateway.toml.bak2"))):
        (out / "gateway.toml").write_text(text)
        assert main(["init", str(log), "--dbc", str(dbc), "--out", str(out), "--yes"]) == 0
        assert (out / kept).read_text() == text, k
        assert f"kept as {kept}" in capsys.readouterr().err
    assert (out / "gateway.toml.bak").read_text() == "# mine"


def test_the_first_minute_shows_no_hottest_core(tmp_path, capsys) -> None:
    vehicle = charged(1.0)
    for k in range(4):  # cells that cool down: the greatest of all estimates is the first one
        vehicle.values[f"Thermal_CellTemp{k + 1}.CellTemp{k + 1}"] = 45.0 - drive(8).t / 40
    log, dbc = write(vehicle, tmp_path)
    assert main(["init", str(log), "--dbc", str(dbc), "--cell", "catl_lf280", "--out", str(tmp_path / "v")]) == 0
    line = next(t for t in capsys.readouterr().out.splitlines() if t.startswith("hottest core:"))
    assert 60.0 <= float(line.rsplit(", ", 1)[1].split(" s ")[0]) < SECONDS


def test_a_current_of_a_shunt_that_is_declared_unsigned_is_read_with_its_sign(tmp_path) -> None:
    vehicle = plain({f"CellTemp{k + 1}": drive(8).surface[:, k] for k in range(4)}, unit="degC")
    signed, unsigned = (f' SG_ Ishunt : 0|32@1{sign} (1,0) [0|0] "mA" B' for sign in "-+")
    old = ' SG_ PackCurrent : 0|16@1- (0.1,0) [-1000|1000] "A" B'
    vehicle.dbc = vehicle.dbc.replace(old, signed).replace("PackVoltage : 16|16", "PackVoltage : 32|16")
    vehicle.values["Elec.Ishunt"] = 1e3 * vehicle.values.pop("Elec.PackCurrent")
    vehicle.told = [(signed, unsigned)]
    (current,) = proposed(vehicle, tmp_path).of("current")
    assert current.path == "Elec.Ishunt"
    assert current.overrides["signed"] is True
    assert current.factor == pytest.approx(1e-3)


def test_by_how_much_a_scale_is_wrong_is_a_guess_that_is_told_with_the_others(tmp_path) -> None:
    vehicle = charged(1.0)
    assert next(proposed(vehicle, tmp_path).of("current")).sure
    right, wrong = (f" SG_ PackCurrent : 0|16@1- ({scale},0) [0|0]" for scale in ("0.1", "100"))
    vehicle.dbc = vehicle.dbc.replace(" SG_ PackCurrent : 0|16@1- (0.1,0) [-1000|1000]", right)
    vehicle.told = [(right, wrong)]
    (current,) = proposed(vehicle, tmp_path).of("current")
    assert not current.sure
    (told,) = (why for why in current.why if "scale contradicts the data" in why)
    assert "times 0.001 they have" in told
    assert "times 0.01 they have" in told


def test_counts_that_stand_for_a_current_tell_no_resistance(tmp_path) -> None:
    vehicle = plain({f"CellTemp{k + 1}": drive(8).surface[:, k] for k in range(4)}, unit="degC")
    old = ' SG_ PackCurrent : 0|16@1- (0.1,0) [-1000|1000] "A" B'
    vehicle.dbc = vehicle.dbc.replace(old, ' SG_ Current_raw : 0|16@1+ (1,0) [0|0] "" B')
    vehicle.values["Elec.Current_raw"] = 32768 + vehicle.values.pop("Elec.PackCurrent") / 0.02
    found = proposed(vehicle, tmp_path)
    assert [p.path for p in found.of("current")] == ["Elec.Current_raw"]
    assert found.resistance is None


def test_signals_of_unknown_names_are_named_on_the_terminal_before_what_is_no_measurement(tmp_path, capsys) -> None:
    d = drive(8)
    vehicle = plain({f"CellTemp{k + 1}": d.surface[:, k] for k in range(4)}, unit="degC")
    vehicle.dbc += (
        '\nBO_ 901 Body: 8 B\n SG_ DoorAjar : 0|16@1+ (1,0) [0|9] "" B\n SG_ Zandaka : 16|16@1+ (0.01,0) [0|100] "" B'
    )
    vehicle.values["Body.DoorAjar"] = np.full(len(d.t), 3.0)
    vehicle.values["Body.Zandaka"] = 50 + 40 * np.sin(np.arange(len(d.t)) ** 1.5)
    log, dbc = write(vehicle, tmp_path)
    assert main(["init", str(log), "--dbc", str(dbc), "--out", str(tmp_path / "o"), "--yes"]) == 0
    line = next(x for x in capsys.readouterr().out.splitlines() if "other signals have no role here" in x)
    assert line.startswith("2 other signals")
    assert line.endswith("Body.Zandaka, Body.DoorAjar")
