"""One log diagnosed and held against all that is known of its truth: a plain dictionary, ready for JSON."""

import time
from dataclasses import replace

import numpy as np

from bms_gateway.diagnosis.adding_bench import all_used
from bms_gateway.diagnosis.candidates import Candidate, candidates
from bms_gateway.diagnosis.detect import absorbed
from bms_gateway.diagnosis.diagnosis import Diagnosis, diagnose
from bms_gateway.diagnosis.filed import as_filed, seen_on
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.residuals import structure
from bms_gateway.diagnosis.screen import screen
from bms_gateway.diagnosis.search import refit, refit_from_nominal
from bms_gateway.diagnosis.weighing import HALF, Settings, prior_odds
from bms_gateway.identify.map_fit import MapFit, fitted, solved, stacked
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal.effects import effect_named
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import ABSORBED
from tests.truth.sizes import SIZES

FIRST_READINGS_S = 300.0
"""Readings of so long settle where a new drive starts; all later ones judge."""


def examine(suite, log, new_log=None, twins=None):
    """Diagnose a log and hold the verdict against its truth.

    `new_log` is another drive of the same pack; `twins` are this log with and without what is hidden, without noise.
    """
    s = log.scenario
    record, model = record_of(log)
    begin = time.process_time()  # the worker has one thread: what an idle machine would take
    d = diagnose(model, [record])
    seconds = time.process_time() - begin
    search = d.search
    named = [x.candidate for x in d.selected]
    before, final = fits(d)
    floor = float(np.hypot(s.noise, s.step / np.sqrt(12)))
    truth = [(name, log.cells.get(name)) for name in s.effects if name in SIZES]
    odds = true_odds(search.baseline, truth)
    return {
        "suite": suite,
        "name": s.name,
        "cells": s.cells,
        "sensors": list(s.sensors),
        "floor": floor,
        "hidden": [
            {"effect": name, "size": size, "cell": log.cells.get(name), "odds": odds.get(name)}
            for name, (size, _) in s.effects.items()
        ],
        "absorbed": any(name in ABSORBED for name in s.effects),
        "seen": None if twins is None else seen(record, search.baseline, twins),
        "ours": {
            "verdict": d.verdict,
            "remains": d.unknown_remains,
            "named": [
                {"effect": x.candidate.name, "cell": x.candidate.cell, "tied": list(x.tied_with), "odds": x.log_odds}
                for x in d.selected
            ],
            "looks": list(d.looks_like),
            "ranking": [(r.effect, r.cell, round(r.evidence, 1), r.refused) for r in d.ranking[:4]],
            "screened": [(g.candidate.key, round(g.gain, 1)) for g in search.gains[:4]],
            "absorbs": takes_up(s, search.baseline),
            "inside": {name: inside(log, d, final, name) for name, _ in truth},
            "structure": [d.baseline.structure.size, d.after.structure.size],
            "held": [d.baseline.heldout_rmse_K, d.after.heldout_rmse_K],
            "core_claimed": bool(named) and not d.alarms,
            "core": [core_error(log, record, before), core_error(log, record, final)],
            "new_drive": None if new_log is None or not named else new_drive_rmse(final, new_log),
            "seconds": seconds,
        },
        "peer": None,
    }


def fits(d: Diagnosis):
    """The fits that a verdict speaks of, without and with what it names: the second search's where that decided."""
    found = d.search
    if d.second is not None and found.baseline.problem.model.cells == 1:
        ready = all_used(found.baseline.problem.records)
        before = seen_on(d.second.baseline, ready)
        return before, seen_on(d.second.best, ready) if d.selected else before
    return found.baseline, found.final if d.selected else found.baseline


def seen(record, fit: MapFit, twins):
    """By how much one who knows shape and size of what is hidden finds it: log-likelihood, the numbers of `fit` free.

    twins : the log with what is hidden and without it, both without noise.
    """
    (m,) = fit.problem.records
    at = record.instants[0] + (m.row + m.share) * m.drive.dt
    moved = np.empty((len(m.y), 1))
    for j, (_, cell) in enumerate(m.channels):
        with_it, without = (t.table[f"surface_{cell}_C"] for t in twins)
        mine = m.channel == j
        moved[mine, 0] = np.interp(at[mine], twins[0].table["time_s"], with_it - without)
    column = fit.weighed(fit.problem.averaged(moved))
    shared = fit.products(column)
    return 0.5 * float((column.T @ column - shared.T @ solved(fit.H, shared))[0, 0])


TAKEN_UP = {
    "current_gain": "gain of the current sensor",
    "uniform_R_e": "all cells' R_e",
    "uniform_R_c": "all cells' R_c",
}
"""What the sentence about an absorbed change must speak of."""


def takes_up(scenario, fit: MapFit):
    """Whether each hidden change that a parameter absorbs is told as such: {name: bool}."""
    there = [name for name in scenario.effects if name in ABSORBED]
    told = absorbed(fit).sentences if there else ()
    return {name: any(TAKEN_UP[name] in sentence for sentence in told) for name in there}


def true_odds(baseline: MapFit, truth):
    """Tempered log-odds of each hidden effect, fitted at its own place on top of the others: {name: odds or None}."""
    model, records = baseline.problem.model, baseline.problem.records
    y = stacked(baseline.problem)[0]
    offered = candidates(model, records[0].drive, (float(np.quantile(y, 0.05)), float(np.quantile(y, 0.95))))
    options = {name: [c for c in offered if c.name == name and c.cell in (cell, None)] for name, cell in truth}
    if not truth or not all(options.values()):
        return {}
    found = {}
    for name in options:
        parent = baseline
        for other in options:
            if other != name:
                parent, _ = grown(parent, options[other], offered)
        fit, c = grown(parent, options[name], offered)
        inflation = structure(fit).inflation
        found[name] = (fit.log_evidence - parent.log_evidence) / inflation + prior_odds(c, offered) - HALF
    return found


def grown(parent: MapFit, options: list[Candidate], offered):
    """The best fit with one of some starts of an effect, and which it was."""
    fits = []
    for gain in screen(parent, options):
        fit = refit(parent, gain)
        if structure(fit).z > Settings().strong:
            fit = max(fit, refit_from_nominal(fit, parent), key=lambda f: f.log_evidence)
        fits.append((fit, gain.candidate))
    return max(fits, key=lambda x: x[0].log_evidence + prior_odds(x[1], offered))


def core_error(log, record, fit: MapFit):
    """RMSE of all cores against the truth, K."""
    X, dt = fit.prediction.X[0], fit.problem.records[0].drive.dt
    at = record.instants[0] + dt * np.arange(len(X))
    cores = np.stack([np.interp(log.table["time_s"], at, X[:, 2 * k]) for k in range(log.core.shape[1])], axis=1)
    return float(np.sqrt(np.mean((cores - log.core) ** 2)))


def inside(log, d: Diagnosis, final: MapFit, name):
    """Whether each number of an effect lies in the 95 % interval that the diagnosis gives: {parameter: bool}."""
    chosen = next((x for x in d.selected if x.candidate.name == name), None)
    if chosen is None or name == "voltage_heat":  # its numbers are an open-circuit curve, the truth's are not
        return {}
    if name == "entropic_heat":
        return _entropic(log, final, chosen)
    found = {}
    for parameter, (true, _) in log.parameters[name].items():
        number = chosen.parameters.get(parameter)
        if number is None:
            continue
        if effect_named(name).parameter(parameter).log:
            error, sd = np.log(true / number.value), number.sd / number.value
        else:
            error, sd = true - number.value, number.sd
        found[parameter] = bool(abs(error) <= 1.96 * sd)
    return found


def _entropic(log, final, chosen):
    """The curve at each knot that the record told, level and departure together; the level where it told that alone."""
    problem = final.problem
    (value, _) = next(iter(log.parameters["entropic_heat"].values()))
    knots = np.array([0.05, 0.35, 0.65, 0.95])
    soc = problem.records[0].drive.soc
    names = [c.name for c in problem.coordinates]
    level = names.index(f"{chosen.candidate.key}.dUdT")
    scale = chosen.parameters["dUdT"].sd * 1e-3 / np.sqrt(final.covariance[level, level])
    found = {}
    for k, knot in enumerate(knots, 1):
        name = f"{chosen.candidate.key}.dUdT_{k}"
        if name not in names or not soc.min() <= knot <= soc.max():
            continue
        row = np.zeros(len(names))
        row[[level, names.index(name)]] = 1.0
        true = float(value if np.ndim(value) == 0 else value[k - 1]) * 1e-3
        sd = scale * np.sqrt(row @ final.covariance @ row)
        found[f"dUdT({knot:g})"] = bool(abs(row @ final.theta - true) <= 1.96 * sd)
    if not found:
        true = float(value if np.ndim(value) == 0 else np.mean(np.interp(soc, knots, value)))
        number = chosen.parameters["dUdT"]
        found["dUdT"] = bool(abs(true - number.value) <= 1.96 * number.sd)
    return found


def new_drive_rmse(fit: MapFit, log):
    """RMSE over a new drive of the same pack: all numbers as they were found, the start from the first readings."""
    record, _ = record_of(log)
    problem = fit.problem
    nu = dict(zip((c.name for c in problem.nuisances), fit.nu, strict=True))
    model = problem.model
    priors = {}
    for name, prior in model.priors.items():
        z = fit.theta[problem.index(name)] if not prior.fixed else 0.0
        own = np.array([1.0 + nu.get(f"{name}[{k}]", 0.0) for k in range(1, model.cells + 1)])
        value = np.asarray(prior.value) * np.exp(z)
        priors[name] = replace(prior, value=value * own if name in ("R_e", "R_u", "R_c") else float(value))
    effects = []
    for e in model.effects:
        free = {c.name: i for i, c in enumerate(problem.coordinates) if c.effect == e.key}
        values = dict(e.values)
        for p in effect_named(e.name).parameters:
            i = free.get(f"{e.key}.{p.name}")
            if i is not None:
                values[p.name] = float(np.exp(fit.theta[i])) if p.log else float(fit.theta[i])
        effects.append(replace(e, values=values))
    known = replace(as_filed(replace(model, priors=priors, effects=tuple(effects))), tolerances={})
    m = measured(record, known, join=1)
    offset = np.array([nu.get(f"surface_offset[{k}]", 0.0) for _, k in m.channels])
    seconds = (m.row + m.share) * m.drive.dt
    first = seconds < FIRST_READINGS_S
    drive = replace(m.drive, T_in=m.drive.T_in - nu.get("inlet_offset", 0.0))
    m = replace(m, drive=drive, y=m.y - offset[m.channel], used=first)
    start = fitted(Problem(known, [m]))
    return float(np.sqrt(np.mean((m.y - start.y)[~first] ** 2)))
