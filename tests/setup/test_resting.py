"""Without a measured inlet: the lowest readings, those of a rest where there is one, and how well they are known."""

import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import load_config
from bms_gateway.setup.resting import REST_S, Surroundings, surroundings
from tests.setup.parked_vehicle import T, parked
from tests.setup.proposals import proposed
from tests.setup.vehicles import write


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


def test_both_are_written_into_the_config(tmp_path) -> None:
    log, dbc = write(parked(), tmp_path)
    out = tmp_path / "v"
    assert main(["init", str(log), "--dbc", str(dbc), "--cell", "catl_lf280", "--out", str(out), "--yes"]) == 0
    text = (out / "gateway.toml").read_text()
    assert (
        "coolant_inlet = { constant_C = 18.2 }  # (?) the bus has none: the lowest readings of the string at rest"
        in text
    )
    loaded = load_config(out / "gateway.toml")
    assert loaded.config.observer.inlet_K == 1.0
    (inlet,) = (c for c in loaded.plan.strings[0].channels if c.quantity == "coolant_inlet")
    assert inlet.constant == pytest.approx(18.2)


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
