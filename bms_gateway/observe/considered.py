"""The numbers with which the observer of a string with effects works, and how they move the string.

Beyond Lin et al., whose observer treats its parameters as exact.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bms_gateway.observe.cell_scatter import exchanged, root, scatter
from bms_gateway.observe.tangent import ROW, Tangent, drive_of, jacobian
from bms_gateway.observe.uncertain import Uncertain, forcing, log_change, uncertain
from bms_gateway.thermal import Disturbance, Floats, Share, StringModel
from bms_gateway.thermal.centre import centre_share
from bms_gateway.thermal.physics import Memory, Numbers, Physics
from bms_gateway.thermal.system import System

BLOCK = 10
"""Steps whose inputs are summed before the sensitivities use them: far below the time constant of a core."""
STRAYED_K, STRAYED_FLOW, STRAYED_STEPS = 3.0, 0.03, 300
"""The Jacobian is renewed when a temperature, ln(flow) or the time is further than this from where it was taken.
Within, effects bend too little to change the covariances visibly. The mean does not depend on the Jacobian in a steady
state."""


@dataclass(slots=True)
class Considered:
    """Numbers of one string with effects.

    Attributes
    ----------
    model : StringModel
    physics : Physics
    uncertain : tuple of Uncertain
        The p numbers that are not known exactly.
    cov, root : ndarray (p, p)
        Their covariance, and a root of it.
    values : mapping of symbol to ndarray
        Numbers of the string itself, SI, at nominal flow.
    now : Numbers
        All numbers in force.
    scatter : ndarray (4,)
        Variances of the cells' scatter.
    centre : Share
        φ.
    """

    model: StringModel
    physics: Physics
    uncertain: tuple[Uncertain, ...]
    cov: Floats
    root: Floats
    values: dict[str, Floats]
    now: Numbers
    scatter: Floats
    centre: Share

    @classmethod
    def of(cls, model: StringModel) -> "Considered":
        """Take them from a model."""
        physics, (numbers, cov) = Physics(model), uncertain(model)
        values = {k: np.array(prior.value, np.float64) for k, prior in model.priors.items()}
        now = physics.numbers(values)
        return cls(model, physics, numbers, cov, root(cov), values, now, scatter(model), centre_share(model))

    def exchange(self, values: Mapping[str, float | Floats], names: Sequence[str], covariance: Floats) -> Floats:
        """Set other values of the string and a covariance of some numbers; return how far (p,) the numbers moved."""
        new = self.values | {k: np.array(x, np.float64) for k, x in values.items() if k in self.values}
        moved = log_change(self.values, new, self.uncertain)
        mine = [u.name for u in self.uncertain]
        given = [j for j, name in enumerate(names) if name in mine]
        cov = exchanged(self.cov, [mine.index(names[j]) for j in given], covariance[np.ix_(given, given)])
        self.take(new, cov)
        return moved

    def take(self, values: dict[str, Floats], cov: Floats) -> None:
        """Set these values of the string, and this covariance."""
        self.values, self.now = values, self.physics.numbers(values)
        self.cov, self.root = cov, root(cov)


@dataclass(slots=True)
class Forced:
    """How the rates of a string depend on its uncertain numbers; found anew for each block of steps.

    Attributes
    ----------
    F : ndarray (M, p)
        Slopes of the rates.
    rows, states : ndarray (k, …), (k, M)
        Inputs and states of the steps since the slopes were found.
    carries : mapping
        The effects' memories at that time; under the name of a number, the memories with this number moved.
    """

    F: Floats
    rows: Floats
    states: Floats
    carries: dict[str, dict[str, Floats]] = field(default_factory=dict)

    @classmethod
    def nothing(cls, states: int, numbers: int) -> "Forced":
        """Slopes of zero, for M states and p numbers."""
        return cls(np.zeros((states, numbers)), np.zeros((0, len(ROW))), np.zeros((0, states)))

    def begin(self) -> None:
        """Start with a string whose numbers have not moved it yet."""
        self.F, self.carries = np.zeros_like(self.F), {}
        self.drop()

    def drop(self) -> None:
        """Forget the steps that wait."""
        self.rows, self.states = self.rows[:0], self.states[:0]

    def add(self, row: Floats, z: Floats, of: Considered, dt: float) -> None:
        """Add a step; find the slopes when a block is full."""
        self.rows, self.states = np.vstack([self.rows, row]), np.vstack([self.states, z])
        if len(self.rows) == BLOCK:
            self.F = self.over(self.rows, self.states, of, dt)
            self.drop()

    def over(self, rows: Floats, states: Floats, of: Considered, dt: float) -> Floats:
        """Mean slope (M, p) over some steps; the memories with moved numbers are advanced."""
        F, moved = forcing(of.physics, of.now, of.uncertain, drive_of(rows, dt), states, self.carries)
        self.carries |= moved
        return F


@dataclass(slots=True)
class Linearised:
    """The Jacobian of a string and the point at which it was taken.

    Attributes
    ----------
    at : ndarray (M,)
        State.
    row : ndarray
        Inputs.
    memory : mapping
        Of the effects.
    age : int
        Steps since then.
    tangent : Tangent or None
        None if it must be taken anew.
    """

    at: Floats
    row: Floats
    memory: dict[str, Floats] = field(default_factory=dict)
    age: int = 0
    tangent: Tangent | None = None

    def strayed(self, z: Floats, flow: float, nodes: int) -> bool:
        """Count one more step; return whether the string (first `nodes` states: temperatures) is now too far off."""
        self.age += 1
        return (
            self.tangent is None
            or self.age > STRAYED_STEPS
            or bool(np.abs(z[:nodes] - self.at[:nodes]).max() > STRAYED_K)
            or bool(abs(np.log(flow / self.row[ROW.index("flow")])) > STRAYED_FLOW)
        )

    def move(self, z: Floats, row: Floats, memory: Memory) -> None:
        """Set another point."""
        self.at, self.row, self.memory, self.age = z, row, dict(memory), 0

    def take(self, of: Considered, dt: float, disturbance: Disturbance) -> Tangent:
        """Take the Jacobian at the point."""
        system = System(of.physics, drive_of(self.row[None], dt), of.now, self.memory)
        self.tangent = Tangent.of(jacobian(system, self.at, disturbance.correlation), dt, disturbance)
        return self.tangent


def slopes_of_readings(read: Floats, moved: Sequence[Floats], of: Considered) -> Floats:
    """Slopes (n, p) of readings (n,) by the uncertain numbers, from readings with each number moved by its step."""
    slopes = [(m - read) / u.step for m, u in zip(moved, of.uncertain, strict=True)]
    return np.reshape(slopes, (len(slopes), len(read))).T  # empty if every number is known exactly
