"""Input of the watch over heat."""

from typing import NamedTuple

from bms_gateway.thermal import Floats


class HeatTick(NamedTuple):
    """One tick of S strings of n cells, as input of the watch.

    The watch computes heat from the current. The voltage is only a witness: that of a pack without current agrees with
    its cool cells, and would hide that the current which is shown is wrong.

    Attributes
    ----------
    square : ndarray (S,), A²
        Mean square of the current; NaN if unknown.
    current, inlet : ndarray (S,), A, °C
        NaN if unknown.
    y, age : ndarray (S, n), °C, s
        New readings, NaN for none, and their age.
    flow : ndarray (S,), optional
        Over nominal flow.
    by_voltage : ndarray (S,), W, optional
        Mean heat of a cell from the voltage; NaN if unknown.
    """

    square: Floats
    current: Floats
    inlet: Floats
    y: Floats
    age: Floats
    flow: Floats | None = None
    by_voltage: Floats | None = None
