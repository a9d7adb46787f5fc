"""Thermocouples in cores that no fit has used: how far the model is off them, and whether they contradict its band."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.diagnosis.core_band import BAND_SD, CoreBand, at_times
from bms_gateway.diagnosis.prepare import joined, measured
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.regimes import seconds_of
from bms_gateway.diagnosis.together import cells_in_words
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.thermal import Floats
from bms_gateway.thermal.centre import probe_lever

OUTSIDE = 0.1
"""Share of a core thermocouple's readings outside the 95 % band above which the band is wrong: twice the share that is
expected outside. The error of a model is nearly constant over minutes, so the share itself scatters."""
CONTRADICTED = "A thermocouple in a core contradicts the band that the surfaces give"
"""Beginning of the reason against a core that such a thermocouple is."""


@dataclass(frozen=True, slots=True)
class CoreCheck:
    """Model compared with a thermocouple in a core that no fit has used, at the position `core_probe`.

    Attributes
    ----------
    record, cell : int
    rmse_K, bias_K : float
        Bias: thermocouple minus model.
    covered : float
        Share of the readings within 1.96 sd; the sd contains the band and the uncertain position of the thermocouple.
    time_s, measured : ndarray (K,)
    source : str
        Name of the record if there are several; otherwise empty.
    """

    record: int
    cell: int
    rmse_K: float
    bias_K: float
    covered: float
    time_s: Floats
    measured: Floats
    source: str = ""

    @property
    def outside(self) -> bool:
        """Whether the thermocouple contradicts the band."""
        return outside(self.covered)


def outside(covered: float) -> bool:
    """Whether a thermocouple contradicts a band that contains this share of its readings."""
    return 1.0 - covered > OUTSIDE


def core_checks(records: Sequence[Record], fit: MapFit, bands: Sequence[CoreBand]) -> tuple[CoreCheck, ...]:
    """Compare a fit with the thermocouples in the cores of its records.

    Parameters
    ----------
    records : sequence of Record
    fit : MapFit
        Of these records, in their order.
    bands : sequence of CoreBand
        Of the fit.
    """
    found = (c for r, record in enumerate(records) for c in _core_checks(record, fit, r, bands[r]))
    return tuple(replace(c, source=records[c.record].source) if len(records) > 1 else c for c in found)


def contradiction(checks: Sequence[CoreCheck]) -> str:
    """Say which thermocouples contradict their bands; empty if none does."""
    against = [c for c in checks if c.outside]
    if not against:
        return ""
    cells = sorted({c.cell for c in against})
    most = max(c.rmse_K for c in against)
    return f"{CONTRADICTED}: {cells_in_words(cells)}, {'up to ' if len(against) > 1 else ''}{most:.3g} K off."


def _core_checks(record: Record, fit: MapFit, r: int, band: CoreBand) -> list[CoreCheck]:
    if not len(record.core.y):
        return []
    model = fit.problem.model
    with_core = measured(record, model, join=joined(record, model), core=True)
    t = seconds_of(with_core)
    found = []
    for j, (kind, cell) in enumerate(with_core.channels):
        mine = with_core.channel == j
        if kind != "probe" or not mine.any():
            continue
        y = with_core.y[mine]
        read, sd = at_times(band, cell, t[mine], probe_lever(model))
        error = y - read
        within = np.abs(error) <= BAND_SD * np.maximum(sd, 1e-9)
        rmse_K, bias_K = float(np.sqrt(np.mean(error**2))), float(np.mean(error))
        found.append(CoreCheck(r, cell, rmse_K, bias_K, float(np.mean(within)), t[mine], y))
    return found
