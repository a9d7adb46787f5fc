"""Whitening and marginal likelihood of the model's own error, against the dense covariance."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.diagnosis.slow_error import GRID, Discrepancy, Noise
from bms_gateway.identify.coordinates import Measured
from bms_gateway.thermal.drive import Drive, Span

SIGMA = np.array([0.18, 0.1])


def record(seed, intervals=60, dt=5.0):
    """Two thermocouples over two spans, read at odd moments, some readings missing and some held out."""
    rng = np.random.default_rng(seed)
    one, none = np.ones(intervals), np.full(intervals, np.nan)
    drive = Drive(dt, one, one, one, one, one, one, none, none, one, frozenset())
    spans = (Span(0, 25), Span(25, intervals))
    channel, row, share = [], [], []
    for j in range(2):
        for span, first in ((spans[0], 0), (spans[1], 26)):
            rows = first + np.flatnonzero(rng.random(len(span)) < 0.8)
            channel.append(np.full(len(rows), j))
            row.append(rows)
            share.append(rng.random(len(rows)))
    channel, row, share = (np.concatenate(x) for x in (channel, row, share))
    start = (np.zeros(2), np.zeros(2))
    return Measured(
        drive,
        spans,
        (("surface", 1), ("surface", 2)),
        channel,
        row,
        share,
        rng.standard_normal(len(row)),
        rng.random(len(row)) < 0.9,
        SIGMA,
        np.zeros(2),
        start,
        start,
    )


def dense(m, d):
    """Covariance of the readings used: independent between thermocouples and spans."""
    t, span = (m.row + m.share) * m.drive.dt, m.row >= 26
    same = (m.channel[:, None] == m.channel) & (span[:, None] == span)
    slow = d.size**2 * np.exp(-np.abs(t[:, None] - t) / d.time) * same
    full = slow + np.diag(SIGMA[m.channel] ** 2)
    return full[np.ix_(m.used, m.used)]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 99), st.sampled_from(GRID))
def test_whitening_gives_the_likelihood_of_the_dense_covariance(seed, d):
    m = record(seed)
    white = Noise([m]).at(d)
    cov = dense(m, d)
    r = white(m.y)
    u = m.y[m.used]
    assert white.log_det == pytest.approx(np.linalg.slogdet(cov)[1], rel=1e-10)
    assert float(r @ r) == pytest.approx(u @ np.linalg.solve(cov, u), rel=1e-9)
    assert not r[~m.used].any()


def test_columns_are_whitened_as_residuals_are():
    m = record(3)
    white = Noise([m]).at(Discrepancy(0.07, 160.0))
    columns = np.random.default_rng(0).standard_normal((len(m.y), 4))
    assert np.allclose(white(columns)[:, 2], white(columns[:, 2]), rtol=0, atol=1e-14)
    assert white(columns[:, :0]).shape == (len(m.y), 0)


@pytest.mark.parametrize("seed", range(3))
def test_profile_is_the_best_of_the_grid(seed):
    m = record(seed)
    m = replace(m, y=0.4 * m.y)

    def cost(d):
        cov, u = dense(m, d), m.y[m.used]
        return np.linalg.slogdet(cov)[1] + u @ np.linalg.solve(cov, u) + d.strain

    best = min((d for d in GRID if d.size >= 0.02), key=cost)
    assert Noise([m]).profile(m.y, 0.02) == best


def test_a_slow_error_is_found_at_its_size_and_pace():
    m = record(0, intervals=900)
    d = Discrepancy(0.15, 160.0)
    u = np.linalg.cholesky(dense(replace(m, used=np.ones(len(m.y), bool)), d)) @ np.random.default_rng(
        5
    ).standard_normal(len(m.y))
    found = Noise([m]).profile(u, 0.0)
    assert 0.1 <= found.size <= 0.22
    assert 80.0 <= found.time <= 320.0
