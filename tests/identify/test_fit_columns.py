"""Columns at fewer places lead a fit to the optimum that columns at every reading lead to."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.stats import norm

from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.fit_columns import FEWEST, LONG_S, LONGEST_S, places
from bms_gateway.identify.map_fit import fitted
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import AddedEffect
from bms_gateway.thermal.drive import Drive, Span
from tests.identify.fit_records import model, record


def part(lengths, dt, *, channels=2, pace=1.0, seed=0, held=0.2):
    """A record in parts of so many intervals, read at random times, `pace` times per interval."""
    rng = np.random.default_rng(seed)
    N = sum(lengths)
    x = rng.normal(size=N)
    drive = Drive(dt, x, x**2, abs(x), 20 + x, 1 + 0 * x, 0 * x, np.nan * x, np.nan * x, 0 * x, frozenset())
    ends = np.cumsum(lengths)
    spans = tuple(Span(int(b - n), int(b)) for b, n in zip(ends, lengths, strict=True))
    rows = np.concatenate([np.arange(n) + s.first + i for i, (n, s) in enumerate(zip(lengths, spans, strict=True))])
    row = np.sort(rng.choice(rows, (channels, max(int(pace * N), 1))), axis=1)
    M = row.size
    return Measured(
        drive, spans, tuple(("surface", k + 1) for k in range(channels)), np.repeat(np.arange(channels), row.shape[1]),
        row.ravel(), rng.random(M), rng.normal(25.0, 3.0, M), rng.random(M) > held,
        np.full(channels, 0.1), np.zeros(channels), (np.full(channels, 24.0),) * len(spans),
        (np.full(channels, 0.1),) * len(spans),
    )  # fmt: skip


def seconds(m, row, share):
    """Time in the record's own intervals since its first, gaps left out."""
    span = np.searchsorted(np.cumsum([len(s) + 1 for s in m.spans]), row, side="right")
    return (row - span + share) * m.drive.dt


LENGTHS = st.lists(st.integers(FEWEST, 40), min_size=1, max_size=3)


@settings(max_examples=60, deadline=None)
@given(LENGTHS, st.sampled_from([0.5, 1.0, 3.0, 3.5]), st.floats(0.3, 4.0), st.integers(0, 99))
def test_every_reading_has_one_place_near_it_of_its_own_sensor_and_use(lengths, dt, pace, seed):
    m = part(lengths, dt, pace=pace, seed=seed)
    p = places(m)
    assert p.joined == (2 * dt <= LONGEST_S)
    assert p.count.sum() == len(m.y) == len(p.place)
    assert (p.at.channel[p.place] == m.channel).all()
    assert (p.at.used[p.place] == m.used).all()
    # an odd last interval hangs on the one before
    apart = np.abs(seconds(m, m.row, m.share) - _time(p, m, lengths)[p.place])
    assert apart.max() <= (3.0 if p.joined else 1.0) * dt + 1e-9
    # the places of a reading taken twice, means of readings, and residuals that keep their variance
    assert p.averaged(m.y) == pytest.approx(p.at.y)
    assert p.gathered(m.y) == pytest.approx(p.at.y * np.sqrt(p.count))


def test_a_long_string_has_fewer_places():
    # sixty thermocouples for an hour: with a place every six seconds, columns of tolerances took minutes
    m = part([1200], 3.0, channels=60)
    p = places(m)
    assert p.at.drive.dt == LONG_S
    assert p.factor == 4
    assert (p.at.channel[p.place] == m.channel).all()
    assert (p.at.used[p.place] == m.used).all()
    assert np.abs(seconds(m, m.row, m.share) - _time(p, m, [1200])[p.place]).max() <= LONG_S
    assert places(part([1200], 3.0, channels=12)).factor == 2


def _time(p, m, lengths):
    """Times of the places in the record's own: parts of an odd number of intervals are one shorter in pairs."""
    span = np.searchsorted(np.cumsum([len(s) + 1 for s in p.at.spans]), p.at.row, side="right")
    first = np.array([s.first for s in m.spans])[span]
    start = np.array([s.first for s in p.at.spans])[span]
    return first * m.drive.dt + (p.at.row - span - start + p.at.share) * p.at.drive.dt


def test_what_is_straight_between_the_instants_is_read_there_as_its_mean():
    """Rows of the longer intervals are the record's own at the same times: a ramp over each part says so."""
    m = part([9, 24, 31], 1.0, pace=2.0, seed=3)
    p = places(m)
    ramp = np.concatenate([100.0 * i + np.arange(len(s) + 1) for i, s in enumerate(m.spans)])
    at = ramp[p.rows]
    read = ramp[m.row] + m.share * (ramp[m.row + 1] - ramp[m.row])
    there = at[p.at.row] + p.at.share * (at[p.at.row + 1] - at[p.at.row])
    assert there == pytest.approx(p.averaged(read))


def test_a_short_part_or_long_intervals_are_left_as_they_are():
    for m in (part([FEWEST - 1, 40], 1.0), part([40], LONGEST_S)):
        p = places(m)
        assert not p.joined
        assert p.at.drive is m.drive
        assert p.at.spans == m.spans


@pytest.mark.parametrize("effects", [(), (AddedEffect("resistance_temperature", None, {"B": 500.0}, {"B": 2000.0}),)])
def test_columns_there_are_means_of_those_at_the_readings(effects):
    m, _, _ = record(2, seed=4)
    problem = Problem(model(2, *effects), [m])
    theta = np.array([c.begin for c in problem.coordinates])
    prediction = problem.predict(theta)
    problem.renew(prediction, theta)
    J = problem.columns(theta, prediction, problem.coordinates)
    expected = problem.averaged(problem.jacobian(theta, prediction, problem.coordinates))
    assert J.shape[0] < 0.51 * len(m.y)
    for j, c in enumerate(problem.coordinates):
        assert np.linalg.norm(J[:, j] - expected[:, j]) < 0.02 * np.linalg.norm(expected[:, j]), c.name


@pytest.mark.parametrize("step", [0.0, 0.25])
def test_the_fit_ends_within_chance_of_the_optimum_of_every_reading(step):
    """Against scipy's trust region on all readings, with columns by its own differences."""
    m, _, _ = record(1, seed=11, step=step)
    m = replace(m, used=np.arange(len(m.y)) % 600 < 480)
    problem = Problem(model(1), [m])
    fit = fitted(problem)
    prior, sd = (np.array([getattr(c, k) for c in problem.coordinates]) for k in ("prior", "sd"))

    def residual(theta):
        u = (m.y - problem.predict(theta).y)[m.used] / 0.1
        if step:
            h = 0.5 * step / 0.1
            p = norm.cdf(h - abs(u)) - norm.cdf(-h - abs(u))
            u = np.sign(u) * np.sqrt(-2.0 * np.log(p / (2.0 * h * norm.pdf(0.0))))
        return np.concatenate([u, (theta - prior) / sd])

    best = least_squares(residual, fit.theta, diff_step=1e-4, x_scale=np.sqrt(np.diag(fit.covariance)))
    assert fit.cost - 2.0 * best.cost < 0.3
    away = fit.theta - best.x
    assert away @ np.linalg.solve(fit.covariance, away) < 0.3
