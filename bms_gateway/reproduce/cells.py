"""Beyond the paper, its open question: a resistance for each cell, from few surfaces and the cells' voltages."""

from bms_gateway.identify.cells_in_words import combinations
from bms_gateway.reproduce.few_sensors import LINES, Outcome, few_sensors
from bms_gateway.reproduce.result import Row, Section, kept
from bms_gateway.reproduce.setting import Size

TEXT = (
    "In Fig 10 and 11 no observer can be right about cells 2 to 4, because their resistance is taken for that of the "
    "others. The paper calls parameters of each cell 'the ultimate solution' and leaves it open. What can be known "
    "is a matter of what is measured: two surfaces determine about one combination of the five R_e each, and one "
    "more by the way heat is carried downstream; what is left stays at the scatter that was known before. The "
    "voltages of the cells, which a battery's bus carries, say how their resistances compare; the sensed cells teach "
    "what a resistance by voltage is worth in heat. The fit maximises the likelihood of a Kalman filter that follows "
    "the disturbances, determinant included; everything else (R_u, R_c, capacities, sensor offsets) is drawn anew "
    "for every string and known only by its scatter.",
)


def section(size: Size) -> Section:
    """Compare ways to find the cells' R_e on Fig 10's string.

    References
    ----------
    Lin et al., Fig 10 and 11; the paper's outlook.
    """
    seeds = max(2, size.seeds // 2)
    outcomes = few_sensors(seeds)
    rows = [_row(i, o, seeds) for i, o in enumerate(outcomes)]
    rows.append(_combinations(outcomes))
    return Section("cells", "A resistance for each cell (beyond Fig 10–11)", TEXT, tuple(rows))


_IDS = ("nominal", "alike", "surfaces", "voltages_3", "voltages_1", "all_sensed")


def _row(i: int, o: Outcome, seeds: int) -> Row:
    line = LINES[i]
    where = "all cells" if len(line.sensors) == 5 else "cells 2–4"
    if not o.fits:
        ours = f"core of {where} {o.core_rmse_K:.1f} K RMSE"
    else:
        ours = (
            f"R_e ± {100 * o.R_e_sd:.1f} % stated, {100 * o.R_e_rms:.1f} % true, {100 * o.coverage:.0f} % inside 95 %; "
            f"core of {where} {o.core_rmse_K:.2f} K"
        )
    promise = ""
    if line.limit_sd is not None and line.limit_core_K is not None:
        promise = f"to be at most {100 * line.limit_sd:g} % and {line.limit_core_K:g} K"
    elif i == 2:
        promise = "without voltages no limit is set; the stated band is wide enough"
    elif i == 0:
        promise = f"{seeds} strings of unknown R_u, R_c, capacities, offsets; cells 2–4 have 4.3 mΩ"
    values = {"core_rmse_K": o.core_rmse_K, "R_e_sd": o.R_e_sd, "R_e_rms": o.R_e_rms, "coverage": o.coverage}
    return Row(f"cells.{_IDS[i]}", line.what, "–", ours, kept(o.kept), promise, values)


def _combinations(outcomes: tuple[Outcome, ...]) -> Row:
    found = combinations(outcomes[2].fits[0])
    determined = [c for c in found if c.determined]
    return Row(
        "cells.combinations",
        "what the two surfaces determine of five R_e, and what they do not",
        "–",
        f"{len(determined)} of {len(found)} combinations",
        "beyond",
        "; ".join(c.text() for c in found),
        {"determined": float(len(determined)), "of": float(len(found))},
    )
