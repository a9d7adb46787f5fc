"""How far off strings may be: what the filter leaves open, what their numbers add, what cells differ by.

The first two parts are looked at again when the filter's covariance or the sensitivities have moved; the third goes
with the temperatures, and is looked at in every step.

Beyond Lin et al., who give no bands.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from bms_gateway.observe.blocks import chosen
from bms_gateway.observe.model import Bools, Ints
from bms_gateway.observe.sensitivity import Flows
from bms_gateway.observe.spread import as_tolerated, between_cells, scatter
from bms_gateway.observe.stored import like, plain
from bms_gateway.thermal import Floats, StringModel

Levers = Floats
"""Temperatures (3, S, n) that a cell's own R_e, R_u, R_c stand behind: core over base, surface over it, gap."""


class Bands:
    """Variances of S strings of n cells, and of the readings of their m sensors by their numbers.

    Parameters
    ----------
    models : sequence of StringModel
    sensors : ndarray of int (S, m)
        0-based cells.
    fitted : ndarray of bool (S, m)
        Which columns of `sensors` count.

    Attributes
    ----------
    own : ndarray (S, n, 3, 3)
        Covariance of each cell's ln R_e, ln R_u, ln R_c about what is common to the cells.
    owned : bool
        Whether any of it is more than the models' tolerances.
    """

    def __init__(self, models: Sequence[StringModel], sensors: Ints, fitted: Bools) -> None:
        S, n = len(models), models[0].cells
        scattered = np.stack([scatter(m) for m in models], axis=1)
        self._tolerated, self._offset = scattered[:3], scattered[3][:, None]
        self.own, self.owned = as_tolerated(self._tolerated, n), False
        # of cores and surfaces: what the filter leaves open, what numbers add, and what thermocouples are off
        self._still, self._more = (np.zeros((S, n)), np.zeros((S, n))), np.zeros(sensors.shape)
        self._over: tuple[Floats, Floats] | None = None
        self._places = (np.arange(S)[:, None] * n + sensors)[fitted]
        self._fitted = None if fitted.all() else fitted
        self._shape = S, n

    def differ(self, s: int, own: Floats | None) -> None:
        """Take what the cells of string `s` differ by; None for its tolerances."""
        if own is not None or self.owned:
            tolerated = as_tolerated(self._tolerated, self._shape[1])[s]
            self.own, self.owned = self.own.copy(), True
            self.own[s] = tolerated if own is None else own

    def know(self, at: Ints, P: Floats, J: Floats, root: Floats, seen: Floats) -> None:
        """Take what the filter leaves open in the strings `at`, and the sensitivities of states and readings."""
        for still, var in zip(self._still, self._known(at, P, J, root), strict=True):
            still[at] = var
        self._more[at] = _squares(np.matmul(seen, chosen(root, at)))

    def rest_on(self, flows: Flows, sensors: Ints, read: Bools) -> None:
        """Let levers stand on the coolant, and where `read` (S, m) says so on the surface that is read.

        A cell's base is M T_s + m T_in, or its own surface: what surfaces are over it is linear in them.
        """
        n = self._shape[1]
        M, m = np.eye(n) - flows.M, flows.m.copy()
        row, col = read.nonzero()
        at = sensors[row, col]
        M[row, at], m[row, at] = 0.0, 0.0
        self._over = M, m

    def levers(self, x: Floats, inlet: Floats) -> Levers:
        """Tell the levers of states `x` (S, M) under the measured `inlet` (S,)."""
        assert self._over is not None  # noqa: S101 - set before the first look
        N, (M, m) = 2 * self._shape[1], self._over
        T_c, T_s = x[:, 0:N:2], x[:, 1:N:2]
        over = np.matmul(M, T_s[:, :, None])[:, :, 0] - m * (inlet + x[:, -2])[:, None]
        levers = np.empty((3, *over.shape))
        levers[1] = over
        np.subtract(T_c, T_s, out=levers[2])
        np.add(levers[2], over, out=levers[0])
        return levers

    def told(self, levers: Levers, available: Bools | None) -> tuple[Floats, Floats]:
        """Tell the standard deviations (S, n) of cores and surfaces; infinite where strings are not `available`."""
        return self._sds(self._still, levers, available)

    def now(self, P: Floats, J: Floats, root: Floats, levers: Levers, available: Bools) -> tuple[Floats, Floats]:
        """Tell them for other covariances and sensitivities, of all strings; nothing changes."""
        return self._sds(self._known(np.arange(self._shape[0]), P, J, root), levers, available)

    def of_readings(self, sd: Floats) -> Floats:
        """Widen what readings (S, m) scatter by with the numbers known."""
        return np.asarray(np.sqrt(np.square(sd) + self._more), dtype=np.float64)

    def on_cells(self, values: Floats) -> Floats:
        """Give values (S, m) of the sensors to their cells (S, n); NaN for cells without one."""
        out = np.full(self._shape[0] * self._shape[1], np.nan)
        out[self._places] = values.ravel() if self._fitted is None else values[self._fitted]
        return out.reshape(self._shape)

    def snapshot(self) -> dict[str, Any]:
        """Return what was last looked at, as numbers and lists."""
        return {"more": plain(self._more)}

    def restore(self, snapshot: dict[str, Any], P: Floats, J: Floats, root: Floats) -> None:
        """Take up a snapshot of as many strings of this length.

        Raises
        ------
        KeyError, TypeError, ValueError
            It is none of them.
        """
        self._more = like(snapshot["more"], self._more)
        self._still = self._known(np.arange(self._shape[0]), P, J, root)

    def _known(self, at: Ints, P: Floats, J: Floats, root: Floats) -> tuple[Floats, Floats]:
        N, offset = 2 * self._shape[1], chosen(self._offset, at)
        var = chosen(np.einsum("sii->si", P), at)[:, :N] + _squares(np.matmul(J[:, :N], chosen(root, at)))
        return var[:, 0::2] + offset, var[:, 1::2] + offset

    def _sds(self, still: tuple[Floats, Floats], levers: Levers, available: Bools | None) -> tuple[Floats, Floats]:
        core, surface = between_cells(levers, self._tolerated, self.own if self.owned else None)
        core, surface = np.sqrt(core + still[0]), np.sqrt(surface + still[1])
        if available is None:
            return core, surface
        return np.where(available[:, None], core, np.inf), np.where(available[:, None], surface, np.inf)


def _squares(a: Floats) -> Floats:
    """Sum the squares over the last axis, which is short: a reduction there would be slow."""
    return np.asarray(np.einsum("smp,smp->sm", a, a), dtype=np.float64)
