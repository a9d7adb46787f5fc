"""What an observer foresees, held against the truth integrated on by itself, and the current that it permits."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.observe import AdaptiveObserver
from bms_gateway.observe.ahead import AT_ENDS, CENTRE, CORE, HORIZONS_S, PATH_S, SURFACE
from bms_gateway.observe.forecast_start import Coming, Profile
from bms_gateway.observe.outlook import Outlook
from tests.observe.rig import Drive, follow, model, truth, wander

CELLS, NOW, LOAD = 4, 900, 90.0
SENSORS = range(1, CELLS + 1)
KNOWN = {"R_e": 0.15, "R_c": 0.15, "R_u": 0.15}


def coming(S, **changes):
    none = np.zeros((S, CELLS))
    plain = Coming(np.full(S, np.nan), np.zeros((4, S)), none, none, none, none, np.zeros((S, 1)), np.ones(S))
    return replace(plain, **changes)


def currents():
    """A restless quarter of an hour, then ten minutes of a steady load."""
    first = np.repeat(np.random.default_rng(3).choice([0.0, 40.0, -70.0, 110.0], NOW // 20), 20)
    return np.concatenate((first, np.full(600, LOAD)))


@pytest.fixture(scope="module")
def followed():
    """The drive, the observer of right numbers and exact readings at its ninth hundred second, and its standing."""
    made = Drive.of(truth(CELLS, batch=(1,)), 10, 30.0, SENSORS, noise=0.0, current=currents())
    observer = AdaptiveObserver([model(CELLS, SENSORS)], 1.0)
    follow(observer, made, 0, NOW + 1)
    return made, observer, observer.standing()


def test_a_steady_load_ends_where_the_truth_does(followed) -> None:
    made, _, standing = followed
    T = Outlook().ahead(standing, coming(1)).under(np.array([LOAD**2]))
    at = NOW + PATH_S.astype(int)
    assert np.abs(T[CORE] - made.core[at]).max() < 0.05
    assert np.abs(T[SURFACE] - made.surface[at]).max() < 0.05
    assert (T[CENTRE] >= T[CORE]).all()


def test_a_profile_ends_where_the_truth_does_and_a_steady_one_as_the_load(followed) -> None:
    made, _, standing = followed
    rng, outlook = np.random.default_rng(5), Outlook()
    each = rng.choice([0.0, 60.0, 150.0], 60)
    later = Drive.of(
        truth(CELLS, batch=(1,)), 10, (made.core[NOW], made.surface[NOW]), SENSORS, current=np.repeat(each, 10)
    )
    inlet = np.full((60, 1), 25.0)
    ahead = outlook.under(standing, coming(1), Profile(each[:, None], each[:, None] ** 2, inlet))
    T = ahead.under(np.zeros(1))
    assert np.abs(T[CORE] - later.core[PATH_S.astype(int)]).max() < 0.05
    load = np.full((60, 1), LOAD)
    steady, plain = (
        outlook.under(standing, coming(1), Profile(load, load**2, inlet)),
        outlook.ahead(standing, coming(1, current=load[0])),
    )
    square = np.array([LOAD**2])
    # between the instants of the path the gap is taken for straight: 0.02 K of the lag
    assert np.allclose(steady.under(np.zeros(1)), plain.under(square), rtol=0.0, atol=0.03)
    assert np.allclose(steady.sd(np.zeros(1)), plain.sd(square), rtol=0.02)


def test_a_permitted_current_brings_the_truth_to_the_limit_and_no_further(followed) -> None:
    made, _, standing = followed
    limit = float(made.core[NOW].max()) + 12.0
    permitted = np.sqrt(Outlook().ahead(standing, coming(1)).permitted(limit, sds=0.0))[:, 0]
    assert (np.diff(permitted) <= 0.0).all()
    for current, seconds in zip(permitted, HORIZONS_S, strict=True):
        later = Drive.of(
            truth(CELLS, batch=(1,)),
            10,
            (made.core[NOW], made.surface[NOW]),
            SENSORS,
            current=np.full(int(seconds), current),
        )
        if seconds < 300:  # the profile within the roll has not followed yet: the centre is no further than half of it
            assert later.core.max() < limit
            continue
        gap = later.core[-1] - later.surface[-1]
        assert float((later.core[-1] + 0.5 * gap).max()) == pytest.approx(limit, abs=0.25)
    sure = np.sqrt(Outlook().ahead(standing, coming(1)).permitted(limit))[:, 0]
    assert (sure < permitted).all()
    assert (Outlook().ahead(standing, coming(1)).permitted(float(made.core[NOW].max()) - 5.0) == 0.0).all()


def test_the_cell_that_limits_the_current_is_the_hottest_of_the_truth_or_the_least_known(followed) -> None:
    made, _, standing = followed
    ahead = Outlook().ahead(standing, coming(1))
    limit = float(made.core[NOW].max()) + 12.0
    current = float(np.sqrt(ahead.permitted(limit, sds=0.0))[-1, 0])
    start = made.core[NOW], made.surface[NOW]
    later = Drive.of(truth(CELLS, batch=(1,)), 10, start, SENSORS, current=np.full(600, current))
    hottest = int((1.5 * later.core[-1] - 0.5 * later.surface[-1]).argmax())
    assert ahead.limiting(limit, sds=0.0).tolist() == [hottest]
    # one cell is known to 20 K only: its band is over a limit that all others keep
    for cell in range(CELLS):
        w = ahead.certainty.w.copy()
        w[..., cell] += 20.0**2
        wide = replace(ahead, certainty=replace(ahead.certainty, w=w))
        assert (wide.permitted(limit)[-1] == 0.0).all()
        assert wide.limiting(limit).tolist() == [cell]


def test_what_is_unknown_of_inlet_load_and_heat_widens_the_band_as_the_truth_moves(followed) -> None:
    made, _, standing = followed
    square, start = np.array([LOAD**2]), (made.core[NOW], made.surface[NOW])
    plain, sd = Outlook().ahead(standing, coming(1)), Outlook().ahead(standing, coming(1)).sd(square)

    def more(told):
        return np.sqrt(told[CORE, -1] ** 2 - sd[CORE, -1] ** 2)[0]

    def moved(**how):
        made = [
            Drive.of(truth(CELLS, batch=(1,)), 10, start, SENSORS, current=np.full(600, LOAD), **h) for h in ({}, how)
        ]
        return (made[1].core[-1] - made[0].core[-1])[0]

    by_inlet = Outlook().ahead(standing, coming(1, inlet_sd=np.ones((4, 1)))).sd(square)
    assert more(by_inlet) == pytest.approx(moved(inlet_error=1.0), rel=0.02)
    heat = np.zeros((1, CELLS))
    heat[0, 1] = 2.0
    by_heat = Outlook().ahead(standing, coming(1, heat_sd=heat))
    assert more(by_heat.sd(square))[1] == pytest.approx(moved(heat_error=heat)[1], rel=0.02)
    warmer = Outlook().ahead(standing, coming(1, heat=heat)).under(square) - plain.under(square)
    assert warmer[CORE, -1, 0] == pytest.approx(moved(heat_error=heat), abs=0.02)
    less = np.sqrt(LOAD**2 * 0.8)
    off = made.core[NOW + 600] - Drive.of(
        truth(CELLS, batch=(1,)), 10, start, SENSORS, current=np.full(600, less)
    ).core[-1]  # fmt: skip
    assert more(plain.sd(square, np.full((4, 1), 0.2 * LOAD**2))) == pytest.approx(off[0], rel=0.03)


def test_bands_hold_where_numbers_lie_within_what_the_model_says() -> None:
    # 80 strings: numbers 15 % off, heat and inlet that wander, sensors on the ends, noise
    S, rng = 80, np.random.default_rng(11)
    off = {k: np.exp(rng.normal(0.0, sd, (S, 1))) for k, sd in KNOWN.items()}
    own = {k: np.exp(rng.normal(0.0, 0.02, (S, CELLS))) for k in KNOWN}
    nominal = {"R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79}
    string = truth(CELLS, batch=(S,), **{k: nominal[k] * off[k] * own[k] for k in KNOWN})
    current, K = currents(), NOW + 600
    heat = wander(rng, K, 0.5, S)[:, :, None] + wander(rng, K, 0.15, S, CELLS)
    made = Drive.of(
        string, 10, 30.0, (1, CELLS), seed=2, current=current, heat_error=heat, inlet_error=wander(rng, K + 1, 0.5, S)
    )
    observer = AdaptiveObserver([model(CELLS, (1, CELLS), rel_sd=KNOWN)] * S, 1.0)
    follow(observer, made, 0, NOW + 1)
    square = np.full(S, LOAD**2)
    ahead = Outlook().ahead(observer.standing(), coming(S))
    T, sd = ahead.under(square)[:, AT_ENDS], ahead.sd(square)
    error = np.zeros(())
    for h, seconds in enumerate(HORIZONS_S):
        error = T[CORE, h] - made.core[NOW + int(seconds)]
        assert 0.9 <= (np.abs(error) <= 2.0 * sd[CORE, h]).mean() <= 0.995
    stays = made.core[NOW] - made.core[NOW + 600]
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(np.mean(stays**2))


def test_variances_of_a_short_time_ago_serve_and_new_parameters_are_followed(followed) -> None:
    _, observer, standing = followed
    outlook, square = Outlook(), np.array([LOAD**2])
    first = outlook.ahead(standing, coming(1))
    again = outlook.ahead(standing, coming(1), first.certainty)
    assert np.array_equal(first.under(square), again.under(square))
    assert np.array_equal(first.sd(square), again.sd(square))
    hotter = AdaptiveObserver([model(CELLS, SENSORS)], 1.0)
    hotter.restore(observer.snapshot())
    hotter.set_parameters(0, {"R_e": 4.2e-3}, ["R_e"], np.full((1, 1), 0.01))
    other = outlook.ahead(hotter.standing(), coming(1)).under(square)
    fresh = Outlook().ahead(hotter.standing(), coming(1)).under(square)
    assert np.allclose(other, fresh, rtol=0.0, atol=1e-9)
    assert (other[CORE, -1] > first.under(square)[CORE, -1] + 3.0).all()
