r"""Standard deviations of strings: from the filter, from the uncertain parameters, and from the scatter of the cells.

The first two parts are updated when the filter's covariance or the sensitivities have moved. The third part depends on
the temperatures and is updated in every step.

The hottest point of a cell (`thermal.centre`) is core + φ gap. Its variance is that of this sum, including the
covariance of core and gap, plus that of φ: :math:`\sigma_\varphi^2 (gap^2 + \sigma_{gap}^2)`.

Beyond Lin et al., who give no bands.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from bms_gateway.observe.ahead import Unlike
from bms_gateway.observe.blocks import chosen
from bms_gateway.observe.cell_scatter import as_tolerated, between_cells, of_centre, scatter, weights
from bms_gateway.observe.model import Bools, Ints
from bms_gateway.observe.sensitivity import LOGARITHMS, Flows
from bms_gateway.observe.stored import like, plain
from bms_gateway.thermal import Floats, StringModel, StringParameters
from bms_gateway.thermal.centre import centre_share, followed, hottest, time_constant

Levers = Floats
"""Levers: temperatures (6, S, n) on which a cell's uncertain numbers act. R_e, R_u, R_c: core over base, surface over
base, gap. φ: the gap after the delay of the roll's profile. Then core and surface themselves."""
CORE, SURFACE = 4, 5
Told = tuple[Floats, Floats, Floats, Floats, Floats, Floats]
Deviations = Floats
"""Standard deviations (3, S, n) of cores, surfaces and centres, K."""


class Bands:
    """Variances of S strings of n cells, and what the parameters add to the variances of the readings of m sensors.

    Parameters
    ----------
    models : sequence of StringModel
    sensors : ndarray of int (S, m)
        0-based cells.
    fitted : ndarray of bool (S, m)
        Which columns of `sensors` are in use.

    Attributes
    ----------
    own : ndarray (S, n, 3, 3)
        Covariance of each cell's ln R_e, ln R_u, ln R_c about what is common to the cells.
    owned : bool
        Whether `own` is more than the models' tolerances for some string.
    lag : ndarray (S, n), K
        Difference core to surface after the delay of the profile within the roll.
    """

    def __init__(self, models: Sequence[StringModel], sensors: Ints, fitted: Bools) -> None:
        S, n = len(models), models[0].cells
        scattered = np.stack([scatter(m) for m in models], axis=1)
        self._tolerated, self._offset = scattered[:3], scattered[3][:, None]
        self.own, self.owned = as_tolerated(self._tolerated, n), False
        self._phi, self._phi_sd = np.array([[[x.value], [x.sd]] for x in map(centre_share, models)]).swapaxes(0, 1)
        self._weights = weights(self._tolerated, self._phi[:, 0], self._phi_sd[:, 0])
        self._alike = self._weights[0] if (self._weights == self._weights[0]).all() else None
        self.lag, self._tau, self._pace = np.zeros((S, n)), np.zeros((S, n)), np.ones((S, n))
        # of cores, surfaces, centres: part of the filter, the parameters and the thermocouples' offsets; of readings
        self._still = np.zeros((3, S, n))
        self._more, self._firm = np.zeros((2, *sensors.shape))  # with and without reversible heat
        self._over: tuple[Floats, Floats] | None = None
        self._places = (np.arange(S)[:, None] * n + sensors)[fitted]
        self._fitted = None if fitted.all() else fitted
        self._shape = S, n

    def differ(self, s: int, own: Floats | None) -> None:
        """Set the covariance of the cells of string `s`; None: the model's tolerances."""
        if own is not None or self.owned:
            tolerated = as_tolerated(self._tolerated, self._shape[1])[s]
            self.own, self.owned = self.own.copy(), True
            self.own[s] = tolerated if own is None else own

    def know(self, at: Ints, P: Floats, J: Floats, root: Floats, seen: Floats) -> None:
        """Update the filter's and the parameters' parts of the strings `at`; `seen`: sensitivities of readings."""
        self._still[:, at] = self._known(at, P, J, root)
        roots = chosen(root, at)
        self._more[at] = _squares(np.matmul(seen, roots))
        self._firm[at] = _squares(np.matmul(seen[..., :LOGARITHMS], roots[:, :LOGARITHMS]))

    def rest_on(self, flows: Flows, sensors: Ints, read: Bools) -> None:
        """Choose the base of the levers: the coolant, or the cell's own surface where `read` (S, m) is true.

        A cell's base is M T_s + m T_in, or its own surface. The surface's height over the base is linear in them.
        """
        n = self._shape[1]
        M, m = np.eye(n) - flows.M, flows.m.copy()
        row, col = read.nonzero()
        at = sensors[row, col]
        M[row, at], m[row, at] = 0.0, 0.0
        self._over = M, m

    def levers(self, x: Floats, inlet: Floats) -> Levers:
        """Return the levers of states `x` (S, M) under the measured `inlet` (S,)."""
        assert self._over is not None  # noqa: S101 - set before the first look
        N, (M, m) = 2 * self._shape[1], self._over
        levers = np.empty((6, *self._shape))
        levers[CORE : SURFACE + 1] = x[:, :N].reshape(*self._shape, 2).transpose(2, 0, 1)
        over = np.matmul(M, levers[SURFACE][:, :, None])[:, :, 0] - m * (inlet + x[:, -2])[:, None]
        levers[1], levers[3] = over, self.lag
        np.subtract(levers[CORE], levers[SURFACE], out=levers[2])
        np.add(levers[2], over, out=levers[0])
        return levers

    def pace(self, parameters: Sequence[StringParameters], dt: float) -> None:
        """Set the speed of the rolls' profiles for these parameters, in steps of `dt`."""
        R_c, C_c = (np.stack([getattr(p, name) for p in parameters]) for name in ("R_c", "C_c"))
        self._tau = time_constant(self._phi, R_c, C_c)
        self._pace = followed(dt, self._tau)

    def follow(self, levers: Levers) -> None:
        """Advance the profiles within the rolls by one step."""
        self.lag = levers[3] = levers[3] + self._pace * (levers[2] - levers[3])

    def rest(self, x: Floats, elapsed_s: float) -> None:
        """Advance the profiles by this time towards the states `x` (S, M)."""
        gap = self._gap(x)
        self.lag = gap + (self.lag - gap) * (1.0 - followed(elapsed_s, self._tau))

    def move(self, s: int, dx: Floats) -> None:
        """Move the profiles of string `s` with a correction (M,) of its states, as if it had always held."""
        self.lag[s] += self._gap(dx)

    def of_cells(self, levers: Levers, sd: Deviations, available: Bools | None) -> Told:
        """Return cores, surfaces and centres (S, n), each with its sd; NaN for strings that are not `available`."""
        core, surface = levers[CORE], levers[SURFACE]
        if available is not None:
            core, surface = np.where(available[:, None], levers[CORE:], np.nan)
        centre, centre_sd = hottest(core, surface, self.lag, self._phi, sd[2], sd[1])
        return core, sd[0], surface, sd[1], centre, centre_sd

    def told(self, levers: Levers, available: Bools | None) -> Deviations:
        """Return the standard deviations; infinite for strings that are not `available`."""
        return self._sds(self._still, levers, available)

    def now(self, P: Floats, J: Floats, root: Floats, levers: Levers, available: Bools) -> Deviations:
        """Return the standard deviations for other covariances and sensitivities of all strings; nothing changes."""
        return self._sds(self._known(np.arange(self._shape[0]), P, J, root), levers, available)

    def of_readings(self, sd: Floats) -> tuple[Floats, Floats]:
        """Add the parameters' part to the sd of readings (S, m): with and without reversible heat."""
        var = np.square(sd)
        return np.sqrt(var + self._more), np.sqrt(var + self._firm)

    def on_cells(self, values: Floats) -> Floats:
        """Give values (S, m) of the sensors to their cells (S, n); NaN for cells without one."""
        out = np.full(self._shape[0] * self._shape[1], np.nan)
        out[self._places] = values.ravel() if self._fitted is None else values[self._fitted]
        return out.reshape(self._shape)

    def unlike(self, levers: Levers) -> Unlike:
        """Return the scatter of the cells, for a forecast."""
        heat, cooling, inside = (np.sqrt(self.own[:, :, i, i]) for i in range(3))
        now = self._between(levers) + self._offset
        return Unlike(heat, cooling, inside, self._phi, self._phi_sd, np.zeros_like(self._phi), now)

    def snapshot(self) -> dict[str, Any]:
        """Return the last results, as numbers and lists."""
        return {"more": plain(self._more), "firm": plain(self._firm), "lag": plain(self.lag)}

    def restore(self, snapshot: dict[str, Any], P: Floats, J: Floats, root: Floats) -> None:
        """Restore a snapshot of as many strings of this length; states of older versions have no lag.

        Raises
        ------
        KeyError, TypeError, ValueError
            `snapshot` is not a snapshot of such bands.
        """
        self._more = like(snapshot["more"], self._more)
        self._firm = like(snapshot.get("firm", snapshot["more"]), self._firm)
        if "lag" in snapshot:
            self.lag = like(snapshot["lag"], self.lag)
        self._still = self._known(np.arange(self._shape[0]), P, J, root)

    def _known(self, at: Ints, P: Floats, J: Floats, root: Floats) -> Floats:
        """Variances (3, s, n) of cores, surfaces and centres of the strings `at`, without the scatter of the cells."""
        N, (phi, phi_sd, offset) = 2 * self._shape[1], (chosen(a, at) for a in (self._phi, self._phi_sd, self._offset))
        P, spread = chosen(P, at), np.matmul(J[:, :N], chosen(root, at))
        diagonal = np.einsum("sii->si", P)
        own = diagonal[:, 0:N:2], diagonal[:, 1:N:2]
        both = np.einsum("scc->sc", P[:, 0:N:2, 1:N:2]) + np.einsum("smp,smp->sm", spread[:, 0::2], spread[:, 1::2])
        core, surface = (var + _squares(spread[:, i::2]) for i, var in enumerate(own))
        var = np.stack([core, surface, of_centre(core, surface, both, phi, phi_sd)])
        return np.asarray(var + offset, dtype=np.float64)

    def _sds(self, still: Floats, levers: Levers, available: Bools | None) -> Deviations:
        sd = np.asarray(np.sqrt(self._between(levers) + still), dtype=np.float64)
        return sd if available is None else np.where(available[:, None], sd, np.inf)

    def _between(self, levers: Levers) -> Floats:
        """Variances (3, S, n) of cores, surfaces and centres from the scatter of the cells."""
        squares = np.square(levers[:CORE])
        if self.owned:
            return between_cells(levers, self.own, self._phi, self._phi_sd)
        if self._alike is not None:
            return np.asarray(np.matmul(self._alike, squares.reshape(CORE, -1)).reshape(3, *self._shape))
        return np.asarray(np.matmul(self._weights, squares.swapaxes(0, 1)).swapaxes(0, 1))

    def _gap(self, x: Floats) -> Floats:
        N = 2 * self._shape[1]
        return np.asarray(x[..., 0:N:2] - x[..., 1:N:2])


def _squares(a: Floats) -> Floats:
    """Sum the squares over the last axis; it is short, and numpy's reduction would be slow."""
    return np.asarray(np.einsum("smp,smp->sm", a, a), dtype=np.float64)
