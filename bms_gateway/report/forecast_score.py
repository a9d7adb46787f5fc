r"""Forecasts of a log compared with the later values: under the forecast load, and under the current that then flowed.

The reference is a table of the true cores, or else the later estimates of the same engine. The forecast of a constant
core is scored too. The score of a Gaussian forecast is its CRPS (T. Gneiting, A. E. Raftery,
Strictly proper scoring rules, JASA 102 (2007), eq. 21),

.. math:: \sigma \left( z (2 \Phi(z) - 1) + 2 \varphi(z) - 1 / \sqrt{\pi} \right)
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from math import erf, exp, pi, sqrt
from typing import Any, Final

import numpy as np

from bms_gateway.engine import Estimated, Event, Foreseen
from bms_gateway.engine.forecast_result import Origin
from bms_gateway.observe.ahead import AT_ENDS, CENTRE, CORE, ENDS, HORIZONS_S, SURFACE
from bms_gateway.observe.forecast_start import Profile
from bms_gateway.thermal import Floats

STEP_NS: Final = 10_000_000_000
SCORED: Final = (1, 2, 3)
"""Horizons that are scored: 1, 5 and 10 min."""
ACTUAL, HELD, STAYS = "actual current", "load as it was", "core stays as it is"
INSIDE: Final = 2.0
"""Standard deviations within which an error counts as inside."""


@dataclass(slots=True)
class Score:
    """Sums of one kind of forecast at one horizon."""

    number: int = 0
    square: float = 0.0
    inside: int = 0
    crps: float = 0.0
    sd: float = 0.0

    def take(self, value: float, sd: float, true: float) -> None:
        """Add a forecast and the later value; an sd of 0 is a forecast without a band."""
        error = value - true
        self.number += 1
        self.square += error * error
        self.inside += abs(error) <= INSIDE * sd
        self.sd += sd
        if sd <= 0.0:
            self.crps += abs(error)
            return
        z = error / sd
        density = exp(-z * z / 2.0) / sqrt(2.0 * pi)
        self.crps += sd * (z * erf(z / sqrt(2.0)) + 2.0 * density - 1.0 / sqrt(pi))

    def document(self) -> dict[str, Any]:
        """Return the score as a document for machines; None without forecasts."""
        n = self.number
        if not n:
            return {"forecasts": 0, "rms_K": None, "inside_2sd": None, "mean_sd_K": None, "crps_K": None}
        return {
            "forecasts": n,
            "rms_K": round(sqrt(self.square / n), 4),
            "inside_2sd": round(self.inside / n, 4),
            "mean_sd_K": round(self.sd / n, 4),
            "crps_K": round(self.crps / n, 4),
        }


@dataclass(frozen=True, slots=True)
class Row:
    """One forecast of one cell, and the later values; NaN if unknown."""

    time_ns: int
    string: str
    cell: int
    horizon_s: float
    load: str
    load_A: float
    core: float
    core_sd: float
    centre: float
    centre_sd: float
    surface: float
    surface_sd: float
    came: float
    quality: str


Truth = Callable[[str, int, int], Floats]
"""Cores (n,) of a string of n cells at an instant, ns; NaN if unknown."""


@dataclass(slots=True)
class _Known:
    """Later values of all strings at one instant."""

    core: Floats
    load: Foreseen


@dataclass(slots=True)
class Scorer:
    """Scores of one log.

    Attributes
    ----------
    names : tuple of str
        Of the strings.
    every_ns : int
        Time between two scored forecasts.
    truth : callable or None
    scores : mapping
        By string, load and horizon in s.
    """

    names: tuple[str, ...]
    every_ns: int
    truth: Truth | None = None
    scores: dict[tuple[str, str, float], Score] = field(default_factory=dict)
    _known: dict[int, _Known] = field(default_factory=dict)
    _waiting: deque[Foreseen] = field(default_factory=deque)
    _newest: Estimated | None = None
    _last: int | None = None

    def take(self, event: Event) -> Iterator[Row]:
        """Use the engine's next event; yield rows of the forecasts that can now be judged."""
        if isinstance(event, Estimated):
            self._newest = event
        elif isinstance(event, Foreseen) and self._newest is not None:
            return self._foreseen(event)
        return iter(())

    def finish(self) -> Iterator[Row]:
        """Judge the forecasts whose last horizons have not come."""
        while self._waiting:
            yield from self._judge(self._waiting.popleft())

    def _foreseen(self, event: Foreseen) -> Iterator[Row]:
        assert self._newest is not None  # noqa: S101 - who calls has looked
        at = event.time_ns
        self._known[at] = _Known(self._newest.core, event)
        if self._last is None or at - self._last >= self.every_ns:
            self._last = at
            self._waiting.append(event)
        while self._waiting and at - self._waiting[0].time_ns >= ENDS[-1] * STEP_NS:
            yield from self._judge(self._waiting.popleft())
        oldest = self._waiting[0].time_ns if self._waiting else at
        for old in [t for t in self._known if t < oldest]:
            del self._known[old]

    def _judge(self, event: Foreseen) -> Iterator[Row]:
        for origin in event.origins:
            actual = self._actual(event.time_ns, origin)
            for j, i in enumerate(origin.members):
                yield from self._of_string(event, i, j, actual)

    def _actual(self, at: int, origin: Origin) -> tuple[Floats, Floats] | None:
        """Forecast under the current that flowed (3, K, S, n), and its sd (3, H, S, n); None if the current is unknown.

        The inlet stays constant, because a plan contains only the current.
        """
        loads = [self._known.get(at + k * STEP_NS) for k in range(1, ENDS[-1] + 1)]
        got = [k for k in loads if k is not None]
        members = list(origin.members)
        if not got or loads[0] is None:
            return None
        last = got[-1]
        current = np.stack([(k or last).load.load.current[members] for k in loads])
        square = np.stack([(k or last).load.load.square[members] for k in loads])
        if np.isnan(square[: len(got)]).any():
            return None
        inlet = np.broadcast_to(origin.standing.inlet, square.shape)
        ahead = origin.outlook.under(origin.standing, origin.coming, Profile(current, square, inlet))
        none = np.zeros(len(members))
        return ahead.under(none)[:, AT_ENDS], ahead.sd(none)

    def _of_string(self, event: Foreseen, i: int, j: int, actual: tuple[Floats, Floats] | None) -> Iterator[Row]:
        f, name = event.forecasts[i], self.names[i]
        if f is None:
            return
        mine = self._part(i)
        for h in SCORED:
            came = self._came(name, mine, event.time_ns, h)
            now = self._came(name, mine, event.time_ns, None)
            held_sd = np.hypot(f.core_sd[h], f.load_sd[CORE, h])
            kinds = {HELD: (f.core[h], held_sd, f.centre[h], np.hypot(f.centre_sd[h], f.load_sd[CENTRE, h]),
                            f.surface[h], np.hypot(f.surface_sd[h], f.load_sd[SURFACE, h]))}  # fmt: skip
            if actual is not None:
                T, sd = actual[0][:, h, j], actual[1][:, h, j]
                kinds[ACTUAL] = (T[CORE], sd[CORE], T[CENTRE], sd[CENTRE], T[SURFACE], sd[SURFACE])
            for load, numbers in kinds.items():
                for k in range(len(came)):
                    known = np.isfinite(f.core[h, k])
                    own = [float(a[k]) if known else np.nan for a in numbers]
                    if known and np.isfinite(came[k]):
                        self._score(name, load, h).take(own[0], own[1], float(came[k]))
                        if load == HELD and np.isfinite(now[k]):
                            self._score(name, STAYS, h).take(float(now[k]), 0.0, float(came[k]))
                    quality = "not_available" if not known else "doubtful" if f.doubtful[k] else "good"
                    core, core_sd, centre, centre_sd, surface, surface_sd = own
                    yield Row(
                        event.time_ns,
                        name,
                        k + 1,
                        HORIZONS_S[h],
                        load,
                        f.load,
                        core,
                        core_sd,
                        centre,
                        centre_sd,
                        surface,
                        surface_sd,
                        float(came[k]),
                        quality,
                    )

    def _score(self, name: str, load: str, h: int) -> Score:
        return self.scores.setdefault((name, load, HORIZONS_S[h]), Score())

    def _part(self, i: int) -> slice:
        assert self._newest is not None  # noqa: S101
        return self._newest.layout.parts[i]

    def _came(self, name: str, mine: slice, at: int, h: int | None) -> Floats:
        """Cores (n,) at a horizon; NaN if unknown."""
        n, when = mine.stop - mine.start, at + (0 if h is None else ENDS[h] * STEP_NS)
        if self.truth is not None:
            return self.truth(name, when, n)
        known = self._known.get(when)
        return np.full(n, np.nan) if known is None else known.core[mine]

    def document(self) -> Mapping[str, Any]:
        """Return the scores as a document for machines: by string, load and horizon."""
        out: dict[str, dict[str, dict[str, Any]]] = {}
        for (name, load, horizon), score in self.scores.items():
            out.setdefault(name, {}).setdefault(load.replace(" ", "_"), {})[f"{horizon:g}"] = score.document()
        return out
