r"""The ranks of the paper beside the exact ones: Tables 2 and 3, Figures 12 and 13.

The paper takes the rank of the observability matrix in double precision. Its rows C Aʲ shrink by a tenth with every
power, while the rounding error stays the same. What counts as zero therefore depends on the unit of time and on R_cc,
which the paper does not print; a true rank depends on neither. This module reproduces the paper's numbers beside the
exact ones, both from the corrected equations.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from bms_gateway.sensors.exact import exact_ranks
from bms_gateway.thermal import Condition, Floats, StringParameters, continuous

TABLE_1: Mapping[str, float] = MappingProxyType({"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79})
"""The paper's cell, an A123 32157 (Table 1); SI."""
C_F = 1.184 * 1007 * 9.5e-3
"""W/K: the paper's air, 9.5 L/s at 25 °C."""
R_CC = 31.84
"""K/W from cell to cell. The paper prints none; with this value its rank counts 106 sets of full strings, as in its
Table 3."""
CELLS, SENSORS = 12, 4
"""Cells and sensors of Table 3."""
TABLE_2 = (1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4)
"""Sensors that are needed for strings of 1 to 12 cells, according to the paper."""
TABLE_3: Mapping[Condition, int] = MappingProxyType({"full": 106, "natural": 52, "no-conduction": 1})
"""Sets of four sensors on twelve cells that are observable according to the paper."""


def paper_string(cells: int, condition: Condition = "full", R_cc: float = R_CC) -> StringParameters:
    """Return the paper's string: cells of Table 1, coupled by the condition (Eq 16–18, 21).

    Examples
    --------
    >>> paper_string(3, "natural", 32.0).C_f
    inf
    """
    return StringParameters.of(
        cells,
        C_c=TABLE_1["C_c"],
        C_s=TABLE_1["C_s"],
        R_e=TABLE_1["R_e"],
        R_c=TABLE_1["R_c"],
        R_u=TABLE_1["R_u"],
        R_cc=R_cc if condition in ("full", "natural") else np.inf,
        C_f=C_F if condition in ("full", "no-conduction") else np.inf,
    )


def paper_rank(p: StringParameters, sensors: Sequence[int]) -> int:
    """Rank of the observability matrix in double precision.

    Parameters
    ----------
    p : StringParameters
    sensors : sequence of int
        1-based cells.

    Returns
    -------
    int
        0…2n.

    Notes
    -----
    Singular values up to max(size)·(spacing of floats at the greatest) count as zero, as in MATLAB's `rank`.

    References
    ----------
    Lin et al., Eq 20, Tables 2 and 3, Fig 12 and 13, which are artefacts of this rounding.
    """
    return int(paper_ranks(p, [sensors])[0])


def paper_ranks(p: StringParameters, sets: Sequence[Sequence[int]], *, unit_s: float = 1.0) -> NDArray[np.int64]:
    """Double-precision rank of many sets with the same number of sensors of one string; as `paper_rank`.

    Parameters
    ----------
    p : StringParameters
    sets : sequence of sequences of int
        1-based cells, as many in each.
    unit_s : float, s

    Returns
    -------
    ndarray (len(sets),)

    References
    ----------
    Lin et al., Eq 20 and Table 3.
    """
    chosen = np.array([list(s) for s in sets], np.intp).reshape(len(sets), -1) - 1
    if not chosen.size:
        return np.zeros(len(sets), np.int64)
    cells, chosen = np.unique(chosen, return_inverse=True)
    chosen = chosen.reshape(len(sets), -1)
    rows = _observability_rows(p, cells, unit_s)
    ranks = np.empty(len(sets), np.int64)
    # In stacks of some hundreds: all of them at once would need gigabytes on long strings.
    step = max(1, 2_000_000 // (chosen.shape[1] * rows[0].size))
    for i in range(0, len(sets), step):
        M = rows[chosen[i : i + step]].reshape(-1, chosen.shape[1] * rows.shape[1], rows.shape[2])
        s = np.linalg.svd(M, compute_uv=False)
        ranks[i : i + step] = (s > max(M.shape[1:]) * np.spacing(s[:, :1])).sum(axis=1)
    return ranks


def _observability_rows(p: StringParameters, cells: NDArray[np.intp], unit_s: float) -> Floats:
    """Rows C_k Aʲ, j = 0…2n − 1, of the surface of each cell k, counted from 0: (cells, 2n, 2n)."""
    A = continuous(p).A * unit_s
    rows = np.empty((len(cells), len(A), len(A)))
    rows[:, 0] = np.eye(len(A))[2 * cells + 1]
    for j in range(1, len(A)):
        rows[:, j] = rows[:, j - 1] @ A
    return rows


@dataclass(frozen=True, slots=True)
class Counts:
    """Number of sets of m sensors that determine a string.

    Attributes
    ----------
    cells, sensors : int
        n and m.
    condition : Condition
    R_cc : float, K/W
    unit_s : float, s
        Unit of time of the paper's rank.
    sets : int
        C(n, m).
    paper, exact : int
        Sets of full rank, by the paper's rank and exactly.
    paper_sets : tuple of tuple of int
        Sets of full rank by the paper's rank.
    blind_sets : tuple of tuple of int
        Sets that do not determine the string by the exact rank.
    """

    cells: int
    sensors: int
    condition: Condition
    R_cc: float
    unit_s: float
    sets: int
    paper: int
    exact: int
    paper_sets: tuple[tuple[int, ...], ...]
    blind_sets: tuple[tuple[int, ...], ...]


def paper_counts(condition: Condition, R_cc: float = R_CC, *, unit_s: float = 1.0) -> Counts:
    """Count the sets of sensors that determine the paper's string: by the paper's rank, and exactly.

    Parameters
    ----------
    condition : Condition
    R_cc : float, K/W
    unit_s : float, s
        Unit of time of the paper's rank.

    Returns
    -------
    Counts

    References
    ----------
    Lin et al., Table 3.

    Examples
    --------
    >>> c = paper_counts("no-conduction")
    >>> c.paper_sets, c.paper, c.exact, c.sets
    (((3, 6, 9, 12),), 1, 165, 495)
    """
    sets = tuple(combinations(range(1, CELLS + 1), SENSORS))
    p = paper_string(CELLS, condition, R_cc)
    paper = paper_ranks(p, sets, unit_s=unit_s) == 2 * CELLS
    exact = exact_ranks(p, sets) == 2 * CELLS
    return Counts(
        CELLS,
        SENSORS,
        condition,
        R_cc,
        unit_s,
        len(sets),
        int(paper.sum()),
        int(exact.sum()),
        tuple(s for s, full in zip(sets, paper, strict=True) if full),
        tuple(s for s, full in zip(sets, exact, strict=True) if not full),
    )


@dataclass(frozen=True, slots=True)
class Needed:
    """Fewest sensors that determine a string, and one set that does.

    Attributes
    ----------
    cells : int
    condition : Condition
    R_cc : float, K/W
    paper, exact : int
        By the paper's rank and exactly.
    paper_set, exact_set : tuple of int
        The first such set.
    published : int
        The paper's figure.
    """

    cells: int
    condition: Condition
    R_cc: float
    paper: int
    exact: int
    paper_set: tuple[int, ...]
    exact_set: tuple[int, ...]
    published: int


def table_2(condition: Condition = "full", R_cc: float = R_CC) -> tuple[Needed, ...]:
    """Reproduce Table 2: the fewest sensors for strings of 1 to 12 cells.

    Returns
    -------
    tuple of Needed
        By number of cells. The paper's rank needs one sensor for every three cells, under every condition and at any
        R_cc from 1 to 60 K/W; exactly, one is enough (without conduction it is the last cell's).

    References
    ----------
    Lin et al., Table 2.
    """
    rows = []
    for n, published in enumerate(TABLE_2, start=1):
        p = paper_string(n, condition, R_cc)
        paper_set, exact_set = (_first_full(p, ranks) for ranks in (paper_ranks, exact_ranks))
        rows.append(Needed(n, condition, R_cc, len(paper_set), len(exact_set), paper_set, exact_set, published))
    return tuple(rows)


def _first_full(p: StringParameters, ranks: Callable[..., NDArray[np.int64]]) -> tuple[int, ...]:
    """Find the first set of full rank, fewest sensors first; a sensor on every cell is always enough."""
    every = range(1, p.cells + 1)
    for m in range(1, p.cells):
        sets = list(combinations(every, m))
        full = np.flatnonzero(ranks(p, sets) == 2 * p.cells)
        if len(full):
            return sets[int(full[0])]
    return tuple(every)


@dataclass(frozen=True, slots=True)
class SetRank:
    """Ranks of one set of sensors.

    Attributes
    ----------
    sensors : tuple of int
    paper, exact : int
    """

    sensors: tuple[int, ...]
    paper: int
    exact: int


def set_ranks(condition: Condition) -> tuple[SetRank, ...]:
    """Compute the paper's rank and the exact rank of every set of two sensors of the paper's string of five cells.

    Returns
    -------
    tuple of SetRank
        In lexical order.

    References
    ----------
    Lin et al., Fig 12 (full interconnection: {1, 2} has 9, sensors apart have 10) and Fig 13 (no conduction: {2, 5}
    has 10, {1, 5} has 9), of 10 states.
    """
    p = paper_string(5, condition, R_CC)
    sets = tuple(combinations(range(1, 6), 2))
    both = zip(sets, paper_ranks(p, sets), exact_ranks(p, sets), strict=True)
    return tuple(SetRank(s, int(a), int(b)) for s, a, b in both)
