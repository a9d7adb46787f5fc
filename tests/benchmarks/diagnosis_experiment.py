"""The suggested next experiment, driven on the hidden pack: does it part what the record left tied, and better?

A record is diagnosed; where its search leaves the truth tied with something else, the best and the worst ranked test of
that pair are driven on the same pack, each is fitted together with the first record under both explanations, and the
log-odds that it brings for the truth are compared.
"""

from contextlib import contextmanager
from dataclasses import replace
from unittest.mock import patch

import numpy as np

from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.diagnosis.experiment import next_experiment
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.residuals import structure
from bms_gateway.identify.map_fit import converged, fitted
from bms_gateway.identify.problem import Problem
from tests.diagnosis.hidden_record import record_of
from tests.truth import hidden
from tests.truth.drives import Drive
from tests.truth.hidden import make_log, new_drive
from tests.truth.sizes import LEAST_CELLS
from tests.truth.suites import SENSORS, suited

SECONDS = 1800
CONFUSABLE = (
    ("thermocouple_offset", {"inlet": "constant"}),
    ("neighbour_heat", {"inlet": "constant", "flow": "constant"}),
    ("inlet_offset", {"inlet": "constant", "flow": "constant"}),
    ("ambient_loss", {"inlet": "constant"}),
    ("polarization", {"cycle": "urban"}),
    ("hysteresis", {"cycle": "mixed"}),
    ("resistance_drift", {"inlet": "constant"}),
    ("cooling_drift", {"inlet": "constant"}),
    ("entropic_heat", {"cycle": "urban"}),
    ("current_offset", {"cycle": "urban"}),
    ("resistance_temperature", {"inlet": "constant"}),
    ("charge_transfer", {"inlet": "constant"}),
    ("radial_gradient", {"cycle": "urban"}),
    ("surface_joule", {"cycle": "urban"}),
    ("thermocouple_lag", {"cycle": "urban"}),
    ("natural_convection", {"cycle": "urban"}),
    ("resistance_soc", {"cycle": "urban"}),
    ("resistance_asymmetry", {"cycle": "urban"}),
    ("cell_resistance", {"inlet": "constant"}),
    ("cell_cooling", {"inlet": "constant"}),
    ("thermocouple_contact", {"inlet": "constant"}),
)
"""Effects on drives that hardly tell them from others."""
UNSENSED = {5: 2, 3: 2}
"""A cell without a sensor, by the number of cells: cell_* hide there."""


def confusable(seed):
    """Scenarios whose effect may well stay tied, without end; numbers that no suite uses."""
    for i, number in enumerate(range(seed * 10_000 + 6_000, seed * 10_000 + 9_000)):
        effect, drive = CONFUSABLE[i % len(CONFUSABLE)]
        lap = i // len(CONFUSABLE)
        cells = (3, 5, 1)[(i + lap) % 3]
        cells = cells if cells >= LEAST_CELLS.get(effect, 1) and effect != "inlet_offset" else 3
        size = ("medium", "weak")[lap % 2]
        s = suited({effect: size}, cells, number, reading=(0.1, 0.1), seconds=SECONDS, **drive)
        if effect.startswith("cell_"):
            s = replace(
                s, effects={effect: (size, UNSENSED[cells])}, sensors=SENSORS[cells][:: len(SENSORS[cells]) - 1]
            )
        yield s


def as_driven(plan):
    """A plan at 1 Hz: mean and mean square of each of its intervals kept."""
    u, k = plan.drive, round(plan.drive.dt)
    ripple = np.sqrt(np.maximum(u.I2 - u.I**2, 0.0))
    current = np.repeat(u.I, k) + np.repeat(ripple, k) * np.tile([1.0, -1.0], k * u.N // 2)
    inlet = np.repeat(u.T_in, k)
    return Drive(current, np.append(inlet, inlet[-1]), np.repeat(u.flow, k), float(u.soc[0]))


@contextmanager
def driving(plan):
    """Logs made within are driven as planned."""
    with patch.object(hidden, "make_drive", lambda *a, **k: as_driven(plan)):
        yield


def gained(scenario, base, fits, plan):
    """Log-odds for the first of two fits over the other that driving the plan on the hidden pack brings."""
    with driving(plan):
        second = make_log(new_drive(scenario, seconds=round(plan.drive.N * plan.drive.dt)))
    record, model = record_of(second)
    both = [base.problem.records[0], measured(record, model)]
    more = []
    for f in fits:
        joint = fitted(Problem(f.problem.model, both))
        more.append((joint.log_evidence - f.log_evidence, structure(joint).inflation))
    return (more[0][0] - more[1][0]) / min(i for _, i in more)


def experiment(scenario):
    """Diagnose, and drive what is suggested: what came of it, or None where the truth is not in a tied pair."""
    log = make_log(scenario)
    record, model = record_of(log)
    search = diagnose(model, [record]).search
    asked = next_experiment(search)
    if asked is None:
        return None
    (effect,) = scenario.effects
    true = effect if log.cells.get(effect) is None else f"{effect}:{log.cells[effect]}"
    parting = next((p for p in asked.partings if true in (p.one, p.other)), None)
    if parting is None:
        return None
    other = parting.other if parting.one == true else parting.one
    best, worst = parting.tests[0], parting.tests[-1]
    found = {"name": scenario.name, "true": true, "other": other, "decides": parting.decides}
    found |= {"best": [best.plan.name, best.log_odds], "worst": [worst.plan.name, worst.log_odds]}
    if not parting.decides:
        return found | {"sensor": None if parting.sensor is None else parting.sensor.cell}
    trials = {t.candidate.key: t.fit for r in reversed(search.rounds) for t in reversed(r)}
    fits = [converged(trials[key]) for key in (true, other)]
    return found | {
        "brought": [gained(scenario, search.baseline, fits, t.plan) for t in (best, worst)],
    }


def experiments_report(found, tried):
    """Lines: how often the suggested test parts better, and each time that it does not."""
    driven = [f for f in found if "brought" in f]
    better = [f for f in driven if f["brought"][0] > f["brought"][1]]
    decided = [f for f in driven if f["brought"][0] >= 3.0]
    share = f"{100 * len(better) / len(driven):.1f} % " if driven else ""
    lines = [
        f"suggested test parts a tied pair better than the worst-ranked (>=90 %): {share}({len(better)}/{len(driven)})",
        f"it brings the truth log-odds >= 3 in {len(decided)}/{len(driven)}; tied: {len(found)} of {tried} records",
    ]
    for f in found:
        text = f"  {f['name']}: {f['true']} ~ {f['other']}: "
        expected = f"{f['best'][0]} promises {f['best'][1]:.1f}, {f['worst'][0]} {f['worst'][1]:.1f}"
        if "brought" not in f:
            asked = f"a sensor on cell {f['sensor']} asked for" if f["sensor"] else "nothing would part them"
            lines.append(f"{text}{expected}: {asked}")
        elif f not in better:
            lines.append(f"{text}{expected}; brought {f['brought'][0]:.1f}, {f['brought'][1]:.1f}")
    return lines
