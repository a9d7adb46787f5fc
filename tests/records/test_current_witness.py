"""Voltage and SOC as witnesses of a current; the truth is a cell of this file, with polarisation, by Euler steps."""

import numpy as np
import pytest

from bms_gateway.records.current_witness import alternates, witness
from tests.data import need
from tests.records.ten_hertz import CAPACITY_AH, means

N, R = 1500, 0.03


def drive(seed: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Current at 10 Hz, voltage of twelve cells in 0.05 V, SOC in 0.4 %: stops, driving, braking."""
    rng = np.random.default_rng(seed)
    n = 10 * N
    level = np.repeat(rng.choice([0.0, 0.2, 0.5, 1.0, -0.4, -0.2], n // 80 + 1), 80)[:n]
    I = np.convolve(150.0 * level, np.ones(12) / 12, "same")  # noqa: E741
    slow = np.zeros(n)
    for k in range(1, n):
        slow[k] = slow[k - 1] + 0.1 / 25 * (0.45 * R * I[k] - slow[k - 1])
    soc = 0.8 - np.cumsum(I) * 0.1 / 3600 / CAPACITY_AH
    V = 12 * (3.35 + 0.75 * soc) - 0.55 * R * I - slow + rng.normal(0, 0.02, n)
    return I, np.round(V / 0.05) * 0.05, np.round(soc / 0.004) * 0.004


def heard(I: np.ndarray, V: np.ndarray, soc: np.ndarray):  # noqa: E741
    return witness(means(I), means(V), means(soc), 1.0, 0.05)


@pytest.mark.parametrize("seed", range(3, 9))
@pytest.mark.parametrize("late", [0, 20], ids=["at_once", "two_seconds_late"])
def test_the_current_of_the_pack_is_confirmed(seed: int, late: int) -> None:
    I, V, soc = drive(seed)  # noqa: E741
    found = heard(np.roll(I, late), V, soc)
    assert found.against == ()
    assert found.supported
    assert found.zero
    assert heard(-I, V, soc).supported


@pytest.mark.parametrize("seed", range(3, 9))
def test_a_current_of_the_motor_is_contradicted(seed: int) -> None:
    I, V, soc = drive(seed)  # noqa: E741
    rng = np.random.default_rng(seed)
    phase = 1.6 * np.abs(I) * np.sin(1.7 * np.arange(len(I)))
    assert any("changes without it" in text for text in heard(phase, V, soc).against)
    assert alternates(np.arange(len(I)) / 10, phase)
    assert any("have the wrong direction" in t or "a magnitude" in t for t in heard(1.4 * np.abs(I), V, soc).against)
    assert any("changes without it" in text for text in heard(3.0 + rng.normal(size=len(I)), V, soc).against)


@pytest.mark.parametrize("offset", [-400.0, -30.0, 40.0, 1600.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_current_with_an_offset_is_told_by_the_charge(offset: float, sign: float) -> None:
    I, V, soc = drive()  # noqa: E741
    found = heard(sign * I + offset, V, soc)
    assert found.offset_A == pytest.approx(offset, abs=2.0)
    assert len(found.against) == 1
    assert not found.zero


def test_a_charge_that_does_not_follow_is_blamed_on_the_charge_where_the_voltage_confirms_the_current() -> None:
    I, V, _ = drive()  # noqa: E741
    other = 0.5 + 0.2 * np.sin(np.arange(len(I)) / 700)
    assert heard(I, V, other).against == ()
    unknown = np.full(len(I), np.nan)
    assert any("does not follow" in text for text in heard(I, unknown, other).against)


@pytest.mark.parametrize("every", [1, 2, 5, 10])
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_current_that_is_sent_seldom_moves_no_less_charge(every: int, seed: int) -> None:
    """Bug: what lay between two frames counted for nothing, and a pack of 30 Ah was told to have 15."""
    I, V, soc = drive(seed)  # noqa: E741
    seldom = np.where(np.arange(N) % every == 0, means(I), np.nan)
    found = witness(seldom, means(V), means(soc), 1.0, 0.05)
    assert found.against == ()
    if every <= 2:  # the current stands for eight seconds at a time: one reading in five may miss it
        assert found.zero
        assert found.capacity_Ah == pytest.approx(CAPACITY_AH, rel=0.02)
    assert found.capacity_Ah is None or found.capacity_Ah == pytest.approx(CAPACITY_AH, rel=0.2)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_current_that_was_not_received_for_minutes_tells_nothing_of_the_charge(seed: int) -> None:
    """Bug: its charge was missing, and an offset of 24 A was told in its place."""
    I, V, soc = (means(x) for x in drive(seed))  # noqa: E741
    I[400:900] = np.nan
    found = witness(I, V, soc, 1.0, 0.05)
    assert found.against == ()
    assert found.offset_A is None
    assert found.capacity_Ah is None


def test_what_does_not_move_says_nothing() -> None:
    I = drive()[0]  # noqa: E741
    still = np.full(len(I), 48.0)
    found = heard(I, still, np.full(len(I), 0.5))
    assert found.against == ()
    assert not found.compared
    assert not found.zero


def test_a_cell_that_comes_to_its_end_under_one_current_is_no_contradiction() -> None:
    t = np.arange(3600.0)
    V = 4.1 - 0.6 * t / 3600 - 0.8 * np.exp((t - 3600) / 60)
    found = witness(5.0 + 0.01 * np.sin(t), V, np.full(len(t), np.nan), 1.0, 0.001)
    assert found.against == ()


TRIPS = ["A02", "A32", "B23", "B28"]


@pytest.mark.parametrize("trip", TRIPS)
def test_a_real_car_confirms_its_current_and_no_other(trip: str) -> None:
    rows = np.genfromtxt(need("i3_trips", f"bmw_i3_Trip{trip}_1Hz.csv"), delimiter=",", names=True)
    I, V, soc = rows["I_A"], rows["V_V"], rows["SoC"] / 100  # noqa: E741
    own = witness(I, V, soc, 1.0, 0.1)
    assert own.against == ()
    assert own.supported
    assert own.zero
    assert not alternates(rows["t_s"], I)
    shifted = witness(I + 100.0, V, soc, 1.0, 0.1)
    assert shifted.offset_A == pytest.approx(100.0, abs=2.0)
    assert witness(np.roll(I, 300), V, soc, 1.0, 0.1).against
