"""Eq 19 to 21, Tables 2 and 3, Figures 12 and 13: the number of sensors; the paper's counts are effects of rounding."""

import numpy as np

from bms_gateway.reproduce.result import Row, Section, agreeing, braced, disproved, kept, several
from bms_gateway.reproduce.setting import Size
from bms_gateway.sensors import Counts, hidden_states, paper_counts, paper_string, set_ranks, table_2
from bms_gateway.sensors.paper import R_CC, TABLE_2, TABLE_3

BY_PROCESSOR = 2
"""Number of sets with a last singular value so near the threshold that another processor may count them differently."""
UNITS_R_CC = 5.0
"""K/W: here the counts depend most on the unit of time."""
UNITS = ((1.0, "1/s"), (5.0, "1/(5 s)"), (60.0, "1/min"))
NATURAL_R_CC = 45.0
"""K/W: between 43.5 and 46.75, where natural convection gives the paper's count of 52."""

TEXT = (
    "Can a few surfaces tell all temperatures at all? They can if the observability matrix [C; CA; CA²; …] has full "
    "rank 2n (Eq 20). The paper computes that rank in floating point, and concludes that one sensor is needed for "
    "every three cells (Table 2) and that of 495 ways to put four sensors on twelve cells 106 are right (Table 3).",
    "A rank is a property of exact numbers. Computed exactly (in the integers modulo a prime, cross-checked by the "
    "Popov–Belevitch–Hautus test), with coolant and conduction ONE sensor at ANY cell makes the whole string "
    "observable, however long. The paper's numbers come from the powers of A: they shrink by a tenth each, and after "
    "some sixteen of them nothing is left above rounding. The proof: the count changes with the unit of time, and no "
    "physics knows whether time is counted in seconds or in minutes.",
    "So rank is no guide to where sensors belong: it asks whether noise-free readings would determine the state, "
    "with no word about how well. The next section asks that.",
)


def section(size: Size) -> Section:  # noqa: ARG001 — nothing here is random
    """Reproduce the paper's ranks, beside the exact ones.

    References
    ----------
    Lin et al., Eq 19–21, Table 2 and 3, Fig 12 and 13.
    """
    natural_rcc = paper_counts("natural", NATURAL_R_CC)
    rows = [
        _table_2(),
        *_table_3("full", paper_counts("full", R_CC)),
        *_table_3("natural", natural_rcc),
        *_table_3("no-conduction", paper_counts("no-conduction")),
        _no_single_r_cc(natural_rcc),
        _units(),
        *_figures_12_13(),
        _pbh(),
    ]
    return Section("observability", "How many sensors? (Eq 20–21, Table 2–3, Fig 12–13)", TEXT, tuple(rows))


def _table_2() -> Row:
    rows = table_2()
    same = all(r.paper == r.published for r in rows)
    one = all(r.exact == 1 for r in rows)
    return Row(
        "table2",
        "fewest sensors for strings of 1 to 12 cells",
        several(np.array(TABLE_2), ".0f"),
        f"its way {several([r.paper for r in rows], '.0f')}; exactly {several([r.exact for r in rows], '.0f')}",
        disproved(same and one),
        "its way (rank in double precision) gives the table digit for digit" + ("" if same else " but for some"),
        {f"paper_{r.cells}": float(r.paper) for r in rows} | {f"exact_{r.cells}": float(r.exact) for r in rows},
    )


_WHAT = {"full": "coolant and conduction", "natural": "natural convection", "no-conduction": "coolant, no conduction"}


def _table_3(condition: str, c: Counts) -> list[Row]:
    at = "" if condition == "no-conduction" else f" at R_cc {c.R_cc:g} K/W"
    if condition == "no-conduction":
        note = f"its one set is {braced(c.paper_sets[0])}; exactly, every set that has the last cell will do"
    elif condition == "natural":
        blind = ", ".join(map(braced, c.blind_sets))
        note = f"the one set that fails, {blind}, has all its sensors where a mode stands still"
    else:
        note = "one sensor anywhere is enough, so every set is"
    return [
        Row(
            f"table3.{condition}",
            f"sets of 4 sensors on 12 cells that observe all, {_WHAT[condition]}",
            str(TABLE_3[c.condition]),
            f"its way {c.paper}{at}; exactly {c.exact} of {c.sets}",
            disproved(abs(c.paper - TABLE_3[c.condition]) <= BY_PROCESSOR and c.exact > c.paper),
            note,
            {"paper_way": float(c.paper), "exact": float(c.exact), "R_cc": c.R_cc},
        )
    ]


def _no_single_r_cc(at_natural: Counts) -> Row:
    full = paper_counts("full", at_natural.R_cc)
    natural = paper_counts("natural", R_CC)
    wanted = (TABLE_3["full"], TABLE_3["natural"])
    both = ((paper_counts("full", R_CC).paper, natural.paper), (full.paper, at_natural.paper))
    met = any(max(abs(a - b) for a, b in zip(pair, wanted, strict=True)) <= BY_PROCESSOR for pair in both)
    return Row(
        "table3.r_cc",
        "both counts of Table 3 at one R_cc: coolant and conduction; natural convection",
        "106; 52",
        f"{paper_counts('full', R_CC).paper}; {natural.paper} at {R_CC:g} K/W, {full.paper}; {at_natural.paper} at "
        f"{at_natural.R_cc:g} K/W",
        agreeing(met),
        "R_cc is not printed, and no single one gives both counts",
        {"full_at_natural": float(full.paper), "natural_at_full": float(natural.paper)},
    )


def _units() -> Row:
    found = [(paper_counts("full", UNITS_R_CC, unit_s=u), name) for u, name in UNITS]
    return Row(
        "table3.units",
        f"the first count at R_cc {UNITS_R_CC:g} K/W, with A in 1/s, 1/(5 s), 1/min",
        "one number",
        "; ".join(f"{c.paper} ({name})" for c, name in found),
        disproved(len({c.paper for c, _ in found}) > 1 and len({c.exact for c, _ in found}) == 1),
        f"a rank cannot depend on the unit of time; exactly it is {found[0][0].exact} in each",
        {f"unit_{u:g}s": float(c.paper) for (c, _), (u, _) in zip(found, UNITS, strict=True)},
    )


def _figures_12_13() -> list[Row]:
    full = {r.sensors: r for r in set_ranks("full")}
    path = {r.sensors: r for r in set_ranks("no-conduction")}
    near, apart = full[1, 2], full[1, 5]
    good, bad = path[2, 5], path[1, 5]
    return [
        Row(
            "fig12",
            "5 cells, coolant and conduction: rank with sensors {1,2}; {1,5}",
            "9; 10",
            f"its way {near.paper}; {apart.paper}; exactly {near.exact}; {apart.exact} of 10",
            disproved((near.paper, apart.paper) == (9, 10)),
            "its way reproduced; {1,2} is as observable as {1,5}, only worse: see the next section",
            {"near": near.paper, "apart": apart.paper, "near_exact": near.exact, "apart_exact": apart.exact},
        ),
        Row(
            "fig13",
            "5 cells, coolant without conduction: rank with sensors {2,5}; {1,5}",
            "10; 9",
            f"its way {good.paper}; {bad.paper}; exactly {good.exact}; {bad.exact} of 10",
            disproved((good.paper, bad.paper) == (10, 9)),
            "heat only travels downstream: sensor k determines the 2k states up to it, the last cell's determines all",
            {"good": good.paper, "bad": bad.paper, "good_exact": good.exact, "bad_exact": bad.exact},
        ),
    ]


def _pbh() -> Row:
    longest = 12
    hidden = [hidden_states(paper_string(longest, "full"), (k,)) for k in range(1, longest + 1)]
    return Row(
        "eq20.pbh",
        "states that one sensor at cell 1, 2, … 12 leaves unobserved, by the PBH test",
        "–",
        several([np.nan if h is None else h for h in hidden], ".0f"),
        kept(all(h == 0 for h in hidden)),
        "a second way to the exact rank, by the characteristic polynomials of parts of the string",
        {f"cell_{k}": float(h) if h is not None else np.nan for k, h in enumerate(hidden, 1)},
    )
