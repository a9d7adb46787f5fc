"""Every row puts the paper beside ours with a verdict, and the figures that the paper stands on stay where they are."""

import json
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.cli.reproduce import document
from bms_gateway.report.reproduce_text import WIDTH, text
from bms_gateway.reproduce import SECTIONS, VERDICTS, WEIGHTS, Size
from bms_gateway.reproduce.errata import ERRATA
from bms_gateway.reproduce.excited import excited
from bms_gateway.reproduce.noise import Outcome, summary
from bms_gateway.reproduce.setting import settled

QUICK = ("excitation", "string", "observability", "placement", "errata")
SIZE = Size(2)


@pytest.fixture(scope="module")
def sections():
    return [SECTIONS[name](SIZE) for name in QUICK]


@pytest.fixture(scope="module")
def rows(sections):
    return {r.id: r for s in sections for r in s.rows}


def test_every_row_has_paper_ours_and_a_verdict(sections):
    document_rows = json.loads(json.dumps(document(sections, 2), allow_nan=False))["rows"]
    assert len({r["id"] for r in document_rows}) == len(document_rows) > 30
    for r in document_rows:
        assert set(r) == {"section", "id", "what", "paper", "ours", "verdict", "note", "values"}
        assert r["verdict"] in VERDICTS
        assert r["what"]
        assert r["paper"]
        assert r["ours"]
        if r["verdict"] in ("differs", "missed"):
            assert r["note"], r
        assert all(v is None or np.isfinite(v) for v in r["values"].values())


def test_the_text_fits_a_terminal_and_names_what_is_open(sections):
    told = text(sections, 2)
    assert max(map(len, told.splitlines())) <= WIDTH
    for s in sections:
        assert s.title in told
    assert "differs: both counts of Table 3 at one R_cc" in told.rpartition("rows:")[2]


def test_sections_are_named_as_they_call_themselves(sections):
    assert [s.id for s in sections] == list(QUICK)
    assert set(WEIGHTS) < set(SECTIONS)


GOLDEN = {
    "fig7.core": {"core_1": (52.9, 0.2), "core_3": (55.2, 0.2), "core_5": (57.6, 0.2)},
    "fig8.cooling": {"minutes": (44.0, 1.5)},
    "fig8.gap": {"gap_K": (6.4, 0.3)},
    "fig9.open": {"cell_1": (31.0, 1.0), "cell_5": (36.0, 1.0)},
    "fig9.independent": {"cell_2": (24.0, 1.5), "cell_3": (25.0, 1.5)},
    "fig9.common": {"cell_3": (0.05, 0.4)},
    "fig11.open": {"norm_K": (12.4, 0.15), "worst_K": (6.9, 0.15)},
    "fig11.white": {"norm_K": (9.3, 0.15), "worst_K": (4.9, 0.15)},
    "fig11.common": {"norm_K": (9.7, 0.15), "worst_K": (5.2, 0.15)},
    "table2": {"paper_12": (4, 0), "exact_12": (1, 0), "paper_6": (2, 0), "paper_7": (3, 0)},
    "table3.full": {"paper_way": (106, 0), "exact": (495, 0)},
    "table3.natural": {"paper_way": (52, 0), "exact": (494, 0)},
    "table3.no-conduction": {"paper_way": (1, 0), "exact": (165, 0)},
    "table3.units": {"unit_1s": (217, 0), "unit_5s": (404, 0), "unit_60s": (0, 0)},
    "fig12": {"near": (9, 0), "apart": (10, 0), "near_exact": (10, 0)},
    "fig13": {"good": (10, 0), "bad": (9, 0), "bad_exact": (10, 0)},
    "place.known": {"sensors_1_12": (0.485, 0.005), "sensors_1_2_11_12": (0.429, 0.005), "sensors_": (1.411, 0.005)},
    "place.best4": {"best_K": (0.429, 0.005)},
}


@pytest.mark.parametrize("name", GOLDEN)
def test_a_figure_stays_where_it_is(rows, name):
    for key, (value, tolerance) in GOLDEN[name].items():
        assert rows[name].values[key] == pytest.approx(value, abs=tolerance + 1e-9), key


def test_nothing_is_missed_in_the_quick_sections(rows):
    assert [i for i, r in rows.items() if r.verdict == "missed"] == []
    assert [i for i, r in rows.items() if r.verdict == "differs"] == ["table3.r_cc"]


def test_a_steady_current_excites_less_than_a_varied_one_and_teaches_less():
    drive, steady, parked = (excited(name) for name in ("urban-assault", "steady", "parked"))
    assert drive.least > 100 * steady.least
    assert drive.sd < 0.5 * steady.sd
    assert np.isinf(parked.sd)


def test_the_readmes_errata_are_ours():
    readme = (Path(__file__).parents[2] / "bms_gateway" / "reproduce" / "README.md").read_text(encoding="utf-8")
    start, end = "<!-- errata -->\n", "\n<!-- /errata -->"
    assert readme.count(start) == readme.count(end) == 1
    lines = ["| where | printed | right | why |", "|---|---|---|---|"]
    lines += [f"| {e.place} | {e.printed} | {e.right} | {e.why} |" for e in ERRATA]
    assert readme.partition(start)[2].partition(end)[0] == "\n".join(lines)
    assert len({e.id for e in ERRATA}) == len(ERRATA)


def test_a_fold_is_no_error_and_a_confident_error_is_told():
    wrong = Outcome(np.full(3, 0.3), 5.0, np.full(3, 0.02), identified=True)
    right = Outcome(np.full(3, 0.01), 0.5, np.full(3, 0.02), identified=True)
    fold = Outcome(np.full(3, np.nan), np.nan, np.full(3, 0.5), identified=False)
    s = summary([wrong, right, fold, fold])
    assert s["folds"] == 0.5
    assert s["confidently_wrong"] == 0.25
    assert s["R_e_bias"] == pytest.approx(0.155)
    assert np.isnan(summary([fold])["core_rmse_K"])


@pytest.mark.parametrize(
    ("error", "minutes"),
    [([0, 0, 0], 0.0), ([9, 0, 0], 1 / 60), ([0, 9, 0], 2 / 60), ([0, 0, 9], np.nan), ([np.nan, 0, 0], 1 / 60)],
)
def test_settled_means_for_good(error, minutes):
    assert settled(np.array(error, float), 1.0) == pytest.approx(minutes, nan_ok=True)
    assert settled(np.array([error, error], float).T, 1.0) == pytest.approx([minutes] * 2, nan_ok=True)
