"""The map of mean errors by regime: digits for what it shows, and no colour for what is nothing."""

import re
from types import SimpleNamespace

import pytest

from bms_gateway.diagnosis.misfit import Level
from bms_gateway.diagnosis.regimes import Bin, Regime
from bms_gateway.report.html_tables import heat_map

FLOOR_K, LEAST = 0.05, 0.18


def model(*means, sd=1e-5):
    """A string of which each cell has such a mean error at rest and twice as much under load; all no chance."""
    sensors = []
    for k, mean in enumerate(means, start=1):
        level = Level(1000, 0.05, FLOOR_K)
        bins = tuple(Bin(f"at {w} A", w, w + 1.0, 500, (w + 1) * mean, sd, 0.05) for w in (0, 1))
        always = Regime("always", "always", "", (Bin("on average", 0.0, 0.0, 1000, mean, sd, 0.05),), 0.1, 0.5)
        current = Regime("current", "current", "A", bins, 0.1, 0.4)
        sensors.append(
            SimpleNamespace(cell=k, trained=level, share=0.5, regimes=(always, current), least_structure=LEAST)
        )
    return SimpleNamespace(name="refitted", sensors=sensors)


def cells_of(html):
    return re.findall(r'<td[^>]*style="background:(#\w+)"[^>]*>(.*?)</td>', html)


@pytest.mark.parametrize(
    ("mean", "shown"),
    [(0.42, "+0.42"), (-0.0021, "−0.0021"), (0.031, "+0.031"), (4.2, "+4.20"), (0.000012, "0.0000")],
)
def test_digits_are_those_of_the_greatest_value(mean, shown):
    """A table said 0.00 everywhere, some of it in bold."""
    found = cells_of(heat_map([model(mean, mean)]))
    assert re.sub("</?b>", "", found[0][1]) == shown


def test_what_does_not_count_against_the_model_is_neither_coloured_nor_bold():
    faint = 0.3 * LEAST * FLOOR_K
    assert {(color, "<b>" in text) for color, text in cells_of(heat_map([model(faint, -faint)]))} == {
        ("#ffffff", False)
    }
    both = cells_of(heat_map([model(faint, 0.4)]))
    assert {(color == "#ffffff", "<b>" in text) for color, text in both} == {(True, False), (False, True)}
    # and what may be chance is coloured, and not bold
    chance = cells_of(heat_map([model(0.4, 0.4, sd=1.0)]))
    assert {(color == "#ffffff", "<b>" in text) for color, text in chance} == {(False, False)}
