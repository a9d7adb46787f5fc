"""What a forecast starts from: where strings stand by their observer, and what is known of the time ahead.

Beyond Lin et al., whose observer tells of now.
"""

from dataclasses import dataclass

from bms_gateway.observe.ahead import Unlike
from bms_gateway.observe.model import Bools, Ints
from bms_gateway.thermal import Disturbance, Floats, StringParameters


@dataclass(frozen=True, slots=True)
class Standing:
    """State of S strings as an observer holds it; nobody changes these arrays afterwards.

    Attributes
    ----------
    x, P, J : ndarray (S, M), (S, M, M), (S, M, p)
        Temperatures and offsets, their covariance with the numbers taken for true, sensitivities to these.
    root : ndarray (S, p, p)
        F with F Fᵀ the covariance of the numbers.
    parameters : tuple of StringParameters
        At nominal flow.
    level : ndarray of int (S,)
        Of the flow (`flow`).
    gain : ndarray (S,)
        Of heat that is given.
    inlet : ndarray (S,), °C
        Newest that was measured.
    lag : ndarray (S, n), K
        Difference core to surface as the profiles within the rolls have followed it.
    unlike : Unlike
    available : ndarray of bool (S,)
    disturbance : Disturbance
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


@dataclass(frozen=True, slots=True)
class Coming:
    """What is taken for the time ahead of S strings of n cells.

    Attributes
    ----------
    heat_per_square : ndarray (S,), W/A²
        Of a mean cell, where its voltage has told it; NaN for R_e.
    inlet_sd : ndarray (H, S), K
        By how much the inlet will be off that of now.
    heat, heat_sd : ndarray (S, n), W
        Of each cell that no current makes.
    shift, shift_sd : ndarray (S, n), K
        By how much cores are warmer than the observer holds, and how much less sure.
    doubt : ndarray (S, 1)
        Share of the difference core to surface that may be wrong beyond all else.
    current : ndarray (S,), A
        Mean of now; only its sign counts.
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
