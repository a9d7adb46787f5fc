"""Where windows state the numbers that change with it: the entropic coefficient by the charge, R_e by its warmth.

A window states the coefficient at the mean charge of its ticks. Between this point and the next window's, and until
now, charge has moved, along which the coefficient has its slope. R_e is stated at the mean warmth of its heat.

Beyond Lin et al., Eq 1.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bms_gateway.identify.contract import Apart
from bms_gateway.identify.for_observer import APART, APART_SD
from bms_gateway.identify.ticks import Ticks
from bms_gateway.thermal import Floats
from bms_gateway.thermal.entropy import MOST

DRIFT = 0.3
"""Sd of a coefficient's change from one window to the next, in its own sd: no electrode's is a line over the charge,
and no R_e follows one law of Arrhenius at all temperatures."""
_LAST = np.arange(-len(APART), 0)


@dataclass(slots=True)
class EntropicCharge:
    """Charges moved by one string, as shares of its capacity, all counted from the same moment.

    Attributes
    ----------
    capacity_As : float
    moved : float
        Until the newest tick.
    asked, told, evidence : float
        At which the coefficient is stated by the window that is being fitted, by `mean`, and by the evidence.
    mean, cov : ndarray (k,), (k, k), or None
        Numbers from the newest fit, the effects `APART` last; None before the first.
    warmth : float
        At which R_e is stated among them (`thermal.warmth`).
    """

    capacity_As: float
    moved: float = 0.0
    asked: float = 0.0
    told: float = 0.0
    evidence: float = 0.0
    mean: Floats | None = field(default=None)
    cov: Floats | None = field(default=None)
    warmth: float = 0.0

    def add(self, current: float, dt: float) -> None:
        """Count one tick."""
        if current == current:
            self.moved += current * dt / self.capacity_As

    def take(self, ticks: Ticks) -> None:
        """Count regular ticks; the same as adding them one by one, to the last bit."""
        step = np.nan_to_num(ticks.current) * ticks.dt / self.capacity_As
        self.moved = float(np.cumsum(np.append(self.moved, step))[-1])

    def ask(self, current: Floats, dt: float) -> float:
        """Note a window with these currents that ends now; return how far it is from the evidence."""
        step = current * dt / self.capacity_As
        at = np.cumsum(step) - step / 2.0
        self.asked = self.moved - float(np.sum(step) - np.mean(at))
        return self.asked - self.evidence

    def answer(self, mean: Floats, cov: Floats, warmth: float, *, looked: bool) -> None:
        """Take the numbers of the window that was asked for; after a look, the evidence is not renewed."""
        self.told, self.mean, self.cov, self.warmth = self.asked, mean, cov, warmth
        if not looked:
            self.evidence = self.asked

    def numbers(self, names: tuple[str, ...], *, gain: bool) -> Apart | None:
        """Return what was found beside the parameters `names`, and whether a `gain` of heat is among it."""
        if self.mean is None or self.cov is None or not self.cov[-1, -1] > 0.0:
            return None
        kept = np.delete(np.arange(len(self.mean)), [] if gain else [len(names)])
        cov = self.cov[np.ix_(kept, kept)].copy()
        cov[_LAST, _LAST] += np.square(DRIFT * np.array(APART_SD))
        mine = (*names, *(("heat",) if gain else ()), *APART)
        return Apart(mine, self.mean[kept], cov, self.moved - self.told, self.warmth)

    def snapshot(self) -> dict[str, Any]:
        """Return it as JSON-able values."""
        found = {"at": [self.moved, self.asked, self.told, self.evidence]}
        if self.mean is None or self.cov is None:
            return found
        return {**found, "mean": self.mean.tolist(), "cov": self.cov.tolist(), "warmth": self.warmth}

    def restored(self, state: Mapping[str, Any] | None, numbers: int) -> "EntropicCharge":
        """Return one with the values of a snapshot for so many numbers; states of older versions have none.

        Raises
        ------
        ValueError
            It has another shape, or holds values that are not finite.
        """
        if state is None:
            return EntropicCharge(self.capacity_As)
        at = np.array(state["at"], np.float64)
        new = EntropicCharge(self.capacity_As, *at.tolist())
        if "mean" in state:
            new.mean, new.cov = (np.array(state[k], np.float64) for k in ("mean", "cov"))
            if new.mean.shape != (numbers,) or new.cov.shape != (numbers, numbers):
                raise ValueError("reversible heat: of another string")
            if not (np.isfinite(new.mean).all() and np.isfinite(new.cov).all()):
                raise ValueError("reversible heat: not finite")
            new.warmth = float(state["warmth"])
            if np.abs(new.mean[_LAST]).max() > MOST or not abs(new.warmth) < MOST:
                raise ValueError("reversible heat: of no electrode")
        if at.shape != (4,) or not np.isfinite(at).all():
            raise ValueError("charge: not finite")
        return new
