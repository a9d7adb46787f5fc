"""Electrical resistance of each cell from a record, by the sums of the live gateway."""

import numpy as np

from bms_gateway.identify.electrical import ElectricalSums, PairMeans


def electrical_resistance(current, voltage, dt=1.0):
    """Give the `ElectricalResistance` of a mean current (K,) in A and mean voltages (K, n) in V; NaN where unknown."""
    sums = ElectricalSums(voltage.shape[1])
    for i, v in zip(current.tolist(), voltage, strict=True):
        same = np.full(len(v), i)
        sums.update(PairMeans(same, same * same, v, same * v), i, dt)
    return sums.result(dt)
