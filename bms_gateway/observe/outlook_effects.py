r"""Forecasts of a string with effects: its balances about its present state, by the Jacobian of its observer.

With f the rates at the present state z under a constant current, z(h) = z + Γ_h f: exact for a linear string, of second
order otherwise. The response to a load is the secant of f from no current to the present one. The other direction has a
response of its own, since effects may distinguish discharge from charge. Effects' memories are set to those after some
minutes of that current. Heat follows R_e and the effects, as no future voltage is measured. Under a profile, each step
starts where the last one ended.

Beyond Lin et al., whose observer estimates only the present.
"""

from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.observe.ahead import AT_ENDS, ENDS, PATH, STEP_S, Ahead, Certainty, Course, Spread, certainty
from bms_gateway.observe.forecast_start import Coming, Profile, Standing
from bms_gateway.observe.tangent import ROW, Tangent, disturbed, drive_of
from bms_gateway.observe.transitions import SEGMENTS, Reach, course
from bms_gateway.thermal import Floats
from bms_gateway.thermal.centre import followed, time_constant
from bms_gateway.thermal.physics import Memory, Numbers, Physics

HELD_S = 300.0
"""s for which the current has flowed in the middle of a forecast."""
LEAST_HEAT_W = 5.0
"""Heat of a mean cell at the least current from which a response is computed."""
_I, _I2, _I_ABS, _T_IN = (ROW.index(k) for k in ("I", "I2", "I_abs", "T_in"))
_V, _IV = ROW.index("V"), ROW.index("IV")


@dataclass(frozen=True, slots=True)
class EffectStanding(Standing):
    """State of one string with effects; see `Standing`. Here x, P and J include the effects' own states.

    Attributes
    ----------
    physics : Physics
    numbers : Numbers
    tangent : Tangent or None
        Tangent in force; None before the first step.
    forcing : ndarray (M, p)
        Of the sensitivities, in the last steps.
    row : ndarray (9,)
        Inputs of the last step, in the order of `ROW`.
    usual : float, A²
        Mean square of the last minutes.
    carry : mapping
        Memories of the effects.
    R_e_at : int or None
        Column of R_e in the sensitivities.
    """

    physics: Physics
    numbers: Numbers
    tangent: Tangent | None
    forcing: Floats
    row: Floats
    usual: float
    carry: Memory
    R_e_at: int | None

    def rates(self, z: Floats, I: float, square: float, dt: float, inlet: float | None = None) -> Floats:  # noqa: E741
        """Rates (M,) of a state `z` (M,) under a mean current, A, and mean square, A², that last for `dt` s."""
        row = self.row.copy()
        row[[_I, _I2, _I_ABS]] = I, square, abs(I)
        row[[_V, _IV]] = np.nan
        row[_T_IN] = self.inlet[0] if inlet is None else inlet
        u, v = drive_of(row[None], dt), disturbed(self.numbers, z[-2:])
        memory, _ = self.physics.memory(u, v, self.carry or None)
        found = self.physics.rates(z[None, :-2], u, v, memory)[0]
        return np.concatenate((np.nan_to_num(found), -z[-2:] / self.disturbance.correlation))


class EffectOutlook:
    """Forecasts of one string with effects, and the matrices that they need."""

    def __init__(self) -> None:
        self._of: Tangent | None = None
        self._reach: Reach | None = None

    def ahead(self, s: Standing, coming: Coming, known: Certainty | None = None) -> Ahead:
        """Forecast from the present state of the string; see `Outlook.ahead`."""
        assert isinstance(s, EffectStanding)  # noqa: S101 - of the observer that this outlook belongs to
        R, z = self._follow(s), _shifted(s, coming)
        M, n = len(z), s.lag.shape[1]
        R_e = float(np.mean(s.numbers.string.R_e))
        I = float(np.sqrt(max(s.usual, LEAST_HEAT_W / R_e)))  # noqa: E741
        sign = -1.0 if coming.current[0] < 0.0 else 1.0
        none = s.rates(z, 0.0, 0.0, HELD_S) + _own(s, coming)
        unit = [(s.rates(z, w * I, I * I, HELD_S) + _own(s, coming) - none) / I**2 for w in (sign, -sign)]
        by_rates = R.path[None, :, :, M:]
        still = course((z + by_rates @ none)[..., :], z[None], s.lag, R.by_path[None], R.by_now[None])
        load, other = (
            course(by_rates @ f, np.zeros((1, M)), np.zeros((1, n)), R.by_path[None], R.by_now[None]) for f in unit
        )
        if known is None:
            forced = np.zeros_like(s.forcing)
            if s.R_e_at is not None:
                forced[:, s.R_e_at] = unit[0]
            F = [np.hstack((s.forcing - s.usual * forced, forced))] * len(SEGMENTS)
            known = certainty(still, load, self._spread(R, s, coming, F), replace(s.unlike, doubt=coming.doubt))
        return Ahead(still, load, known, s.unlike.phi, other)

    def under(self, s: Standing, coming: Coming, profile: Profile) -> Ahead:
        """Forecast under a profile of the load; its response to a load is zero."""
        assert isinstance(s, EffectStanding)  # noqa: S101
        R, z, lag = self._follow(s), _shifted(s, coming), s.lag[0]
        M, n = len(z), len(lag)
        tau = time_constant(s.unlike.phi[0], s.numbers.string.R_c, s.numbers.string.C_c)
        states, lags = [z], [lag]
        for I, square, inlet in zip(profile.current[:, 0], profile.square[:, 0], profile.inlet[:, 0], strict=True):  # noqa: E741
            if len(states) > ENDS[-1]:
                break
            f = s.rates(z, float(I), float(square), STEP_S, float(inlet)) + _own(s, coming)
            z = z + R.path[0, :, M:] @ f
            gap = (z + states[-1])[: 2 * n].reshape(n, 2) / 2.0
            lag = lag + followed(STEP_S, tau) * (gap[:, 0] - gap[:, 1] - lag)
            states.append(z)
            lags.append(lag)
        at = [0, *PATH]
        X, L = np.stack(states)[at], np.stack(lags)[at]
        still = Course(X[:, None, 0 : 2 * n : 2], X[:, None, 1 : 2 * n : 2], L[:, None])
        nothing = Course(*(np.zeros_like(still.core) for _ in range(3)))
        forced = np.zeros_like(s.forcing)
        if s.R_e_at is not None:
            I = float(np.sqrt(max(s.usual, 1.0)))  # noqa: E741
            forced[:, s.R_e_at] = (s.rates(s.x[0], I, I * I, HELD_S) - s.rates(s.x[0], 0.0, 0.0, HELD_S)) / I**2
        F = []
        for a, b in SEGMENTS:
            more = float(profile.square[a:b, 0].mean()) - s.usual
            F.append(np.hstack((s.forcing + more * forced, np.zeros_like(forced))))
        known = certainty(still, nothing, self._spread(R, s, coming, F), replace(s.unlike, doubt=coming.doubt))
        return Ahead(still, nothing, known, s.unlike.phi)

    def _follow(self, s: EffectStanding) -> Reach:
        """Make matrices anew with each Jacobian."""
        assert s.tangent is not None  # noqa: S101 - of a string that is available
        if self._reach is None or self._of is not s.tangent:
            A, string = s.tangent.jacobian.A, s.numbers.string
            W = s.tangent.intensity(inlet_known=True, current_known=True)
            tau = np.broadcast_to(time_constant(s.unlike.phi[0], string.R_c, string.C_c), s.lag[0].shape)
            self._reach, self._of = Reach.of(A, np.eye(len(A)), W, np.array(tau)), s.tangent
        return self._reach

    @staticmethod
    def _spread(R: Reach, s: EffectStanding, coming: Coming, F: list[Floats]) -> Spread:
        assert s.tangent is not None  # noqa: S101 - of a string that is available
        n, p = s.lag.shape[1], s.J.shape[2]
        J, gram, N = np.hstack((s.J[0], np.zeros_like(s.J[0]))), [], 2 * n
        for k in range(len(SEGMENTS)):
            J = R.carry[k] @ J + R.gather[k] @ F[k]
            slopes = np.matmul(J[:N].reshape(2 * N, p), s.root[0]).reshape(n, 4, p)
            gram.append(np.matmul(slopes, slopes.swapaxes(1, 2)))
        left = R.Phi @ s.P[0]
        core, surface, M, at = R.Phi[:, 0::2], R.Phi[:, 1::2], s.x.shape[1], np.arange(n)
        still = R.Q + np.stack(
            (
                np.einsum("hnm,hnm->hn", left[:, 0::2], core),
                np.einsum("hnm,hnm->hn", left[:, 1::2], surface),
                np.einsum("hnm,hnm->hn", left[:, 0::2], surface),
            )
        )
        ends = R.path[[k - 1 for k in AT_ENDS]]
        by_inlet = (ends[:, :N, M:] @ s.tangent.jacobian.A[:, -2]) * coming.inlet_sd
        by_heat = [np.einsum("hnm,mn->hn", ends[:, i:N:2, M:], s.tangent.jacobian.B_q) * coming.heat_sd for i in (0, 1)]
        by_core = [R.Phi[:, 2 * at + i, 2 * at] * coming.shift_sd for i in (0, 1)]
        for a, b in ((by_inlet[:, 0::2], by_inlet[:, 1::2]), by_heat, by_core):
            still = still + np.stack((a * a, b * b, a * b))
        return Spread(still[:, :, None], np.stack(gram)[:, None])


def _own(s: EffectStanding, coming: Coming) -> Floats:
    """Rates (M,) from the heat of cells that no current makes."""
    assert s.tangent is not None  # noqa: S101 - of a string that is available
    return np.asarray(s.tangent.jacobian.B_q @ coming.heat[0], dtype=np.float64)


def _shifted(s: EffectStanding, coming: Coming) -> Floats:
    z = s.x[0].copy()
    z[0 : 2 * s.lag.shape[1] : 2] += coming.shift[0]
    return np.asarray(z, dtype=np.float64)
