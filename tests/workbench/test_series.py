"""Long series on their way to a picture: thinned without loss, whole in a short window, correlated rightly."""

import gc
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from bms_gateway.workbench.series import POINTS, Shelf, drawn, thinned
from bms_gateway.workbench.steps import forget, joined
from bms_gateway.workbench.whiteness import correlation

HOURS_10 = 10.0 * 3600.0


@pytest.fixture
def shelf(tmp_path):
    return Shelf(tmp_path)


def kept(shelf, t, y):
    return {"data": [{"name": "measured", "kept": shelf.keep(t, y)}]}


def test_a_spike_of_one_sample_is_seen_in_the_whole(shelf, tmp_path):
    t = np.arange(HOURS_10)
    y = np.sin(t / 1000.0)
    y[23_456] = 9.0
    figure = kept(shelf, t, y)
    shelf.save()
    shown = drawn(figure, tmp_path)["data"][0]
    assert len(shown["x"]) <= POINTS
    assert max(shown["y"]) == 9.0
    assert shown["x"][shown["y"].index(9.0)] == 23_456.0


def test_a_minute_of_ten_hours_of_sixty_cells_is_whole_and_quick(shelf, tmp_path):
    t = np.arange(0.0, HOURS_10, 0.5)
    rng = np.random.default_rng(5)
    cells = [rng.normal(25.0, 1.0, len(t)) for _ in range(60)]
    figures = [kept(shelf, t, y) for y in cells]
    shelf.save()
    began = time.process_time()
    shown = drawn(figures[41], tmp_path, (7200.0, 7260.0))["data"][0]
    assert time.process_time() - began < 0.1
    inside = (t >= 7199.5) & (t <= 7260.5)
    np.testing.assert_allclose(shown["x"], t[inside])
    np.testing.assert_allclose(shown["y"], cells[41][inside], atol=1e-4)


def test_a_break_of_a_line_stays_open():
    t = np.arange(10_000.0)
    y = np.ones(10_000)
    y[5_000] = np.nan
    few_t, few_y = thinned(t, y, 100)
    assert len(few_t) < 110
    assert np.isnan(few_y[few_t == 5_000.0]).all()
    assert np.isfinite(few_y[few_t != 5_000.0]).all()


def test_equal_series_are_kept_once_and_forgotten_with_their_file(shelf, tmp_path):
    t = np.arange(5.0)
    one, two = shelf.keep(t, t), shelf.keep(t.copy(), t.copy())
    assert one == two
    shelf.save()
    (path,) = tmp_path.iterdir()
    forget(tmp_path, [path.name])
    assert path.exists()
    forget(tmp_path)
    assert not path.exists()


class Noisy:
    """Lets another thread run at the moment when the collector finds it."""

    def __init__(self):
        self.me = self

    def __del__(self):
        time.sleep(0)


def test_pictures_are_drawn_side_by_side(shelf, tmp_path):
    document = {"data": [{"kept": shelf.keep(np.arange(9.0), np.arange(9.0) + k)} for k in range(20)]}
    shelf.save()
    end = time.monotonic() + 4.0

    def draw() -> int:
        times = 0
        while time.monotonic() < end:
            Noisy()
            assert drawn(document, tmp_path)["data"][3]["y"][-1] == 11.0
            times += 1
        return times

    often, quick = gc.get_threshold(), sys.getswitchinterval()
    gc.set_threshold(10)
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as threads:
            drawings = [threads.submit(draw) for _ in range(4)]
        assert all(each.result() for each in drawings)
    finally:
        gc.set_threshold(*often)
        sys.setswitchinterval(quick)


def test_the_axis_holds_every_step_whichever_is_shown():
    figure = {"data": [], "layout": {"yaxis": {"title": "K"}}, "span": {"yaxis": (0.0, 1.0)}}
    steps = [("a", True, {"span": {"yaxis": (-9.0, 1.0)}}), ("b", False, {"span": {"yaxis": (0.0, 2.0)}})]
    low, high = joined(figure, steps)["layout"]["yaxis"]["range"]
    assert low < -9.0 < 2.0 < high < 3.0
    own = [
        {"name": name, "proven": proven, **drawn} for name, proven, drawn in steps
    ]  # for an axis that fits one of them
    assert joined(figure, steps)["steps"] == own


def test_correlations_are_those_of_their_definition():
    rng = np.random.default_rng(6)
    e, u = rng.normal(size=500), rng.normal(size=500)
    found = correlation(u, e, 20)
    scale = np.sqrt(np.sum(u**2) * np.sum(e**2))
    wanted = [sum(u[i] * e[i + k] for i in range(500 - k)) / scale for k in range(20)]
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    assert correlation(e, e, 2)[0] == pytest.approx(1.0)
