"""The thermal time constant of a log against that of the named cell: told where they are far apart, and only there."""

import numpy as np
import pytest

from bms_gateway.cli.main import main
from bms_gateway.setup.thermal_time import time_shown
from tests.setup.vehicles import SECONDS, Vehicle, write

T = np.arange(SECONDS * 10) / 10


def warmed(times: tuple[float, float], amps: float = 60.0) -> np.ndarray:
    """Two nodes by Euler steps under a current that goes on and off.

    `times` are those of the surface to the coolant and of the core to the surface. Returns current, A, and surface, °C.
    """
    current = amps * (np.sin(2 * np.pi * T / 130) > 0)
    core = skin = 20.0
    out = np.empty(len(T))
    for k, I in enumerate(current):  # noqa: E741
        flow = (core - skin) / times[1]
        core += 0.1 * (I**2 * 1e-4 - flow)
        skin += 0.1 * (4.0 * flow - (skin - 20.0) / times[0])
        out[k] = skin
    return np.stack([current, out])


@pytest.mark.parametrize(("skin", "core"), [(10.0, 10.0), (20.0, 15.0), (30.0, 10.0)])
def test_the_slow_time_constant_lies_between_the_bounds(skin: float, core: float) -> None:
    current, surface = warmed((skin, core))
    rates = np.array([[-1 / core, 1 / core], [4 / core, -4 / core - 1 / skin]])
    slow = -1 / np.linalg.eigvals(rates).real.max()
    rows = slice(None, None, 10)
    shown = time_shown(T[rows], current[rows] ** 2, np.round(surface[rows], 1), np.full(SECONDS, 20.0), 0.1)
    assert shown is not None
    assert shown[0] <= 1.15 * slow
    assert shown[1] >= 0.85 * slow
    assert shown[1] < 2.0 * slow


def test_a_log_that_is_too_short_or_too_still_shows_none() -> None:
    current, surface = warmed((900.0, 60.0))
    rows = slice(None, None, 10)
    still = np.full(SECONDS, 20.0)
    assert time_shown(T[rows], current[rows] ** 2, np.round(surface[rows], 1), still, 0.1) is None
    assert time_shown(T[rows], current[rows] ** 2, still, still, 0.1) is None


def made(surface: np.ndarray, current: np.ndarray, folder) -> list[str]:
    lines = ['VERSION ""', "BU_: B", "BO_ 256 Pack: 8 B", ' SG_ PackCurrent : 0|16@1- (0.1,0) [-1000|1000] "A" B',
             ' SG_ PackVoltage : 16|16@1+ (0.01,0) [0|600] "V" B', "BO_ 257 Temps: 8 B"]  # fmt: skip
    lines += [f' SG_ CellTemp{k + 1} : {16 * k}|16@1- (0.1,0) [-40|90] "degC" B' for k in range(4)]
    lines += ["BO_ 258 Cooling: 8 B", ' SG_ CoolantInletTemp : 0|16@1- (0.1,0) [-40|90] "degC" B']
    values = {"Pack.PackCurrent": current, "Pack.PackVoltage": 380.0 - 0.1 * current}
    values |= {f"Temps.CellTemp{k + 1}": surface + 0.1 * k for k in range(4)}
    values["Cooling.CoolantInletTemp"] = np.full(len(T), 20.0)
    vehicle = Vehicle("warm", "\n".join(lines), values, {"Temps": 1.0, "Cooling": 1.0}, {})
    log, dbc = write(vehicle, folder)
    return [str(log), "--dbc", str(dbc), "--out", str(folder / "v"), "--yes"]


def test_a_cell_that_is_far_slower_than_the_log_is_told(tmp_path, capsys) -> None:
    current, surface = warmed((20.0, 15.0))
    words = made(surface, current, tmp_path)
    assert main(["init", *words, "--cell", "catl_lf280 still"]) == 0
    told = [line for line in capsys.readouterr().err.splitlines() if "follow heat and coolant in" in line]
    assert len(told) == 1
    for part in ("string_1", "'catl_lf280 still' would in", "cooling", "parallel"):
        assert part in told[0]
