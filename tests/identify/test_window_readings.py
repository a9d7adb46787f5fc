"""What identification holds while it gathers, and takes to fit: little, and no more for more parameters or sensors."""

import tracemalloc
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.identify import PairMeans, Tick
from bms_gateway.identify.cell_live import CellIdentifier
from bms_gateway.identify.resistance_by_cell import CellProblem, CellRecord, CellSettings, fit_cells
from bms_gateway.identify.window import WindowIdentifier
from bms_gateway.identify.window_readings import TOGETHER, Gathered
from bms_gateway.thermal import Disturbance, Start
from tests.identify.cell_strings import model
from tests.identify.drive import measured, ticks
from tests.identify.drive import model as small

NAN = float("nan")
CELLS, STRINGS, SENSED = 12, 5, (0, 11)
MINUTES = 17  # less than a window: everything is still held


def traced(work: Callable[[], object]) -> tuple[int, int]:
    """Bytes that are held after `work`, and at most while it ran."""
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        kept = work()
        held, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    del kept
    return held - before, peak - before


@settings(deadline=None)
@given(
    seed=st.integers(0, 10**6),
    cuts=st.lists(st.integers(1, 2 * TOGETHER), min_size=1, max_size=6),
    cells=st.integers(1, 4),
)
def test_what_is_given_back_is_what_came_however_it_came(seed: int, cuts: list[int], cells: int) -> None:
    rng, readings = np.random.default_rng(seed), Gathered()
    parts = []
    for count in cuts:
        y, age = rng.normal(25.0, 3.0, (count, cells)), rng.random((count, cells))
        y[:, rng.random(cells) < 0.4] = NAN
        y[rng.random(y.shape) < 0.2] = NAN
        parts.append((y, age))
        if rng.random() < 0.5:
            readings.take(y, age)
        else:
            for k in range(count):
                readings.add(y[k], age[k])
    surface, ages = readings.whole()
    y, age = (np.concatenate(x) for x in zip(*parts, strict=True))
    read = np.isfinite(y)
    assert np.array_equal(surface, y, equal_nan=True)
    assert np.array_equal(ages[read], age[read])
    assert np.isfinite(ages).all()
    surface, ages, of = readings.read()
    assert list(of) == np.flatnonzero(read.any(axis=0)).tolist()
    assert np.array_equal(surface, y[:, list(of)], equal_nan=True)
    assert np.array_equal(ages[read[:, list(of)]], age[:, list(of)][read[:, list(of)]])


@pytest.mark.parametrize("dropped", [0, 1, 7, 70, 500])
def test_readings_of_a_cell_are_dropped_from_the_last_ticks_only(dropped: int) -> None:
    readings, y = Gathered(), 25.0 + np.arange(130 * 3.0).reshape(130, 3)
    readings.take(y[:60], np.zeros((60, 3)))
    for row in y[60:]:
        readings.add(row, np.zeros(3))
    readings.drop(1, dropped)
    left = y.copy()
    left[max(0, 130 - dropped) :, 1] = NAN
    assert np.array_equal(readings.whole()[0], left, equal_nan=True)
    readings.add(y[0], np.zeros(3))  # and it goes on
    assert np.array_equal(readings.whole()[0][-1], y[0])


def gather(add: Callable[[Tick], object]) -> None:
    """Bring ticks as the engine does: a string's readings are cut out of those of all strings."""
    for k in range(60 * MINUTES):
        all_strings, age = np.full((STRINGS, CELLS), NAN), np.zeros((STRINGS, CELLS))
        all_strings[:, SENSED] = 25.0 + 1e-3 * k
        add(Tick(k * 10**9, 1.0, 900.0 + k, NAN, 25.0 + 1e-6 * k, all_strings[0], age[0]))


@pytest.mark.parametrize("method", ["cells", "window"])
def test_ticks_that_are_gathered_take_the_room_of_what_was_read(method: str) -> None:
    """Two thermocouples and some numbers are 100 bytes; arrays of all cells of all strings were 1,000."""
    m = model((1, CELLS), CELLS)

    def work() -> object:
        if method == "window":
            window = WindowIdentifier(m)
            gather(window.add)
            return window
        cells, volts = CellIdentifier(m), PairMeans(*np.ones((4, CELLS)))
        gather(lambda tick: cells.add(tick, volts, 30.0, 1.0, partial(pytest.fail, "no fit is due")))
        return cells

    held, _ = traced(work)
    assert held / (60 * MINUTES) < 250.0


def test_a_fit_of_cells_takes_no_more_memory_for_more_parameters() -> None:
    K = 1800
    y = np.full((K, CELLS), NAN)
    y[:, SENSED] = 25.0
    record = CellRecord(np.full(K, 900.0), np.full(K + 1, 25.0), y, np.zeros_like(y))
    m = model((1, CELLS), CELLS)
    problem = CellProblem(m, record, CellSettings(), Disturbance(), Start())
    theta = np.log([m.priors[symbol].value for symbol, _ in problem.layout.names])

    def peak(sets: int) -> int:
        return traced(lambda: problem.residuals([theta] * sets))[1]

    peak(1)  # what is made once and kept
    assert peak(64) < 2.0 * peak(8)  # all at once: seven times


def test_a_record_of_the_cells_that_were_read_is_fitted_as_one_of_all() -> None:
    K, m = 1200, model((1, CELLS), CELLS)
    rng = np.random.default_rng(4)
    y, age = np.full((K, CELLS), NAN), rng.random((K, CELLS))
    y[:, SENSED] = 25.0 + rng.normal(0.0, 0.1, (K, 2)) + np.linspace(0.0, 5.0, K)[:, None]
    square, inlet = np.full(K, 900.0), np.full(K + 1, 25.0)
    records = CellRecord(square, inlet, y, age), CellRecord(square, inlet, y[:, SENSED], age[:, SENSED], 1.0, SENSED)
    fits = [fit_cells(m, record) for record in records]
    assert records[0].sensed == records[1].sensed == SENSED
    assert fits[0].sensed == fits[1].sensed == SENSED
    assert fits[0].mean.tobytes() == fits[1].mean.tobytes()
    assert fits[0].cov.tobytes() == fits[1].cov.tobytes()


@pytest.mark.parametrize("gap", [40, 400])
def test_a_window_holds_no_inlet_that_nobody_measured(gap: int) -> None:
    """Bug: an inlet that was lost as it moved stood still for a minute: the fit found an error of the model there."""
    square, inlet, y, _ = measured(11, minutes=24, amplitude=6.0)
    heard = inlet.copy()
    heard[700 : 700 + gap] = NAN
    identifier = WindowIdentifier(small())
    windows = []
    for t in ticks(square, heard, y):
        if (job := identifier.add(t)) is not None:
            windows.append(job.window)
            identifier.accept(job.run())
    assert windows
    for w in windows:
        assert w.inlet == pytest.approx(inlet[: len(w.inlet)], abs=0.3)
    assert max(len(w.inlet) for w in windows) == (1201 if gap == 40 else 700)
