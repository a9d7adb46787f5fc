r"""From windows to what has changed: one Kalman filter over everything that a window can speak of.

.. math::
    \ln R_e &= \ell + G + J + (B - B_0)\,w + s\,(\tfrac12 - SOC) \\
    \ln R_u &= u + U - n \ln(\text{flow}) \\
    b_k &= o_k + D_k, \qquad \ln R_c, \ln C_c, \ln C_s = c_1, c_2, c_3

ℓ, u, o and c are as commissioned and never move; G (growth), U (cooling) and D (drift of thermocouple k) walk away from
zero since then, so that the baseline is refined by every early window and stays what it was. B, s and n are constants
of the cell, learnt on the way: temperature and charge come back, growth does not.

What can happen overnight and what cannot tells the rest apart. A fan stops, a thermocouple comes loose: U and D may
jump. A cell does not age by several per cent in an hour: where a window's R_e contradicts the trend and neither cooling
nor offsets explain it, it is left out; when `CONFIRM` windows in a row say so, J takes up the jump, which is a fault of
the current's scale or of a joint, and G goes on as before.

Beyond Lin et al., who identify once.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import Any

import numpy as np

from bms_gateway.errors import StateError
from bms_gateway.health.window_fit import FIRST_OFFSET, Observed
from bms_gateway.thermal import Floats

PER = 1000.0  # K: unit of B in the filter
B_PRIOR = (2500.0, 1200.0)
"""K: exponent of a lithium-ion cell's resistance where the model says nothing; data sheets and records: 1500…4000."""
SOC_SD = 0.3  # of s: R_e at empty against full, in the range that a vehicle uses
FLOW_POWER = (0.6, 0.3)  # of n: tube banks 0.63, a still gap 0
OFFSET_SD = 1.0  # K: a thermocouple against the inlet's, as installed
SHAPE_SD = 0.05  # ln R_c, ln C_c, ln C_s: what a commissioning leaves
UNKNOWN = 1.0  # ln: a level that only the windows tell
RATE_SD, RATE_WALK = 2e-3, 3e-5
"""ln per window: growth goes on as it has gone, 0.1 % a drive is a cell that wears out in a year; it is at rest only if
the windows say so. Without a rate, a growing R_e would be followed late, and its start be taken for the baseline; with
one that is pulled to rest as narrowly as it usually is, a part of that start still is: half a point of growth."""
WALK = {"growth": 0.001, "cooling": 0.01, "drift": 0.02}
"""Steps in a window, ln and K; filters clog within weeks."""
FLOORS, FLOOR_K = (0.02, 0.03, 0.02, 0.02, 0.02), 0.1
"""What a window errs beyond its own sd: profile, uneven warmth, a model of two nodes."""
OPENED = {"jump": 0.3, "cooling": 0.4, "drift": 2.0}  # what may have happened since the last window
SURPRISE = 3.7  # sd: one in ten thousand windows that are as they should be
SUDDEN = 3.0
"""sd of R_e alone: among seven numbers that scatter, one that jumps by a fifth would pass; without one: 2 at most."""
SETTLING, DOUBTED = 10, 4.0
"""Windows that make the baseline: one that surprises is taken with so many times its variance. Nothing can have changed
since a commissioning that is under way, and what is opened then leaves it open what the baseline was."""
CONFIRM = 3  # surprising windows in a row before a jump of R_e is believed
UNREST_SHARE, RESTLESS = 0.1, 0.25
"""Weight of the newest window in the share of unusual ones, and the share from which R_e is held: a thermocouple that
hangs loose moves with the load and makes every window another surprise."""
DOUBTFUL = 0.02  # share of unusual windows from which each thermocouple is left out in turn: one in forty suffices
CLEARER = 2.0
"""sd by which a jump of R_e, or leaving one thermocouple out, must explain a window better than changes of cooling and
offsets do: these explain a little of everything."""
LEFT_OUT = 1e2  # variance that takes a reading out
LINEAR = 300.0
"""K: B so unsure bends what a window finds, which is told to first order; the first windows must not fix the baseline
before it is known."""
L, G, RATE, J, B, S, U0, U, N, R_C, C_C, C_S = range(12)
FIXED = C_S + 1
# states; then o_1…o_m, D_1…D_m


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a string before the first window.

    Attributes
    ----------
    level_sd : float
        Of ln R_e at 25 °C as commissioned; `UNKNOWN` where the first windows make the baseline.
    grown_sd : float
        Of the growth since then (`GROWN` where the model file carries the baseline); 0 where it is made now.
    B, B_sd : float
        K.
    shape_sd : tuple of float
        Of ln R_c, ln C_c, ln C_s.
    """

    level_sd: float = UNKNOWN
    grown_sd: float = 0.0
    B: float = B_PRIOR[0]
    B_sd: float = B_PRIOR[1]
    shape_sd: tuple[float, ...] = (SHAPE_SD, SHAPE_SD, SHAPE_SD)


class Kind(Enum):
    """What a window took to be explained."""

    USUAL = "as the trend expects"
    OPENED = "cooling or thermocouples have changed"
    LOOSE = "one thermocouple, without which it is usual"
    JUMP = "R_e has jumped"
    STRANGE = "nothing that the filter knows"


UNREST = {Kind.USUAL: 0.0, Kind.OPENED: 1.0, Kind.LOOSE: 0.2, Kind.JUMP: 0.5, Kind.STRANGE: 1.0}


class Trend:
    """See the module's text.

    Parameters
    ----------
    sensors : int
        Thermocouples m.
    prior : Prior

    Attributes
    ----------
    left_out : int or None
        Which of the m the newest window was taken without; None where with all.
    """

    def __init__(self, sensors: int, prior: Prior | None = None) -> None:
        self.m = sensors
        prior = prior or Prior()
        size = FIXED + 2 * sensors
        self.x = np.zeros(size)
        self.x[B], self.x[N] = prior.B / PER, FLOW_POWER[0]
        sd = np.zeros(size)
        sd[[L, G, B, S, U0, N]] = prior.level_sd, prior.grown_sd, prior.B_sd / PER, SOC_SD, UNKNOWN, FLOW_POWER[1]
        sd[RATE] = RATE_SD
        sd[R_C:FIXED] = prior.shape_sd
        sd[FIXED : FIXED + sensors] = OFFSET_SD
        self.P = np.diag(sd**2)
        self.windows = 0
        self.surprises = 0
        self.unrest = 0.0
        self.left_out: int | None = None

    @property
    def drifts(self) -> slice:
        """Where D_1…D_m are."""
        return slice(FIXED + self.m, FIXED + 2 * self.m)

    @property
    def exponent(self) -> float:
        """B as known now, K."""
        return float(self.x[B]) * PER

    @property
    def charge_slope(self) -> float:
        """Slope s of ln R_e over what is missing in charge, as known now."""
        return float(self.x[S])

    def expected(self, flow: float, soc: float) -> Floats:
        """Predict the next window's `Observed.mean` (5 + m,), referred with `exponent`."""
        return np.asarray(self._matrix(flow, soc) @ self.x)

    def _matrix(self, flow: float, soc: float) -> Floats:
        H = np.zeros((FIRST_OFFSET + self.m, len(self.x)))
        H[0, [L, G, J]] = 1.0
        H[0, S] = 0.5 - soc if soc == soc else 0.0
        H[1, [U0, U]] = 1.0
        H[1, N] = -np.log(flow) if flow > 0.0 else 0.0
        k = np.arange(self.m)
        H[[2, 3, 4], [R_C, C_C, C_S]] = 1.0
        H[FIRST_OFFSET + k, FIXED + k] = H[FIRST_OFFSET + k, FIXED + self.m + k] = 1.0
        return H

    def _said(self, seen: Observed, left_out: int | None = None) -> tuple[Floats, Floats, Floats]:
        """H, z and R of a window, as of one referred with no exponent at all; `left_out`: without this thermocouple."""
        H, floors = self._matrix(seen.flow, seen.soc), np.array([*FLOORS, *[FLOOR_K] * self.m])
        if left_out is not None:
            H, floors = np.delete(H, FIRST_OFFSET + left_out, axis=0), np.delete(floors, FIRST_OFFSET + left_out)
        H[:, B] = -seen.by_B * PER
        bent = 1.0 + float(self.P[B, B]) * (PER / LINEAR) ** 2
        return H, seen.mean - seen.by_B * seen.B, bent * (seen.cov + np.diag(floors**2))

    def update(
        self,
        seen: Observed,
        share: float = 1.0,
        *,
        believe: bool = True,
        without: Mapping[int, Observed] = MappingProxyType({}),
    ) -> Kind:
        """Take one window.

        Parameters
        ----------
        seen : Observed
        share : float
            Its length in units of a full window: walks go by time driven.
        believe : bool
            False: its R_e is left out, for the current is known to be wrong, and growth stays where it is.
        without : mapping
            What the same window says with the k-th of the thermocouples left out.

        Returns
        -------
        Kind
            What it took to explain it.
        """
        H, z, R = self._said(seen)
        P = self.P.copy()
        if self.windows:
            F = np.eye(len(self.x))
            F[G, RATE] = share if believe else 0.0  # a rate that a wrong current has made must not go on by itself
            self.x, P = F @ self.x, F @ P @ F.T
            P[G, G] += WALK["growth"] ** 2 * share
            P[RATE, RATE] += RATE_WALK**2 * share
            P[U, U] += WALK["cooling"] ** 2 * share
            P[self.drifts, self.drifts] += np.eye(self.m) * WALK["drift"] ** 2 * share
        self.windows += 1
        kind, before, self.left_out = Kind.USUAL, self.left_out, None
        if self.windows > SETTLING:
            P, kind = self._explained(P, seen, without, before)
            if self.left_out is not None:
                H, z, R = self._said(without[self.left_out], self.left_out)
        elif self._score(P, H, z, R) > SURPRISE:
            R = DOUBTED * R
        self.unrest += UNREST_SHARE * (UNREST[kind] - self.unrest)
        self.surprises = self.surprises + 1 if kind is Kind.JUMP else 0
        if kind is Kind.STRANGE:
            self.P = P
            return kind
        if not believe or self.restless or 0 < self.surprises < CONFIRM:
            R[0, 0] += LEFT_OUT
        elif self.surprises >= CONFIRM:
            P[J, J] += OPENED["jump"] ** 2
        gain = self._gain(P, H, R)
        self.x = self.x + gain @ (z - H @ self.x)
        keep = np.eye(len(self.x)) - gain @ H
        P = keep @ P @ keep.T + gain @ R @ gain.T
        self.P = 0.5 * (P + P.T)
        return kind

    def resistance(self, seen: Observed) -> tuple[float, float]:
        """Tell ln R_e of a window, referred as its `mean` is, and its sd, by what is known of all but R_e.

        A window alone tells heat badly from resistance to it, by a tenth; R_c, C_c and C_s, which many windows have
        taught and which do not change, tell how much heat it was.
        """
        H, z, R = self._said(seen)
        P = self.P.copy()
        P[J, J] += UNKNOWN**2
        gain = self._gain(P, H, R)
        x, P = self.x + gain @ (z - H @ self.x), P - gain @ H @ P
        return float(H[0] @ x + seen.by_B[0] * seen.B), float(np.sqrt(max(H[0] @ P @ H[0], 0.0)))

    @staticmethod
    def _gain(P: Floats, H: Floats, R: Floats) -> Floats:
        return np.asarray(np.linalg.solve(H @ P @ H.T + R, H @ P).T)

    @property
    def doubtful(self) -> bool:
        """Whether a window lately was unusual: then each thermocouple is asked whether it is it."""
        return self.unrest > DOUBTFUL

    @property
    def restless(self) -> bool:
        """Whether so many windows lately had to be explained by something new that growth must not be read off them."""
        return self.unrest > RESTLESS

    def _explained(
        self, P: Floats, seen: Observed, without: Mapping[int, Observed], before: int | None
    ) -> tuple[Floats, Kind]:
        """Find what must have changed since the last window, and the covariance that allows for it.

        A thermocouple that has lost its contact reads less the hotter its cell is, as no offset explains; and a change
        of cooling that would explain it comes and goes with the load. Without it the window is as ever. The one that
        was left out `before` is believed again where it explains a window as well as the others do.
        """
        said = self._said(seen)
        whole = self._score(P, *said)
        scores = {k: self._score(P, *self._said(other, k)) for k, other in without.items()}
        known = before is not None and before in scores and scores[before] + CLEARER < whole
        sudden = self._jump(P, *said) > SUDDEN
        if whole <= SURPRISE and not known and not sudden:
            return P, Kind.USUAL
        opened = self._opened(P)
        jumped = opened.copy()
        jumped[J, J] += OPENED["jump"] ** 2
        changed, jump = self._score(opened, *said), self._score(jumped, *said)
        usual = [k for k, score in scores.items() if score <= SURPRISE]
        if known and before in usual:
            usual = [before]
        if len(usual) == 1 and (known or scores[usual[0]] + CLEARER < min(changed, jump)):
            self.left_out = usual[0]
            return P, Kind.LOOSE
        if min(changed, jump) > SURPRISE:
            return P, Kind.STRANGE
        if jump + CLEARER < changed or changed > SURPRISE:
            return opened, Kind.JUMP
        return (P, Kind.USUAL) if whole <= SURPRISE else (opened, Kind.OPENED)

    def surprising(self, seen: Observed) -> bool:
        """Whether a window contradicts the trend as it stands."""
        return self._score(self.P, *self._said(seen)) > SURPRISE

    def _jump(self, P: Floats, H: Floats, z: Floats, R: Floats) -> float:
        """Size of the jump of R_e that explains a window best, sd."""
        h = H[:, J]
        weight = np.linalg.solve(H @ P @ H.T + R, h)
        return abs(float(weight @ (z - H @ self.x))) / float(np.sqrt(weight @ h))

    def _score(self, P: Floats, H: Floats, z: Floats, R: Floats) -> float:
        """How much farther from the trend a window lies than chance puts it, sd (Wilson and Hilferty's normal χ²)."""
        nu = z - H @ self.x
        q = len(nu)
        square = float(nu @ np.linalg.solve(H @ P @ H.T + R, nu))
        return float(((square / q) ** (1 / 3) - 1.0 + 2.0 / (9.0 * q)) / np.sqrt(2.0 / (9.0 * q)))

    def _opened(self, P: Floats) -> Floats:
        """Let cooling and thermocouples have changed since the last window: each by itself, and all of them alike."""
        P = P.copy()
        P[U, U] += OPENED["cooling"] ** 2
        P[self.drifts, self.drifts] += OPENED["drift"] ** 2 * (np.eye(self.m) + 1.0)
        return P

    def of(self, state: int) -> tuple[float, float]:
        """Mean and sd of one state."""
        return float(self.x[state]), float(np.sqrt(max(self.P[state, state], 0.0)))

    def reset(self, level_sd: float = UNKNOWN) -> None:
        """Make a new baseline of R_e from the next windows; what else is known stays."""
        for state, sd in ((L, level_sd), (G, 0.0), (RATE, RATE_SD), (J, 0.0)):
            self.P[state, :] = self.P[:, state] = 0.0
            self.P[state, state] = sd**2
        self.x[[G, RATE, J]] = 0.0
        self.surprises = 0

    def snapshot(self) -> dict[str, Any]:
        """State as JSON-able values."""
        return {
            "x": self.x.tolist(),
            "P": self.P.tolist(),
            "windows": self.windows,
            "surprises": self.surprises,
            "unrest": self.unrest,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take up a stored state.

        Raises
        ------
        StateError
            It is another string's, or not finite.
        """
        x, P = (np.array(state[key], dtype=np.float64) for key in ("x", "P"))
        sound = x.shape == self.x.shape and P.shape == self.P.shape and np.isfinite(x).all() and np.isfinite(P).all()
        if not sound or np.linalg.eigvalsh(P)[0] < -1e-9:
            raise StateError("health: the stored state is damaged or of another string; starting anew")
        self.x, self.P = x, P
        self.windows, self.surprises, self.unrest = (
            int(state["windows"]),
            int(state["surprises"]),
            float(state["unrest"]),
        )
