"""What a stored state may hold at the most, number by number: the last value taken and the first refused."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from bms_gateway.engine.plausible import check_covariance, check_parameters, check_temperatures
from bms_gateway.errors import StateError
from bms_gateway.identify import Posterior
from bms_gateway.thermal import KINDS

NAMES = ("front", "rear")


@dataclass
class States:
    """As an observer tells them: two strings of three cells."""

    available: np.ndarray
    core: np.ndarray
    core_sd: np.ndarray
    surface: np.ndarray
    surface_sd: np.ndarray


def states(**changed: tuple[int, int, float]) -> States:
    made = States(np.array([True, True]), *(np.full((2, 3), v) for v in (30.0, 1.0, 28.0, 0.5)))
    for name, (string, cell, value) in changed.items():
        getattr(made, name)[string, cell] = value
    return made


@pytest.mark.parametrize("what", ["core", "surface"])
@pytest.mark.parametrize(("last", "first"), [(-60.0, -60.1), (200.0, 200.1)])
def test_temperatures_from_minus_60_to_200_are_taken(what: str, last: float, first: float) -> None:
    check_temperatures(NAMES, states(**{what: (1, 2, last)}))
    with pytest.raises(StateError, match=rf"rear: {what} of cell 3 is {first} °C; possible: -60 to 200 °C"):
        check_temperatures(NAMES, states(**{what: (1, 2, first)}))
    with pytest.raises(StateError, match=rf"front: {what} of cell 1 is nan"):
        check_temperatures(NAMES, states(**{what: (0, 0, math.nan)}))


@pytest.mark.parametrize("what", ["core", "surface"])
@pytest.mark.parametrize(("last", "first"), [(1e-9, 0.0), (200.0, 200.1)])
def test_bands_above_0_up_to_200_are_taken(what: str, last: float, first: float) -> None:
    check_temperatures(NAMES, states(**{f"{what}_sd": (0, 1, last)}))
    told = rf"front: {what} of cell 2 has a standard deviation of {first:.4g} K; possible: above 0, to 200 K"
    with pytest.raises(StateError, match=told):
        check_temperatures(NAMES, states(**{f"{what}_sd": (0, 1, first)}))


def test_nothing_is_asked_of_a_string_without_an_estimate() -> None:
    e = states(core=(1, 0, math.nan), core_sd=(1, 1, -1.0))
    e.available[1] = False
    check_temperatures(NAMES, e)


def test_a_covariance_is_symmetric_and_negative_in_no_direction_but_for_rounding() -> None:
    check_covariance("front", "temperatures", np.zeros((0, 0)))
    check_covariance("front", "temperatures", np.diag([0.0, 1.0]))
    for eps, good in ((0.9e-6, True), (1.1e-6, False)):
        skew, negative = np.diag([1.0, 2.0]), np.diag([-2.0 * eps, 2.0])
        skew[0, 1] = 2.0 * eps
        for P in (scale * P for scale in (0.01, 1.0, 100.0) for P in (skew, negative)):
            if good:
                check_covariance("front", "temperatures", P)
            else:
                with pytest.raises(StateError, match="front: the matrix of its temperatures is no covariance"):
                    check_covariance("front", "temperatures", P)
    for bad in (math.nan, math.inf):
        with pytest.raises(StateError, match="is no covariance"):
            check_covariance("front", "temperatures", np.array([[bad]]))


def posterior(ln: float, sd: float) -> Posterior:
    return Posterior(("R_e",), np.array([ln]), np.array([[sd * sd]]))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_parameter_may_lean_beyond_its_bound_by_a_factor_of_e_and_no_more(sign: int) -> None:
    bound = float(np.log(KINDS["R_e"].upper if sign > 0 else KINDS["R_e"].lower))
    check_parameters("rear", posterior(bound + sign, 0.1))
    with pytest.raises(StateError, match=r"rear: R_e is .* mOhm ± 10 %; possible: 0.01 to 1000 mOhm"):
        check_parameters("rear", posterior(bound + sign * 1.001, 0.1))


def test_a_parameter_known_to_no_better_than_a_factor_of_150_is_refused_with_its_value() -> None:
    middle = math.log(5e-3)
    check_parameters("rear", posterior(middle, 5.0))
    with pytest.raises(StateError, match=r"R_e is 5 mOhm ± 501 %"):
        check_parameters("rear", posterior(middle, 5.01))
    with pytest.raises(StateError, match="is no covariance"):
        check_parameters("rear", Posterior(("R_e",), np.array([middle]), np.array([[-1.0]])))
    with pytest.raises(StateError, match="R_e is nan"):
        check_parameters("rear", posterior(math.nan, 0.1))
