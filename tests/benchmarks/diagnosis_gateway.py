"""The gateway with the added effect: cores that `analyze` estimates from one CAN log, with both model files.

The models are those that `fit` and `add` write from the record; the CAN log is the same record encoded. Beside it the
error of the two fits over the record, which know all of it at each instant.
"""

import contextlib
import io
import tempfile
from pathlib import Path

import numpy as np

from bms_gateway.diagnosis.adding import add_effects, wanted
from bms_gateway.diagnosis.calibrate import fitted_model, identify
from bms_gateway.diagnosis.diagnosis import diagnose
from tests.acceptance.drives import analyze
from tests.acceptance.effects import config_with, encoded
from tests.acceptance.live_effects import judged
from tests.benchmarks.diagnosis_case import core_error
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import make_log
from tests.truth.sizes import SIZES
from tests.truth.suites import suited

SECONDS = 2400


def hidden_ones(seed):
    """Scenarios of medium and strong effects in strings of 3 and 5, without end; numbers that no suite uses."""
    names = tuple(SIZES)
    order = np.random.default_rng([seed, 79]).permutation(len(names))
    for i, number in enumerate(range(seed * 10_000 + 9_000, seed * 10_000 + 10_000)):
        name, lap = names[order[i % len(names)]], i // len(names)
        cells = 5 if (i + lap) % 2 or name == "coolant_bypass" else 3
        yield suited({name: ("medium", "strong")[(i + lap) // 2 % 2]}, cells, number, seconds=SECONDS)


def gateway(scenario):
    """Core error of `analyze` before and after, and of the fits; None where the verdict is not right."""
    log = make_log(scenario)
    record, model = record_of(log)
    d = diagnose(model, [record])
    if [s.candidate.name for s in d.selected] != list(scenario.effects):
        return None
    (named,) = d.selected
    addition = add_effects(model, [record], [wanted(named.candidate.key, model)])
    found = {"name": scenario.name, "refused": addition.refused}
    before = identify(model, [record])
    models = fitted_model(before.fit, model), addition.model
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        here = Path(folder)
        plain, better = (config_with(m, k, here) for m, k in zip(models, ("plain", "better"), strict=True))
        can = encoded(log, plain, here)
        live = [judged(log, analyze(can, c, here / c.stem)) for c in (plain, better)]
    offline = [core_error(log, record, f) for f in addition.fits]
    return found | {"live": [c.rms for c in live], "inside": [c.inside for c in live], "offline": offline}


def gateway_report(found, tried):
    """Lines: how often the broadcast core gets better, how its gain compares with the fits', and where it does not."""
    if not found:
        return [f"gateway: no right verdict in {tried}"]
    live, offline = (np.array([f[k] for f in found]) for k in ("live", "offline"))
    falls, falls_offline = live[:, 1] < live[:, 0], offline[:, 1] < offline[:, 0]
    ratio = (live[:, 1] / live[:, 0]) / (offline[:, 1] / offline[:, 0])
    n = len(found)
    shares = [np.mean([f["inside"][k] for f in found]) for k in (0, 1)]
    return [
        f"analyze with the added effect: core RMSE falls in {falls.sum()}/{n}, offline in {falls_offline.sum()}/{n} "
        f"({n} right verdicts of {tried})",
        "  median K: live {:.2f} -> {:.2f}, offline {:.2f} -> {:.2f}".format(
            *np.median(live, axis=0), *np.median(offline, axis=0)
        ),
        f"  after/before, median: live {np.median(live[:, 1] / live[:, 0]):.2f}, "
        f"offline {np.median(offline[:, 1] / offline[:, 0]):.2f}, live over offline {np.median(ratio):.2f}",
        f"  share of cores within two sd, mean: {shares[0]:.2f} -> {shares[1]:.2f}",
        *(
            f"  {f['name']}: live {f['live'][0]:.2f} -> {f['live'][1]:.2f} K, "
            f"offline {f['offline'][0]:.2f} -> {f['offline'][1]:.2f} K"
            + (f" (add refuses: {f['refused']})" if f["refused"] else "")
            for f, ok in zip(found, falls, strict=True)
            if not ok or f["refused"]
        ),
    ]
