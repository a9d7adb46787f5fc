"""A physical effect: its parameters, its place in the balances, and the hooks by which it acts.

One effect is one file with one class. Its hooks are pure functions of arrays: the same hooks serve a whole record at
once (leading axis: intervals), the fit, the screening and one tick of the live observer. A hook gets the `Point`, the
values of the effect's parameters (SI) and `at`, the share of each cell that is affected: ones, or a single one for an
effect on one cell. It may put new arrays into the point, but must not change the arrays in it.

Hooks run in the order of the signal: `inputs`, `coefficients`, `heats`, `flux`, `surroundings`, `reading`. An effect
with a memory of the inputs (polarisation, delay) advances it in `follow`; an effect with its own thermal states (radial
modes, a slow thermocouple) states their number per cell and their start, and gives their rates in a hook.

Effects that Lin et al., Eq 1 and 16-18, leave out.
"""

from abc import ABC
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

Node = Literal["core", "surface", "coolant", "reading", "input"]
Place = Literal["string", "cell", "sensor", "gap"]
"""Place of an effect: everywhere, on one cell, on one thermocouple, or on the stream after one cell."""
HOOKS = ("inputs", "coefficients", "heats", "flux", "surroundings", "reading")
Values = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """One number of an effect.

    Attributes
    ----------
    name, description : str
    unit : str
        Shown to people; `to_si` times the shown number is SI.
    to_si : float
    prior, sd : float
        Centre (SI) and standard deviation before any data: SI, or of the logarithm if `log`. The Occam factor of an
        added effect depends on it.
    lower, upper : float
        SI. An estimate that ends at a bound is not accepted.
    log : bool
        Positive and known in per cent: fitted as its logarithm.
    probe : float
        SI: value of the screening; for a shape parameter its typical value.
    neutral : float or None
        SI: value at which the effect vanishes; None for a shape parameter.
    reach : float
        SI (or of the logarithm if `log`): limit of a linear step.
    least : float
        SI: no body has a smaller value (a conductance, a resistance or a share below zero). A fit may try such values,
        so that its estimate is not biased at the limit; a value that is certainly smaller excludes the effect.
    """

    name: str
    description: str
    unit: str
    to_si: float
    prior: float
    sd: float
    lower: float
    upper: float
    log: bool = False
    probe: float = 0.0
    neutral: float | None = 0.0
    reach: float = np.inf
    least: float = -np.inf


class Effect(ABC):
    """A physical effect that a string model may lack.

    Attributes
    ----------
    name : str
        Part of the contract: model files, commands and JSON use it.
    title, equation, signature, needs : str
        For people: name, added equation, visible sign, and what a record must contain to show it.
    node : {"core", "surface", "coolant", "reading", "input"}
        Balance concerned.
    place : {"string", "cell", "sensor", "gap"}
    parameters : tuple of EffectParameter
    confused_with : tuple of str
        Names of effects that look alike.
    signals : tuple of str
        Of "flow", "soc", "voltage": a record without them cannot have the effect.
    least_cells : int
        Least number of cells for the effect.
    one_sided : bool
        The neutral value of the first parameter is its physical limit.
    steep : bool
        The balances bend within a kelvin: sensitivities are computed interval by interval, exactly and slower.
    plausibility : float
        Prior log-odds on a bench cell: 0 if every cell has it, −1.5 common, −3 needs a special cause.
    states : int
        Number of its own thermal states per cell. They describe the distribution of temperature and store no heat.
    warms : {-1, 0, 1}
        Sign of the effect at its probe on a string on discharge that is warmer than inlet and surroundings, at a flow
        above the nominal one and an SOC below a half: 1 warms, -1 cools, 0 depends or neither.
    elsewhere : str
        An effect outside every catalogue with the same surfaces but another core: with this effect in a model, surfaces
        alone do not prove a core.
    constants : bool
        The law contains a constant of nature with energy or charge in its unit (R/F, Stefan-Boltzmann), so it cannot be
        tested in other units.

    See Also
    --------
    bms_gateway.thermal.properties.broken_properties : tests the properties of every effect in one call.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    equation: ClassVar[str]
    signature: ClassVar[str]
    needs: ClassVar[str] = ""
    node: ClassVar[Node]
    place: ClassVar[Place] = "string"
    parameters: ClassVar[tuple[EffectParameter, ...]]
    confused_with: ClassVar[tuple[str, ...]] = ()
    signals: ClassVar[tuple[str, ...]] = ()
    least_cells: ClassVar[int] = 1
    one_sided: ClassVar[bool] = False
    steep: ClassVar[bool] = False
    plausibility: ClassVar[float] = -3.0
    states: ClassVar[int] = 0
    warms: ClassVar[int] = 0
    constants: ClassVar[bool] = False
    elsewhere: ClassVar[str] = ""

    def starts(self, low: float, high: float) -> tuple[dict[str, float], ...]:
        """Start values of a fit, by parameter (SI); parameters that are not named start at their probe.

        Parameters
        ----------
        low, high : float, °C
            Range of the measured surfaces.
        """
        return ({},)

    def determined(self, u: Drive) -> tuple[str, ...]:
        """Names of the parameters that a record of this drive can determine.

        A fit leaves the others at their neutral value; if none can be determined, the effect is not offered.
        """
        return tuple(p.name for p in self.parameters)

    def follow(self, u: Drive, p: Values, carry: Floats | None) -> tuple[Floats, Floats] | None:
        """Advance the effect's memory of the inputs over the intervals of `u`.

        Parameters
        ----------
        u : Drive
            N intervals.
        p : mapping of str to float
        carry : ndarray or None
            Result of the last call; None at the start of a record.

        Returns
        -------
        memory : ndarray (N, k)
            Mean over each interval, which hooks find in `Point.memory[point.key]`.
        carry : ndarray
            For the next call. N calls of one interval give the same as one call of N.

        None for an effect without a memory.
        """
        return None

    def rest(self, T_c: Floats, T_s: Floats, p: Values) -> Floats:
        """Return the effect's own states in balance with core and surface: ndarray (…, n, states)."""
        return np.zeros((*np.shape(T_c), self.states))

    def inputs(self, z: Point, p: Values, at: Floats) -> None:
        """Change the inputs: current, coolant inlet."""

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Change resistances, capacities, coolant flow, film exponent."""

    def heats(self, z: Point, p: Values, at: Floats) -> None:
        """Change the heat made in the core, which is I²R_e when the hook runs."""

    def flux(self, z: Point, p: Values, at: Floats) -> None:
        """Change the flux core to surface, which is (T_c − T_s)/R_c when the hook runs; set the rates of own states."""

    def surroundings(self, z: Point, p: Values, at: Floats) -> None:
        """Add heat at the surface; coolant temperatures and film flux are known when the hook runs."""

    def reading(self, z: Point, p: Values, at: Floats) -> None:
        """Change what the thermocouple reads, which is T_s when the hook runs."""

    @classmethod
    def hooks(cls) -> tuple[str, ...]:
        """Names of the hooks that the class overrides, in the order of the signal."""
        return tuple(h for h in HOOKS if getattr(cls, h) is not getattr(Effect, h))

    @classmethod
    def parameter(cls, name: str) -> EffectParameter:
        """Return the parameter of that name; KeyError if there is none."""
        return {p.name: p for p in cls.parameters}[name]
