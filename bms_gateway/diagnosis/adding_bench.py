"""Adding effects where the model's own error, not the noise of the thermocouples, sets what can be told."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.second_search import SecondSearch
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import MapFit


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


def all_used(records: Sequence[Measured]) -> list[Measured]:
    """Return the records with nothing held out, as this search fits them."""
    return [replace(m, used=np.ones_like(m.used)) for m in records]
