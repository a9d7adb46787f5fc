"""`init` on vehicles that it has not seen: what each signal is, whether the DBC is right, and estimates at the end."""

import json

import numpy as np
import pytest

from bms_gateway.cli.main import main
from tests.setup.vehicles import VEHICLES, write
from tests.setup.vehicles_abroad import ABROAD
from tests.setup.vehicles_afar import AFAR, IN_SERIES

ALL = VEHICLES | ABROAD | AFAR


@pytest.fixture(scope="module", params=sorted(ALL))
def found(request, tmp_path_factory):
    """Vehicle, log, folder of the config and what `init` said of it."""
    folder = tmp_path_factory.mktemp(request.param)
    vehicle = ALL[request.param]()
    log, dbc = write(vehicle, folder)
    said = folder / "init.json"
    status = main(["init", str(log), "--dbc", str(dbc), "--cell", "catl_lf280", "--out", str(folder / "out"), "--yes",
                   "--json", str(said)])  # fmt: skip
    assert status == 0
    return vehicle, log, folder / "out", json.loads(said.read_text())


@pytest.mark.plain_cases(4)
def test_every_signal_is_what_it_is(found) -> None:
    vehicle, _, _, said = found
    by_signal = {s["signal"]: s for s in said["signals"]}
    for entry in said["signals"]:
        print(entry["role"], entry["index"], entry["signal"], entry["sure"], entry["overrides"], entry["why"])
    right = [path for path, (role, _) in vehicle.truth.items() if by_signal.get(path, {}).get("role") == role]
    missed = sorted(set(vehicle.truth) - set(right))
    assert len(right) >= 0.9 * len(vehicle.truth), missed
    sure = [s for s in said["signals"] if s["sure"]]
    assert all(vehicle.truth.get(s["signal"], ("none", None))[0] == s["role"] for s in sure)
    assert sure or vehicle.name == "terse"  # without a unit nothing is sure
    for path, (_, index) in vehicle.truth.items():
        if index is not None and path in by_signal:
            assert by_signal[path]["index"] == index, path


def test_scale_and_contradictions_are_told(found) -> None:
    vehicle, _, _, said = found
    by_signal = {s["signal"]: s for s in said["signals"]}
    for role, scale in vehicle.scale.items():
        assert next(s for s in said["signals"] if s["role"] == role)["scale"] == pytest.approx(scale)
    for path, overrides in vehicle.overrides.items():
        assert by_signal[path]["overrides"].items() >= overrides.items()
        assert any("contradicts" in why for why in by_signal[path]["why"])


def test_observed_values_are_those_of_the_drive(found) -> None:
    _, _, _, said = found
    for s in said["signals"]:
        low, high = s["observed"]
        assert low <= high
        if s["role"] in ("surface", "coolant_inlet"):
            assert 15.0 < low <= high < 60.0, s
        if s["role"] == "current":
            assert low < -5.0
            assert high > 20.0
        if s["role"] == "soc":
            assert 0.0 <= low <= high <= 1.0
        if s["role"] == "cell_voltage":
            assert 3.0 < low <= high < 4.5


@pytest.mark.plain_cases(4)
def test_check_calls_it_sound_and_analyze_estimates(found, capsys, tmp_path) -> None:
    _, log, out, _ = found
    assert main(["check", str(out / "gateway.toml")]) == 0
    assert main(["analyze", str(log), "--config", str(out / "gateway.toml"), "--out", str(tmp_path / "r")]) == 0
    rows = np.genfromtxt(tmp_path / "r" / "estimates.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    core = rows["core_C"][rows["time_s"] > rows["time_s"][0] + 60]
    assert np.isfinite(core).mean() > 0.9
    assert 15.0 < np.nanmin(core) <= np.nanmax(core) < 80.0
    summary = json.loads((tmp_path / "r" / "summary.json").read_text())
    lost = sum(summary["rejected"].values())
    assert lost < 0.1 * summary["frames"], summary["rejected"]


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.plain_cases(1)
def test_traffic_of_our_own_dbc_needs_no_guess(named: bool, tmp_path) -> None:
    from bms_gateway.config import shipped

    config, log = shipped("deploy/example/gateway.toml"), tmp_path / "own.log"
    assert main(["simulate", "--config", str(config), "--out", str(log), "--duration", "40", "--seed", "1"]) == 0
    dbc = ["--dbc", str(shipped("dbc/bms_gateway.dbc"))] if named else []
    said = tmp_path / "init.json"
    words = ["init", str(log), *dbc, "--cell", "a123_32157", "--out", str(tmp_path / "v"), "--json", str(said)]
    assert main(words) == 0
    found = json.loads(said.read_text())
    assert [s["cells"] for s in found["strings"]] == [12] * 5
    assert all(s["sure"] for s in found["signals"])
    ends = [s for s in found["signals"] if s["role"] == "surface"]
    assert [(s["string"], s["index"]) for s in ends[:2]] == [("string_1", 1), ("string_1", 12)]
    assert main(["check", str(tmp_path / "v" / "gateway.toml"), "--log", str(log)]) == 0


@pytest.mark.parametrize("found", ["bus"], indirect=True)
def test_each_pack_has_its_own_water(found) -> None:
    _, _, _, said = found
    inlets = {s["string"]: (s["signal"], s["sure"]) for s in said["signals"] if s["role"] == "coolant_inlet"}
    assert inlets == {f"string_{m}": (f"EssPackTemps{m}.EssPack{m}WaterIn", True) for m in (1, 2)}


@pytest.mark.parametrize("found", ["scooter"], indirect=True)
def test_the_greatest_reading_is_written_as_that_of_all_cells_and_the_others_as_comments(found) -> None:
    _, _, out, _ = found
    text = (out / "gateway.toml").read_text()
    assert '\nhottest = { max_of = "1-14", signal = "BMS_Msg2.MaxCelTemp" }' in text  # by MaxCelSpanning
    assert '\n# coldest = { min_of = "1-14", signal = "BMS_Msg2.MinCelTemp" }' in text
    assert '\n# mean = { mean_of = "1-14", signal = "BMS_Msg2.GemCelTemp" }' in text
    assert "sensors = [14]" in (out / "string_1.toml").read_text()


@pytest.mark.parametrize("found", sorted(IN_SERIES), indirect=True)
def test_the_voltage_of_an_extreme_cell_tells_how_many_are_in_series(found) -> None:
    vehicle, _, out, said = found
    assert said["series_cells"] == IN_SERIES[vehicle.name]
    text = (out / "gateway.toml").read_text()
    assert f"there are {said['series_cells']} cells in series" in text
    assert "by the signals of the greatest and least cell voltage" in text
    assert "is a guess" not in text  # the bus says it
