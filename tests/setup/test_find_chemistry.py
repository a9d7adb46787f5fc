"""Iron phosphate or not, and the number of cells in series, where no voltage of a cell is on the bus."""

import csv

import numpy as np
import pytest

from bms_gateway.setup.find_chemistry import chemistries, count_cells
from tests.data import need
from tests.setup.proposals import proposed
from tests.setup.vehicles import SECONDS, Vehicle, drive

N = SECONDS * 10
# a maker's data sheet of an iron phosphate cell: V at rest over the SOC; not the table of the product
LFP_SOC = [0.0, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95, 1.0]
LFP_V = [2.7, 3.205, 3.25, 3.282, 3.29, 3.30, 3.328, 3.336, 3.42]


def rest(kind: str, soc: np.ndarray) -> np.ndarray:
    return np.interp(soc, LFP_SOC, LFP_V) if kind == "LFP" else 3.42 + 0.55 * soc + 0.2 * soc**3


def driven(kind: str, cells: int, swing: float, seed: int, start: float = 0.8) -> tuple[np.ndarray, ...]:
    """A, V and SOC by the second for half an hour; two lags of the polarisation, 3 % scatter of the SOC's scale."""
    rng = np.random.default_rng(seed)
    n = 1800
    I = np.repeat(rng.choice([0.0, 40.0, 90.0, 160.0, -50.0, 20.0], n // 10), 10)  # noqa: E741
    drawn = np.cumsum(I)
    soc = start - swing * drawn / drawn.max()
    lag = np.zeros((2, n))
    for k in range(1, n):
        for j, tau in enumerate((12.0, 150.0)):
            lag[j, k] = lag[j, k - 1] + (I[k] - lag[j, k - 1]) / tau
    R = 0.6e-3
    V = cells * (rest(kind, soc) - R * I - 0.4 * R * lag[0] - 0.5 * R * lag[1])
    return I, np.round(V, 1), np.round(soc * (1 + 0.03 * rng.normal()), 3)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("kind", "cells"), [("LFP", 120), ("LFP", 16), ("NMC", 108), ("NMC", 14)])
def test_a_drive_over_a_quarter_of_the_charge_tells_both(kind: str, cells: int, seed: int) -> None:
    I, V, soc = driven(kind, cells, 0.27, seed)  # noqa: E741
    found = chemistries(I, V, soc, 1.0)
    assert found is not None
    assert found.flat == (kind == "LFP")
    assert (found.cells_flat if kind == "LFP" else found.cells_other) == pytest.approx(cells, rel=0.025)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["LFP", "NMC"])
def test_a_short_drive_tells_no_chemistry_but_is_never_wrong(kind: str, seed: int) -> None:
    found = chemistries(*driven(kind, 100, 0.05, seed), 1.0)
    assert found is not None
    assert found.flat is None
    assert (found.cells_flat if kind == "LFP" else found.cells_other) == pytest.approx(100, rel=0.04)


@pytest.mark.parametrize("trip", ["A02", "A32", "B23", "B28"])
def test_a_measured_car_has_96_cells_of_another_kind(trip: str) -> None:
    with open(need("i3_trips", f"bmw_i3_Trip{trip}_1Hz.csv")) as file:
        rows = [[float(r[k] or "nan") for k in ("I_A", "V_V", "SoC")] for r in csv.DictReader(file)]
    I, V, soc = np.array(rows).T  # noqa: E741
    found = chemistries(-I, V, soc / 100, 1.0)
    assert found is not None
    assert found.flat is False
    assert found.cells_other == pytest.approx(96, abs=1.6)


def test_what_a_person_says_of_the_cell_decides() -> None:
    counted = count_cells(396.0, None, "LFP")
    assert (round(396.0 / counted.cell_V), counted.told) == (120, True)
    assert round(396.0 / count_cells(396.0, None, "NMC").cell_V) == 107
    open_ = count_cells(396.0, None, None)
    assert not open_.told
    assert "of iron phosphate (LFP) 120" in open_.why


def vehicle(kind: str, soc: bool) -> Vehicle:
    """A pack of 60 cells whose bus has no voltage of a cell."""
    d = drive(31)
    share = 0.8 - 0.3 * np.cumsum(d.current) / max(np.cumsum(d.current).max(), 1.0)
    lines = ['VERSION ""', "BU_: X", "BO_ 410 Pack: 8 X", ' SG_ PackCurrent : 0|16@1- (0.1,0) [0|0] "A" X',
             ' SG_ PackVoltage : 16|16@1+ (0.1,0) [0|0] "V" X']  # fmt: skip
    v = {"Pack.PackCurrent": d.current, "Pack.PackVoltage": 60 * (rest(kind, share) - 1e-3 * d.current)}
    if soc:
        lines.append(' SG_ PackSOC : 32|16@1+ (0.01,0) [0|100] "%" X')
        v["Pack.PackSOC"] = 100 * share
    lines.append("BO_ 411 Temps: 8 X")
    lines += [f' SG_ CellTemp{k + 1} : {16 * k}|16@1- (0.1,0) [0|0] "degC" X' for k in range(4)]
    v |= {f"Temps.CellTemp{k + 1}": d.surface[:, k] for k in range(4)}
    return Vehicle(f"{kind}{soc}", "\n".join(lines), v, {"Temps": 1.0}, {})


@pytest.mark.parametrize("kind", ["LFP", "NMC"])
def test_init_counts_the_cells_and_says_by_what(kind: str, tmp_path) -> None:
    proposal = proposed(vehicle(kind, soc=True), tmp_path)
    assert proposal.series_cells == pytest.approx(60, abs=1)
    assert any("cells in series" in r and "iron phosphate" in r and "guess" not in r for r in proposal.remarks)


def test_init_says_where_it_cannot_tell(tmp_path) -> None:
    proposal = proposed(vehicle("LFP", soc=False), tmp_path)
    told = [r for r in proposal.remarks if "cells in series is a guess" in r]
    assert len(told) == 1
    assert "of iron phosphate (LFP) 60" in told[0]
