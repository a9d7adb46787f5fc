"""The heat balances of a string together with given inputs and parameters, for the solver in `trajectory`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bms_gateway.thermal.drive import Drive, Span, at_instants, average, between, cut
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.physics import Memory, Numbers, Physics


@dataclass(frozen=True, slots=True)
class System:
    r"""Balances :math:`\dot X = f(X)` of a driven string.

    Attributes
    ----------
    physics : Physics
    u : Drive
        Inputs over N intervals.
    v : Numbers
    memory : Memory
        From `Physics.memory` for `u` and `v`.
    spans : sequence of Span
        Stretches with one start each, which cover the intervals in order; none means one stretch.
    """

    physics: Physics
    u: Drive
    v: Numbers
    memory: Memory
    spans: Sequence[Span] = ()

    def cut(self, first: int, last: int) -> "System":
        """Intervals `first` to `last` (not included), as one stretch."""
        memory = {k: m[first:last] for k, m in self.memory.items()}
        return System(self.physics, cut(self.u, first, last), self.v, memory)

    def parts(self) -> Iterator[tuple[slice, "System"]]:
        """Yield each span by itself, with its rows of a trajectory: a span of k intervals has k + 1 of them."""
        row = 0
        for span in self.spans or (Span(0, self.u.N),):
            yield slice(row, row + len(span) + 1), self.cut(span.first, span.last)
            row += len(span) + 1

    def at_instants(self) -> "System":
        """Return the system of one stretch with the inputs at its N + 1 instants."""
        memory = {k: between(m) for k, m in self.memory.items()}
        return System(self.physics, at_instants(self.u), self.v, memory)

    def rates(self, X: Floats) -> Floats:
        """Rates of change (N, D) in 1/s at the states `X` (N, D)."""
        return self.physics.rates(X, self.u, self.v, self.memory)

    def readings(self, X: Floats) -> Floats:
        """Read thermocouples on all n cells (N, n), °C, at the states `X` (N, D)."""
        return self.physics.readings(X, self.u, self.v, self.memory)

    def linearised(self, X: Floats) -> Floats:
        """Jacobian (D, D), 1/s, at one state `X` (D,) under the mean inputs."""
        mean = {key: np.mean(m, axis=0, keepdims=True) for key, m in self.memory.items()}
        return self.physics.linearised(X, average(self.u), self.v, mean)
