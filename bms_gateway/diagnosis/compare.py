"""Comparison of measurement and free-running model: where, when and in which regime they differ.

Two models are compared with the readings: the filed model, in which only what belongs to a record is free (`filed`),
and the same model refitted within its priors, with the numbers of every command. If the refitted model does not explain
the surfaces, other numbers may be closer to them, because they compensate for the missing effect. The error of even the
closest numbers comes from the structure of the model; it is reported in addition.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.diagnosis.core_band import CoreBand, core_bands
from bms_gateway.diagnosis.core_check import CoreCheck, core_checks
from bms_gateway.diagnosis.core_known import KnownCore, known_core
from bms_gateway.diagnosis.filed import filed_fit
from bms_gateway.diagnosis.findings import (
    core_sentences,
    refit_sentences,
    sensor_sentences,
    stream_sentences,
    tie_sentences,
)
from bms_gateway.diagnosis.misfit import Block, Level, Sensor, Series, levels, series
from bms_gateway.diagnosis.misfit import blocks as blocks_of
from bms_gateway.diagnosis.misfit import sensors as sensors_of
from bms_gateway.diagnosis.prepare import joined, measured
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.regimes import FEATURES
from bms_gateway.diagnosis.residuals import Structure, structure
from bms_gateway.identify.map_fit import MapFit, stacked
from bms_gateway.thermal import StringModel


@dataclass(frozen=True, slots=True)
class Variant:
    """One model compared with the readings.

    Attributes
    ----------
    name : {"filed", "refitted", "closest"}
    fit : MapFit
    trained, held : Level
    structure : Structure
    sensors : tuple of Sensor
    blocks : tuple of Block
        Blocks with most of the excess error, in order of time; empty if there is no excess.
    explained : tuple of (feature, share)
        Share of the excess of all sensors that the bins of each feature explain, greatest first; `always` is a constant
        error.
    series : tuple of Series
    cores : tuple of CoreBand, one per record
    core_checks : tuple of CoreCheck
        Empty for numbers that are not accepted.
    findings : tuple of str
    """

    name: str
    fit: MapFit
    trained: Level
    held: Level
    structure: Structure
    sensors: tuple[Sensor, ...]
    blocks: tuple[Block, ...]
    explained: tuple[tuple[str, float], ...]
    series: tuple[Series, ...]
    cores: tuple[CoreBand, ...]
    core_checks: tuple[CoreCheck, ...]
    findings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Measured and modelled.

    Attributes
    ----------
    sources : tuple of str
    filed, refitted : Variant
        The cores of the filed model have the sd of the refitted model, plus the distance to it: the filed model counts
        as exact and has no sd of its own.
    core : KnownCore
        How well these records determine the cores, and whether they are proven.
    closest : Variant or None
        The model with other numbers that are clearly closer to the surfaces and are not accepted; None if there are
        none.
    """

    sources: tuple[str, ...]
    filed: Variant
    refitted: Variant
    core: KnownCore
    closest: Variant | None = None


def compare(model: StringModel, records: Sequence[Record], core: KnownCore | None = None) -> Comparison:
    """Compare a model with records.

    Parameters
    ----------
    model : StringModel
    records : sequence of Record
    core : KnownCore, optional
        For this model and these records, if it is already known.

    Returns
    -------
    Comparison
        Filed and refitted; readings of cores, if there are any, are used for `core_checks` only.
    """
    core = known_core(model, records) if core is None else core
    # on the instants of the refit, which depend on the numbers before any data
    ready = [measured(r, model, join=joined(r, model.unfitted)) for r in records]
    refitted, closest = core.identified.fit, core.identified.closest
    filed = filed_fit(model, ready, model_error=core.identified.model_error_K > 0.0)
    # the uncertainty of a model that counts as exact: its change by refitting, and the sd after it
    doubted = tuple(
        replace(best, T_c=mine.T_c, gap_K=mine.gap_K, lag_K=mine.lag_K, sd_K=np.hypot(best.sd_K, mine.T_c - best.T_c))
        for mine, best in zip(core_bands(filed), core.bands, strict=True)
    )
    as_is = _variant("filed", filed, doubted, records, proven=core.proven)
    again = _variant("refitted", refitted, core.bands, records, proven=core.proven)
    if ties := tie_sentences(model):
        again = replace(again, findings=(*again.findings, *ties))
    before, after = ((v.trained.rmse_K, v.held.rmse_K) for v in (as_is, again))
    worse = refit_sentences(before, after, core.identified.model_error_K > 0.0)
    again = replace(again, findings=(*worse, *again.findings))
    return Comparison(
        tuple(r.source for r in records),
        as_is,
        again,
        core,
        _variant("closest", closest, (), records, proven=False) if core.identified.comes_closer else None,
    )


def _variant(
    name: str, fit: MapFit, bands: tuple[CoreBand, ...], records: Sequence[Record], *, proven: bool
) -> Variant:
    sensors = sensors_of(fit)
    y, sigma, _, _, used = stacked(fit.problem)
    error = y - fit.y
    blocks = blocks_of(fit)
    trained, held = levels(error, sigma, used)
    weight = {s.cell: s.share for s in sensors}
    names = ["always", *FEATURES]
    totals = {k: sum(weight[s.cell] * r.share for s in sensors for r in s.regimes if r.feature == k) for k in names}
    explained = tuple(sorted(((k, float(x)) for k, x in totals.items() if x > 0.0), key=lambda e: -e[1]))
    findings = sensor_sentences(sensors, blocks, explained, len(records))
    findings += stream_sentences(fit.problem.model, sensors)
    findings += core_sentences(bands, sensors, name, proven=proven) if bands else ()
    checks = core_checks(records, fit, bands) if bands else ()
    return Variant(
        name,
        fit,
        trained,
        held,
        structure(fit),
        sensors,
        blocks,
        explained,
        series(fit),
        bands,
        checks,
        findings,
    )
