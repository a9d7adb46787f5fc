"""No identification: the values of the model file, with the standard deviations stated there.

In place of Lin et al., Eq 5-10, where parameters are given (Table 1).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from bms_gateway.identify.contract import FIXED, Estimate, Posterior, Tick, estimates_of, log_prior
from bms_gateway.identify.ticks import ENDLESS, Ticks
from bms_gateway.thermal import StringModel


class FixedIdentifier:
    """Always returns the prior."""

    learns = False

    def __init__(self, model: StringModel, status: str = FIXED) -> None:
        names, mean, sd = log_prior(model)
        self._posterior = Posterior(names, mean, np.diag(sd**2))
        self._status = status

    def add(self, tick: Tick) -> None:
        """Learn nothing."""

    def disbelieve(self, cell: int, seconds: float) -> None:
        """Do nothing."""

    def patience(self, dt: float) -> int:  # noqa: ARG002 — the protocol
        """No tick is ever needed."""
        return ENDLESS

    def take(self, ticks: Ticks) -> None:
        """Learn nothing."""

    def accept(self, result: object) -> None:
        """Do nothing: no job was returned."""

    def posterior(self) -> Posterior:
        """Return the prior."""
        return self._posterior

    def estimates(self) -> tuple[Estimate, ...]:
        """Return the prior's values, all with the same status."""
        return estimates_of(self._posterior, [self._status] * len(self._posterior.names))

    def doubts(self) -> tuple[str, ...]:
        """Return no doubts: this method does not judge the model."""
        return ()

    def snapshot(self) -> dict[str, Any]:
        """Return an empty state."""
        return {"method": "off"}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Ignore the state."""
