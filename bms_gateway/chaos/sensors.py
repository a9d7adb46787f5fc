"""Broken sensors of the first string: thermocouples, current, coolant inlet."""

import numpy as np

from bms_gateway.chaos.fault_targets import Facts
from bms_gateway.chaos.reaction import Counted, InState, Marked, Reaction, Told
from bms_gateway.chaos.scenario import Injection, Scenario
from bms_gateway.chaos.simulated_pack import Change
from bms_gateway.engine.broadcast import State
from bms_gateway.frames.quality import Quality
from bms_gateway.thermal import Floats

FAR = 1e5  # beyond what any signal can hold: it is sent as the end of the range, or as not available
SLOW_S = 90.0  # a thermocouple that has come off its cell and hangs in the air beside it
SOUND_WINDOW_S = 2700.0
"""Cores are proven again by the first window of twenty minutes without the fault; another one may still be open."""
NOISY_K = 6.0
HEATS_K_S = 0.35  # rise of a cell with an internal short before it runs away
RUNS_S = 240.0
FOLD_S = 5.0  # time in which its rate grows by a factor of e
DIES_K = 250.0
FROZEN = np.nan

Q = Quality
BROKEN_WIRE = Marked.of(Q.OPEN, Q.OUT_OF_RANGE, Q.NOT_AVAILABLE, Q.ERROR)
SHORT_CIRCUIT = Marked.of(Q.SHORT, Q.OUT_OF_RANGE, Q.NOT_AVAILABLE, Q.ERROR)
NO_VOLTAGE = "without a voltage on the bus nothing contradicts a current"


def sensor_scenarios(facts: Facts) -> list[Scenario]:
    """Make all scenarios of this room for a config."""
    return [*_thermocouples(facts), *_currents(facts), _inlet(facts)]


def _thermocouples(facts: Facts) -> list[Scenario]:
    cell = facts.sensed
    unfit = facts.lacks("surface")

    def one(
        name: str, fault: str, expected: tuple[Reaction, ...], lasts_s: float, recovers_s: float, change: Change
    ) -> Scenario:
        injection = Injection(values={("surface", cell): change})
        fault = f"cell {cell}: {fault}"
        return Scenario(f"thermocouple-{name}", "sensor", fault, expected, lasts_s, recovers_s, injection, unfit)

    told = Told("sensor", "is not used")
    return [
        one("open", "wire broken, reads its upper end", (BROKEN_WIRE, told), 60, 60, lambda _t, v: v * 0 + FAR),
        one("short", "shorted, reads its lower end", (SHORT_CIRCUIT, told), 60, 60, lambda _t, v: v * 0 - FAR),
        one(
            "stuck",
            "keeps its last value",
            (Marked.of(Q.STUCK), Counted.of("stuck")),
            400,
            120,
            Frozen(),
        ),
        one(
            "noisy",
            f"loose contact, noise of {NOISY_K:g} K",
            # a reading that was believed before the first jump may open the band until the core is not available
            (Marked.of(Q.JUMPY, Q.NOT_AVAILABLE), Counted.of("jumpy"), told),
            60,
            300,
            Noisy(facts.seed),
        ),
        Scenario(
            "cell-runaway",
            "sensor",
            f"cell {cell} heats, runs away and takes its thermocouple with it",
            (Told("runaway", "thermal runaway"), BROKEN_WIRE),
            330,
            SOUND_WINDOW_S,
            Injection(values={("surface", cell): RunsAway()}),
            unfit,
            misleads=True,  # the readings of the thermocouple do not belong to the simulated cell
        ),
        Scenario(
            "thermocouple-slow",
            "sensor",
            f"cell {cell}: off its cell, follows within {SLOW_S:g} s",
            (Told("unproven"),),
            1500,
            SOUND_WINDOW_S,
            # long loads show the fault; under many short loads all surfaces move little
            Injection(values={("surface", cell): Slow()}, cycle="urban-assault"),
            unfit,
            misleads=True,
        ),
    ]


class RunsAway:
    """Shows a cell that a fault heats until it runs away; the thermocouple is destroyed by the heat."""

    def __init__(self) -> None:
        self._since = FROZEN

    def __call__(self, t: Floats, value: Floats) -> Floats:
        """Show readings."""
        if self._since != self._since:
            self._since = float(t[0])
        s = t - self._since
        own = HEATS_K_S * s + np.expm1(np.maximum(s - RUNS_S, 0.0) / FOLD_S)
        return np.where(own < DIES_K, value + own, FAR)


class Frozen:
    """Keeps its first reading."""

    def __init__(self) -> None:
        self._kept = FROZEN

    def __call__(self, _t: Floats, value: Floats) -> Floats:
        """Show readings."""
        if self._kept != self._kept:
            self._kept = float(value[0])
        return np.full(len(value), self._kept)


class Noisy:
    """Adds white noise."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng([seed, 0x15E])

    def __call__(self, _t: Floats, value: Floats) -> Floats:
        """Show readings."""
        return value + NOISY_K * self._rng.standard_normal(len(value))


class Slow:
    """Follows with a lag."""

    def __init__(self) -> None:
        self._shown, self._t = FROZEN, 0.0

    def __call__(self, t: Floats, value: Floats) -> Floats:
        """Show readings."""
        out = np.empty(len(value))
        for i, (now, v) in enumerate(zip(t.tolist(), value.tolist(), strict=True)):
            if self._shown != self._shown:
                self._shown, self._t = v, now
            self._shown += (v - self._shown) * -np.expm1(-max(0.0, now - self._t) / SLOW_S)
            self._t = max(now, self._t)
            out[i] = self._shown
        return out


def _currents(facts: Facts) -> list[Scenario]:
    unfit = facts.lacks("current")
    needs_voltage = unfit or (NO_VOLTAGE if facts.lacks("voltage") else "")
    limit = 0.3 * facts.peak_A
    stands: tuple[Reaction, ...] = (Counted.of("stuck"), Told("sensor", "while the voltage moves"))

    def one(name: str, fault: str, expected: tuple[Reaction, ...], change: Change, why: str) -> Scenario:
        injection = Injection(values={("current", None): change})
        # a current that reads too low gives too little heat until the fault is found; with the wrong sign, the heat
        # that is derived from the voltage has the wrong sign too
        misleads = expected is not gone
        return Scenario(f"current-{name}", "sensor", fault, expected, 300, 300, injection, why, misleads)

    saturated = f"current sensor ends at ±{limit:.0f} A"
    gone = Counted.of("out_of_range", "not_available", "error"), InState(State.DEGRADED)
    return [
        one("stuck", "current keeps its last value", stands, Frozen(), needs_voltage),
        one("clipped", "current never below 0", stands, lambda _t, v: np.maximum(v, 0.0), needs_voltage),
        one("saturated", saturated, stands, lambda _t, v: np.clip(v, -limit, limit), needs_voltage),
        one("end-of-range", "current at the end of its signal", gone, lambda _t, v: v * 0 + FAR, unfit),
        one("sign", "current with the wrong sign", (Told("current_sign"),), lambda _t, v: -v, needs_voltage),
    ]


def _inlet(facts: Facts) -> Scenario:
    injection = Injection(values={("coolant_inlet", None): lambda _t, v: np.full(len(v), np.nan)})
    return Scenario(
        "inlet-missing",
        "sensor",
        "coolant inlet is not measured",
        (Told("sensor", "coolant inlet is not used"),),
        120,
        120,
        injection,
        facts.lacks("coolant_inlet"),
    )
