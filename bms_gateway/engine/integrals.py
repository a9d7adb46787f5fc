"""Inputs that are computed from every sample: currents with their voltages, inlets, voltages of cells."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.cell_voltage import CellVoltages, Run
from bms_gateway.engine.current import Current, Means
from bms_gateway.engine.line import Line
from bms_gateway.engine.samples import Samples
from bms_gateway.engine.wiring import Wire
from bms_gateway.frames.ammeter import Ammeter
from bms_gateway.frames.quality import Quality
from bms_gateway.identify import PairMeans
from bms_gateway.thermal import Floats

GOOD = int(Quality.GOOD)  # comparing with a member of an enumeration takes numpy many times longer
ACTIVE_A = 1.0  # mean current of a tick above which a sensor that never moves is suspicious


class Integrals:
    """Currents, inlets and voltages of all strings from tick to tick; a current that strings share is integrated once.

    Parameters
    ----------
    wires : sequence of Wire
    steps : sequence of float
        Smallest step of each input.

    Attributes
    ----------
    pairs : list of (int, int)
        Inputs of each current and of its voltage (−1 for none), in the order of the means.
    meters : dict
        Comparison of each current with its voltage, by pair.
    inlets : dict
        Line of each inlet, by input.
    active : bool
        Whether current flowed in the last tick.
    refused : int
        Number of samples of the last tick at a value at which the current stands while its voltage moves.
    """

    def __init__(self, wires: Sequence[Wire], steps: Sequence[float]) -> None:
        self._currents = {(w.current, w.voltage): Current() for w in wires if w.current >= 0}
        self.pairs = list(self._currents)
        self.meters = {(i, u): Ammeter(steps[u]) for i, u in self.pairs if u >= 0}
        inlets = [w.whole["coolant_inlet"] for w in wires]
        self.inlets = {i: Line() for i in inlets if i >= 0}
        self._cells = CellVoltages([(w.current, w.cell_voltage) for w in wires])
        self._followed = np.zeros(len(steps), np.bool_)
        self._followed[self._cells.inputs] = True
        self._followed[[i for pair in self.pairs for i in pair if i >= 0] + list(self.inlets)] = True
        self._number = np.arange(len(steps) + 1)
        self.active, self.refused = False, 0

    def update(
        self, samples: Samples, quality: NDArray[np.uint8], channel_quality: NDArray[np.uint8], t0: int, t1: int
    ) -> tuple[list[Means], list[PairMeans | None]]:
        """Use the good samples of a tick [t0, t1); return the means of `pairs`, and of cells' voltages by string.

        If a voltage contradicts a current, `quality` and `channel_quality` of the current are changed.
        """
        self.refused = 0
        s = samples.sorted_by_input((quality == GOOD) & self._followed.take(samples.input))
        edges = s.input.searchsorted(self._number)
        edge = edges.tolist()

        def of(i: int) -> tuple[NDArray[np.int64], Floats]:
            run = slice(edge[i], edge[i + 1]) if i >= 0 else slice(0)
            return s.time_ns[run], s.value[run]

        currents = {i: of(i) for i, _ in self._currents}
        volts = {u: of(u) for _, u in self._currents}
        for (i, u), meter in self.meters.items():
            meter.update(currents[i][1], volts[u][1])
            if meter.stands_at and len(currents[i][1]):
                currents[i] = self._credible(i, meter, currents[i], channel_quality)
                stands = (samples.input == i) & np.isin(samples.value, meter.stands_at)
                quality[stands & (quality == GOOD)] = Quality.STUCK
            if meter.reversed:
                # heat from I²R_e does not depend on the sign of the current, heat from the voltage does
                volts[u] = of(-1)
        means = [line.update(*currents[i], *volts[u], t0, t1) for (i, u), line in self._currents.items()]
        for i, inlet in self.inlets.items():
            inlet.update(*of(i))
        self.active = any(m.I2 > ACTIVE_A**2 for m in means)
        cells = self._cells.update(s.time_ns, s.value, edges, currents)
        return means, cells

    def _credible(self, i: int, meter: Ammeter, run: Run, channel_quality: NDArray[np.uint8]) -> Run:
        """Refuse the value at which a current stands while the voltage moves."""
        time_ns, value = run
        # readings between the refused values are still used, but the sensor counts as failed until it proves that it
        # works
        # otherwise
        channel_quality[i] = Quality.STUCK
        keep = ~np.isin(value, meter.stands_at)
        self.refused += int(np.count_nonzero(~keep))
        return time_ns[keep], value[keep]

    def forget(self) -> None:
        """Discard what is no longer valid after a gap: the last current and the slope of the inlet."""
        for current in self._currents.values():
            current.forget()
        for meter in self.meters.values():
            meter.forget()
        self._cells.forget()
        for inlet in self.inlets.values():
            inlet.forget()
