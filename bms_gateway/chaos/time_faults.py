"""Faulty time stamps and clocks, parking, and a restart while driving."""

import numpy as np
from numpy.typing import NDArray

from bms_gateway.chaos.reaction import Counted, Quiet, Reaction, Told, Unmoved
from bms_gateway.chaos.scenario import Injection, Scenario

HOUR_S = 3600.0
YEARS_S = 1.7e9
Stamps = NDArray[np.int64]


def time_scenarios() -> list[Scenario]:
    """Make all scenarios of this room; they do not depend on the config."""
    stepped = (Counted.of("clock_steps"), Unmoved())
    misdated = (Counted.of("misdated"), Unmoved())

    def one(
        name: str, fault: str, expected: tuple[Reaction, ...], injection: Injection, lasts: float = 60.0
    ) -> Scenario:
        return Scenario(name, "time", fault, expected, lasts, 60.0, injection)

    return [
        one("clock-forward", "wall clock set forward by an hour", stepped, Injection(wall_s=HOUR_S)),
        one("clock-back", "wall clock set back by an hour", stepped, Injection(wall_s=-HOUR_S)),
        one(
            "clock-1970",
            "wall clock starts in 1970 and is set on the way",
            stepped,
            Injection(epoch_s=0.0, wall_s=YEARS_S),
        ),
        one("stamps-equal", "all frames of a tenth of a second have one stamp", (Unmoved(),), Injection(stamps=_equal)),
        one(
            "stamps-jumbled",
            "stamps go back and forth by up to 50 ms",
            (Counted.of("reordered"), Unmoved()),
            Injection(stamps=_jumbled),
        ),
        one(
            "stamps-backwards",
            "the adapter's clock runs an hour behind",
            misdated,
            Injection(stamps=lambda s, _rng: s - round(HOUR_S * 1e9)),
        ),
        one("stamps-future", "single stamps lie a day ahead", misdated, Injection(stamps=_future)),
        one("parked-minutes", "parked for 5 minutes", _asleep(), Injection(parked=True), 300.0),
        one("parked-hours", "parked for 8 hours", _asleep(), Injection(parked=True), 8 * HOUR_S),
        one("restart", "stopped for 20 s while driving", (Quiet(15),), Injection(restart=True), 20.0),
    ]


def _asleep() -> tuple[Reaction, ...]:
    return (Told("silent"), Quiet(60), Told("awake"))


def _equal(stamps: Stamps, _rng: np.random.Generator) -> Stamps:
    return np.full(len(stamps), stamps[-1])


def _jumbled(stamps: Stamps, rng: np.random.Generator) -> Stamps:
    return stamps - rng.integers(0, 50_000_000, len(stamps))


def _future(stamps: Stamps, rng: np.random.Generator) -> Stamps:
    late = stamps.copy()
    late[rng.random(len(stamps)) < 0.02] += round(24 * HOUR_S * 1e9)
    return late
