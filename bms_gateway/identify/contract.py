"""Inputs and outputs of every identifier, so that the engine can choose one per string.

An identifier gets one `Tick` per second. Some update at once; the windowed one returns a `Job` when a window is full. A
job is a pure function of its own data: inline or on another thread, it gives the same `Result` to the last bit. The
engine returns the result by `accept` at a bus time that the engine chooses.

Every method takes the place of the recursive least squares of Lin et al. (Eq 5-10).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from typing import Any, Protocol

import numpy as np

from bms_gateway.identify.ticks import Ticks
from bms_gateway.thermal import CELL_SYMBOLS, KINDS, Floats, StringModel, StringParameters
from bms_gateway.thermal.warmth import WARMTH

LEARNING = "learning"
IDENTIFIED = "identified"
FIXED = "fixed"
FIXED_OFFLINE = f"{FIXED}: identified offline, with its effects"
FIXED_AT_COMMISSIONING = f"{FIXED}: its ratio to the other cells is that of the commissioning run"


def not_identifiable(why: str) -> str:
    """Status text of a parameter that the data do not determine."""
    return f"not identifiable: {why}"


@dataclass(frozen=True, slots=True)
class Tick:
    """Measurements of one tick for one string.

    Attributes
    ----------
    time_ns : int
        Bus time of the tick.
    dt : float
        Seconds since the previous tick; differs from the period after a gap.
    mean_square_current : float
        Mean of I² over the tick, A²; NaN without a current.
    heat : float
        Mean heat of one cell over the tick, W (mean over the cells), if it comes from voltage; NaN otherwise.
    inlet : float
        Coolant inlet at the tick, °C; NaN without a reading.
    surface : ndarray (n,)
        Surface readings, °C; NaN where there is no sensor or no reading.
    age : ndarray (n,)
        Tick time minus time stamp of the reading, s.
    current : float
        Mean over the tick, A, discharge positive; NaN without a current.
    """

    time_ns: int
    dt: float
    mean_square_current: float
    heat: float
    inlet: float
    surface: Floats
    age: Floats
    current: float = nan


@dataclass(frozen=True, slots=True)
class Estimate:
    """One parameter for output: `value` and `sd` in SI, `unit` as shown to people, `status` as text."""

    name: str
    value: float
    sd: float
    unit: str
    status: str


@dataclass(frozen=True, slots=True)
class Posterior:
    """Gaussian over natural logarithms of parameters common to the cells.

    Attributes
    ----------
    names : tuple of str
        Symbols, in the order of the arrays.
    mean : ndarray (p,)
        Natural logarithm of the SI value; of the geometric mean if the prior has one value per cell.
    cov : ndarray (p, p)
        Symmetric, positive semi-definite.
    heat : HeatGain or None
        Gain of heat from voltage, if the data contained such heat.
    apart : Apart or None
        The same for an observer that knows reversible heat and R_e of warm cores; None if none was found.
    constant : ndarray (n,) or None
        Constant error of each cell's thermocouple, K; None if none was sought.
    """

    names: tuple[str, ...]
    mean: Floats
    cov: Floats
    heat: "HeatGain | None" = None
    apart: "Apart | None" = None
    constant: Floats | None = None

    def as_constants(self, warmth: Sequence[tuple[float, float]]) -> "Posterior":
        """Widen R_e by how it changes with its core, for who takes it for a constant over some windows.

        Parameters
        ----------
        warmth : sequence of (float, float)
            Mean and sd of the cores' warmth in each of them.
        """
        if self.apart is None:
            return self
        B = self.apart.names.index(WARMTH)
        away = np.mean([sd**2 + (mean - self.apart.warmth) ** 2 for mean, sd in warmth])
        cov, at = self.cov.copy(), self.names.index("R_e")
        cov[at, at] += (self.apart.mean[B] ** 2 + self.apart.cov[B, B]) * away
        return replace(self, cov=cov)

    def with_heat(self) -> tuple[tuple[str, ...], Floats]:
        """Return names and covariance, with the gain as `heat` at the end if there is one."""
        if self.heat is None:
            return self.names, self.cov
        across = self.heat.cov[:-1, None]
        return (*self.names, "heat"), np.block([[self.cov, across], [across.T, self.heat.cov[-1:, None]]])

    def for_observer(self, model: StringModel) -> tuple[dict[str, float | Floats], tuple[str, ...], Floats]:
        """Values, names and covariance as the observer of a string takes them.

        Where the model has effects, its observer knows no others: what the windows found of them is then left in the
        parameters.
        """
        mine = self.apart if not model.effects else None
        k = len(self.names)
        numbers = string_parameters(model, self.names, self.mean if mine is None else mine.mean[:k])
        values: dict[str, float | Floats] = {name: getattr(numbers, name) for name in self.names}
        if self.heat is not None:
            values["heat"] = self.heat.value
        if mine is None:
            return values, *self.with_heat()
        beside = dict(zip(mine.names[k:], mine.mean[k:].tolist(), strict=True))
        if "heat" in beside:
            beside["heat"] = float(np.exp(beside["heat"]))
        return {**values, **beside, "charge": mine.charge, "u_0": mine.warmth}, mine.names, mine.cov


@dataclass(frozen=True, slots=True)
class Apart:
    """Parameters and, not included in them, reversible heat and how R_e follows its core.

    Attributes
    ----------
    names : tuple of str
        Those of the posterior, `heat` if there is a gain, then those of `for_observer.APART`.
    mean : ndarray (k,)
        Logarithms; mV/K of reversible heat; 1000 K of B (`thermal.warmth`).
    cov : ndarray (k, k)
    charge : float
        Moved until now since the charge at which the entropic coefficient is stated, as a share of the capacity.
    warmth : float
        At which R_e is stated.
    """

    names: tuple[str, ...]
    mean: Floats
    cov: Floats
    charge: float
    warmth: float


@dataclass(frozen=True, slots=True)
class HeatGain:
    """Factor between the heat from voltage and the heat of a cell.

    Attributes
    ----------
    value : float
    cov : ndarray (p + 1,)
        Covariance of its logarithm with those of the parameters, then its variance.
    """

    value: float
    cov: Floats


class Job(Protocol):
    """A pure piece of work; picklable."""

    def run(self) -> "Result":
        """Compute the result; the same job gives the same result."""
        ...


class Result(Protocol):
    """Result of a job; only its identifier uses the content."""


class Identifier(Protocol):
    """The methods that all identifiers share.

    Attributes
    ----------
    learns : bool
        Whether its estimates may change.
    """

    learns: bool

    def add(self, tick: Tick) -> Job | None:
        """Include one tick; return a job if there is heavy work to do."""
        ...

    def patience(self, dt: float) -> int:
        """Return how many regular ticks, `dt` s apart, `take` may combine before one must come by `add`."""
        ...

    def take(self, ticks: Ticks) -> None:
        """Include regular ticks that have waited, no more than `patience` allows."""
        ...

    def disbelieve(self, cell: int, seconds: float) -> None:
        """Forget the readings of a cell (0-based) in the last seconds, as far as they are kept: they were wrong."""
        ...

    def accept(self, result: Any) -> None:
        """Use the result of a job."""
        ...

    def posterior(self) -> Posterior:
        """Estimates and covariance for the observer."""
        ...

    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates for people and the bus."""
        ...

    def doubts(self) -> tuple[str, ...]:
        """Sentences on evidence against the cores."""
        ...

    def snapshot(self) -> dict[str, Any]:
        """State as JSON-able values."""
        ...

    def restore(self, state: Mapping[str, Any]) -> None:
        """Set the state from `snapshot`."""
        ...


def symbols(model: StringModel) -> tuple[str, ...]:
    """Parameters that the model's structure has."""
    more = (("R_cc",) if model.has_conduction else ()) + (("C_f",) if model.has_coolant_path else ())
    return CELL_SYMBOLS + more


def log_prior(model: StringModel) -> tuple[tuple[str, ...], Floats, Floats]:
    """Names, ln of the prior's (geometric mean) values and their sd."""
    names = symbols(model)
    mean = np.array([float(np.mean(np.log(model.priors[s].value))) for s in names])
    return names, mean, np.array([model.priors[s].rel_sd for s in names])


def estimates_of(posterior: Posterior, status: Sequence[str]) -> tuple[Estimate, ...]:
    """Estimates in SI: the median, and the sd of the log-normal to first order."""
    sd = np.sqrt(np.maximum(np.diag(posterior.cov), 0.0))
    return tuple(
        Estimate(name, float(np.exp(m)), float(np.exp(m) * s), KINDS[name].unit, text)
        for name, m, s, text in zip(posterior.names, posterior.mean, sd, status, strict=True)
    )


def string_parameters(model: StringModel, names: tuple[str, ...], ln: Floats) -> StringParameters:
    """Compute the parameters of a string from their logarithms; the ratios between cells are those of the prior.

    Parameters
    ----------
    model : StringModel
    names : tuple of str
        A subset of the model's symbols.
    ln : ndarray (p,)
    """
    values: dict[str, float | Floats] = {}
    for name, x in zip(names, ln, strict=True):
        prior = np.asarray(model.priors[name].value, dtype=np.float64)
        values[name] = np.exp(x + np.log(prior) - np.mean(np.log(prior)))
    return model.parameters(values)
