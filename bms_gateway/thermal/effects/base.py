"""What a physical effect is: its parameters, where it stands in the balances, and the hooks by which it acts.

One effect is one file with one class. Its hooks are pure functions of arrays: the same ones serve a whole record at
once (leading axis: intervals), the fit, the screening and one tick of the live observer. A hook gets the `Point`, the
values of the effect's parameters (SI) and `at`, the share of each cell that is concerned: ones, or a single one for an
effect that sits on one cell. It may put new arrays into the point and must not write into the arrays it finds there.

Hooks run in the order of the signal: `inputs`, `coefficients`, `heats`, `flux`, `surroundings`, `reading`. An effect
with a memory of the inputs (polarisation, delay) says in `follow` how it runs on; one with thermal states of its own
(radial modes, a slow thermocouple) says how many per cell, how they start, and gives their rates in a hook.

What Lin et al., Eq 1 and 16-18, leave out.
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
"""Where an effect sits: everywhere, on one cell, on one thermocouple, or on the stream after one cell."""
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
        Centre (SI) and standard deviation of what is known before any data: SI, or of the logarithm where `log`.
        The Occam factor of an added effect lives on it.
    lower, upper : float
        SI. An estimate that ends on a bound is not believed.
    log : bool
        Positive and known in per cent: fitted in its logarithm.
    probe : float
        SI: the value at which the screening looks at the effect; for a shape parameter its typical value.
    neutral : float or None
        SI: the value at which the effect vanishes; None for a shape parameter.
    reach : float
        SI (or of the logarithm where `log`): farther than this a linear step in it means nothing.
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


class Effect(ABC):
    """A physical effect that a string model may lack.

    Attributes
    ----------
    name : str
        Part of the contract: model files, commands and JSON use it.
    title, equation, signature, needs : str
        For people: what it is, the equation added, how it shows, what a record must contain to show it.
    node : {"core", "surface", "coolant", "reading", "input"}
        Balance concerned.
    place : {"string", "cell", "sensor", "gap"}
    parameters : tuple of EffectParameter
    confused_with : tuple of str
        Names of effects that look alike.
    signals : tuple of str
        Of "flow", "soc", "voltage": without them in the record the effect is not offered.
    least_cells : int
        Strings shorter than this do not have it.
    one_sided : bool
        The first parameter has its neutral value as physical limit.
    steep : bool
        The balances bend within a kelvin: sensitivities are stepped interval by interval, exact and slower.
    plausibility : float
        Prior log-odds on a bench cell: 0 for what every cell has, −1.5 common, −3 needs a special cause.
    states : int
        Thermal states of its own per cell. They say how temperature is spread and store no heat.
    warms : {-1, 0, 1}
        What the effect at its probe does to a string on discharge that is warmer than inlet and surroundings, at a
        flow above the nominal one and an SOC below a half: 1 warms it, -1 cools it, 0 depends or neither.
    elsewhere : str
        What is in no catalogue and looks the same at every surface, but leaves another core: with this effect in a
        model, surfaces alone do not prove a core.
    constants : bool
        The law holds a constant of nature with energy or charge in its unit (R/F, Stefan-Boltzmann), so that it
        cannot be tried in other units.

    See Also
    --------
    bms_gateway.thermal.properties.broken_properties : what every effect must obey, by one call.
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
        """Values from which a fit should be tried, by parameter (SI); what is not named starts at its probe.

        Parameters
        ----------
        low, high : float, °C
            Range of the measured surfaces.
        """
        return ({},)

    def determined(self, u: Drive) -> tuple[str, ...]:
        """Names of the parameters that a record of this drive can tell at all.

        A fit leaves the others at their neutral value; with none left, the effect is not offered.
        """
        return tuple(p.name for p in self.parameters)

    def follow(self, u: Drive, p: Values, carry: Floats | None) -> tuple[Floats, Floats] | None:
        """Run the effect's memory of the inputs on over the intervals of `u`.

        Parameters
        ----------
        u : Drive
            N intervals.
        p : mapping of str to float
        carry : ndarray or None
            What the last call returned; None at the start of a record.

        Returns
        -------
        memory : ndarray (N, k)
            Mean over each interval, for the hooks to find in `Point.memory[point.key]`.
        carry : ndarray
            For the next call. N calls of one interval give the same as one call of N.

        Or None for an effect that remembers nothing.
        """
        return None

    def rest(self, T_c: Floats, T_s: Floats, p: Values) -> Floats:
        """Give the effect's own states in balance with core and surface: ndarray (…, n, states)."""
        return np.zeros((*np.shape(T_c), self.states))

    def inputs(self, z: Point, p: Values, at: Floats) -> None:
        """Change the inputs: current, coolant inlet."""

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Change resistances, capacities, coolant flow, film exponent."""

    def heats(self, z: Point, p: Values, at: Floats) -> None:
        """Change the heat made in the core, which is I²R_e when the hook runs."""

    def flux(self, z: Point, p: Values, at: Floats) -> None:
        """Change the flux core to surface, which is (T_c − T_s)/R_c when the hook runs; rates of own states."""

    def surroundings(self, z: Point, p: Values, at: Floats) -> None:
        """Bring heat to the surface; coolant temperatures and film flux are known when the hook runs."""

    def reading(self, z: Point, p: Values, at: Floats) -> None:
        """Change what the thermocouple reads, which is T_s when the hook runs."""

    @classmethod
    def hooks(cls) -> tuple[str, ...]:
        """Names of the hooks that the class overrides, in the order of the signal."""
        return tuple(h for h in HOOKS if getattr(cls, h) is not getattr(Effect, h))

    @classmethod
    def parameter(cls, name: str) -> EffectParameter:
        """Return the parameter of that name; KeyError where there is none."""
        return {p.name: p for p in cls.parameters}[name]
