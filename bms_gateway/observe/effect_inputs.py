"""Inputs of a string with effects, step by step: missing inputs are replaced, charge and time are counted.

The inputs of Lin et al., Eq 11-13, and those that effects of the catalogue need.
"""

from collections.abc import Mapping
from math import exp, isfinite, log, nan
from typing import Any

import numpy as np

from bms_gateway.observe.flow import FLOW_LIMITS
from bms_gateway.observe.measured import Measured
from bms_gateway.observe.model import OFFSETS, Bools
from bms_gateway.observe.stored import like, plain
from bms_gateway.observe.tangent import ROW
from bms_gateway.observe.unseen import Usual, faded
from bms_gateway.thermal import Floats

DRIFT_HOURS = 4.0
"""Drifts are learnt on records of some hours. After that time they stay constant, because their course is not known."""


class Inputs:
    """Inputs of one string.

    Parameters
    ----------
    soc : float
        State of charge from which counting starts.
    capacity_Ah : float or None
        Of a cell; None: no charge counting.
    dt, correlation : float, s
        Step, and time over which the current stays correlated.

    Attributes
    ----------
    inlet, flow, soc, hours : float
        Newest coolant inlet [°C], flow over nominal flow, state of charge, and age of drifts [h].
    usual : Usual
        Mean current [A], its square and its magnitude in the last minutes.
    known : ndarray of bool (2,)
        Whether inlet and current were measured in the newest step.
    row : ndarray (9,)
        Means of the newest step, in the order of `ROW`.
    """

    def __init__(self, soc: float, capacity_Ah: float | None, dt: float, correlation: float) -> None:
        self._capacity_Ah, self._dt, self._correlation = capacity_Ah, dt, correlation
        self.inlet, self.soc, self.flow, self.hours = nan, float(soc), 1.0, 0.0
        self.usual = Usual.nothing(1, 3)
        self.known: Bools = np.ones(OFFSETS, np.bool_)
        self.row: Floats = np.full(len(ROW), nan)

    @staticmethod
    def measured(m: Measured) -> Bools:
        """Return whether inlet and current are measured."""
        return np.array([isfinite(m.inlet), isfinite(m.I) and isfinite(m.I2) and isfinite(m.I_abs)])

    def begin(self, inlet: float) -> None:
        """Start with this inlet, °C, as if inlet and current had been measured before."""
        self.inlet, self.known = inlet, np.ones(OFFSETS, np.bool_)

    def take(self, m: Measured) -> Floats:
        """Means of a step as a row (9,); a missing input has its last value, a missing current its usual value."""
        known = self.measured(m)
        inlet0, self.inlet = self.inlet, m.inlet if known[0] else self.inlet
        if not self.known[0]:
            inlet0 = self.inlet  # no ramp that starts from a held value
        current = np.array([m.I, m.I2, m.I_abs]) if known[1] else self.usual.mean[0]
        self.usual = self.usual.after(current[None], faded(self._dt, self._correlation), bool(known[1]))
        if isfinite(m.flow):
            self.flow = float(np.clip(m.flow, *FLOW_LIMITS))
        half = self._dt / 7200.0
        moved = float(current[0]) * half / self._capacity_Ah if self._capacity_Ah else 0.0
        if isfinite(m.soc):
            self.soc, soc = m.soc, m.soc
        else:
            soc = min(max(self.soc - moved, 0.0), 1.0)
            self.soc = min(max(soc - moved, 0.0), 1.0)
        hours = self.aged(half)
        self.aged(half)
        self.known = known
        self.row = np.array([*current, (inlet0 + self.inlet) / 2.0, self.flow, soc, m.V, m.IV, hours])
        return self.row

    def aged(self, hours: float) -> float:
        """Add to the age of drifts, and return it, h."""
        self.hours = min(self.hours + hours, DRIFT_HOURS)
        return self.hours

    def grown(self, flow: float) -> float:
        """Logarithm of a flow over the newest one; 0 if the flow is not known."""
        return log(float(np.clip(flow, *FLOW_LIMITS)) / self.flow) if isfinite(flow) else 0.0

    def rest(self, inlet: float, flow: float, share: float, hours: float) -> Floats:
        """Row (9,) of some `hours` of rest in a gap; inlet, °C, and flow are at `share` of the way to their end."""
        row = self.row.copy()
        row[[ROW.index(k) for k in ("I", "I2", "I_abs", "IV")]] = 0.0
        row[ROW.index("T_in")] = self.inlet + (inlet - self.inlet) * share
        row[ROW.index("flow")] = self.flow * exp(self.grown(flow) * share)
        row[ROW.index("hours")] = self.aged(hours)
        return row

    def resume(self, inlet: float, flow: float, row: Floats, gap_s: float, *, unseen: bool) -> None:
        """Continue after a gap of `gap_s` with inlet, °C, and flow at its end, and the last `row` of rest."""
        self.flow *= exp(self.grown(flow))
        self.inlet, self.row, self.known = inlet, row, np.array([False, not unseen])
        self.usual = self.usual.aged(faded(gap_s, self._correlation))

    def snapshot(self) -> dict[str, Any]:
        """Return it as numbers, lists and None for NaN."""
        return {k: plain(np.asarray(getattr(self, k))) for k in (*_NUMBERS, *_ARRAYS)} | self.usual.snapshot()

    def restored(self, own: Mapping[str, Any]) -> "Inputs":
        """Return inputs like these with the values of a `snapshot`.

        Raises
        ------
        KeyError, TypeError, ValueError
            A value is missing, has another shape, or is not a number.
        """
        new = Inputs(self.soc, self._capacity_Ah, self._dt, self._correlation)
        for k in _NUMBERS:
            setattr(new, k, like(own[k], np.asarray(nan)).item())
        for k in _ARRAYS:
            setattr(new, k, like(own[k], getattr(self, k)))
        new.usual = self.usual.restored(own)
        return new


_NUMBERS, _ARRAYS = ("inlet", "soc", "flow", "hours"), ("known", "row")
