r"""Heat that leaves casings, cores, or both: change of the cores if a part of one loss is the other.

`core_loss` and `ambient_loss` look nearly the same at the surfaces and lead to different cores. A real cell has both.
With both in a fit, each with the catalogue's prior, the posterior contains every division of the loss that the readings
and the known capacities allow. The uncertainty of a core is its standard deviation there, plus its distance from the
core with one loss only. It enters the band as a share m of core minus surface, which a model file can store:

.. math:: m^2 \, \overline{(T_c - T_s)^2} = \overline{s_2^2 + (T_{c,2} - T_c)^2 - s_1^2}
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bms_gateway.diagnosis.calibrate import Identified, identify
from bms_gateway.diagnosis.core_band import core_bands, typical_K
from bms_gateway.diagnosis.record import Record
from bms_gateway.thermal import AddedEffect
from bms_gateway.thermal.effects import effect_named

OTHER = {"core_loss": "ambient_loss", "ambient_loss": "core_loss"}
"""The other loss for each of the two."""


def exchanged_share(found: Identified, records: Sequence[Record]) -> float | None:
    """Share of core minus surface that may be wrong because heat leaves elsewhere than in the model.

    Parameters
    ----------
    found : Identified
        Fit of a model with one of the two losses, or with both.
    records : sequence of Record

    Returns
    -------
    float or None
        To four digits, rounded up, for the cell with the largest change. None (unknown) if the model with both losses
        does not explain the surfaces, or one of its numbers ends at a bound.
    """
    start = found.fit.problem.model
    there = [e.name for e in start.effects if e.name in OTHER]
    more = [name for name in dict.fromkeys(OTHER[n] for n in there) if name not in there]
    if not more:
        return 0.0
    both = identify(replace(start, effects=(*start.effects, *map(_from_nothing, more))), records)
    if both.model_error_K or any(both.fit.at_bound(c.name) for c in both.fit.problem.coordinates):
        return None
    extra, lever = [], []
    for one, other in zip(core_bands(found.fit), core_bands(both.fit), strict=True):
        extra.append(other.sd_K**2 + (other.T_c - one.T_c) ** 2 - one.sd_K**2)
        lever.append(one.lever_K)
    moved = np.maximum(np.mean(np.concatenate(extra), axis=0), 0.0)
    return float(np.ceil(1e4 * np.sqrt(np.max(moved / np.maximum(typical_K(lever) ** 2, 1e-12)))) / 1e4)


def _from_nothing(name: str) -> AddedEffect:
    """Return an effect with the catalogue's prior."""
    parameters = effect_named(name).parameters
    return AddedEffect(name, None, {p.name: p.probe for p in parameters}, {p.name: p.sd for p in parameters})
