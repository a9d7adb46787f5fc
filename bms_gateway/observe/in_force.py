"""The numbers with which the adaptive observer works, and which sensors were read lately."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bms_gateway.observe.cell_scatter import exchanged, prior_covariance, root
from bms_gateway.observe.covariance_steps import READ_WITHIN
from bms_gateway.observe.flow import at_level, flow_levels
from bms_gateway.observe.model import Bools, Ints
from bms_gateway.observe.sensitivity import PARAMETERS, R_E_AT, WARMTH_AT, felt_at
from bms_gateway.thermal import Floats, StringModel, StringParameters
from bms_gateway.thermal.warmth import WARMTH, resistance_factor


@dataclass(slots=True)
class InForce:
    """Numbers of S strings of n cells.

    Attributes
    ----------
    models : tuple of StringModel
    parameters : list of StringParameters
        At nominal flow.
    level : ndarray of int (S,)
        Level of the coolant flow (`flow`).
    cov, root : ndarray (S, p, p)
        Covariance of the logarithms of `PARAMETERS`, and a root of it.
    gain : ndarray (S,)
        Factor on heat that is measured instead of computed as I²R_e.
    B, u_0 : ndarray (S,)
        With which R_e follows its core, 1000 K, and the warmth at which it is known (`thermal.warmth`).
    R_e, share : ndarray (S, n)
        Ω; heat of each cell over the mean of its string.
    """

    models: tuple[StringModel, ...]
    parameters: list[StringParameters]
    level: Ints
    cov: Floats
    root: Floats
    gain: Floats
    B: Floats
    u_0: Floats
    R_e: Floats = field(init=False)
    share: Floats = field(init=False)

    def __post_init__(self) -> None:
        self._renew()

    @classmethod
    def of(cls, models: Sequence[StringModel], heat_rel_sd: float) -> "InForce":
        """Take the numbers from models; `heat_rel_sd` is the relative error of measured heat."""
        cov, S = np.stack([prior_covariance(m, heat_rel_sd) for m in models]), len(models)
        roots = np.stack([root(c) for c in cov])
        return cls(
            tuple(models), [m.nominal for m in models], np.zeros(S, np.int64), cov, roots, np.ones(S), *np.zeros((2, S))
        )

    @property
    def cells(self) -> int:
        """Count the cells of a string."""
        return self.models[0].cells

    def consider(self, at: int, sd: float) -> None:
        """Set the sd of number `at` of all strings, uncorrelated with the others."""
        self.cov = np.stack([exchanged(c, [at], np.array([[sd**2]])) for c in self.cov])
        self.root = np.stack([root(c) for c in self.cov])

    def string(self, s: int) -> StringParameters:
        """Numbers of string `s` at its present flow."""
        return at_level(self.parameters[s], int(self.level[s]))

    def strings(self) -> list[StringParameters]:
        """Numbers of all strings at their present flows."""
        return [self.string(s) for s in range(len(self.models))]

    def follow_flow(self, ratio: Floats) -> Ints:
        """Set flows over nominal (S,), NaN: the last one; return the strings whose numbers this changes."""
        if np.isnan(ratio).all():
            return np.zeros(0, np.int64)
        self.level, moved = flow_levels(ratio, self.level)
        return np.flatnonzero(moved)

    def moved(self, s: int, values: Mapping[str, float | Floats]) -> StringParameters:
        """Numbers of string `s` with other values; symbols that the string does not have are ignored."""
        now = {k: getattr(self.parameters[s], k) for k in self.models[s].priors}
        return self.models[s].parameters({**now, **{k: v for k, v in values.items() if k in now}})

    def exchange(self, s: int, new: StringParameters, gain: float, names: Sequence[str], covariance: Floats) -> None:
        """Set other numbers of string `s`, and the covariance (k, k) of the logarithms of k of them."""
        self.parameters[s] = new
        self.gain, self.cov, self.root = self.gain.copy(), self.cov.copy(), self.root.copy()
        self.gain[s] = gain
        self.cov[s] = exchanged(self.cov[s], [PARAMETERS.index(name) for name in names], covariance)
        self.root[s] = root(self.cov[s])
        self._renew()

    def state_resistance(self, s: int, values: Mapping[str, Any], J: Floats) -> tuple[float, float]:
        """Take B and the warmth at which R_e of string `s` is known from now on.

        Parameters
        ----------
        s : int
        values : mapping of str to float
            `WARMTH` and `u_0`; without the latter, R_e is known at the warmth that the cores have had of late.
        J : ndarray (M, p)
            Sensitivities of the string; they are changed in place to those about the new warmth.

        Returns
        -------
        float
            By how much ln R_e of before is larger at the new warmth than at the old.
        float, 1000 K
            By how much B has grown.
        """
        old_B, shift = float(self.B[s]), float(values["u_0"]) - float(self.u_0[s]) if "u_0" in values else felt_at(J)
        J[:, WARMTH_AT] -= shift * J[:, R_E_AT]
        self.B, self.u_0 = self.B.copy(), self.u_0.copy()
        self.B[s], self.u_0[s] = float(values.get(WARMTH, old_B)), self.u_0[s] + shift
        return old_B * shift, float(self.B[s]) - old_B

    def cores(self, x: Floats) -> Floats:
        """Cores (S, n) of states `x` (S, M), °C."""
        return x[:, 0 : 2 * self.cells : 2]

    def by_warmth(self, x: Floats) -> Floats:
        """R_e (S, n) of the cores of states `x` (S, M), °C, over R_e where it is known."""
        if not self.B.any():
            return np.ones_like(self.R_e)
        return resistance_factor(self.B[:, None], self.cores(x), self.u_0[:, None])

    def restore(self, parameters: list[StringParameters], own: Mapping[str, Any]) -> None:
        """Set all of them."""
        self.parameters, self.level, self.cov, self.gain = parameters, own["level"], own["cov"], own["gain"]
        self.B, self.u_0, cov = own["B"], own["u_0"], own["cov"]
        self.root = np.stack([root(c) for c in cov])
        self._renew()

    def _renew(self) -> None:
        self.R_e = np.stack([p.R_e for p in self.parameters])
        self.share = np.asarray(self.R_e / self.R_e.mean(axis=1, keepdims=True), dtype=np.float64)


@dataclass(slots=True)
class Heard:
    """Which sensors of S strings with m sensors were read lately.

    Attributes
    ----------
    unread : ndarray (S, m), s
        Time since the last reading of each sensor.
    sd, firm : ndarray (S, m), K
        Of the newest readings, from what was known before them; NaN for none. `firm` is without
        reversible heat and warmth.
    fresh : bool
        Whether all sensors were read in the newest step.
    """

    unread: Floats
    sd: Floats
    firm: Floats
    fresh: bool = False
    _rested: bool = False  # whether the bands use the surfaces of all sensors
    _resting: bytes = b""  # sensors whose surfaces the bands use; empty: not known yet

    @classmethod
    def nothing(cls, shape: tuple[int, ...]) -> "Heard":
        """Create the state of sensors (S, m) that were never read."""
        return cls(np.full(shape, np.inf), *np.full((2, *shape), np.nan))

    def take(self, read: Bools, dt: float) -> None:
        """Note which sensors were read in a step of `dt` seconds."""
        self.unread = np.where(read, 0.0, self.unread + dt)

    def pass_time(self, gap_s: float) -> None:
        """Pass over a time without readings."""
        self.unread, self.fresh = self.unread + gap_s, False

    def forget(self) -> None:
        """Forget which surfaces the bands use."""
        self._resting, self._rested = b"", False

    def newly(self) -> Bools | None:
        """Sensors whose surfaces bands can use now; None if they are those of the last call."""
        if self.fresh and self._rested:
            return None
        read: Bools = self.unread <= READ_WITHIN
        self._rested = bool(read.all())
        if self._resting == read.tobytes():
            return None
        self._resting = read.tobytes()
        return read
