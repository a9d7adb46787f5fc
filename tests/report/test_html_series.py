"""Series and lines of a page: few points that hide no excursion, open gaps, styles that differ without colour."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.report.html_figures import HEATS, STYLES
from bms_gateway.report.html_series import broken, envelope, smooth


def test_lines_differ_in_style_too_where_colour_is_not_seen():
    for styles in (STYLES, HEATS):
        assert len({dash for _, dash in styles}) == len({color for color, _ in styles}) == len(styles)


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
