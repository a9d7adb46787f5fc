"""The methods that all observers of a gateway share, so that the engine can hold any of them.

In place of Lin et al., Fig 5, where there is one observer.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from bms_gateway.observe.estimate import Estimate
from bms_gateway.observe.forecast_start import Standing
from bms_gateway.thermal import Floats, StringParameters


class Observer(Protocol):
    """An observer of S strings with n cells each. Inputs differ, so each observer has a step method of its own."""

    @property
    def parameters(self) -> tuple[StringParameters, ...]:
        """Numbers of the strings at nominal flow."""
        ...

    @property
    def covariances(self) -> Floats:
        """Covariance (S, M, M) of the states of each string if its parameters were exact."""
        ...

    def estimate(self) -> Estimate:
        """Return the present state of the strings, with no innovation; nothing changes."""
        ...

    def standing(self) -> Standing:
        """Return all that a forecast starts from; nothing changes."""
        ...

    def set_parameters(
        self,
        s: int,
        values: Mapping[str, float | Floats],
        names: Sequence[str],
        covariance: Floats,
        own: Floats | None = None,
    ) -> None:
        """Take identified parameters of string `s` into use; see `AdaptiveObserver.set_parameters`."""
        ...

    def propagate(self, gap_s: float, inlet: Floats | None = None, *, unseen: bool = False) -> Estimate:
        """Carry all strings over a time without frames, s."""
        ...

    def propagate_unknown(self) -> None:
        """Carry all strings over a time of unknown length."""
        ...

    def snapshot(self) -> dict[str, Any]:
        """State as JSON-able values."""
        ...

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Set the state from `snapshot`."""
        ...
