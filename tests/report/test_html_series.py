"""Series and lines of a page: few points that hide no excursion, open gaps, styles that differ without colour."""

import json
import re
from importlib import resources
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.diagnosis.misfit import Level, Sensor, Worst
from bms_gateway.diagnosis.regimes import Bin, Regime
from bms_gateway.report.html_figures import HEATS, ROAD, styles
from bms_gateway.report.html_series import Shown, broken, envelope, points_each, smooth
from bms_gateway.report.html_tables import heat_map
from bms_gateway.report.step_names import FILED, REFITTED, with_added


def test_lines_differ_in_style_too_where_colour_is_not_seen():
    added = [with_added(text) for text in ("one", "two")]
    for drawn in (styles([FILED, REFITTED]), styles([REFITTED, added[0]]), styles(added), HEATS):
        assert len({dash for _, dash in drawn}) == len({color for color, _ in drawn}) == len(drawn)


def test_steps_have_the_colours_of_the_page():
    """The page's own script says which colour a step has by its place on the road."""
    script = (resources.files("bms_gateway.workbench") / "page" / "plots.js").read_text()
    listed = re.search(r"const STYLES = (\[\[.*?\]\]);", script)[1]
    assert tuple(color for color, _ in json.loads(listed)) == ROAD
    for names, places in (([FILED, REFITTED], (0, 1)), ([REFITTED, "+ x"], (1, 2)), (["+ x", "+ y"], (2, 3))):
        assert [color for color, _ in styles(names)] == [ROAD[k] for k in places]


@settings(deadline=None)
@given(st.lists(st.floats(-50, 150), min_size=1, max_size=300), st.integers(2, 60))
def test_thinning_hides_no_excursion(values, most):
    y, t = np.array(values), np.arange(len(values), dtype=float)
    few_t, few = envelope(t, y, most)
    assert len(few) <= max(most, 2)
    assert few.min() == y.min()
    assert few.max() == y.max()
    assert (np.diff(few_t) >= 0).all()
    assert np.array_equal(y[few_t.astype(int)], few)


def test_lines_are_open_where_the_record_has_a_gap():
    t = np.array([0.0, 1, 2, 100, 101])
    at, y = broken(t, np.ones(5), (99.0,))
    assert at.tolist() == [0, 1, 2, 99, 100, 101]
    assert np.isnan(y[3])
    assert np.isfinite(np.delete(y, 3)).all()
    at, y = smooth(np.array([0.0, 1, 2, 50, 51]), np.arange(5.0), (49.0,))
    assert at.tolist() == [1.0, 50.5]
    assert y.tolist() == [1.0, 3.5]


def regime_of(ends):
    """Two cells whose bins of the time lie a little apart, as those of cells with other readings do."""
    trained = Level(100, 0.5, 0.05)
    sensors = []
    for cell, shift in ((1, 0.0), (2, 0.3)):
        bins = tuple(
            Bin(f"at times below {b + shift:g} min", a + shift, b + shift, 50, 0.2, 0.01, 0.3)
            for a, b in pairwise(ends)
        )
        always = Regime("always", "always", "", (Bin("on average", 0.0, 0.0, 100, 0.0, 0.05, 0.5),), 0.0, 0.0)
        time = Regime("time", "time since the start", "min", bins, 0.04, 0.8)
        sensors.append(Sensor(cell, trained, trained, 0.5, 50.0, 1.0, Worst(0, 100.0, 0.5), (always, time)))
    return Shown("refitted", None, tuple(sensors), ())


def test_ends_of_a_regime_are_told_as_finely_as_they_lie_apart():
    text = heat_map((regime_of((-0.14167, 4.667, 120.04)),))
    assert "about 0 to 4.8 min" in text
    assert "about 5 to 120 min" in text


def test_many_steps_of_many_cells_share_the_points_of_a_report_that_can_be_mailed():
    """Of five steps of sixty cells each trace had 400 points, 264,000 in all: more than 2 MB."""
    for cells, steps in ((60, 5), (60, 8), (100, 3)):
        traces = cells * (1 + 2 * steps)
        assert 100 <= points_each(traces) < 400
        assert points_each(traces) * traces <= 170_000
    assert points_each(60 * 7) == 400  # three steps of sixty cells
