"""What a forecast starts from: the observer's present state of the strings, and the assumptions about the time ahead.

Beyond Lin et al., whose observer estimates only the present.
"""

from dataclasses import dataclass

import numpy as np

from bms_gateway.observe.ahead import Unlike
from bms_gateway.observe.model import Bools, Ints
from bms_gateway.thermal import Disturbance, Floats, StringParameters
from bms_gateway.thermal.warmth import resistance_factor


@dataclass(frozen=True, slots=True)
class Standing:
    """State of S strings as an observer holds it; these arrays are never changed.

    Attributes
    ----------
    x, P, J : ndarray (S, M), (S, M, M), (S, M, p)
        Temperatures and offsets; their covariance if the parameters were exact; sensitivities to the parameters.
    root : ndarray (S, p, p)
        F with F Fᵀ the covariance of the numbers.
    parameters : tuple of StringParameters
        At nominal flow.
    level : ndarray of int (S,)
        Level of the flow (`flow`).
    gain : ndarray (S,)
        Factor on measured heat.
    inlet : ndarray (S,), °C
        Newest measured value.
    lag : ndarray (S, n), K
        Difference core to surface after the delay of the profiles within the rolls.
    unlike : Unlike
    available : ndarray of bool (S,)
    disturbance : Disturbance
    entropic : ndarray (S, 2), mV/K
    charge : ndarray (S,)
        Coefficients of reversible heat, and the charge since their reference (`reversible`); 0 with effects.
    B, u_0 : ndarray (S,)
        With which R_e follows its core, 1000 K, and the warmth at which it is known (`thermal.warmth`).
    """

    x: Floats
    P: Floats
    J: Floats
    root: Floats
    parameters: tuple[StringParameters, ...]
    level: Ints
    gain: Floats
    inlet: Floats
    lag: Floats
    unlike: Unlike
    available: Bools
    disturbance: Disturbance
    entropic: Floats
    charge: Floats
    B: Floats
    u_0: Floats

    def by_warmth(self, core: Floats) -> Floats:
        """R_e of cores at `core` (S, n), °C, over R_e where it is known."""
        return resistance_factor(self.B[:, None], core, self.u_0[:, None])

    def amps(self, current: Floats) -> Floats:
        """Return I and I s (…, S, 2), A, of reversible heat under currents (…, S), as of `Reversible.pass_step`.

        In ten minutes the charge changes by little against what is known of the slope over it.
        """
        return np.stack((current, current * self.charge), axis=-1)


@dataclass(frozen=True, slots=True)
class Coming:
    """Assumptions about the time ahead of S strings of n cells.

    Attributes
    ----------
    heat_per_square : ndarray (S,), W/A²
        Heat of a mean cell by its voltage, where measured; NaN: R_e.
    inlet_sd : ndarray (H, S), K
        Standard deviation of the coming change of the inlet.
    heat, heat_sd : ndarray (S, n), W
        Heat of each cell that no current makes.
    shift, shift_sd : ndarray (S, n), K
        Amount by which cores are warmer than the observer's estimate, and its standard deviation.
    doubt : ndarray (S, 1)
        Share of the difference core to surface that may be wrong in addition.
    current : ndarray (S,), A
        Present mean; its reversible heat is kept, else only its sign counts.
    """

    heat_per_square: Floats
    inlet_sd: Floats
    heat: Floats
    heat_sd: Floats
    shift: Floats
    shift_sd: Floats
    doubt: Floats
    current: Floats


@dataclass(frozen=True, slots=True)
class Profile:
    """Means over steps of `ahead.STEP_S`: current, A, its square, A², and inlet, °C, (T, S) each."""

    current: Floats
    square: Floats
    inlet: Floats
