"""The content of the page for each step, as plain documents; numbers and sentences are those of the reports."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bms_gateway.diagnosis.adding import Addition
from bms_gateway.diagnosis.adding_bench import all_used, fit_with
from bms_gateway.diagnosis.compare import Comparison, Variant
from bms_gateway.diagnosis.core_band import half_width_K
from bms_gateway.diagnosis.core_check import CoreCheck
from bms_gateway.diagnosis.core_known import KnownCore, unlike, unseen
from bms_gateway.diagnosis.diagnosis import Diagnosis
from bms_gateway.diagnosis.filed import seen_on
from bms_gateway.diagnosis.ranking import Standing
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.record_finding import Finding
from bms_gateway.diagnosis.verdict_parts import Errors, errors
from bms_gateway.diagnosis.verdict_words import alternatives
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.report.add_text import AddReport, headline
from bms_gateway.report.core_text import UNKNOWN_K, core_document, core_sentence, thermocouple_sentence
from bms_gateway.report.diagnosis_text import (
    Part,
    Told,
    closer_numbers,
    finite,
    number_lines,
    parts_of,
    reach,
)
from bms_gateway.report.html import closest_html, numbers_html, verdict_tag
from bms_gateway.report.html_correlation import correlation_table
from bms_gateway.report.html_evidence import summary
from bms_gateway.report.html_ranking import NAMED_AT
from bms_gateway.report.html_series import Shown
from bms_gateway.report.html_tables import errors_apart, heat_map, thermocouples_table
from bms_gateway.report.step_names import FILED, REFITTED, with_added
from bms_gateway.report.words import in_words, named_all, on_page, parameter_named, parameters_labelled, unit
from bms_gateway.thermal import StringModel
from bms_gateway.thermal.effects import catalogue, effect_named
from bms_gateway.workbench.contours import known
from bms_gateway.workbench.pictures import preview

Document = dict[str, Any]
WEIGHTS = {"stop": "cannot be used", "warn": "look at this first", "note": "good to know"}


def opened(
    model: StringModel,
    records: Sequence[Record],
    findings: Sequence[tuple[str, Finding]],
    notes: Sequence[tuple[str, str]],
    about: Sequence[Document],
) -> Document:
    """Describe the opened files and the findings of the direct checks.

    Parameters
    ----------
    model : StringModel
    records : sequence of Record
    findings, notes : sequence of (source, …)
    about : sequence of dict
        Of each record, from `tracks`, and the number of readings of its file as `heard`.
    """
    order = list(WEIGHTS)
    checks = sorted(findings, key=lambda f: order.index(f[1].severity))
    return {
        "cells": model.cells,
        "condition": model.condition,
        "sensors": list(model.sensors),
        "effects": [e.key for e in model.effects],
        "catalogue": [{"name": e.name, "title": e.title} for e in catalogue().values()],
        "records": [
            {
                "source": r.source,
                "minutes": float(r.instants[-1] - r.instants[0]) / 60.0,
                "readings": len(r.y),
                "means_s": r.drive.dt,
                "cells": list(r.cells),
                "core": len(r.core.y) > 0,
                **about[k],
            }
            for k, r in enumerate(records)
        ],
        "checks": [
            {
                "record": s,
                "severity": f.severity,
                "weight": WEIGHTS[f.severity],
                "sentence": in_words(on_page(f.sentence)),
            }
            for s, f in checks
        ],
        "notes": [{"record": s, "note": text} for s, text in notes],
    }


def compared(c: Comparison, name: str) -> Document:
    """Describe where a model fails, as one step; for the first model, also with the parameters from its file.

    Parameters
    ----------
    c : Comparison
    name : str
        Name of the step.
    """
    steps = [(FILED, c.filed), (name, c.refitted)] if name == REFITTED else [(name, c.refitted)]
    models = [Shown.of(*s) for s in steps]
    return {
        "variants": {name: _variant(name, v, closest_html(c) if v is c.refitted else "") for name, v in steps},
        "errors": errors_apart(models),
        "core": told_core(c.core),
        "parameters": numbers_html(c.refitted.fit, c.core, narrow=True),
        "correlations": correlation_table(c.refitted.fit),
        "thermocouples": thermocouples_table(models, c.refitted.core_checks),
    }


def told_core(core: KnownCore | None, otherwise: str = "") -> Document:
    """Describe the uncertainty of the cores, as in JSON documents, with its sentence."""
    told = core_document(core, otherwise)
    why = [in_words(parameters_labelled(text)) for text in told["why"]]
    return {**told, "why": why, "sentence": core_sentence(core) if core else ""}


def _variant(name: str, v: Variant, closest: str) -> Document:
    shown = Shown.of(name, v)
    half = half_width_K(v.cores)
    hottest, centre = (
        np.max(np.stack([x.max(axis=0) for x in xs]), axis=0)
        for xs in ([b.T_c for b in v.cores], [b.T_centre for b in v.cores])
    )
    sensors = {s.cell: s for s in v.sensors}
    cells = []
    unknown, unlike_of = half > UNKNOWN_K, dict.fromkeys(unseen(v.fit), 100.0 * unlike(v.fit))
    for k in range(1, v.fit.problem.model.cells + 1):
        s = sensors.get(k)
        cells.append(
            {
                "cell": k,
                "error_K": finite(s.trained.rmse_K) if s else None,
                "held_K": finite(s.held.rmse_K) if s else None,
                "floor_K": finite(s.trained.floor_K) if s else None,
                "ratio": finite(s.trained.ratio) if s else None,
                "core_C": None if unknown[k - 1] else finite(float(hottest[k - 1])),
                "core_95_K": finite(float(half[k - 1])),
                "assumed_percent": unlike_of.get(k),
                "centre_C": None if unknown[k - 1] else finite(float(centre[k - 1])),
            }
        )
    return {
        "findings": [in_words(t) for t in v.findings],
        "cards": summary([shown]),
        "regimes": heat_map([shown]),
        "closest": closest,
        "cells": cells,
        "stair": stair(errors(v.fit), float(half.max())),
        "core_measured": [thermocouple(x) for x in v.core_checks],
        "known": known(v.fit) if name != FILED else None,  # nothing was learnt for a model that was not fitted
    }


def thermocouple(check: CoreCheck) -> Document:
    """Describe the error of a model against a thermocouple in a core that no fit has used."""
    return {"cell": check.cell, "sentence": thermocouple_sentence(check), "alarm": check.outside}


def stair(e: Errors, core_K: float | None) -> Document:
    """Return one step of the staircase: errors, half width of the least certain core, K, and whether it is given.

    Without a half width, the cores are not judged yet.
    """
    return {
        "trained_K": finite(e.train_rmse_K),
        "held_K": finite(e.heldout_rmse_K),
        "floor_K": finite(e.noise_floor_K),
        "core_K": None if core_K is None else finite(core_K),
        "core_known": core_K is None or core_K <= UNKNOWN_K,
    }


def diagnosed(told: Told) -> tuple[Document, dict[str, Document]]:
    """Describe a diagnosis; return also the curves of each effect, by its name."""
    d = told.diagnosis
    verdict = d.verdict if d else "insufficient_data"
    remains = bool(d and d.unknown_remains and d.selected)
    fits = _fits(d, told.ranking) if d else {}
    document = {
        "verdict": verdict,
        "tag": verdict_tag(d),
        "remains": verdict == "unknown_effect" or remains,
        "sentence": in_words(told.sentence),
        "selected": [s.candidate.key for s in d.selected] if d else [],
        "offer": list(told.offer.effects),
        "not_offered": in_words(told.offer.sentence),
        "error": f"closest {'error' if d and d.decided_by_second else 'held-out error'}",
        "ranking": [_standing(r, p, r.name in fits) for p in parts_of(told.ranking) for r in p.ranked],
        "absorbed": [in_words(t) for t in told.absorbed],
        "core": told_core(told.core, told.sentence),
        "card": [in_words(t) for t in told.card],
        "next": in_words(told.next_experiment or ""),
    }
    return document, {name: preview(fit) for name, fit in fits.items()}


def _standing(r: Standing, part: Part, drawn: bool) -> Document:
    return {
        "name": r.name,
        "effects": [effect(key) for key in r.effects],
        "role": r.role,
        "group": part.title,
        "against": part.bars,
        "needs": reach(NAMED_AT, part.top),
        "evidence": finite(r.evidence),
        "reach": reach(r.evidence, part.top),
        "share": finite(r.share),
        "error_K": finite(r.error_K),
        "without_K": finite(r.without_K),
        "numbers": [in_words(t) for t in number_lines(r.effects, r.parameters)],
        "tied": [in_words(t) for t in alternatives(r.tied_with)],
        "refused": in_words(r.refused),
        "drawn": drawn,
    }


def effect(key: str) -> Document:
    """Return the catalogue's description of an effect."""
    name, _, _ = key.partition(":")
    e = effect_named(name)
    return {
        "key": key,
        "title": e.title,
        "equation": e.equation,
        "signature": e.signature,
        "needs": e.needs,
        "confused_with": [in_words(t) for t in e.confused_with],
        "parameters": [
            ", ".join([parameter_named([name], p.name), *([unit(p.unit)] if unit(p.unit) else [])])
            for p in e.parameters
        ],
    }


def _fits(d: Diagnosis, ranking: Sequence[Standing]) -> dict[str, MapFit]:
    """Find the fit of each line of a ranking, if the search kept it."""
    ready = d.search.baseline.problem.records
    chosen = [s.candidate.key for s in d.selected]
    last: Mapping[str, MapFit] = {t.candidate.key: t.fit for t in d.search.rounds[-1]} if d.search.rounds else {}
    first: Mapping[str, MapFit] = {t.candidate.key: t.fit for t in d.search.rounds[0]} if d.search.rounds else {}
    found: dict[str, MapFit] = {}
    for r in ranking:
        fit: MapFit | None
        if r.role == "named":
            fit = d.fits[1]
        elif d.second is not None and d.decided_by_second:
            fit = fit_with(d.second, [*chosen, *r.effects] if r.role == "next" else list(r.effects))
            fit = None if fit is None else seen_on(fit, all_used(ready))
        else:
            fit = (last if r.role == "next" else first).get(r.name)
        if fit is not None:
            found[r.name] = fit
    return found


def added(report: AddReport, addition: Addition, words: Sequence[str]) -> Document:
    """Describe the change of the errors by an addition, or why it is refused."""
    steps = [stair(side.errors, float(side.core.half_width_K.max())) for side in (report.before, report.after)]
    return {
        "words": list(words),
        "names": named_all(c.key for c in report.added),
        "step": with_added(named_all(c.key for c in report.added), forced=report.forced),
        "kept": report.written,
        "forced": report.forced,
        "refused": in_words(report.refused),
        "remark": in_words(report.remark),
        "closest": closer_numbers(report.after.core.identified),
        "tag": report.tag,
        "core": told_core(report.after.core),
        "headline": in_words(headline(report)),
        "before": steps[0],
        "after": steps[1],
        "parameters": numbers_html(addition.fits[1], report.after.core, narrow=True),
        "core_measured": [
            {**thermocouple(a), "before_K": finite(b.rmse_K), "after_K": finite(a.rmse_K)}
            for b, a in zip(report.before.checks, report.after.checks, strict=True)
        ],
    }
