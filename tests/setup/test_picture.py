"""What the picture of a new vehicle's first cores is drawn from."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.engine.events import Estimated, Parameters
from bms_gateway.engine.readings import Layout
from bms_gateway.setup.picture import Cores, draw, no_picture

NAN = np.nan


def estimated(second: int, core: list[float], surface: list[float]) -> Estimated:
    """A tick of two strings of two cells."""
    row, zero = np.array(core), np.zeros(4)
    layout = Layout.of(["front", "rear"], [2, 2])
    rest = np.zeros(4, np.uint8), row, zero + 0.5, zero, zero
    return Estimated(second * 10**9, layout, row, zero + 0.5, np.array(surface), *rest)


def taken() -> Cores:
    cores = Cores()
    cores.take(estimated(0, [20.0, 21.0, 22.0, NAN], [20.0, 20.5, 21.0, NAN]))
    cores.take(estimated(100, [30.0, 31.0, 34.0, 33.0], [25.0, 26.0, 28.0, 27.0]))
    cores.take(estimated(101, [30.0, 31.0, 33.0, 32.0], [NAN, NAN, NAN, NAN]))
    return cores


def test_a_row_has_the_hottest_core_and_the_range_of_the_surfaces() -> None:
    # Bug: the warmest surface was always unknown, so the picture's legend named a band that was not there.
    np.testing.assert_array_equal(
        taken().rows, [(22.0, 0.5, 21.0, 20.0), (34.0, 0.5, 28.0, 25.0), (33.0, 0.5, NAN, NAN)]
    )


def test_the_hottest_is_that_after_settling_with_its_own_string_and_cell() -> None:
    hottest = taken().hottest
    assert (hottest.string, hottest.cell, hottest.core_C, hottest.time_ns) == ("rear", 1, 34.0, 100 * 10**9)


def test_a_core_that_is_hardly_known_is_not_the_hottest() -> None:
    cores = taken()
    e = estimated(120, [30.0, 46.9, 33.0, 32.0], [25.0] * 4)
    cores.take(replace(e, core_sd=np.array([0.5, 14.0, 0.5, 0.5])))
    assert (cores.hottest.core_C, cores.rows[-1][0]) == (34.0, 33.0)


def test_the_last_tick_is_the_last_one_at_which_a_core_was_known() -> None:
    cores = taken()
    assert (cores.last.time_ns, cores.unknown_s) == (101 * 10**9, 0.0)
    cores.take(estimated(140, [NAN] * 4, [25.0, 26.0, 28.0, 27.0]))
    assert (cores.last.time_ns, cores.unknown_s) == (101 * 10**9, 39.0)


def test_where_no_core_was_ever_known_the_last_tick_stands() -> None:
    cores = Cores()
    for second in (5, 6):
        cores.take(estimated(second, [NAN] * 4, [25.0, 26.0, 28.0, 27.0]))
    assert (cores.last.time_ns, cores.unknown_s, cores.hottest) == (6 * 10**9, 0.0, None)


def test_the_surfaces_are_drawn(tmp_path, monkeypatch) -> None:
    pytest.importorskip("matplotlib")
    from matplotlib.axes import Axes

    drawn, plain = {}, Axes.fill_between

    def fill_between(axes, t, low, high, **how):
        drawn[how["label"]] = np.stack((low, high))
        return plain(axes, t, low, high, **how)

    monkeypatch.setattr(Axes, "fill_between", fill_between)
    assert draw(taken(), tmp_path / "cores.png").stat().st_size > 1000
    np.testing.assert_array_equal(drawn["surfaces"][:, :2], [[20.0, 25.0], [21.0, 28.0]])


def test_a_fit_is_marked_where_the_core_steps(tmp_path, monkeypatch) -> None:
    """The first fit of a drive moved the hottest core from 36 to 39.5 °C, and the picture said nothing."""
    pytest.importorskip("matplotlib")
    from matplotlib.axes import Axes

    cores = Cores()
    for second, strings in ((0, ("front", "rear")), (100, ()), (101, ("front", "rear")), (150, ("rear",))):
        cores.take(estimated(second, [30.0, 31.0, 34.0, 33.0], [25.0, 26.0, 28.0, 27.0]))
        for string in strings:
            cores.learn(Parameters(second * 10**9, string, ()))
    drawn = []
    monkeypatch.setattr(Axes, "axvline", lambda _, x, **how: drawn.append((x, how["label"])))
    assert draw(cores, tmp_path / "cores.png") is not None
    assert drawn == [(101.0, "a fit gives new parameters"), (150.0, None)]  # not the numbers of the file at the start


def test_without_a_picture_the_reason_is_the_extra_only_where_cores_were_known() -> None:
    dark = Cores()
    for second in (5, 6, 7):
        dark.take(estimated(second, [NAN] * 4, [25.0, 26.0, 28.0, 27.0]))
    assert "no core is known" in no_picture(dark)
    assert "extra" not in no_picture(dark)
    dark.take(estimated(8, [25.0, 26.0, 27.0, 28.0], [25.0, 26.0, 28.0, 27.0]))
    assert "one second" in no_picture(dark)
    assert "pip install 'bms-gateway[report]'" in no_picture(taken())
