r"""Reversible heat of strings without effects: the entropy of the electrodes, at whatever state of charge they are.

Each core gains

.. math:: q = -I \, T_c \, (u_0 + u_1 \, s)

with u_0 and u_1 the entropic coefficient dU/dT and its slope, and s the charge moved since the point at which u_0
holds, as a share of the capacity. The heat follows the sign of the current, often for half an hour, so no noise
describes it: u_0 and u_1 are two more of the uncertain numbers (`sensitivity`), with a covariance from the start on and
a mean as soon as windows have found one.

Beyond Lin et al., Eq 1.
"""

from collections.abc import Mapping, Sequence
from math import isnan
from typing import Any, Final

import numpy as np

from bms_gateway.observe.stored import like, plain
from bms_gateway.thermal import Floats, StringModel
from bms_gateway.thermal.entropy import CAPACITY_AH, ENTROPIC, KELVIN, MOST, PER_MV, PRIOR_SD

FARTHEST: Final = 0.5
"""Charge over which the slope is followed: what is known of slopes is the difference between the middle and the ends.
It also bounds this heat where the capacity is not known."""


class Reversible:
    """Entropic coefficients of S strings, and the charge that they have moved.

    Parameters
    ----------
    models : sequence of StringModel
    dt : float, s

    Attributes
    ----------
    value : ndarray (S, 2), mV/K
        In the order of `ENTROPIC`.
    charge : ndarray (S,)
        Moved since the reference of `value`, as a share of the capacity, at most `FARTHEST`.
    """

    def __init__(self, models: Sequence[StringModel], dt: float) -> None:
        self.value, self.charge = np.zeros((len(models), 2)), np.zeros(len(models))
        self._half = dt / 7200.0 / np.array([m.capacity_Ah or CAPACITY_AH for m in models])
        self._current: Floats | None = None
        self._some = False

    def flow(self, current: Floats) -> None:
        """Take the mean current (S,), A, of the coming step, discharge positive; NaN: unknown, without this heat."""
        self._current = current

    def pass_step(self) -> Floats | None:
        """Count the charge of the step; return I and I s (S, 2) of it, A, or None if its current is not told."""
        current, self._current = self._current, None
        if current is None:
            return None
        if isnan(current.sum()):
            current = np.nan_to_num(current)
        half = current * self._half
        middle = self.charge + half
        amps = np.empty((len(current), 2))
        amps[:, 0], amps[:, 1] = current, current * middle
        self.charge = np.minimum(np.maximum(middle + half, -FARTHEST), FARTHEST)  # np.clip is slower
        return amps

    def added_to(self, heat: Floats, amps: Floats | None, core: Floats) -> Floats:
        """Add the mean of this heat to `heat` (S, n), W, of cores at `core` (S, n), °C."""
        return heat if amps is None or not self._some else heat + reversible(self.value, amps, core)

    def exchange(self, s: int, values: Mapping[str, Any], J: Floats) -> Floats:
        """Take new values of string `s`, with their own reference if `charge` is among them.

        Parameters
        ----------
        s : int
        values : mapping of str to float
            `ENTROPIC`, mV/K, and `charge`.
        J : ndarray (M, 2)
            Sensitivities of the string to its numbers; they are changed in place to those about the new reference.

        Returns
        -------
        ndarray (2,), mV/K
            How far the numbers about the new reference have moved.
        """
        charge = float(np.clip(values.get("charge", self.charge[s]), -FARTHEST, FARTHEST))
        shift = float(self.charge[s]) - charge
        J[:, 1] -= shift * J[:, 0]
        old = np.array([self.value[s, 0] + shift * self.value[s, 1], self.value[s, 1]])
        new = np.array([values.get(name, x) for name, x in zip(ENTROPIC, old.tolist(), strict=True)])
        self.value, self.charge = self.value.copy(), self.charge.copy()
        self.value[s], self.charge[s] = new, charge
        self._some = bool(self.value.any())
        return np.asarray(new - old)

    def snapshot(self) -> dict[str, Any]:
        """Return values and charges as lists of numbers."""
        return {"entropic": plain(self.value), "charge": plain(self.charge)}

    def restore(self, own: Mapping[str, Any]) -> None:
        """Restore a snapshot.

        Raises
        ------
        KeyError, TypeError, ValueError
            It has another shape, or holds values that are not numbers.
        """
        value, charge = like(own["entropic"], self.value), like(own["charge"], self.charge)
        if not ((np.abs(value) <= MOST).all() and (np.abs(charge) <= FARTHEST).all()):
            raise ValueError("reversible heat: holds values of no cell")
        self.value, self.charge, self._some = value, charge, bool(value.any())


def per_ampere(core: Floats) -> Floats:
    """Heat of cores at `core` (…, n), °C, per ampere and mV/K, W."""
    return np.asarray(-PER_MV * (core + KELVIN), dtype=np.float64)


def reversible(value: Floats, amps: Floats, core: Floats) -> Floats:
    """Heat (S, n), W, by coefficients (S, 2), mV/K, under `Reversible.pass_step`'s currents (S, 2)."""
    return np.asarray(per_ampere(core) * np.einsum("sk,sk->s", value, amps)[:, None], dtype=np.float64)


def completed(snapshot: Mapping[str, Any], strings: int, known: Floats) -> dict[str, Any]:
    """Complete an observer's snapshot by a version that knew no gain, no reversible heat or no warmth.

    Parameters
    ----------
    snapshot : mapping
    strings : int
    known : ndarray (p, p)
        Covariance of a string's numbers today.
    """
    numbers, prior = len(known), (*PRIOR_SD, float(known[-1, -1]) ** 0.5)
    nothing = np.zeros(strings).tolist()
    older = {"gain": np.ones(strings).tolist(), "B": nothing, "u_0": nothing, "charge": nothing}
    own = older | {"entropic": np.zeros((strings, 2)).tolist()} | snapshot["own"]
    cov = np.array(own["cov"], np.float64)
    more = numbers - cov.shape[-1]
    if more != (1 if "entropic" in snapshot["own"] else len(prior)):
        return {**snapshot, "own": own}
    # the numbers that it did not know come last
    whole = np.tile(np.diag(np.square([*np.zeros(numbers - more), *prior[-more:]])), (strings, 1, 1))
    whole[:, :-more, :-more] = cov
    own["cov"], own["J"] = whole.tolist(), _wider(own["J"], more)
    found = {**snapshot, "own": own}
    if snapshot.get("block") is not None:
        block = snapshot["block"]
        found["block"] = {"amps": np.zeros((strings, 2)).tolist(), **block, "J": _wider(block["J"], more)}
    return found


def _wider(J: Any, more: int) -> Any:
    a = np.array(J, np.float64)
    return np.concatenate((a, np.zeros((*a.shape[:2], more))), axis=2).tolist()
