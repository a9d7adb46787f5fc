"""Tests that a bench or a parked vehicle can drive: current, inlet and flow, within the range of the record itself.

Each test is built from the record: its greatest currents, its own drive if a drive is needed, its mean inlet, and the
capacity of the cells, so that the charge stays within its limits. All start with every cell at the inlet's temperature.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bms_gateway.identify.coordinates import Measured
from bms_gateway.thermal import Floats, StringModel
from bms_gateway.thermal.drive import Drive

STEP_S = 4.0
"""Interval of the plans: short enough to distinguish a surface from a core."""
MINUTES = 40.0
INLET_K = 10.0
FLOWS = (0.5, 1.5)
SOC = (0.1, 0.95)
SOC_STEP = 0.25
"""Share of the capacity that one long step may use."""
LATER_H = 1.0
"""Time after which a drive is repeated: relevant drifts show within an hour."""
GENTLE_C = 1.0
"""C-rate of a direction that the record never drove."""


@dataclass(frozen=True, slots=True)
class Plan:
    """One test that could be driven.

    Attributes
    ----------
    name : str
    instruction : str
        What to do, as part of a sentence.
    drive : Drive
        Cells are soaked at `drive.T_in[0]` when it begins.
    """

    name: str
    instruction: str
    drive: Drive

    @property
    def minutes(self) -> float:
        """Duration."""
        return float(self.drive.hours[-1] * 60.0 + 0.5 * self.drive.dt / 60.0)


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the tests.

    Attributes
    ----------
    discharge, charge : float, A
    inlet : float, °C
        Mean of the record's.
    capacity_Ah : float or None
    known : frozenset
        Inputs of the record besides current and temperatures; a test has the same inputs.
    own : ndarray (K,) A, its mean square (K,) A²
        The record's own drive, in steps of the plans.
    """

    discharge: float
    charge: float
    inlet: float
    capacity_Ah: float | None
    known: frozenset[str]
    own: Floats
    own_square: Floats


def limits_of(m: Measured, model: StringModel) -> Limits:
    """Take the limits from a record."""
    u = m.drive
    out, back = float(np.quantile(u.I, 0.998)), float(np.quantile(-u.I, 0.998))
    gentle = GENTLE_C * model.capacity_Ah if model.capacity_Ah else max(out, back) / 3.0
    discharge = out if out > 0.1 * back else min(gentle, back)
    charge = back if back > 0.1 * out else min(gentle, out)
    end = m.spans[0].last * u.dt
    at = (np.arange(int(end / STEP_S)) + 0.5) * STEP_S
    edges = np.arange(m.spans[0].last + 1) * u.dt

    def resampled(x: Floats) -> Floats:
        total = np.concatenate([[0.0], np.cumsum(x[: m.spans[0].last]) * u.dt])
        return np.asarray(
            (np.interp(at + STEP_S / 2, edges, total) - np.interp(at - STEP_S / 2, edges, total)) / STEP_S
        )

    return Limits(
        discharge,
        charge,
        float(np.mean(u.T_in)),
        model.capacity_Ah,
        u.known,
        resampled(u.I),
        resampled(u.I2),
    )


def plans(limits: Limits, model: StringModel) -> tuple[Plan, ...]:
    """Build the library of tests; flow steps only if a stream warms up along the string."""
    found = [make(limits) for make in LIBRARY]
    return tuple(p for p in found if p.name != "flow_steps" or model.has_coolant_path)


def _drive(
    limits: Limits,
    current: Floats,
    *,
    square: Floats | None = None,
    inlet: Floats | float = 0.0,
    flow: Floats | float = 1.0,
) -> Drive:
    """Complete the inputs of a test; inlet in K above the usual one, flow over nominal."""
    N = len(current)
    one = np.ones(N)
    mean_square: Floats = current * current if square is None else square
    soc = 0.5 * one
    if limits.capacity_Ah:
        moved = -np.cumsum(current) * STEP_S / 3600.0 / limits.capacity_Ah
        middle = 0.5 * (SOC[0] + SOC[1]) - 0.5 * (moved.max() + moved.min())
        soc = np.clip(middle + moved, *SOC)
    none = np.full(N, np.nan)
    return Drive(
        STEP_S,
        current,
        mean_square,
        np.maximum(np.abs(current), 0.9 * np.sqrt(mean_square)),
        limits.inlet + inlet * one,
        flow * one,
        soc,
        none,
        none,
        np.asarray((np.arange(N) + 0.5) * STEP_S / 3600.0, dtype=np.float64),
        limits.known - {"voltage"},
    )


def _steps(seconds: float) -> int:
    return max(round(seconds / STEP_S), 1)


def _filled(parts: Sequence[Floats]) -> Floats:
    """Repeat the parts until the time is over."""
    x = np.concatenate(parts)
    N = _steps(60.0 * MINUTES)
    return np.asarray(np.tile(x, N // len(x) + 1)[:N])


def _pulses(A: float, B: float, on_s: float, for_s: float) -> Floats:
    """Discharge at A and charge at B alternately, with equal charge in both directions."""
    out, back = np.full(_steps(on_s), A), np.full(_steps(on_s * A / B), -B)
    one = np.concatenate([out, back])
    return np.asarray(np.tile(one, max(round(for_s / (len(one) * STEP_S)), 1)))


def _longest(limits: Limits, A: float, most_s: float) -> float:
    """Longest time for which a current may flow in one direction."""
    if not limits.capacity_Ah:
        return most_s
    return min(most_s, SOC_STEP * limits.capacity_Ah * 3600.0 / A)


def _rest(seconds: float) -> Floats:
    return np.zeros(_steps(seconds))


def _long_and_short(limits: Limits) -> Plan:
    A = min(limits.discharge, limits.charge)
    long_s = _longest(limits, A, 180.0)
    current = _filled([_pulses(A, A, 8.0, 480.0), _rest(240), _pulses(A, A, long_s, 480.0), _rest(240)])
    text = f"±{A:.0f} A in pulses of 8 s for 8 min, rest, the same in pulses of {long_s:.0f} s, rest, and again"
    return Plan("long_and_short_pulses", text, _drive(limits, current))


def _both_ways(limits: Limits) -> Plan:
    A, B = limits.discharge, limits.charge
    low = 0.3 * min(A, B)
    step = _longest(limits, max(A, B), 240.0)
    slow = step * A / low
    back = step * B / low
    current = _filled(
        [
            np.full(_steps(step), A),
            _rest(180),
            np.full(_steps(slow), -low),
            _rest(120),
            np.full(_steps(step), -B),
            _rest(180),
            np.full(_steps(back), low),
            _rest(120),
        ]
    )
    text = (
        f"discharge hard ({A:.0f} A) and charge gently ({low:.0f} A), then charge hard ({B:.0f} A) and discharge gently"
    )
    return Plan("charge_and_discharge_steps", text, _drive(limits, current))


def _amplitudes(limits: Limits) -> Plan:
    A = min(limits.discharge, limits.charge)
    parts = []
    for share in (1.0, 0.25, 0.75, 0.5):
        parts += [_pulses(share * A, share * A, 20.0, 440.0), _rest(160)]
    text = f"±pulses of 20 s at {A:.0f}, {A / 4:.0f}, {0.75 * A:.0f} and {A / 2:.0f} A, 7 min each, with rests"
    return Plan("amplitude_sweep", text, _drive(limits, _filled(parts)))


def _charge_sweep(limits: Limits) -> Plan:
    A = min(limits.discharge, limits.charge)
    N = _steps(60.0 * MINUTES)
    ripple = np.where(np.arange(N) // _steps(20) % 2, -0.6, 0.6) * A
    slow = 0.4 * A
    if limits.capacity_Ah:
        slow = min(slow, 0.7 * limits.capacity_Ah * 3600.0 / (0.5 * N * STEP_S))
    current = ripple + np.where(np.arange(N) < N // 2, slow, -slow)
    text = f"±{0.6 * A:.0f} A pulses of 20 s while the cells are emptied and filled again by {slow:.0f} A on top"
    return Plan("charge_sweep", text, _drive(limits, current))


def _own(limits: Limits, minutes: float = MINUTES) -> tuple[Floats, Floats]:
    N = _steps(60.0 * minutes)
    times = N // len(limits.own) + 1
    return np.tile(limits.own, times)[:N], np.tile(limits.own_square, times)[:N]


def _with_inlet(name: str, text: str, levels: Sequence[float], *, driving: bool = True) -> Callable[[Limits], Plan]:
    def make(limits: Limits) -> Plan:
        current, square = _own(limits)
        if not driving:
            current, square = np.zeros(len(current)), np.zeros(len(current))
        at = np.minimum(np.arange(len(current)) * len(levels) // len(current), len(levels) - 1)
        inlet = np.asarray(levels)[at]
        if len(set(levels)) > 1:  # ducts and flaps need some seconds
            inlet = np.convolve(np.pad(inlet, (4, 0), mode="edge"), np.full(5, 0.2), "valid")
        return Plan(name, text, _drive(limits, current, square=square, inlet=inlet))

    return make


def _flow_steps(limits: Limits) -> Plan:
    current, square = _own(limits)
    levels = np.array([1.0, FLOWS[0], FLOWS[1], FLOWS[0], 1.0, FLOWS[1]])
    flow = levels[np.minimum(np.arange(len(current)) * 6 // len(current), 5)]
    text = f"the same drive while the flow steps between {FLOWS[0]:g} and {FLOWS[1]:g} of nominal every 7 min"
    return Plan("flow_steps", text, _drive(limits, current, square=square, flow=flow))


def _soak(limits: Limits) -> Plan:
    return Plan("soak", "rest at 0 A and constant inlet", _drive(limits, _rest(60.0 * MINUTES)))


def _cool_down(limits: Limits) -> Plan:
    A = min(limits.discharge, limits.charge)
    hot = _pulses(0.7 * A, 0.7 * A, 20.0, 1200.0)
    current = np.concatenate([hot, _rest(60.0 * MINUTES - STEP_S * len(hot))])
    text = f"heat up with ±{0.7 * A:.0f} A pulses for 20 min, then rest for 20 min"
    return Plan("heat_and_cool_down", text, _drive(limits, current))


def _again_later(limits: Limits) -> Plan:
    current, square = _own(limits, MINUTES / 2)
    gap = np.zeros(_steps(3600.0 * LATER_H) - len(current))
    text = f"the same {MINUTES / 2:.0f} min of drive twice, {60 * LATER_H:.0f} min apart, at rest in between"
    return Plan(
        "drive_again_later",
        text,
        _drive(limits, np.concatenate([current, gap, current]), square=np.concatenate([square, gap, square])),
    )


LIBRARY: tuple[Callable[[Limits], Plan], ...] = (
    _long_and_short,
    _both_ways,
    _amplitudes,
    _charge_sweep,
    _with_inlet(
        "inlet_up",
        f"the same drive while the inlet steps up by {INLET_K:g} K and back every 10 min",
        (0.0, INLET_K, 0.0, INLET_K),
    ),
    _with_inlet(
        "inlet_down",
        f"the same drive while the inlet steps down by {INLET_K:g} K and back every 10 min",
        (0.0, -INLET_K, 0.0, -INLET_K),
    ),
    _with_inlet(
        "inlet_at_rest",
        f"rest at 0 A while the inlet steps by ±{INLET_K:g} K every 10 min",
        (0.0, INLET_K, -INLET_K, 0.0),
        driving=False,
    ),
    _with_inlet("warm_drive", f"the same drive with the inlet {INLET_K:g} K warmer", (INLET_K,)),
    _with_inlet("cold_drive", f"the same drive with the inlet {INLET_K:g} K colder", (-INLET_K,)),
    _flow_steps,
    _soak,
    _cool_down,
    _again_later,
)
"""Functions that make the tests; of equal tests the first one is preferred."""
