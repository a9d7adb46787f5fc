"""Heat in two cells at once: both are told, and no thermocouple, coolant or sound cell is blamed for it.

The truth is `tests.truth.pack` by way of the benchmark's cases; that of the evidence is the density of a Gaussian.
"""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bms_gateway.health.heat.several import Likes, Products
from tests.benchmarks.heat_case import Case
from tests.health.heat_runs import raised

EIGHT = tuple(range(1, 9))


def two(pack: str, drive: str, cells: tuple[int, ...], sensors: tuple[int, ...], heats: dict[int, float]) -> Case:
    """Two cells that heat from minute 40 on, for 25 min."""
    (first, watts), *also = heats.items()
    at = {"at": 2400, "cells": max(cells), "sensors": sensors}
    return Case(pack, 0, 3900, drive, "heat", first, watts, also=tuple(also), **at)


@pytest.mark.parametrize(
    ("pack", "drive", "sensors", "heats"),
    [
        ("liquid", "urban", (2, 5, 7), {2: 10.0, 5: 6.0}),
        ("small", "urban", (2, 5, 7), {2: 3.0, 7: 3.0}),
        ("liquid", "rest", (2, 5, 7), {2: 10.0, 7: 10.0}),
        ("liquid", "urban", EIGHT, {3: 10.0, 5: 10.0}),
        ("small", "rest", EIGHT, {3: 3.0, 5: 3.0}),
        ("liquid", "rest", EIGHT, {3: 10.0, 6: 6.0}),
        ("small", "rest", (2, 5, 7), {2: 1.8, 5: 1.8}),
    ],
)
@pytest.mark.plain_cases(4)
def test_heat_in_two_sensed_cells_is_told_and_both_are_named(
    pack: str, drive: str, sensors: tuple[int, ...], heats: dict[int, float]
) -> None:
    """Bug: with three thermocouples, the one of the sound cell was said to be wrong, and no heat was told."""
    for alerts in raised(two(pack, drive, EIGHT, sensors, heats), range(700, 704)):
        told = {cell: t for t, code, cell in alerts if code == "unexplained_heat"}
        assert set(heats) <= set(told)
        assert max(told[cell] for cell in heats) - 2400 <= 240
        assert {code for _, code, _ in alerts} <= {"unexplained_heat", "thermocouple"}
        assert {cell for _, code, cell in alerts if code == "thermocouple"} <= set(heats)
        assert alerts[0][1] == alerts[1][1] == "unexplained_heat"


def test_three_of_eight_cells_that_heat_are_named() -> None:
    heats = {2: 10.0, 5: 8.0, 8: 8.0}
    for alerts in raised(two("liquid", "urban", EIGHT, EIGHT, heats), range(710, 713)):
        told = {cell for _, code, cell in alerts if code == "unexplained_heat"}
        assert set(heats) <= told
        assert {code for _, code, _ in alerts} == {"unexplained_heat"}


def test_one_cell_that_heats_is_named_alone_though_its_neighbours_are_warmed() -> None:
    for alerts in raised(two("liquid", "urban", EIGHT, EIGHT, {3: 30.0}), range(720, 725)):
        assert [(code, cell) for _, code, cell in alerts] == [("unexplained_heat", 3)]


@pytest.mark.parametrize("fault", ["pump", "fan"])
def test_what_all_thermocouples_show_is_no_heat_of_cells(fault: str) -> None:
    """Bug of a first version: a pump that stopped was heat in each of the three sensed cells."""
    for alerts in raised(Case("liquid", 0, drive="us06", fault=fault), range(5108, 5111)):
        assert alerts[0][1] == "cooling"
        assert not any(code == "unexplained_heat" for _, code, _ in alerts)


def test_the_evidence_for_a_set_of_faults_is_that_of_their_gaussian_density() -> None:
    rng = np.random.default_rng(3)
    steps, m, faults = 5, 3, 4
    g, size = rng.normal(size=(steps, 1, m, 1, faults)), np.array([0.5, 1.0, 2.0, 1.5])
    S = np.stack([np.cov(rng.normal(size=(m, 20))) for _ in range(steps)])
    nu = rng.normal(size=(steps, m)) + g[:, 0, :, 0] @ np.array([0.9, 0.0, 1.7, 0.0])
    products, D = Products(np.zeros(faults, np.int64), 1, 1, (0,)), np.zeros((1, faults))
    for k in range(steps):
        V = np.linalg.solve(S[k], g[k, 0, :, 0])[None, :, None, :]
        products.take(g[k], V)
        D += nu[k] @ V[0, :, 0]
    likes = Likes(products.of(0, 0), D, size**-2.0, (-np.inf, np.inf))
    blocks = np.zeros((steps * m, steps * m))
    for k in range(steps):
        blocks[k * m : (k + 1) * m, k * m : (k + 1) * m] = S[k]
    G, y = g[:, 0, :, 0].reshape(-1, faults), nu.reshape(-1)
    sets = np.array([[0, 1], [0, 2], [2, 3]])
    ln, amplitude, var = likes.weigh(sets, 0)
    for place, some in enumerate(sets):
        with_them = blocks + G[:, some] @ np.diag(size[some] ** 2) @ G[:, some].T
        zero = np.zeros(len(y))
        by_density = multivariate_normal(zero, with_them).logpdf(y) - multivariate_normal(zero, blocks).logpdf(y)
        assert ln[place] == pytest.approx(by_density, abs=1e-9)
        gain = np.diag(size[some] ** 2) @ G[:, some].T @ np.linalg.inv(with_them)
        np.testing.assert_allclose(amplitude[place], gain @ y, atol=1e-9)
        np.testing.assert_allclose(var[place], np.diag(size[some] ** 2) - gain @ G[:, some] @ np.diag(size[some] ** 2))
    apart = ~np.eye(faults, dtype=bool)
    found = likes.likeliest(apart, 2.0, faults)
    assert found is not None
    assert set(found[2].tolist()) == {0, 2}
    apart[0, 2] = apart[2, 0] = False
    other = likes.likeliest(apart, 2.0, faults)
    assert other is not None
    assert other[0] < found[0]
    assert likes.likeliest(apart, 2.0, 1) is None


@pytest.mark.parametrize("sensors", [(2, 6, 10), (1, 3, 5, 7)])
def test_two_thermocouples_that_come_loose_make_no_sound_cell_hot(sensors: tuple[int, ...]) -> None:
    """Bug: the cell of the third thermocouple was said to have a short."""
    loose = sensors[0], sensors[2]
    at = {"at": 2400, "cells": 12 if sensors[-1] == 10 else 8, "sensors": sensors}
    case = Case("liquid", 0, 2520, "us06", "loose", loose[0], 0.3, also=((loose[1], 0.3),), **at)
    both = {("thermocouple", cell) for cell in loose}
    told = [{(code, cell) for _, code, cell in alerts} for alerts in raised(case, range(730, 735))]
    assert not any(code == "unexplained_heat" for x in told for code, _ in x)
    assert sum(x >= both for x in told) >= 4  # where the vehicle stands, nothing shows it
