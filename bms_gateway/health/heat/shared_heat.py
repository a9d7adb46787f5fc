"""New heat among the cells that it may be in: one thermocouple hardly distinguishes its cell from the neighbours."""

import numpy as np

from bms_gateway.health.heat.course import Course
from bms_gateway.health.heat.fault_evidence import Evidence, Kind, Weighed
from bms_gateway.health.heat.filter import HeatFilter

SIZE_SD = 0.2
"""Relative sd of the size of new heat: its first half minute depends on C_s and R_c as much as on the heat."""
GROUP, TEMPERED = 2, 8.0
"""Largest distance, in cells, between two cells to which heat may belong; and the least divisor of the ln evidence
between them: the error by a wrong R_cc grows with the square of its error and with the evidence itself."""


def share_out(f: HeatFilter, e: Evidence, course: Course, s: int, w: Weighed, fault: int) -> dict[int, float]:
    """Shift the states by heat that is in a cell or in a neighbour of it.

    The cells of the group are merged by their moments. The evidence between them depends on R_cc, which is known
    to some tens of per cent only (`TEMPERED`).

    Parameters
    ----------
    f : HeatFilter
        Its states and covariance of string `s` are changed.
    e, course, w
        Evidence, course and weighed faults of all strings.
    s, fault : int
        The string, and the accepted fault: heat in a cell.

    Returns
    -------
    dict of int to float
        Indices, among the observed cells, of the cells in which the heat may be, and its size in each, W.
    """
    cells, best = f.at.told[s], int(f.at.told[s, e.place[fault]])
    ln = w.ln[s].max(axis=0)
    group = [
        j
        for j in np.flatnonzero(e.kinds == Kind.HEAT).tolist()
        if f.at.seen[s, e.place[j]] and abs(int(cells[e.place[j]]) - best) <= GROUP and np.isfinite(ln[j])
    ]
    tempered = TEMPERED + float(f.usual.beside_sd[s] ** 2 * ln[fault])
    chance = np.exp((ln[group] - ln[fault]) / tempered)
    chance /= chance.sum()
    onsets = [int(w.ln[s, :, j].argmax()) for j in group]
    along = np.array([e.moved(s, o, j) for o, j in zip(onsets, group, strict=True)])
    amplitude = np.array([w.amplitude[s, o, j] for o, j in zip(onsets, group, strict=True)])
    var = np.array([w.var[s, o, j] for o, j in zip(onsets, group, strict=True)])
    moves = along * amplitude[:, None]
    mean = chance @ moves
    off = moves - mean
    f.z[s] += mean
    f.P[s] += (off.T * chance) @ off + (along.T * (chance * var)) @ along
    h = f.at.heat.start + e.place[group]
    f.P[s, h, h] += chance * np.square(SIZE_SD * amplitude)
    if f.usual.alone[s]:  # few thermocouples let the common states follow the heat: set these back
        f.z[s, f.at.common] = e.before(s, int(w.ln[s, :, fault].argmax()))
        f.z[s, f.at.flow] = course.film[s]  # mean of the last hour: slow heat shifts it before the onset
    watts = zip(group, chance.tolist(), amplitude.tolist(), strict=True)
    return {int(e.place[j]): size for j, c, size in watts if c > 0.02}
