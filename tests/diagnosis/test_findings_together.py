"""Sensors that fail in the same way are told in one sentence; few of them one by one."""

import numpy as np
import pytest

from bms_gateway.diagnosis.findings import sensor_sentences, stream_sentences
from bms_gateway.diagnosis.misfit import Block, Level, Sensor, Worst
from bms_gateway.diagnosis.regimes import Bin, Regime
from bms_gateway.thermal import StringModel


def sensor(cell, mean_K, label="while the surface is above 30 °C"):
    """One that reads so much more while its surface is hot, and agrees while it is cold."""
    cold = Bin("while the surface is below 25 °C", 15.0, 25.0, 500, 0.0, 0.01, 0.05)
    hot = Bin(label, 30.0, 40.0, 500, mean_K, 0.01, abs(mean_K))
    always = Regime("always", "always", "", (Bin("on average", 0.0, 0.0, 1000, 0.0, 0.05, 0.5),), 0.0, 0.0)
    surface = Regime("surface", "surface temperature", "°C", (cold, hot), mean_K**2, 0.8)
    trained, held = Level(1000, abs(mean_K), 0.05), Level(200, abs(mean_K), 0.05)
    return Sensor(cell, trained, held, abs(mean_K), 50.0, 0.1, Worst(0, 100.0, mean_K), (always, surface))


def calm(cell):
    one = sensor(cell, 0.01)
    level = Level(1000, 0.05, 0.05)
    return Sensor(cell, level, level, 0.0, 0.0, 0.0, one.worst, one.regimes)


def test_sixty_cells_of_one_pattern_are_one_sentence():
    found = sensor_sentences([sensor(k, -0.5 - 0.01 * k) for k in range(1, 61)], (), (), 1)
    assert found == (
        "All cells read 0.51 to 1.1 K less than the model while the surface is above 30 °C, growing along the coolant.",
    )


def test_what_differs_in_sign_or_place_is_another_pattern():
    many = [sensor(k, 0.6 + 0.01 * (-1) ** k, f"while the surface is above {29 + k % 3} °C") for k in range(1, 9)]
    found = sensor_sentences([*many, sensor(9, -0.9), calm(10), calm(11), calm(12), calm(14)], (), (), 1)
    assert found[0].startswith("Cell 9 reads 0.9 K less than the model while the surface is above 30 °C")
    assert found[1] == "8 cells (1 to 8) read 0.59 to 0.61 K more than the model where the surface temperature is high."
    assert found[2] == "The model agrees with cells 10 to 12, 14 to within the noise."


def test_few_cells_are_told_one_by_one():
    found = sensor_sentences([sensor(k, -0.5) for k in (1, 3, 5)], (), (), 1)
    assert [text.split(" reads")[0] for text in found] == ["Cell 1", "Cell 3", "Cell 5"]
    assert np.all([text.endswith("they agree on average.") for text in found])


def test_a_constant_error_of_two_cells_is_one_sentence():
    found = sensor_sentences([constant(2, 0.44), constant(5, 0.49), calm(3)], (), [("always", 0.6)], 1)
    assert found[-1] == "60 % of the squared error above the noise comes from the mean of the error."
    assert found[0] == "2 cells (2, 5) read 0.44 to 0.49 K more than the model on average."


def constant(cell, mean_K):
    one = sensor(cell, 0.0)
    always = Regime("always", "always", "", (Bin("on average", 0.0, 0.0, 1000, mean_K, 0.01, mean_K),), mean_K**2, 0.9)
    return Sensor(cell, one.trained, one.held, abs(mean_K), 50.0, 0.1, Worst(0, 100.0, mean_K), (always,))


@pytest.mark.parametrize(
    ("ends", "told"),
    [
        ((540.0, 577.5), "60 % of the error lies at 9.0 to 9.6 min."),
        ((540.0, 720.0), "60 % of the error lies at 9 to 12 min."),
    ],
)
def test_short_times_are_told_in_tenths_of_a_minute(ends, told):
    found = sensor_sentences([sensor(1, 0.5)], [Block(0, *ends, 0.6, 0.5)], (), 1)
    assert found[-1] == told


def test_what_no_regime_explains_is_told_as_the_largest_error_over_half_a_minute():
    def unexplained(cell):
        one = sensor(cell, 0.3)
        return Sensor(cell, one.trained, one.held, 0.027, 50.0, 0.1, Worst(0, 100.0, -0.19), one.regimes[:1])

    assert sensor_sentences([unexplained(6), calm(1)], (), (), 1)[0] == (
        "Cell 6 is up to 0.19 K off over half a minute (structured error 0.027 K rms), "
        "and no single regime explains it."
    )
    together = sensor_sentences([unexplained(k) for k in range(1, 6)], (), (), 1)[0]
    assert together == "All cells are up to 0.19 K off over half a minute, and no single regime explains it."


def test_an_error_that_changes_sign_along_the_string_asks_for_the_flow_of_the_coolant():
    """Cells in a stream, and a model without one: a search takes it for a cell that is cooled worse."""
    errors = dict(zip((1, 3, 5, 8, 10, 12), (-0.7, -0.5, -0.2, 0.2, 0.4, 0.7), strict=True))
    without = chain(12, "natural")
    found = stream_sentences(without, [constant(k, e) for k, e in errors.items()])
    assert [text.partition(":")[0] for text in found] == [
        "The mean error grows along the string, from -0.7 K (cell 1) to +0.7 K (cell 12), and in the model no coolant "
        "warms from cell to cell"
    ]
    backwards = stream_sentences(without, [constant(13 - k, e) for k, e in errors.items()])
    assert "falls along the string" in backwards[0]
    assert "at the last cell first" in backwards[0]
    assert stream_sentences(chain(12, "full"), [constant(k, e) for k, e in errors.items()]) == ()
    assert stream_sentences(without, [constant(k, -0.7) for k in errors]) == ()
    assert stream_sentences(without, [constant(k, e) for k, e in zip(errors, (-1, 2, -2, 1, -1, 1), strict=True)]) == ()
    assert stream_sentences(without, [constant(1, -0.7), constant(12, 0.7)]) == ()


def chain(cells, condition):
    return StringModel(cells, tuple(range(1, cells + 1)), condition, {})


def course(means):
    """Every seventh cell, with these mean errors."""
    return [constant(7 * k + 1, x) for k, x in enumerate(means)]


def test_one_course_along_the_coolant_is_one_sentence():
    """It came out as four: some cells read more, some less, and of those between "no single regime explains it"."""
    found = sensor_sentences(course([0.42, 0.31, 0.2, 0.1, 0.01, -0.12, -0.3, -0.61, -0.96]), (), (), 1)
    assert found == (
        "The mean error of cells 1, 8, 15, 22, 29, 36, 43, 50, 57 falls along the coolant: cell 1 reads 0.42 K more "
        "than the model, cell 57 0.96 K less.",
    )


def test_a_cell_that_stands_out_of_the_course_has_a_sentence_of_its_own():
    found = sensor_sentences(
        [*course([0.42, 0.56, 0.58, 0.55]), constant(23, 1.9),
         *(constant(30 + 7 * k, x) for k, x in enumerate([0.34, 0.04, -0.28, -0.61, -0.96]))], (), (), 1
    )  # fmt: skip
    assert found[0].startswith("The mean error of cells 1, 8, 15, 22, 30, 37, 44, 51, 58 falls along the coolant: ")
    assert found[1:] == ("Cell 23 reads 1.9 K more than the model on average.",)


def test_a_few_cells_and_one_pattern_are_told_as_before():
    assert len(sensor_sentences(course([0.5, -0.3, 0.2]), (), (), 1)) > 1
    (one,) = sensor_sentences(course([-0.2, -0.3, -0.5, -0.9]), (), (), 1)
    assert one == "All cells read 0.2 to 0.9 K less than the model on average, growing along the coolant."


def test_a_mean_that_is_no_chance_is_told_where_no_regime_explains_the_most():
    """ "No single regime explains it" stood beside a table with this mean in bold."""
    one = constant(45, -0.28)
    some = Regime("surface", "surface temperature", "°C", sensor(45, -0.6).regimes[1].bins[:1], 0.1, 0.16)
    always = Regime("always", "always", "", one.regimes[0].bins, 0.08, 0.44)
    told = Sensor(45, one.trained, one.held, 0.39, 50.0, 0.1, one.worst, (always, some))
    assert sensor_sentences([told, calm(1)], (), (), 1)[0] == "Cell 45 reads 0.28 K less than the model on average."
    bold = Regime("time", "time", "min", sensor(45, -0.6).regimes[1].bins, 0.01, 0.05)
    weak = Regime("always", "always", "", calm(1).regimes[0].bins, 0.0, 0.0)
    told = Sensor(45, one.trained, one.held, 0.39, 50.0, 0.1, one.worst, (weak, bold))
    assert sensor_sentences([told, calm(1)], (), (), 1)[0].endswith("no single regime explains much of it.")
