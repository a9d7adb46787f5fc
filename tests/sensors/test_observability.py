"""Ranks against rational arithmetic written here, and the figures published or derived for twelve cells."""

import itertools
from fractions import Fraction

import numpy as np
import pytest

from bms_gateway.sensors import exact_rank, observability, paper_rank, steady_core_sd
from bms_gateway.thermal import Disturbance, StringParameters, continuous, gathered_noise
from tests.truth.string import C_F, TABLE_1

FOURS = list(itertools.combinations(range(1, 13), 4))
COUPLINGS = {
    "full": {"R_cc": 32.0, "C_f": C_F},
    "natural": {"R_cc": 32.0},
    "no-conduction": {"C_f": C_F},
    "single": {},
}


def cells(n, condition="full", **other):
    return StringParameters.of(n, **{**TABLE_1, **COUPLINGS[condition], **other})


def rational_rank(n, sensors, R_cc, C_f):
    """Rank of [C; CA; …] over the rationals, from heat balances written out here."""
    C_c, C_s, _, R_c, R_u = (Fraction(v) for v in TABLE_1.values())
    g = 1 / Fraction(R_cc) if R_cc else Fraction(0)
    e = 1 / (R_u * Fraction(C_f)) if C_f else Fraction(0)

    def rates(x):
        T_c, T_s = x[0::2], x[1::2]
        stream, out = Fraction(0), []
        for k in range(n):
            around = [j for j in (k - 1, k + 1) if 0 <= j < n]
            into = (stream - T_s[k]) / R_u + (T_c[k] - T_s[k]) / R_c + sum(g * (T_s[j] - T_s[k]) for j in around)
            out += [(T_s[k] - T_c[k]) / R_c / C_c, into / C_s]
            stream += e * (T_s[k] - stream)
        return out

    unit = [[Fraction(int(i == j)) for i in range(2 * n)] for j in range(2 * n)]
    columns = [rates(u) for u in unit]
    rows = [unit[2 * k - 1] for k in sensors]
    every = list(rows)
    for _ in range(2 * n - 1):
        rows = [[sum(r * c for r, c in zip(row, column, strict=True)) for column in columns] for row in rows]
        every += rows
    rank = 0
    for column in range(2 * n):
        pivot = next((r for r in every[rank:] if r[column]), None)
        if pivot is None:
            continue
        every.remove(pivot)
        every.insert(rank, pivot)
        for i in range(rank + 1, len(every)):
            if factor := every[i][column] / pivot[column]:
                every[i] = [a - factor * b for a, b in zip(every[i], pivot, strict=True)]
        rank += 1
    return rank


@pytest.mark.parametrize("condition", COUPLINGS)
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_exact_rank_is_the_rational_one(n, condition):
    coupling = COUPLINGS[condition]
    for m in range(1, n + 1):
        for sensors in itertools.combinations(range(1, n + 1), m):
            expected = rational_rank(n, sensors, coupling.get("R_cc"), coupling.get("C_f"))
            assert exact_rank(cells(n, condition), sensors) == expected, sensors


def test_one_sensor_anywhere_determines_a_full_string_of_any_length():
    assert all(exact_rank(cells(n), (k,)) == 2 * n for n in range(1, 13) for k in range(1, n + 1))


@pytest.mark.parametrize(
    ("condition", "sets"), [("full", 495), ("natural", 494), ("no-conduction", 165), ("single", 0)]
)
def test_how_many_sets_of_four_determine_twelve_cells(condition, sets):
    p = cells(12, condition)
    blind = [s for s in FOURS if exact_rank(p, s) < 24]
    assert len(FOURS) - len(blind) == sets
    if condition == "natural":
        assert blind == [(2, 5, 8, 11)]  # on the nodes of a mode


def test_without_conduction_a_sensor_sees_what_is_upstream():
    p = cells(9, "no-conduction")
    assert [exact_rank(p, (k,)) for k in range(1, 10)] == [2 * k for k in range(1, 10)]


def test_exact_rank_takes_the_ntu_node_and_no_sensor_too():
    assert exact_rank(cells(6, coolant="ntu"), (3,)) == 12
    assert exact_rank(cells(6), ()) == 0
    assert paper_rank(cells(6), ()) == 0


def test_exact_rank_of_forty_cells_is_full_where_double_precision_gives_up():
    assert exact_rank(cells(40), (1,)) == 80
    assert paper_rank(cells(40), (1,)) < 80


def test_published_counts_are_those_of_rounding():
    """Table 3: the counts move with R_cc and with the unit of time, which a rank cannot."""
    full = cells(12, R_cc=5.0)
    natural = cells(12, "natural", R_cc=45.0)
    alone = cells(12, "no-conduction")
    assert sum(paper_rank(full, s) == 24 for s in FOURS) == pytest.approx(217, abs=2)
    assert sum(paper_rank(natural, s) == 24 for s in FOURS) == pytest.approx(52, abs=2)
    assert [s for s in FOURS if paper_rank(alone, s) == 24] == [(3, 6, 9, 12)]


@pytest.mark.parametrize(
    ("sensors", "sd"),
    [
        ((), 1.411),
        ((12,), 0.732),
        ((1, 12), 0.485),
        ((1, 2, 12), 0.467),
        ((3, 6, 9, 12), 0.496),
        ((1, 2, 11, 12), 0.429),
        (tuple(range(1, 13)), 0.366),
    ],
)
def test_worst_core_of_twelve_cells_is_as_derived(sensors, sd):
    assert steady_core_sd(cells(12), sensors).max() == pytest.approx(sd, rel=0.01)


def test_steady_sd_is_where_the_filter_ends():
    p, sensors = cells(3), (1, 3)
    d, s = Disturbance(), continuous(p)
    common = s.B_q.sum(axis=1)
    W = d.heat_common**2 * np.outer(common, common) + d.heat_cell**2 * s.B_q @ s.B_q.T
    Phi, Q = gathered_noise(s.A, 2 * d.correlation * (W + d.inlet**2 * np.outer(s.B_f, s.B_f)), 1.0)
    C = np.eye(6)[[1, 5]]
    P = np.eye(6) * 100
    for _ in range(6000):
        P = Phi @ P @ Phi.T + Q
        P -= P @ C.T @ np.linalg.solve(C @ P @ C.T + d.sensor**2 * np.eye(2), C @ P)
    np.testing.assert_allclose(steady_core_sd(p, sensors), np.sqrt(np.diag(P)[0::2]), rtol=1e-5)


def test_a_sensor_more_never_widens_a_band_and_the_answer_names_the_worst_cell():
    p = cells(6)
    one, two = observability(p, (6,)), observability(p, (1, 6))
    assert (two.core_sd <= one.core_sd + 1e-9).all()
    assert two.observable
    assert two.states == two.exact_rank == 12
    assert two.core_sd[two.worst_cell - 1] == two.core_sd.max()


def test_with_independent_heat_errors_only_no_placement_helps_an_unsensed_cell():
    d = Disturbance(heat_common=0.0, heat_cell=0.5, inlet=0.0)
    p = cells(6, "single")
    np.testing.assert_allclose(steady_core_sd(p, (1, 6), d)[1:5], steady_core_sd(p, (), d)[1:5], rtol=1e-6)
