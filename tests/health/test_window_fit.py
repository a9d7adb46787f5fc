"""One window against the independent integrator: R_e at 25 °C, R_u and offsets are inside their bands."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.health import window_fit
from bms_gateway.health.trend import Trend
from bms_gateway.health.window_fit import at_mean_charge, core_temperature, fit_window
from bms_gateway.thermal import StringParameters
from tests.benchmarks.health_life import CELLS, SENSORS, SOC_SLOPE, Life, drives_of
from tests.truth.pack import NOMINAL

SENSED = tuple(k - 1 for k in SENSORS)
STRING = StringParameters.of(CELLS, **NOMINAL, coolant="ntu")
GUESS = Trend(len(SENSED)).expected(1.0, 0.5)


def observed(life: Life, drives: int, B: float = 2500.0) -> list:
    return [fit_window(STRING, w, SENSED, GUESS, B) for w, _ in drives_of(life, 0, drives)]


def test_resistances_are_found_within_their_bands() -> None:
    """C_c and R_c of the truth are 4 and 5 % off; charge is taken off by what is known of it here."""
    seen = observed(Life(5), 16)
    off = np.array(
        [
            [o.mean[0] - SOC_SLOPE * (0.5 - o.soc), o.mean[1] + 0.5 * np.log(o.flow), o.mean[2] - np.log(0.95)]
            for o in seen
        ]
    )
    sd = np.array([np.sqrt(np.diag(o.cov))[:3] for o in seen])
    assert (np.abs(off) < 3.0 * np.hypot(sd, 0.03)).mean() > 0.95
    assert np.abs(off.mean(axis=0)).max() < 0.06


def test_cells_that_are_unlike_pass_for_no_other_scale_of_heat() -> None:
    """The last cell has 5 % less R_e than the first two: taken for alike, R_e was found 10 % low, R_u 10 % high.

    Heat, and resistance to it, are told apart by nothing but how surfaces differ along the string.
    """
    seen = observed(Life(8, exponent=3500.0), 16, 3500.0)
    off = np.array([[o.mean[0] - SOC_SLOPE * (0.5 - o.soc), o.mean[1] + 0.5 * np.log(o.flow)] for o in seen])
    weight = np.array([1.0 / (np.diag(o.cov)[:2] + 0.03**2) for o in seen])
    assert np.abs((weight * off).sum(axis=0) / weight.sum(axis=0)).max() < 0.06


def test_a_cell_alone_is_unlike_no_other(monkeypatch) -> None:
    w, _ = next(drives_of(Life(7), 0, 1))
    alone = replace(w, surface=w.surface[:, :1], age=w.age[:, :1])
    one = StringParameters.of(1, **{k: v for k, v in NOMINAL.items() if k not in ("R_cc", "C_f")})
    guess = Trend(1).expected(1.0, 0.5)
    seen = fit_window(one, alone, (0,), guess, 2500.0)
    monkeypatch.setattr(window_fit, "UNLIKE_SD", 1e-6)
    same = fit_window(one, alone, (0,), guess, 2500.0)
    assert same.mean == pytest.approx(seen.mean, abs=1e-9)
    assert same.cov == pytest.approx(seen.cov, rel=1e-6)


def test_a_cold_hard_drive_is_fitted_to_its_end(monkeypatch) -> None:
    """There R_e falls by a third as the core warms, and a fit that went to and fro was off by ten of its own sd."""
    windows = [w for w, _ in drives_of(Life(8, exponent=3500.0), 340, 350)]
    usual = [fit_window(STRING, w, SENSED, GUESS, 3500.0) for w in windows]
    monkeypatch.setattr(window_fit, "ROUNDS", 40)
    monkeypatch.setattr(window_fit, "SETTLED", 1e-8)
    for w, o in zip(windows, usual, strict=True):
        longer = fit_window(STRING, w, SENSED, GUESS, 3500.0)
        assert np.abs((o.mean - longer.mean) / np.sqrt(np.diag(o.cov))).max() < 0.1
        assert o.rms < 0.09  # the readings' noise is 0.1 K at most, means of four


def test_a_fit_that_is_cut_short_still_says_what_noise_it_saw(monkeypatch) -> None:
    w, _ = next(drives_of(Life(7), 0, 1))
    whole = fit_window(STRING, w, SENSED, GUESS, 2500.0)
    monkeypatch.setattr(window_fit, "ROUNDS", 3)
    monkeypatch.setattr(window_fit, "SETTLED", 0.0)
    short = fit_window(STRING, w, SENSED, GUESS, 2500.0)
    assert short.slow == whole.slow
    assert np.abs((short.mean - whole.mean) / np.sqrt(np.diag(whole.cov))).max() < 1.0


def test_a_drive_that_empties_the_cells_is_given_the_heat_of_one_charge() -> None:
    w, _ = next(drives_of(Life(7), 0, 1))
    K = len(w.square)
    current = np.repeat(np.linspace(2.0, 22.0, K), 4)  # in quarters of a tick, as a finer bus has it
    level = at_mean_charge(w, current, 8.0, 0.5)
    drawn = np.cumsum(current[::4]) * w.dt / 3600.0 / 8.0
    assert np.log(level.square / w.square) == pytest.approx(0.5 * (drawn - drawn.mean()), abs=1e-12)
    assert level.square[0] < w.square[0]  # full at first: less R_e than at the mean
    assert level.soc == w.soc


def test_growth_is_in_R_e_and_in_nothing_else() -> None:
    pairs = zip(observed(Life(6), 6), observed(Life(6, fault=("joint", 0, 0.2)), 6), strict=True)
    moved = np.array([b.mean - a.mean for a, b in pairs])
    assert moved[:, 0].mean() == pytest.approx(np.log(1.2), abs=0.03)
    assert np.abs(moved[:, 1:5].mean(axis=0)).max() < 0.06


def test_an_offset_of_a_thermocouple_is_in_its_own_place() -> None:
    pairs = zip(observed(Life(7), 4), observed(Life(7, fault=("thermocouple", -60, 2.0)), 4), strict=True)
    moved = np.array([b.mean - a.mean for a, b in pairs])
    assert moved[:, 5].mean() - moved[:, 6].mean() == pytest.approx(2.0, abs=0.3)
    assert np.abs(moved[:, 0]).mean() < 0.1


def test_what_an_error_of_the_exponent_does_is_told_for_all_that_a_window_finds() -> None:
    """Taken for its effect on R_e's mean alone, it stayed in the baseline made before B was known: growth 4 % off."""
    told, found, windows = [], [], drives_of(Life(10, exponent=3000.0), 0, 6)
    for w, _ in windows:
        at, low, high = (fit_window(STRING, w, SENSED, GUESS, B) for B in (3000.0, 2900.0, 3100.0))
        told.append(100.0 * at.by_B)
        found.append((high.mean - low.mean) / 2.0)
    off, size = np.abs(np.array(told) - found), np.abs(found)
    assert (np.median(off, axis=0) < 0.25 * np.median(size, axis=0) + 0.001).all()  # the odd window is curved
    assert size[:, 5:].max() > 0.05


def test_noise_of_the_inlet_s_readings_passes_for_no_other_casing_or_film() -> None:
    """What a casing answers to noise is not in its readings, and a slower casing answers to less of it: without what
    the fit adds for that, R_e is told 4.7 % low and R_u 3.6 % high here, most of it in drives that ramp."""
    windows, rng = [w for w, _ in drives_of(Life(107, exponent=3500.0), 0, 24)], np.random.default_rng(3)
    moved, weight = [], []
    for w in windows:
        noisier = replace(w, inlet=w.inlet + rng.normal(0.0, 0.12, len(w.inlet)))
        one, two = (fit_window(STRING, each, SENSED, GUESS, 3500.0) for each in (w, noisier))
        moved.append(two.mean - one.mean)
        weight.append(1.0 / (np.diag(one.cov) + 0.03**2))
    shift = np.average(np.array(moved), axis=0, weights=np.array(weight))
    assert np.abs(shift[:5]).max() < 0.015
    assert np.abs(shift[5:]).max() < 0.03


def test_readings_that_lack_and_a_bulk_coolant_are_no_matter() -> None:
    w, _ = next(drives_of(Life(8, flow_known=False), 0, 1))
    whole = fit_window(STRING, w, SENSED, GUESS, 2500.0)
    surface = w.surface.copy()
    surface[25:75] = np.nan
    surface[:8] = np.nan
    gaps = fit_window(replace(STRING, coolant="bulk"), replace(w, surface=surface), SENSED, GUESS, 2500.0)
    assert gaps.mean[:2] == pytest.approx(whole.mean[:2], abs=0.1)
    assert np.linalg.eigvalsh(gaps.cov)[0] > 0.0


def test_a_window_without_heat_says_nothing() -> None:
    w, _ = next(drives_of(Life(9), 0, 1))
    still = replace(w, square=np.zeros_like(w.square), surface=np.where(np.isnan(w.surface), np.nan, 20.0),
                    inlet=np.full_like(w.inlet, 20.0))  # fmt: skip
    seen = fit_window(STRING, still, SENSED, GUESS, 2500.0)
    assert seen.mean[0] == pytest.approx(GUESS[0], abs=0.05)
    assert np.sqrt(seen.cov[0, 0]) > 0.5


@pytest.mark.slow
def test_a_life_is_flagged_in_time_and_one_without_growth_is_not() -> None:
    """The benchmark in small: one life up to the first threshold, with a year's weather."""
    from tests.benchmarks.bench_health import IN_TIME, first_at, lived

    _, told, growth = lived(Life(41, 0.30 / 400), 160)
    found = first_at(told, "ageing", 1)
    assert found is not None
    assert abs(found - 0.10 * 400 / 0.30) <= IN_TIME
    assert {c.code for _, c in told} == {"ageing"}
    assert np.abs(growth - 0.30 / 400 * np.arange(160))[40:].max() < 0.04
    _, told, _ = lived(Life(41), 120)
    assert told == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "size", "cell", "told"),
    [
        ("loose", -0.3, 1, "no longer follows its cell"),
        ("inlet", 0.5, None, "check the inlet's sensor first"),
        ("inlet", -0.5, None, "check the inlet's sensor first"),
    ],
)
def test_a_loose_thermocouple_and_a_moved_inlet_sensor_are_told_in_a_life(fault, size, cell, told) -> None:
    from tests.benchmarks.bench_health import lived

    health, changes, _ = lived(Life(43, fault=(fault, 40, size)), 70)
    assert {c.code for _, c in changes} == {"thermocouple"}
    drive, first = changes[0]
    assert 40 <= drive <= 60
    assert first.cell == cell
    assert told in first.text
    assert abs(health.ageing.growth) < 0.06


@pytest.mark.parametrize(("B", "start", "tolerance"), [(0.0, 31.0, 1e-6), (3500.0, 5.0, 0.03)])
@pytest.mark.parametrize("ticks", [1, 4])
def test_the_core_follows_its_surface_and_heat_by_its_own_time_constant(B, start, tolerance, ticks) -> None:
    """Against steps of 0.08 s; a heat that fades as the core warms is that of the step's middle."""
    p = StringParameters.of(2, **NOMINAL)
    rng = np.random.default_rng(1)
    surface, square = 5.0 + rng.normal(size=300).cumsum() * 0.1, 6000.0 * rng.uniform(0.0, 2.0, 300)
    spread = 1.0 + np.resize([0.5, -0.5] if ticks > 1 else [0.0], 300 * ticks)  # within a step
    got = core_temperature(p, np.repeat(surface, ticks), np.repeat(square, ticks) * spread, B, start, 4.0 / ticks)
    tau, T, fine = float(p.R_c[0] * p.C_c[0]), start, []
    for k in range(300):  # surface and current are held over the step
        begun = T
        for _ in range(50):
            heat = float(p.R_e[0]) * square[k] * np.exp(B * (1.0 / (T + 273.15) - 1.0 / 298.15))
            T += (surface[k] + float(p.R_c[0]) * heat - T) * -np.expm1(-0.08 / tau)
        fine.append(0.5 * (begun + T))
    assert got == pytest.approx(np.repeat(fine, ticks), abs=tolerance)


def test_ticks_that_fill_no_last_step_and_starts_beyond_belief_are_borne() -> None:
    p, K = StringParameters.of(1, **NOMINAL), 1201
    got = core_temperature(p, np.full(K, 20.0), np.full(K, 3600.0), 3500.0, -300.0, 1.0)
    assert got.shape == (K,)
    assert np.isfinite(got).all()
    assert abs(got[-1] - got[-2]) < 0.2
