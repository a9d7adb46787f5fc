"""Beyond Tables 2 and 3: the best places of sensors, judged by how well every core is known."""

import numpy as np

from bms_gateway.reproduce.result import Curve, Figure, Panel, Row, Section, braced, disproved, kept, several
from bms_gateway.reproduce.setting import R_CC, Size
from bms_gateway.sensors import PlacementProblem, paper_string
from bms_gateway.thermal import Disturbance, Floats

CELLS = 12
SENSORS = 4
KNOWN = (
    ((), 1.411),
    ((12,), 0.732),
    ((1, 12), 0.485),
    ((1, 2, 12), 0.467),
    ((1, 2, 11, 12), 0.429),
    ((3, 6, 9, 12), 0.496),
    (tuple(range(1, 13)), 0.366),
)
"""Sets, and the sd of the worst core, K, that an independent earlier computation gave for them."""
NEAR = 0.005

TEXT = (
    "A sensor is worth what it takes off the uncertainty of the worst core. With errors of the heat (0.5 W common, "
    "0.15 W per cell), of the inlet (0.5 K) and of the sensors (0.1 K), the error of the best possible observer "
    "settles at the solution of a Riccati equation; its worst core is the measure here, every set of sensors is tried.",
)


def section(size: Size) -> Section:  # noqa: ARG001 — nothing here is random
    """Rank placements of four sensors on twelve cells.

    References
    ----------
    Beyond Lin et al., Table 3, whose one set is compared.
    """
    problem = PlacementProblem(paper_string(CELLS, "full", R_CC))
    sd = {found.sensors: found.core_sd for sensors, _ in KNOWN for found in problem.measure([sensors])}
    worst = {sensors: float(v.max()) for sensors, v in sd.items()}
    best = problem.best(SENSORS)
    top, two = best.best[0], problem.best(2)
    rows = [
        Row(
            "place.known",
            "sd of the worst core, K: no sensor, {12}, {1,12}, {1,2,12}, {1,2,11,12}, {3,6,9,12}, all",
            several([x for _, x in KNOWN], ".3f"),
            several(list(worst.values()), ".3f"),
            kept(all(abs(worst[s] - x) < NEAR for s, x in KNOWN)),
            "left: figures of an earlier, independent computation, the paper has none",
            {"sensors_" + "_".join(map(str, s)): w for s, w in worst.items()},
        ),
        Row(
            "place.two_beat_four",
            "two sensors at the ends against the paper's four {3,6,9,12}",
            "only {3,6,9,12}",
            f"{{1,12}} {worst[1, 12]:.3f} K; {{3,6,9,12}} {worst[3, 6, 9, 12]:.3f} K",
            disproved(worst[1, 12] < worst[3, 6, 9, 12]),
            "the first cell has no neighbour upstream and the last one all the heat: the ends know least by themselves",
            {"two": worst[1, 12], "four": worst[3, 6, 9, 12]},
        ),
        Row(
            "place.best4",
            "the best four of 495, and what is left when any one of them fails",
            "{3,6,9,12}",
            f"{braced(top.sensors)} {top.worst_sd:.3f} K; {several([x.worst_sd for x in best.losses], '.3f')}",
            "paper wrong" if top.sensors != (3, 6, 9, 12) else "agrees",
            "evenly spaced: "
            f"{braced(best.even.sensors)} {best.even.worst_sd:.3f} K. The best two: {braced(two.best[0].sensors)}",
            {"best_K": top.worst_sd, "worst_loss_K": max(x.worst_sd for x in best.losses)},
        ),
        _independent(),
    ]
    return Section("placement", "Where do sensors belong? (beyond Table 3)", TEXT, tuple(rows), (_figure(sd),))


def _independent() -> Row:
    """If each cell has its own error, the sensors of other cells do not improve a cell without a sensor."""
    alone = Disturbance(heat_common=0.0, heat_cell=0.5, inlet=0.0)
    problem = PlacementProblem(paper_string(CELLS, "full", R_CC), alone)
    nothing = problem.measure([()])[0].worst_sd
    four = problem.best(SENSORS).best[0]
    return Row(
        "place.independent",
        "heat errors of each cell on its own (0.5 W): worst core without a sensor; with the best four",
        "–",
        f"{nothing:.3f} K; {four.worst_sd:.3f} K",
        kept(four.worst_sd > 0.9 * nothing),
        "no placement helps the cells that have no sensor then: what is common is what a sensor shares",
        {"nothing_K": nothing, "four_K": four.worst_sd},
    )


def _figure(sd: dict[tuple[int, ...], Floats]) -> Figure:
    cells = np.arange(1, CELLS + 1, dtype=np.float64)
    chosen = [(12,), (1, 12), (3, 6, 9, 12), (1, 2, 11, 12), tuple(range(1, 13))]
    curves = tuple(
        Curve("all" if len(s) == CELLS else braced(s), cells, sd[s], "o--" if s == (3, 6, 9, 12) else "o-")
        for s in chosen
    )
    return Figure(
        "placement",
        "How well each core of twelve is known, by where the sensors are",
        (Panel("", "cell", "sd of the core, K", curves),),
    )
