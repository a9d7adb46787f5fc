"""A short of hundreds of watts within a cell: its band widens in the ticks in which it is seen, and narrows again."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.observe import AdaptiveObserver
from bms_gateway.observe.effect_observer import EffectObserver
from bms_gateway.observe.measured import Measured
from bms_gateway.thermal import AddedEffect
from tests.benchmarks.heat_case import CELLS, PACKS, SENSORS, Case, make, model, with_seeds
from tests.truth.string import TruthString, rk4

LAYOUTS = {"no other cell": (1, (1,), 1), "no other sensor": (12, (6,), 6), "other sensors": (12, (2, 6, 10), 6)}
AT = 600


def followed(case: Case, seeds: range, ticks: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    """Errors and standard deviations (seconds, strings) of the core of the case's cell."""
    made = make(with_seeds(case, seeds))
    observer = AdaptiveObserver([model(case.pack, case.cells, case.sensors)] * len(made), 1.0)
    I, inlet, y = (np.stack([getattr(x, k) for x in made]) for k in ("current", "inlet", "y"))  # noqa: E741
    age, k = np.zeros((len(made), case.cells)), case.cell - 1
    error, sd = np.zeros((2, case.seconds, len(made)))
    for t in range(case.seconds):
        e = observer.step(I[:, t] ** 2, None, inlet[:, t], y[:, t], age)
        error[t], sd[t] = [x.core[t, k] for x in made] - e.core[:, k], e.core_sd[:, k]
    return error, sd


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("watts", [100.0, 200.0])
@pytest.mark.plain_cases(2)
def test_the_core_of_a_shorted_cell_is_in_its_band_within_seconds(layout: str, watts: float) -> None:
    # Bug: the filter took the heat for an offset of the inlet by 60 K, and the core was 50 K too cold at 1 K.
    cells, sensors, cell = LAYOUTS[layout]
    case = Case("liquid", 0, AT + 120, "us06", "heat", cell, watts, AT, cells=cells, sensors=sensors)
    error, sd = followed(case, range(300, 303))
    inside = np.abs(error) <= 2.0 * sd
    assert inside[AT + 60 :].mean() >= 0.9
    assert inside[AT + 20 : AT + 60].mean() >= 0.9
    assert sd[AT + 60].mean() > 2.0 * sd[AT - 1].mean()
    assert np.abs(error[AT + 60]).max() < 12.0  # of 40 K and more by which the core has warmed


def test_what_is_over_narrows_the_band_again() -> None:
    case = Case("liquid", 0, AT, "us06", cells=1, sensors=(1,), cell=1)
    (made,) = make([case])
    made = replace(made, y=made.y.copy())
    made.y[300:320, 0] += np.sin(np.linspace(0.0, np.pi, 20)) * 3.0
    observer, plain = (AdaptiveObserver([model("liquid", 1, (1,))], 1.0) for _ in range(2))
    sound = make([case])[0].y
    widest = 0.0
    for t in range(AT):
        now = made.current[t : t + 1] ** 2, None, made.inlet[t : t + 1]
        sick, well = (o.step(*now, y[t][None], np.zeros((1, 1))) for o, y in ((observer, made.y), (plain, sound)))
        widest = max(widest, float(sick.core_sd[0, 0] / well.core_sd[0, 0]))
    assert widest > 5.0
    assert sick.core_sd[0, 0] < 0.25 * widest * well.core_sd[0, 0]


@pytest.mark.parametrize("pack", ["liquid", "small"])
def test_bands_of_sound_strings_are_those_of_a_filter_that_is_never_surprised(
    pack: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(pack, 0, 900, "us06", step=0.5)
    _, sd = followed(case, range(402, 405))
    monkeypatch.setattr("bms_gateway.observe.innovation_check.ODD", np.inf)
    _, never = followed(case, range(402, 405))
    assert np.mean(sd[300:]) == pytest.approx(np.mean(never[300:]), rel=0.02)


def test_a_restart_in_the_middle_of_a_short_changes_nothing() -> None:
    case = Case("liquid", 0, 400, "us06", "heat", 1, 100.0, 300, cells=1, sensors=(1,))
    (made,) = make([case])
    first, second = (AdaptiveObserver([model("liquid", 1, (1,))], 1.0) for _ in range(2))
    told: list[list[float]] = [[], []]
    for t in range(case.seconds):
        now = made.current[t : t + 1] ** 2, None, made.inlet[t : t + 1], made.y[t][None], np.zeros((1, 1))
        if t == 330:
            second.restore(first.snapshot())
        for o, kept in ((first, told[0]), (second, told[1])):
            if o is first or t >= 330:
                e = o.step(*now)
                kept.append([float(e.core[0, 0]), float(e.core_sd[0, 0])])
    assert told[0][330:] == told[1]


def test_a_string_with_effects_widens_too() -> None:
    case = Case("liquid", 0, 400, "us06", "heat", 1, 200.0, 300, cells=1, sensors=(1,))
    (made,) = make([case])
    effect = AddedEffect("resistance_temperature", None, {"B": 1500.0}, {"B": 500.0})
    observer = EffectObserver(replace(model("liquid", 1, (1,)), effects=(effect,)), 1.0)
    inside = []
    for t in range(case.seconds):
        i = float(made.current[t])
        e = observer.step(Measured(i, i * i, abs(i), inlet=float(made.inlet[t])), made.y[t], np.zeros(1))
        if t >= 330:
            inside.append(abs(float(e.core[0, 0] - made.core[t, 0])) <= 2.0 * float(e.core_sd[0, 0]))
    assert np.mean(inside) >= 0.9


def test_a_coarse_thermocouple_that_has_not_moved_yet_is_not_odd() -> None:
    """A pack that stands for minutes and then drives: readings of 1 K stand still while the surface warms."""
    steps: list[float] = []
    for offset in np.linspace(-0.45, 0.45, 7):
        observer = AdaptiveObserver([model("liquid", 1, (1,))], 1.0)
        truth = TruthString.of(1, **{k: PACKS["liquid"][k] for k in ("C_c", "C_s", "R_e", "R_c", "R_u")})
        current = np.where(np.arange(400) < 200, 0.0, 40.0)
        _, surface = rk4(truth, current, np.full(401, 25.0 + offset), 25.0 + offset)
        widest = 0.0
        for t in range(400):
            y = np.round(surface[t + 1][None])
            e = observer.step(current[t : t + 1] ** 2, None, np.array([25.0 + offset]), y, np.zeros((1, 1)))
            if t == 190:
                rested = float(e.core_sd[0, 0])
            widest = max(widest, float(e.core_sd[0, 0])) if t > 190 else 0.0
        steps.append(widest / rested)
    assert max(steps) < 2.0


def test_steps_of_the_readings_are_expected_of_their_innovations() -> None:
    squares = []
    for seed in (501, 502, 503):
        (made,) = make([Case("liquid", seed, 1200, step=1.0, hard=False)])
        observer = AdaptiveObserver([model("liquid", CELLS, SENSORS)], 1.0)
        of_case = []
        for t in range(1200):
            now = made.current[t : t + 1] ** 2, None, made.inlet[t : t + 1], made.y[t][None], np.zeros((1, CELLS))
            of_case.append(float(observer.step(*now).errors.mean_square()[0]))
        squares.append(np.mean(of_case[120:]))
    assert max(squares) < 2.0  # 4 is called a mismatch
