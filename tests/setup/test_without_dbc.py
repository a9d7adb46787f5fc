"""Without a DBC: what moves as a current, a voltage and thermocouples do is proposed, and never more than a guess.

Where the bits really are is told by the DBC by which the simulated frames were made, or by that of the maker.
"""

import json
import re

import numpy as np
import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import shipped
from bms_gateway.config.dbc_files import dbc_text, own_dbc_text
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.bits import Place
from bms_gateway.frames.dbc import parse, parse_lenient
from bms_gateway.setup.bit_fields import SELECTORS, fields_of
from bms_gateway.setup.vehicle_logs import read_traffic
from bms_gateway.setup.without_dbc import guess
from tests.data import need
from tests.setup.every_vehicle import EVERY
from tests.setup.vehicles import write


def bits(place):
    """Numbers of the bits, counted through the bytes in the order of their own significance."""
    if not place.big_endian:
        return set(range(place.start, place.start + place.size))
    found, at = [], place.start
    for _ in range(place.size):
        found.append(at)
        at = at + 15 if at % 8 == 0 else at - 1
    return set(found)


def real(field, messages):
    """Names of the signals of which a field has three quarters of the bits, or twelve of a long one."""
    names = set()
    for m in messages:
        for s in m.signals.values() if m.can_id == field.can_id else ():
            values = s.mux[-1].values if s.mux else ()
            if s.mux and field.page is not None and field.page not in values:
                continue
            if len(bits(s.place) & bits(field.place)) >= min(0.75 * s.place.size, 12):
                names.add(s.path)
    return names


def proposed(log, dbc):
    text = dbc_text(dbc)
    messages = parse_lenient(str(dbc), text)
    found = {}
    for g in guess(read_traffic([log], []).frames):
        found.setdefault(g.role, []).append(set().union(*(real(f, messages) for f in (g.field, *g.beside))))
    return found


CURRENTS = {"german": "HVB_Strom_Ist", "imperial": "PackCurrent", "terse": "I_Batt", "wrong_dbc": "pack_curr",
            "french": "BAT_Courant", "scooter": "Stroom", "bus": "EssBusCurrent", "chinese": "ZongDianLiu",
            "worded": "BMS_IstStrom", "storage": "BatteryCurrent"}  # fmt: skip
WARM = {"german": "HVB_Zelltemp_", "imperial": "Thermistor", "wrong_dbc": "cell_temp_", "terse": "BMS_2.T",
        "french": "BAT_TempModule_", "bus": "Ntc", "chinese": "DanTiWenDu", "worded": "BMS_Zelltemp"}  # fmt: skip


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """Write a vehicle and propose, once for all tests."""
    done = {}

    def found(name):
        if name not in done:
            folder = tmp_path_factory.mktemp(name)
            vehicle = EVERY[name]()
            log, _ = write(vehicle, folder)
            (folder / "right.dbc").write_text(vehicle.dbc)
            done[name] = log, proposed(log, folder / "right.dbc")
        return done[name]

    return found


@pytest.mark.parametrize("name", CURRENTS)
@pytest.mark.plain_cases(4)
def test_a_current_is_among_the_first_three(simulated, name):
    assert any(CURRENTS[name] in path for names in simulated(name)[1]["current"] for path in names)


@pytest.mark.parametrize("name", WARM)
def test_thermocouples_are_among_the_first_three(simulated, name):
    found = simulated(name)[1]["surface"]
    assert any(WARM[name] in path for names in found for path in names), found


@pytest.mark.slow
def test_the_guesses_are_a_dbc_that_leads_to_a_config_in_which_nothing_is_sure(simulated, tmp_path, capsys):
    log, _ = simulated("imperial")
    out = tmp_path / "v"
    assert main(["init", str(log), "--out", str(out), "--yes", "--json", str(tmp_path / "g.json")]) == 1
    told = capsys.readouterr().out
    assert "GUESSES from the movement of the bits alone" in told
    assert not (out / "gateway.toml").exists()
    text = (out / "guessed.dbc").read_text()
    assert "GUESSED by bms-gateway init" in text
    assert max(len(number) for number in re.findall(r"\d+\.\d+", text)) <= 8  # no 3276.7000000000003
    messages = parse("guessed.dbc", text)
    assert messages
    assert all(m.name.startswith("GUESS_") for m in messages)
    assert {g["role"] for g in json.loads((tmp_path / "g.json").read_text())["guesses"]} >= {"current", "surface"}
    words = ["--dbc", str(out / "guessed.dbc"), "--out", str(out), "--yes", "--json", str(tmp_path / "i.json")]
    assert main(["init", str(log), *words]) == 0
    signals = json.loads((tmp_path / "i.json").read_text())["signals"]
    assert {"current", "surface"} <= {s["role"] for s in signals}
    assert not any(s["sure"] for s in signals)
    assert main(["check", str(out / "gateway.toml")]) == 0


def test_a_bus_without_anything_that_moves_gives_no_guess(tmp_path, capsys):
    log = tmp_path / "still.log"
    log.write_text("".join(f"({1e9 + k / 10:.6f}) can0 100#{k % 256:02X}00112233\n" for k in range(600)))
    assert main(["init", str(log), "--out", str(tmp_path / "v")]) == 1
    assert "GUESS" not in capsys.readouterr().out
    assert not (tmp_path / "v").exists()


SHUNTS = ("DC_Bus_Current", "IVT_Result_I.IVT_I", "BMU_stateBusHV.CurrentBusHV")
"""Of the race car: the inverter's, and two of the battery."""
REAL = {
    "uwfe_autocross_2025-04-30_run10": ("uwfe_2024CAR_fixed", {"current": SHUNTS, "surface": ("TempChannel",)}),
    "uwfe_july7_run12": ("uwfe_2024CAR_fixed", {"current": SHUNTS, "surface": ("TempChannel",)}),
    "uwfe_pitt_autocross_02": ("uwfe_2024CAR_fixed", {"current": SHUNTS, "surface": ("TempChannel",)}),
    "leaf_ze1_62kwh_eco_drive": ("leaf_EV-can_ZE1", {"current": ("LB_Current",)}),
}


@pytest.mark.parametrize("log", REAL)
@pytest.mark.slow
def test_real_vehicles_without_their_dbc(log):
    """The batteries of both Leaf logs stay at one temperature: nothing there can be known for a thermocouple."""
    dbc, wanted = REAL[log]
    found = proposed(need("can", f"{log}.log.gz"), need("dbc", f"{dbc}.dbc"))
    for role, parts in wanted.items():
        assert any(part in path for names in found[role] for path in names for part in parts), (role, found[role])


@pytest.mark.slow
def test_our_own_messages_without_our_dbc(tmp_path):
    """Their thermocouples are selected by half a byte beside a counter, behind a check sum."""
    log = tmp_path / "own.log"
    config = str(shipped("deploy/example/gateway.toml"))
    words = ["--cycle", "us06", "--seed", "3", "--duration", "900"]
    assert main(["simulate", "--config", config, "--out", str(log), *words]) == 0
    messages = parse_lenient("own.dbc", own_dbc_text())
    found = {}
    for g in guess(read_traffic([log], []).frames):
        found.setdefault(g.role, []).append(set().union(*(real(f, messages) for f in (g.field, *g.beside))))
    assert any("electrical.current" in path for names in found["current"] for path in names), found
    assert any("surface.surface_" in path for names in found["surface"] for path in names), found


@pytest.mark.parametrize("place", SELECTORS, ids=str)
def test_bits_that_select_are_found_beside_a_counter_and_a_check_sum(place):
    rng = np.random.default_rng(1)
    k = np.arange(400)
    data = np.zeros((400, 8), np.uint8)
    data[:, 0], data[:, 1] = rng.integers(0, 256, 400), k % 15
    byte, low = divmod(place.first_bit, 8)
    data[:, byte] &= 255 ^ ((1 << place.size) - 1 << low)
    data[:, byte] |= (k % 3 << low).astype(np.uint8)
    data[:, 4] = 60 * (k % 3) + k // 40
    frames = FrameBatch(k * 10**8, np.full(400, 0x123, np.uint32), np.full(400, 8, np.uint8), data)
    found = list(fields_of(frames))
    assert {f.page for f in found} == {0, 1, 2}
    if place.size == 8 or place.first_bit >= 8:
        assert {f.selector for f in found} == {place}
    assert all(f.place.bits.isdisjoint(f.selector.bits) for f in found)
    assert {f.page for f in found if f.place == Place(32, 8) and np.ptp(f.x) == 9} == {0, 1, 2}
