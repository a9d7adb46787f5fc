"""Pairs of a cell's voltage and the current at the same instant, collected over a tick for all strings.

Voltages of cells come in turns, once a second or slower, while the current changes many times in between. A mean
voltage and a mean current of a tick would therefore belong to different instants. A voltage and the current at the same
instant belong together, and any choice of such instants is a fair sample of the drive.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.current import HOLD_S
from bms_gateway.identify import PairMeans
from bms_gateway.thermal import Floats

Run = tuple[NDArray[np.int64], Floats]
"""Stamps, ns, and values of one input's accepted samples in a tick."""


class CellVoltages:
    """Pairing for all strings of a plan.

    Parameters
    ----------
    wires : sequence of (int, ndarray of intp (n,))
        Per string: the input of its current and those of its cells' voltages, −1 where there is none.
    """

    def __init__(self, wires: Sequence[tuple[int, NDArray[np.intp]]]) -> None:
        self._wires = [(current, cells) for current, cells in wires]
        self.inputs = sorted({int(i) for current, cells in wires if current >= 0 for i in cells if i >= 0})
        self._paired = {
            # not by np.unique, which would load masked arrays: a thirtieth of the start time
            current: np.array(sorted({int(k) for i, c in wires if i == current for k in c if k >= 0}), np.intp)
            for current in sorted({i for i, c in wires if i >= 0 and (c >= 0).any()})
        }
        self._last: dict[int, tuple[int, float]] = {}

    def update(
        self, time_ns: NDArray[np.int64], value: Floats, edge: NDArray[np.intp], currents: Mapping[int, Run]
    ) -> list[PairMeans | None]:
        """Pair the samples of one tick.

        Parameters
        ----------
        time_ns, value : ndarray (K,)
            Accepted samples sorted by input, each input's in order.
        edge : ndarray (inputs + 1,)
            Index at which the samples of each input begin.
        currents : mapping of input to Run

        Returns
        -------
        list of PairMeans or None
            One per string; None where no cell of it had a sample.
        """
        sums: dict[int, Floats] = {}
        for current, inputs in self._paired.items():
            t, I = self._carried(current, currents[current])  # noqa: E741
            count = edge[inputs + 1] - edge[inputs]
            if not count.any() or not len(t):
                continue
            cell = np.repeat(np.arange(len(inputs)), count)
            at = np.repeat(edge[inputs] - np.concatenate([[0], np.cumsum(count)[:-1]]), count) + np.arange(len(cell))
            stamp, V = time_ns[at], value[at]
            newest = t.searchsorted(stamp, side="right") - 1
            fresh = (newest >= 0) & (stamp - t.take(newest, mode="clip") <= HOLD_S * 1e9)
            i, V, cell = I.take(newest, mode="clip")[fresh], V[fresh], cell[fresh]
            width = len(inputs)
            of = [np.bincount(cell, w, width) for w in (None, i, i * i, V, i * V)]
            with np.errstate(invalid="ignore"):
                means = np.array(of[1:]) / of[0]
            table = np.full((4, len(edge)), np.nan)  # one more column, for the index −1
            table[:, inputs] = means
            sums[current] = table
        return [self._of(sums.get(current), cells) for current, cells in self._wires]

    @staticmethod
    def _of(table: Floats | None, cells: NDArray[np.intp]) -> PairMeans | None:
        if table is None:
            return None
        mine = table[:, cells]
        return PairMeans(*mine) if np.isfinite(mine[3]).any() else None

    def _carried(self, current: int, run: Run) -> Run:
        """Put the newest sample before the tick in front."""
        t, I = run  # noqa: E741
        last = self._last.get(current)
        if len(t):
            self._last[current] = int(t[-1]), float(I[-1])
        if last is None:
            return t, I
        return np.concatenate([[last[0]], t]), np.concatenate([[last[1]], I])

    def forget(self) -> None:
        """Forget the last currents: a measurement from before a gap does not hold after it."""
        self._last.clear()
