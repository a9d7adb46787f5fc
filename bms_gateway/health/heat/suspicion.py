"""Faults of a string that are not accepted yet, and their probabilities."""

from math import exp, log

import numpy as np

from bms_gateway.health.heat.fault_evidence import Weighed
from bms_gateway.health.heat.prior_odds import ln_prior
from bms_gateway.health.heat.verdict import Verdict
from bms_gateway.thermal import Floats


def suspicion(verdict: Verdict, w: Weighed) -> tuple[Floats, list[tuple[int, int, float]]]:
    """Return the probability (H,) of each fault, and (best onset, fault, probability) of the important ones."""
    ln = w.ln[verdict.s]
    each = ln.max(axis=0) / verdict.course.doubt[verdict.s]
    E = each + ln_prior(verdict.evidence, verdict.course, verdict.s)
    none = log(1e4)
    top = max(float(E.max()), none)
    share = np.exp(E - top)
    share = share / (share.sum() + exp(none - top))
    return share, [(int(ln[:, j].argmax()), int(j), float(share[j])) for j in np.flatnonzero(share > 0.02)]
