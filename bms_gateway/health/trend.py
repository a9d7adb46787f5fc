r"""Changes of a string since commissioning: one Kalman filter over the results of all windows.

.. math::
    \ln R_e &= \ell + G + J + (B - B_0)\,w + s\,(\tfrac12 - SOC) \\
    \ln R_u &= u + U - n \ln(\text{flow}) \\
    b_k &= o_k + D_k, \qquad \ln R_c, \ln C_c, \ln C_s = c_1, c_2, c_3

ℓ, u, o and c are the commissioned values; they are constant, and every early window makes them better known. G
(growth), U (cooling) and D (drift of thermocouple k) are random walks that begin at zero at commissioning. B, s and n
are constants of the cell, which the filter learns: temperature and charge return to the same values, growth does not.

The filter separates sudden changes from slow ones. U and D may jump, because a fan can stop and a thermocouple can
come loose. G may not jump, because a cell does not age by several per cent within an hour. If the R_e of a window
contradicts the trend, and neither cooling nor offsets explain it, this R_e is left out. If `CONFIRM` windows in a row
do so, J takes the jump: the scale of the current or an electrical joint has changed. G is not changed by it.

Lin et al. identify the parameters once; this trend is not part of the paper.
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
"""K: exponent of R_e, and its sd, where the model has none; data sheets and records have 1500 to 4000 K."""
SOC_SD = 0.3  # of s: R_e of an empty cell against a full one, within the range of charge that a vehicle uses
FLOW_POWER = (0.6, 0.3)  # of n: 0.63 for tube banks, 0 for a gap without flow
OFFSET_SD = 1.0  # K: offset of a thermocouple against the inlet's sensor, as installed
SHAPE_SD = 0.05  # ln R_c, ln C_c, ln C_s: sd after commissioning
UNKNOWN = 1.0  # ln: sd of a level that only the windows can tell
RATE_SD, RATE_WALK = 2e-3, 3e-5
"""ln per window: sd of the growth rate at commissioning, and its random step. A rate of 0.1 % per drive wears a cell
out in a year. The filter keeps a rate because, without one, it would follow a growing R_e late and take the first
growth for the baseline. With a narrower sd of the rate, half a point of growth would still be taken for the
baseline."""
WALK = {"growth": 0.001, "cooling": 0.01, "drift": 0.02}
"""Random steps per window, ln and K; air filters clog within weeks."""
FLOORS, FLOOR_K = (0.02, 0.03, 0.02, 0.02, 0.02), 0.1
"""Errors of a window beyond its own sd: current profile, uneven temperature of the cells, two nodes for a cell."""
OPENED = {"jump": 0.3, "cooling": 0.4, "drift": 2.0}  # sd of a sudden change since the last window
SURPRISE = 3.7  # sd: one in ten thousand windows of a sound string is farther from the trend
SUDDEN = 3.0
"""sd of R_e alone, which is judged too: in the joint score of seven numbers, a jump of R_e by a fifth could stay
unnoticed. Without a jump the value is 2 at most."""
SETTLING, DOUBTED = 10, 4.0
"""Number of windows that make the baseline; the variance of a surprising one among them is multiplied by the second
number. Sudden changes are not considered in this time, because they would leave the baseline undetermined."""
CONFIRM = 3  # number of surprising windows in a row after which a jump of R_e is accepted
UNREST_SHARE, RESTLESS = 0.1, 0.25
"""Weight of the newest window in the share of unusual windows, and the share above which growth is not updated: a loose
thermocouple moves with the load and makes each window unusual in another way."""
DOUBTFUL = 0.02  # share of unusual windows above which windows are fitted without each thermocouple: one in forty
CLEARER = 2.0
"""sd by which a jump of R_e, or leaving one thermocouple out, must explain a window better than changes of cooling and
offsets. The latter explain a part of every difference."""
LEFT_OUT = 1e2  # variance that removes the influence of a number
LINEAR = 300.0
"""K: sd of B above which the results of a window are no longer linear in B; the variance of the first windows is then
increased, so that they do not fix the baseline before B is known."""
L, G, RATE, J, B, S, U0, U, N, R_C, C_C, C_S = range(12)
FIXED = C_S + 1
# states; then o_1…o_m, D_1…D_m


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a string before the first window.

    Attributes
    ----------
    level_sd : float
        Of ln R_e at 25 °C at commissioning; `UNKNOWN` where the first windows make the baseline.
    grown_sd : float
        Of the growth since commissioning: `GROWN` if the model file has the baseline, 0 if the windows make it now.
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
    """Explanation of a window."""

    USUAL = "as the trend expects"
    OPENED = "cooling or thermocouples have changed"
    LOOSE = "one thermocouple, without which it is usual"
    JUMP = "R_e has jumped"
    STRANGE = "nothing that the filter knows"


UNREST = {Kind.USUAL: 0.0, Kind.OPENED: 1.0, Kind.LOOSE: 0.2, Kind.JUMP: 0.5, Kind.STRANGE: 1.0}


class Trend:
    """The Kalman filter of one string; see the module's text.

    Parameters
    ----------
    sensors : int
        Number of thermocouples m.
    prior : Prior

    Attributes
    ----------
    left_out : int or None
        Index of the thermocouple that was left out of the newest window; None: all were used.
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
        """Indices of the states D_1…D_m."""
        return slice(FIXED + self.m, FIXED + 2 * self.m)

    @property
    def exponent(self) -> float:
        """Present estimate of B, K."""
        return float(self.x[B]) * PER

    @property
    def charge_slope(self) -> float:
        """Present estimate of s, the slope of ln R_e over the missing charge."""
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
        """H, z and R of a window for an exponent of zero; `left_out`: without this thermocouple."""
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
            Length of the window over that of a full one: the random steps grow with the time driven.
        believe : bool
            False: the current is known to be wrong, so that R_e is left out and growth is not updated.
        without : mapping
            Results of the same window without the k-th thermocouple, by k.

        Returns
        -------
        Kind
            The explanation of the window.
        """
        H, z, R = self._said(seen)
        P = self.P.copy()
        if self.windows:
            F = np.eye(len(self.x))
            F[G, RATE] = share if believe else 0.0  # the rate may come from the wrong current: G must not follow it
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
        """Estimate ln R_e of one window and its sd, at the exponent of its `mean`, with all else known from the trend.

        A single window separates the heat from the thermal resistances only to about 10 %. R_c, C_c and C_s do not
        change, and the trend knows them from many windows; with them the window tells its heat.
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
        """Whether a recent window was unusual: windows are then also fitted without each thermocouple."""
        return self.unrest > DOUBTFUL

    @property
    def restless(self) -> bool:
        """Whether so many recent windows were unusual that they must not change the growth."""
        return self.unrest > RESTLESS

    def _explained(
        self, P: Floats, seen: Observed, without: Mapping[int, Observed], before: int | None
    ) -> tuple[Floats, Kind]:
        """Find what has changed since the last window, and the covariance that allows for this change.

        A thermocouple without contact reads too low in proportion to the heat of its cell. No constant offset explains
        this, and a change of cooling would have to come and go with the load. Without this thermocouple the window
        agrees with the trend. The thermocouple that was left out `before` is used again when a window agrees with the
        trend as well with it as without it.
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
        """Size of the jump of R_e that explains a window best, in sd."""
        h = H[:, J]
        weight = np.linalg.solve(H @ P @ H.T + R, h)
        return abs(float(weight @ (z - H @ self.x))) / float(np.sqrt(weight @ h))

    def _score(self, P: Floats, H: Floats, z: Floats, R: Floats) -> float:
        """Distance of a window from the trend as a normal deviate, sd (χ² by Wilson and Hilferty)."""
        nu = z - H @ self.x
        q = len(nu)
        square = float(nu @ np.linalg.solve(H @ P @ H.T + R, nu))
        return float(((square / q) ** (1 / 3) - 1.0 + 2.0 / (9.0 * q)) / np.sqrt(2.0 / (9.0 * q)))

    def _opened(self, P: Floats) -> Floats:
        """Covariance after a sudden change of the cooling, of each thermocouple, and of all thermocouples alike."""
        P = P.copy()
        P[U, U] += OPENED["cooling"] ** 2
        P[self.drifts, self.drifts] += OPENED["drift"] ** 2 * (np.eye(self.m) + 1.0)
        return P

    def of(self, state: int) -> tuple[float, float]:
        """Mean and sd of one state."""
        return float(self.x[state]), float(np.sqrt(max(self.P[state, state], 0.0)))

    def reset(self, level_sd: float = UNKNOWN) -> None:
        """Find a new baseline of R_e from the next windows; all other states stay."""
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
