"""Without a measured inlet: the lowest readings, those of a rest where there is one, and how well they are known."""

import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import load_config
from bms_gateway.config.model_file import read_model
from bms_gateway.records.read import read_measurements
from bms_gateway.setup.resting import REST_S, Surroundings, surroundings
from tests.setup.parked_vehicle import T, parked
from tests.setup.proposals import proposed
from tests.setup.vehicles import Vehicle, drive, write


def test_the_lowest_readings_at_rest_are_the_surroundings(tmp_path) -> None:
    found = surroundings(proposed(parked(), tmp_path), 1)
    assert found == Surroundings(pytest.approx(18.2, abs=0.11), 1.0, rest=True)


def test_cells_that_cool_down_at_rest_say_less(tmp_path) -> None:
    found = surroundings(proposed(parked(cooling_K=4.0), tmp_path), 1)
    assert found.rest
    assert 1.5 < found.sd_K < 3.0


def test_a_short_rest_is_none(tmp_path) -> None:
    found = surroundings(proposed(parked(rest=REST_S - 30.0), tmp_path), 1)
    assert (found.rest, found.sd_K) == (False, 3.0)
    assert found.value_C == pytest.approx(18.2, abs=0.3)


def test_a_rest_after_the_drive_is_warmer_than_its_begin(tmp_path) -> None:
    vehicle = parked()
    for name, x in vehicle.values.items():
        vehicle.values[name] = x[::-1].copy()
    for k in range(4):
        vehicle.values[f"Thermal_CellTemp{k + 1}.CellTemp{k + 1}"] = 18.0 + 0.2 * k + T / 40
    found = surroundings(proposed(vehicle, tmp_path), 1)
    assert not found.rest
    assert found.value_C == pytest.approx(18.2, abs=0.5)


def test_both_are_written_into_the_config(tmp_path, capsys) -> None:
    log, dbc = write(parked(), tmp_path)
    out = tmp_path / "v"
    assert main(["init", str(log), "--dbc", str(dbc), "--cell", "catl_lf280", "--out", str(out), "--yes"]) == 0
    text = (out / "gateway.toml").read_text()
    assert (
        "coolant_inlet = { constant_C = 18.2 }  # (?) the bus has none: the lowest readings of the string at rest"
        in text
    )
    told = [line for line in capsys.readouterr().err.splitlines() if "coolant_inlet = { constant_C" in line]
    assert len(told) == 1
    assert "the lowest readings of the cells at rest stand for it, 18.2 °C with inlet_K = 1.0" in told[0]
    loaded = load_config(out / "gateway.toml")
    assert loaded.config.observer.inlet_K == 1.0
    (inlet,) = (c for c in loaded.plan.strings[0].channels if c.quantity == "coolant_inlet")
    assert inlet.constant == pytest.approx(18.2)
    (model,) = [path for path in out.glob("*.toml") if path.name != "gateway.toml"]
    (record,) = read_measurements([log], model=read_model(model), config=out / "gateway.toml")
    assert record.assumed["coolant_inlet"] == "18.2 °C all along, by the configuration"


def test_what_no_surroundings_have_is_not_taken_for_theirs(tmp_path) -> None:
    """A constant below absolute zero is none that a config may have."""
    proposal = proposed(parked(), tmp_path)
    for p in proposal.of("surface"):
        p.series.x[::10] = -312.0
        p.series.low = -312.0
    assert surroundings(proposal, 1).value_C == pytest.approx(18.2, abs=0.3)
    for p in proposal.of("surface"):
        p.series.x[:] = -312.0
    assert surroundings(proposal, 1) == Surroundings(25.0)


def test_the_air_outside_is_told_where_it_stands_for_the_coolant(tmp_path, capsys) -> None:
    """Ambient temperature and no coolant inlet: what is taken, how well it is known, what else to write."""
    d = drive(2)
    lines = ['VERSION ""', "BU_: BMS", "BO_ 288 Pack: 8 BMS", ' SG_ PackCurrent : 0|16@1- (0.1,0) [0|0] "A" BMS',
             ' SG_ PackVoltage : 16|16@1+ (0.1,0) [0|1000] "V" BMS', "BO_ 290 CellTemps: 8 BMS"]  # fmt: skip
    lines += [f' SG_ CellTemp{k + 1} : {8 * k}|8@1+ (0.5,-40) [0|0] "degC" BMS' for k in range(4)]
    lines += ["BO_ 291 Climate: 8 BMS", ' SG_ AmbientTemp : 0|8@1+ (0.5,-40) [0|0] "degC" BMS']
    values = {"Pack.PackCurrent": d.current, "Pack.PackVoltage": d.voltage, "Climate.AmbientTemp": d.inlet}
    values |= {f"CellTemps.CellTemp{k + 1}": d.surface[:, k] for k in range(4)}
    vehicle = Vehicle("airy", "\n".join(lines), values, {"CellTemps": 0.2, "Climate": 1.0}, {})
    log, dbc = write(vehicle, tmp_path)
    out = tmp_path / "v"
    assert main(["init", str(log), "--dbc", str(dbc), "--cell", "lg_m50 50p", "--out", str(out), "--yes"]) == 0
    told = [line for line in capsys.readouterr().err.splitlines() if "no signal is a coolant inlet" in line]
    assert len(told) == 1
    for part in ("Climate.AmbientTemp", "18.0 to 20.0 °C, inlet_K = 3.0", "coolant_inlet = { constant_C = 22.0 }"):
        assert part in told[0]
    assert load_config(out / "gateway.toml").config.observer.inlet_K == 3.0
