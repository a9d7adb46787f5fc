"""Checks the proposed current against voltage and SOC."""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.ammeter import UNUSUAL
from bms_gateway.records.current_witness import Witness, usual_voltage, witness
from bms_gateway.setup.heat_resistance import heat_resistance
from bms_gateway.setup.proposal import Proposal, Proposed

NEAR_ZERO: Final = 0.1
"""Share of the greatest magnitude below which a current must fall at times, so that its zero is seen."""
MOST_TORN: Final = 0.3
"""Share of an interval's voltage samples that may be invalid."""
NO_ZERO: Final = "it never comes near 0, and no SOC shows where its zero is"
NOT_SHOWN: Final = "neither the steps of the voltage nor the SOC confirm it"


def hear_witnesses(proposal: Proposal, edges: NDArray[np.float64]) -> None:
    """Mark a current as not sure, with the reason, if voltage or SOC contradicts it or neither confirms it.

    Parameters
    ----------
    proposal : Proposal
        With current, voltage and SOC.
    edges : ndarray, s
        Edges of the intervals over which means are taken.
    """
    heard: dict[tuple[str, str, str], Witness] = {}
    for p in proposal.of("current"):
        volts, soc = (_of(proposal, role, p) for role in ("voltage", "soc"))
        key = (p.path, volts.path if volts else "", soc.path if soc else "")
        if key not in heard:
            heard[key] = _witness(p, volts, soc, edges)
            proposal.remarks += [f"{p.path}: {text}" for text in heard[key].against]
        said = heard[key]
        p.against += said.against
        p.why += said.against
        low, high = p.observed
        away = low > NEAR_ZERO * high or high < NEAR_ZERO * low
        if not said.against and away and not said.zero:
            p.sure = False
            p.why.append(NO_ZERO)
        if not said.against and said.compared and not (said.supported or said.zero):
            p.sure = False
            p.why.append(NOT_SHOWN)
        if said.against:
            p.sure = False


def measure_heat(proposal: Proposal, edges: NDArray[np.float64]) -> None:
    """Set the effective resistance for heat, if the log determines it: the median of the strings."""
    steps = np.diff(edges)
    found: dict[tuple[str, str], float | None] = {}
    if np.ptp(steps) > 1e-6:  # the log has silences
        return
    for p in proposal.of("current"):
        volts = _of(proposal, "voltage", p)
        if volts is not None and not p.against:
            I, V = (q.factor * q.series.on_grid(edges) + q.shift for q in (p, volts))  # noqa: E741 - the field's symbol
            found[p.path, volts.path] = heat_resistance(I, V, float(steps[0]))
    measured = [R for R in found.values() if R is not None]
    if measured:
        proposal.heat_resistance = float(np.median(measured))


def _of(proposal: Proposal, role: str, current: Proposed) -> Proposed | None:
    return next((q for q in proposal.signals if q.role == role and q.string in (current.string, None)), None)


def _voltage(volts: Proposed, edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over intervals, without samples whose bytes belong to two measurements; NaN if many samples are such.

    Many such samples follow each other while contactors are open, or close.
    """
    s = volts.series
    V = volts.factor * s.x + volts.shift
    usual = usual_voltage(V)
    torn = np.abs(V - usual) >= UNUSUAL * abs(usual)
    if not torn.any():
        return volts.factor * s.on_grid(edges) + volts.shift
    mean = replace(s, t=s.t[~torn], x=V[~torn]).on_grid(edges)
    return np.where(replace(s, x=torn.astype(np.float64)).on_grid(edges) <= MOST_TORN, mean, np.nan)


def _witness(p: Proposed, volts: Proposed | None, soc: Proposed | None, edges: NDArray[np.float64]) -> Witness:
    nothing = np.full(len(edges) - 1, np.nan)
    V = nothing if volts is None else _voltage(volts, edges)
    S = nothing if soc is None else soc.factor * soc.series.on_grid(edges) + soc.shift
    I = p.factor * p.series.on_grid(edges) + p.shift  # noqa: E741 - the field's symbol
    return witness(I, V, S, float(np.median(np.diff(edges))), 0.0 if volts is None else volts.resolution)
