"""No identification: the model file's values, with their spread as its author stated it.

In place of Lin et al., Eq 5-10, where parameters are given (Table 1).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from bms_gateway.identify.contract import FIXED, Estimate, Posterior, Tick, estimates_of, log_prior
from bms_gateway.identify.ticks import ENDLESS, Ticks
from bms_gateway.thermal import StringModel


class FixedIdentifier:
    """The prior, for ever."""

    learns = False

    def __init__(self, model: StringModel, status: str = FIXED) -> None:
        names, mean, sd = log_prior(model)
        self._posterior = Posterior(names, mean, np.diag(sd**2))
        self._status = status

    def add(self, tick: Tick) -> None:
        """Learn nothing."""

    def patience(self, dt: float) -> int:  # noqa: ARG002 — the protocol
        """Return that nothing need ever come."""
        return ENDLESS

    def take(self, ticks: Ticks) -> None:
        """Learn nothing."""

    def accept(self, result: object) -> None:
        """Nothing is ever handed out, so nothing comes back."""

    def posterior(self) -> Posterior:
        """Return the prior."""
        return self._posterior

    def estimates(self) -> tuple[Estimate, ...]:
        """Return the prior's values, each with the one status."""
        return estimates_of(self._posterior, [self._status] * len(self._posterior.names))

    def doubts(self) -> tuple[str, ...]:
        """Nothing: this method does not judge the model."""
        return ()

    def snapshot(self) -> dict[str, Any]:
        """Return nothing to remember."""
        return {"method": "off"}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take nothing."""
