"""Pictures of what a model leaves over, against what NumPy makes of the same residuals and the table."""

import csv

import numpy as np
import pytest

from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.whiteness import correlation
from tests.support.desk_steps import done, files
from tests.truth.packs import pack as make_pack

NOISE_K = 0.05
"""Of the sensors of the pack."""


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"), noise=NOISE_K)


def of_desk(pack, table):
    """Residual of cell 1 in order of time, and the pictures of what is left over, as a desk gives them."""
    desk = Desk("test")
    try:
        desk.open(files(pack, table))
        done(desk)
        surface = next(s for s in desk.figure("surface-0-1")["steps"] if s["name"] == "refitted")
        kinds = ("auto", "heat", "inlet", "noise")
        return np.array(surface["each"]["y"], float), {kind: desk.figure(f"{kind}-0-1") for kind in kinds}
    finally:
        desk.close()


def drawn(figure):
    step = next(s for s in figure["steps"] if s["name"] == "refitted")["model"]
    return np.array(step["x"], float), np.array(step["y"], float)


@pytest.fixture(scope="module")
def hidden(pack):
    return of_desk(pack, pack.hidden)


@pytest.fixture(scope="module")
def clean(pack):
    return of_desk(pack, pack.clean)


def test_a_lag_is_that_of_the_residual():
    rng = np.random.default_rng(7)
    u = rng.normal(size=4000)
    e = np.roll(u, 9) + 0.1 * rng.normal(size=4000)
    found = correlation(u, e, 40)
    assert int(np.argmax(found)) == 9
    assert found[9] == pytest.approx(1.0, abs=0.02)
    assert np.abs(np.delete(found, 9)).max() < 0.08


@pytest.mark.parametrize(("kind", "column"), [("heat", "current_A"), ("inlet", "coolant_inlet_C")])
def test_correlations_with_the_inputs_go_both_ways(pack, hidden, kind, column):
    left, figures = hidden
    with pack.hidden.open(newline="") as f:
        u = np.array([float(r[column]) for r in csv.DictReader(f)])[: len(left)]
    u = u**2 if kind == "heat" else u
    # the inputs are means of intervals between rows, which a held current begins
    u = u - u.mean()
    at, y = drawn(figures[kind])
    assert at[0] == -at[-1] < 0.0
    assert (np.diff(at) > 0.0).all()
    for lag in (-120, -30, 0, 30, 120):
        k = int(np.argmin(np.abs(at - lag)))
        n = round(at[k])
        a, b = (u[: len(u) - n], left[n:]) if n >= 0 else (u[-n:], left[:n])
        wanted = np.sum(a * b) / np.sqrt(np.sum(u**2) * np.sum(left**2))
        assert y[k] == pytest.approx(wanted, abs=0.04), (kind, lag)
    bound = figures[kind]["data"][0]["y"][0]
    assert bound == pytest.approx(1.96 / np.sqrt(len(left)), rel=0.01)


def test_the_histogram_is_that_of_the_residual_over_the_noise(hidden, clean):
    for left, figures in (hidden, clean):
        at, density = drawn(figures["noise"])
        width = at[1] - at[0]
        far = (np.abs(left / NOISE_K) > 6.0).mean()  # is told apart: a bar at the edge would hide the rest
        beyond = next(s for s in figures["noise"]["steps"] if s["name"] == "refitted")["beyond"]
        assert beyond == pytest.approx(far, abs=0.03)
        assert density.sum() * width == pytest.approx(1.0 - beyond, abs=1e-3)
        inside = np.abs(left / NOISE_K) < 1.0
        middle = np.abs(at) < 1.0
        assert density[middle].sum() * width == pytest.approx(inside.mean(), abs=0.06)
    # noise alone is as narrow as the bell that is drawn behind it; a model that lacks something is not
    at, density = drawn(clean[1]["noise"])
    bell = np.exp(-0.5 * at**2) / np.sqrt(2.0 * np.pi)
    assert np.abs(density - bell).max() < 0.1
    _, density = drawn(hidden[1]["noise"])
    assert np.abs(density - bell).max() > 0.1
