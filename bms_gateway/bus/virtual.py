"""Simulated pack: strings on a drive cycle, with scatter, moving inlet and unknown start, from one seed.

It is simulated in segments, so that ten hours take no more memory than ten minutes. The true core of every cell is
given too, for comparison with the gateway's estimates.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from bms_gateway.bus.traffic import Key, Series, lines, steps
from bms_gateway.engine.plan import Plan, StringPlan
from bms_gateway.engine.statistics import statistic_of
from bms_gateway.thermal import Floats, StringParameters, continuous, discretize, simulate
from bms_gateway.thermal.cycles import CAPACITY_AH, CYCLES

SEGMENT_S = 600
STEP_S = 1.0
INLET_C, INLET_SWING_K, INLET_PERIOD_S = 25.0, 3.0, 300.0
SENSOR_NOISE_K = 0.1
OCV_EMPTY_V, OCV_SPAN_V, SOC_START = 3.2, 0.15, 0.6  # an LFP cell's plateau, straight


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of one string's truth: K instants, both ends included.

    Attributes
    ----------
    string : StringPlan
    time_s : ndarray (K,)
    core_C, surface_C : ndarray (K, n)
    series : mapping of (quantity, cell) to Series
        All measurable quantities, without noise.
    """

    string: StringPlan
    time_s: Floats
    core_C: Floats
    surface_C: Floats
    series: Mapping[Key, Series]


@dataclass(frozen=True, slots=True)
class PackFault:
    """A fault of the first string.

    Attributes
    ----------
    during_s : (float, float)
        When it begins and ends; whole seconds.
    heat_W : mapping of int to float
        Additional heat of a cell, by its number from 1.
    R_u, flow : float
        Factors on the resistance to the coolant and on the flow.
    current : float
        True current divided by the measured current.
    """

    during_s: tuple[float, float]
    heat_W: Mapping[int, float] = field(default_factory=dict)
    R_u: float = 1.0
    flow: float = 1.0
    current: float = 1.0


class VirtualPack:
    """The strings of a plan, simulated.

    Parameters
    ----------
    plan : Plan
    seed : int
        The same seed gives the same pack and drive, bit for bit, on one machine.
    scatter : float
        Cells differ by so many times the model's tolerances; 0 makes them equal.
    common : float
        Standard deviation of the logarithm by which R_e, R_c and R_u of each string differ from the model file, where
        that does not fix them: what identification has to find. 0: the model file is right.
    inlet_swing_K : float
        Amplitude of the inlet's motion, where the plan has it from the bus.
    cycle : str
        Of `thermal.cycles.CYCLES`, driven over and over.

    Attributes
    ----------
    phase : float
        Of the inlet's motion at the start, rad; drawn from the seed.
    """

    def __init__(
        self,
        plan: Plan,
        seed: int = 0,
        *,
        scatter: float = 1.0,
        common: float = 0.0,
        inlet_swing_K: float = INLET_SWING_K,
        cycle: str = "urban-assault",
    ) -> None:
        self.plan = plan
        rng = np.random.default_rng([seed, 0x60])
        capacity = plan.strings[0].model.capacity_Ah or CAPACITY_AH
        self._cycle = CYCLES[cycle](rng, capacity)
        self.phase = float(rng.uniform(0.0, 2 * np.pi))
        self._swing = inlet_swing_K
        self.parameters = tuple(_truth(s, rng, scatter, common) for s in plan.strings)
        self._start = tuple(self._start_state(s, rng) for s in plan.strings)

    def segments(
        self,
        duration_s: float,
        *,
        rest_s: tuple[float, float] | None = None,
        fault: PackFault | None = None,
    ) -> Iterator[tuple[Segment, ...]]:
        """Simulate from 0 to `duration_s`, some minutes at a time; between the ends of `rest_s` no current flows.

        A fault breaks the first string for a while.

        Yields
        ------
        tuple of Segment
            One per string; the last instant of one is the first of the next.
        """
        steps = [discretize(continuous(p), STEP_S) for p in self.parameters]
        fault = fault or PackFault((np.inf, np.inf))
        broken = replace(self.parameters[0], R_u=self.parameters[0].R_u * fault.R_u).with_flow_ratio(fault.flow)
        broken_step = discretize(continuous(broken), STEP_S)
        states = list(self._start)
        charge = [0.0] * len(states)
        whole = max(1, round(duration_s / STEP_S))
        for first in range(0, whole, SEGMENT_S):
            last = min(whole, first + SEGMENT_S)
            k = np.arange(first, last + 1)
            time: Floats = k.astype(np.float64) * STEP_S
            current = self._cycle[k % len(self._cycle)]
            if rest_s is not None:
                current = np.where((time >= rest_s[0]) & (time < rest_s[1]), 0.0, current)
            out = []
            for i, (string, p) in enumerate(zip(self.plan.strings, self.parameters, strict=True)):
                inlet = self._inlet(string, time)
                here = (time >= fault.during_s[0]) & (time < fault.during_s[1]) & (i == 0)
                real = np.where(here, fault.current * current, current)
                heat = np.outer(real[:-1] ** 2, p.R_e)
                for cell, watts in fault.heat_W.items():
                    heat[here[:-1], cell - 1] += watts
                x = np.empty((len(time), len(states[i])))
                x[0] = states[i]
                edges = [0, *(np.flatnonzero(np.diff(here[:-1])) + 1).tolist(), len(time) - 1]
                for a, b in pairwise(edges):
                    x[a : b + 1] = simulate(broken_step if here[a] else steps[i], x[a], heat[a:b], inlet[a : b + 1])
                states[i] = x[-1]
                drawn = charge[i] + np.concatenate([[0.0], np.cumsum(real[:-1] * STEP_S)])
                charge[i] = float(drawn[-1])
                flow = np.where(here, fault.flow, 1.0)
                out.append(_segment(string, p, _Driven(time, current, real, inlet, flow, drawn), x))
            yield tuple(out)

    def _inlet(self, string: StringPlan, time: Floats) -> Floats:
        constant = next((c.constant for c in string.channels if c.quantity == "coolant_inlet"), None)
        if constant is not None:
            return np.full(len(time), constant)
        w = 2 * np.pi / INLET_PERIOD_S
        wave = 0.8 * np.sin(w * time + self.phase) + 0.2 * np.sin(2.7 * w * time)  # no pure sine: richer than one
        return INLET_C + self._swing * wave

    def _start_state(self, string: StringPlan, rng: np.random.Generator) -> Floats:
        """Start temperatures: above the coolant, cores above surfaces, cells different; unknown to the gateway."""
        n = string.model.cells
        surface = self._inlet(string, np.zeros(1)) + rng.uniform(0.0, 8.0) + rng.normal(0.0, 0.5, n)
        x = np.empty(2 * n)
        x[1::2] = surface
        x[0::2] = surface + rng.uniform(0.0, 8.0) + rng.normal(0.0, 0.5, n)
        return x


def _truth(string: StringPlan, rng: np.random.Generator, scatter: float, common: float) -> StringParameters:
    """Parameters of the true string: they differ from the file by a common factor, and from cell to cell."""
    model = string.model
    p = model.nominal
    drawn = {}
    for name in ("R_e", "R_c", "R_u"):
        together = 0.0 if model.priors[name].fixed else common * rng.normal()
        each = scatter * model.tolerances.get(f"cell_{name}", 0.0) * rng.normal(size=model.cells)
        drawn[name] = getattr(p, name) * np.exp(together + each)
    return replace(p, **drawn)


class _Driven(NamedTuple):
    """Inputs of a string at T instants.

    Attributes
    ----------
    time : ndarray (T,), s
    current, real : ndarray (T,), A
        Measured and true.
    inlet : ndarray (T,), °C
    flow : ndarray (T,)
        Relative to nominal.
    drawn : ndarray (T,), A s
        Charge since the start.
    """

    time: Floats
    current: Floats
    real: Floats
    inlet: Floats
    flow: Floats
    drawn: Floats


def _segment(string: StringPlan, p: StringParameters, u: _Driven, x: Floats) -> Segment:
    time = u.time
    core, surface = x[:, 0::2], x[:, 1::2]
    model = string.model
    soc = np.clip(SOC_START - u.drawn / (3600.0 * (model.capacity_Ah or CAPACITY_AH)), 0.0, 1.0)
    cells = (OCV_EMPTY_V + OCV_SPAN_V * soc)[:, None] - np.outer(u.real, p.R_e)
    series: dict[Key, Series] = {
        ("current", None): steps(time, u.current),
        ("voltage", None): steps(time, cells.sum(axis=1)),
        ("coolant_inlet", None): lines(time, u.inlet),
        ("soc", None): lines(time, soc),
    }
    if model.flow is not None:
        series["coolant_flow", None] = steps(time, model.flow * u.flow)
    for k in range(model.cells):
        series["surface", k + 1] = lines(time, surface[:, k])
        series["cell_voltage", k + 1] = steps(time, cells[:, k])
    for c in string.channels:
        if c.statistic is not None:
            series[c.key] = lines(time, statistic_of(c.statistic, surface[:, np.array(c.among) - 1].T))
    return Segment(string, time, core, surface, series)
