"""Additions to a model as the pages of a report are told of them."""

from dataclasses import replace

import numpy as np

from bms_gateway.diagnosis.calibrate import channel_errors
from bms_gateway.diagnosis.verdict_parts import errors
from bms_gateway.identify.problem import Problem
from bms_gateway.report.add_text import AddReport, Side


def replace_records(fit, records):
    return Problem(fit.problem.model, records, fit.problem.beliefs)


def report_of(addition, told=None, *, force=False):
    """What the terminal is told of an addition."""
    before, after = (
        Side(errors(f), channel_errors(f), core) for f, core in zip(addition.fits, addition.core, strict=True)
    )
    refused, written = addition.refused, force or not addition.refused
    return AddReport(
        "out.toml", addition.added, written, force and bool(refused), refused, addition.remark, addition.log_odds,
        before, after, (), *((told.sources, told.findings, told.notes) if told else (("x",), (), ())),
    )  # fmt: skip


def cores_of(comparison, *half_K, why=(), fits=()):
    """Cores of a comparison with these 95 % half widths, of these fits in place of its own."""
    own = comparison.core
    flat = [
        [replace(b, sd_K=np.full_like(b.sd_K, h / 1.96), remainder_K=0.0 * b.remainder_K, share=0.0) for b in own.bands]
        for h in half_K
    ]
    found = tuple(replace(own, bands=tuple(bands), why=why) for bands in flat)
    of = [replace(own.identified, fit=f) for f in fits] or [own.identified] * len(found)
    return tuple(replace(core, identified=x) for core, x in zip(found, of, strict=True))
