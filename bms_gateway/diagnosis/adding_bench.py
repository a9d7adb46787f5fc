"""Adding effects if the model error, not the noise of the thermocouples, limits what the records can show."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.second_search import SecondSearch
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import MapFit


def fit_with(found: SecondSearch, keys: Sequence[str]) -> MapFit | None:
    """Return the fit with exactly these effects among the accepted hypotheses of the search; None if there is none."""
    if sorted(keys) == sorted(c.candidate.key for c in found.chosen):
        return found.best
    for h in found.hypotheses:
        if sorted(keys) == sorted(c.key for c in h.effects):
            return h.fit.map
    return None


def named_by(found: SecondSearch) -> list[Candidate]:
    """Return the effects that the search names; none if the missing effect is not in the catalogue."""
    return [c.candidate for c in found.chosen] if found.verdict == "missing_effect" else []


def all_used(records: Sequence[Measured]) -> list[Measured]:
    """Return the records with nothing held out, because this search fits all readings."""
    return [replace(m, used=np.ones_like(m.used)) for m in records]
