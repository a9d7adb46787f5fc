"""What is worse about a refit, and what is better, is said of fitted and held-out readings apart."""

import pytest

from bms_gateway.diagnosis.findings import refit_sentences
from bms_gateway.report.step_names import FILED, REFITTED
from bms_gateway.workbench.steps import TABLES, Frame, steps_of

END = " The model lacks something; its cores are no answer."
HELD = " where nothing was fitted"


def told(before, after):
    """Return what the steps say of a refit with these errors, K: where fitted, and held out."""
    errors = {FILED: before, REFITTED: after}
    variants = {n: {"stair": {"trained_K": a, "held_K": b}} for n, (a, b) in errors.items()}
    core = {"proven": True, "why": [], "sentence": ""}
    compared = {"variants": variants, "core": core, **dict.fromkeys(TABLES, "")}
    return steps_of([Frame("", REFITTED, compared=compared)])[1]["worse"]


@pytest.mark.parametrize(
    ("held", "said"),
    [
        (
            (3.5, 1.9),
            " where it was fitted, and better where not: the error where fitted rises from 2.55 to 2.86 K, held out it "
            "falls from 3.5 to 1.9 K.",
        ),
        ((1.9, 3.5), ": the error where fitted rises from 2.55 to 2.86 K, held out it rises from 1.9 to 3.5 K."),
        ((1.9, 1.91), ": the error where fitted rises from 2.55 to 2.86 K, held out it stays at 1.91 K."),
        ((None, None), ": the error where fitted rises from 2.55 to 2.86 K."),
    ],
)
def test_a_refit_that_is_better_on_held_out_readings_is_not_called_worse_alone(held, said):
    assert told((2.55, held[0]), (2.86, held[1])) == f"This refit is worse than the model from its file{said}{END}"


def test_a_refit_that_follows_the_fitted_readings_is_not_called_worse():
    assert told((2.86, 1.9), (2.55, 3.5)) == ""


@pytest.mark.parametrize(
    ("before", "after", "lacks", "worse", "better"),
    [
        ((2.55, 3.5), (2.86, 1.9), True, ["2.86 K where fitted, not 2.55 K"], f"1.9 K{HELD}, not 3.5 K"),
        ((2.86, 1.9), (2.55, 3.5), True, [f"3.5 K{HELD}, not 1.9 K"], "2.55 K where fitted, not 2.86 K"),
        ((2.55, 1.9), (2.86, 3.5), True, ["2.86 K where fitted", "3.5 K where nothing"], ""),
        ((2.55, 3.5), (2.86, 1.9), False, ["2.86 K where fitted, not 2.55 K"], ""),
    ],
)  # fmt: skip
def test_the_reports_say_both(before, after, lacks, worse, better):
    (said,) = refit_sentences(before, after, lacks)
    first, _, more = said.partition(" More closely: ")
    assert all(w in first for w in worse)
    assert more.partition(". ")[0].rstrip(".") == better


def test_held_out_errors_that_differ_by_chance_say_nothing():
    assert refit_sentences((2.86, 1.9), (2.55, 3.5), lacks=False) == ()
