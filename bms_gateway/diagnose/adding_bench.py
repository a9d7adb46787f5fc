"""Adding effects where the model's own error, not the noise of the thermocouples, sets what can be told."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bms_gateway.diagnose.band import ALARMED, LUMPED, Cores, core_band
from bms_gateway.diagnose.candidates import Candidate
from bms_gateway.diagnose.second import SecondSearch
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.thermal import Floats


def fit_with(found: SecondSearch, keys: Sequence[str]) -> MapFit | None:
    """Return the fit with exactly these effects among those that the search believes possible; None where none is."""
    if sorted(keys) == sorted(c.candidate.key for c in found.chosen):
        return found.best
    for h in found.hypotheses:
        if sorted(keys) == sorted(c.key for c in h.effects):
            return h.fit.map
    return None


def named_by(found: SecondSearch) -> list[Candidate]:
    """Return the effects that the search names; none where what is missing is in no catalogue."""
    return [c.candidate for c in found.chosen] if found.verdict == "missing_effect" else []


def core_before_and_after(found: SecondSearch, after: MapFit) -> tuple[Floats, Floats]:
    """95 % half width of each cell's core (n,) without and with effects, K: root mean square over all records."""
    records, size = found.records, found.discrepancy
    before = core_band(found.baseline, size[0], found.hypotheses, records, alarmed=True)
    if after is found.best:
        return _half_width(before), _half_width(found.cores())
    own = core_band(after, size[1], found.hypotheses, records, alarmed=not found.core_claimed)
    return _half_width(before), _half_width(own)


def doubt(found: SecondSearch) -> float:
    """Relative sd of R_c beyond the posterior's: what two nodes may get wrong of the way from core to surface."""
    return LUMPED if found.core_claimed else ALARMED


def all_used(records: Sequence[Measured]) -> list[Measured]:
    """Return the records with nothing held out, as this search fits them."""
    return [replace(m, used=np.ones_like(m.used)) for m in records]


def _half_width(bands: Sequence[Cores]) -> Floats:
    return np.asarray(1.96 * np.sqrt(np.mean(np.concatenate([b.sd for b in bands]) ** 2, axis=0)))
