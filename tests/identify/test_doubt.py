"""A fit that explains its surfaces by parameters that cannot be is neither believed nor kept to itself."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.errors import StateError
from bms_gateway.identify import Tick, WindowIdentifier
from bms_gateway.identify.doubt import DOUBTED, HOPELESS, hopeless, noise_factor
from bms_gateway.thermal import Prior, StringModel
from tests.identify.drive import drive, measured, model, ticks
from tests.truth.hidden import Scenario, make_log
from tests.truth.pack import NOMINAL
from tests.truth.string import TABLE_1

CELLS, SENSORS, MINUTES = 5, (1, 3, 5), 41
KNOWN = {"C_c": 0.05, "C_s": 0.05, "R_e": 0.6, "R_c": 0.6, "R_u": 0.6, "R_cc": 0.4, "C_f": 0.05}


def ticks_of(log, cells, sensors):
    """Ticks of a second from a log of the truth."""
    t = log.table
    for k in range(1, len(t["time_s"])):
        y = np.full(cells, np.nan)
        y[[c - 1 for c in sensors]] = [t[f"surface_{c}_C"][k] for c in sensors]
        amps = float(t["current_A"][k - 1])
        yield Tick(k * 10**9, 1.0, amps**2, np.nan, float(t["coolant_inlet_C"][k]), y, np.zeros(cells), amps)


def followed(effects, seed=7):
    """The identifier after a drive of the independent truth with something hidden, and the pack's own numbers."""
    log = make_log(
        Scenario(effects, CELLS, SENSORS, noise=0.05, step=0.1, cycle="urban", seed=seed, seconds=60 * MINUTES)
    )
    priors = {s: Prior(NOMINAL[s], sd) for s, sd in KNOWN.items()}
    identifier = WindowIdentifier(StringModel(CELLS, SENSORS, "full", priors))
    for tick in ticks_of(log, CELLS, SENSORS):
        job = identifier.add(tick)
        if job is not None:
            identifier.accept(job.run())
    return identifier, log.pack


def off(identifier, name, truth):
    """Error of a logarithm, and its sd."""
    p = identifier.posterior()
    i = p.names.index(name)
    return p.mean[i] - np.log(np.mean(truth)), float(np.sqrt(p.cov[i, i]))


@pytest.mark.parametrize("effect", ["surface_joule", "coolant_delay"])
@pytest.mark.plain_cases(1)
def test_a_strong_effect_that_is_missing_is_told_and_leaves_the_band_of_R_c_wide(effect):
    # Bug: R_c was "identified" 3 to 8 prior sd off, and the core 10 to 17 K off at a stated sd of 0.3 to 0.5 K.
    identifier, pack = followed({effect: ("strong", None)})
    error, sd = off(identifier, "R_c", pack["R_c"])
    print(f"{effect}: R_c {error:+.2f} ± {sd:.2f} of its logarithm")
    assert abs(error) < 2 * sd
    assert sd > 0.2
    (sentence,) = identifier.doubts()
    assert "do not fit parameters near those of the model file" in sentence


@pytest.mark.parametrize("effects", [{}, {"radial_gradient": ("medium", None)}, {"radial_gradient": (1.1, None)}])
@pytest.mark.plain_cases(1)
def test_a_sound_model_is_not_doubted_and_its_numbers_are_found(effects):
    # Bug: R_c of cells with two thirds of it in the roll was told 40 % low, or nothing was learnt of them.
    identifier, pack = followed(effects)
    assert identifier.doubts() == ()
    for name in ("R_e", "R_c", "R_u"):
        error, sd = off(identifier, name, pack[name])
        assert abs(error) < 2.5 * sd
        assert sd < 0.1


@pytest.mark.parametrize("gain", [0.8, 1.2])
def test_heat_from_a_voltage_that_is_off_by_a_fifth_is_found_to_be(gain):
    # Bug: heat from voltage was held for known to 3 %, and its error went into R_c and R_u with full confidence.
    square, inlet, y, _ = measured(8, minutes=61)
    rng = np.random.default_rng(8)
    priors = {"R_c": 1.266 * np.exp(0.3 * rng.normal()), "R_u": 0.79 * np.exp(0.3 * rng.normal())}
    identifier = WindowIdentifier(model(**priors))
    drive(identifier, ticks(square, inlet, y, heat=gain * square * TABLE_1["R_e"]))
    p = identifier.posterior()
    assert p.heat is not None
    sd = float(np.sqrt(p.heat.cov[-1]))
    assert abs(np.log(p.heat.value * gain)) < 2 * sd < 0.4
    for name in ("R_c", "R_u"):
        error, spread = off(identifier, name, TABLE_1[name])
        assert abs(error) < 2.5 * spread
    names, cov = p.with_heat()
    assert names[-1] == "heat"
    assert np.linalg.eigvalsh(cov).min() > -1e-9


def test_doubt_gain_and_carried_effects_outlive_a_restart():
    identifier, _ = followed({"surface_joule": ("strong", None)})
    stored = json.loads(json.dumps(identifier.snapshot()))
    priors = {s: Prior(NOMINAL[s], sd) for s, sd in KNOWN.items()}
    fresh = WindowIdentifier(StringModel(CELLS, SENSORS, "full", priors))
    fresh.restore(stored)
    assert fresh.doubts() == identifier.doubts() != ()
    assert fresh.snapshot() == stored
    del stored["names"][-1]  # of a version that carried fewer effects
    with pytest.raises(StateError, match="starting anew"):
        fresh.restore(stored)


@pytest.mark.parametrize(("size", "cell"), [("medium", 1), ("strong", 3), ("strong", 5)])
@pytest.mark.plain_cases(1)
def test_a_thermocouple_that_reads_too_much_is_found_and_leaves_R_c_as_it_is(size, cell):
    # Bug: an error of 1.8 K made all readings worthless to the windows, and one of 0.7 K could make cores 5 K too warm.
    identifier, pack = followed({"thermocouple_offset": (size, cell)})
    b = {"medium": 0.7, "strong": 1.8}[size]
    constant = identifier.posterior().constant
    assert constant[1] == constant[3] == 0.0  # cells without a thermocouple
    beside = constant[[k - 1 for k in SENSORS]].mean()  # what all read too much looks like warmer surroundings
    assert 0.5 < abs(constant[cell - 1] - beside) / (b * 2 / 3) < 1.3
    assert identifier.doubts() == ()
    for name in ("R_e", "R_c", "R_u"):
        error, sd = off(identifier, name, pack[name])
        assert abs(error) < 2.5 * sd
        assert sd < 0.1


@pytest.mark.parametrize("seed", range(20))
def test_the_noise_is_raised_as_little_as_keeps_every_judged_number_within_its_limit(seed):
    """Against least squares written out: data y = X b weighted by 1/f², a Gaussian known before, its minimiser."""
    rng = np.random.default_rng(seed)
    X, root = rng.normal(size=(40, 5)), rng.normal(size=(5, 5))
    y, known, before = X @ rng.normal(0, 3, 5), root @ root.T + np.eye(5), rng.normal(size=5)
    judged, limit = rng.normal(size=(3, 5)), rng.uniform(0.05, 0.5, 3)

    def off(factor):
        rows = np.vstack((X / factor, np.linalg.cholesky(known).T))
        right = np.concatenate((y / factor, np.linalg.cholesky(known).T @ before))
        return np.linalg.lstsq(rows, right, rcond=None)[0] - before

    factor = noise_factor(X.T @ X, known, off(1.0), judged, limit)
    assert factor > 1.0
    assert np.max(np.abs(judged @ off(factor)) / limit) <= 1.001
    assert np.max(np.abs(judged @ off(0.98 * factor)) / limit) > 1.0 or factor >= 99.0


def test_cells_that_differ_by_two_per_cent_are_no_error_of_the_model():
    # Bug: the fit of alike cells was looked at, and paid the difference in losses, 2.7 sd of them.
    log = make_log(
        Scenario({}, 12, (1, 6, 12), noise=0.05, step=0.1, cycle="udds", inlet="ramp", seed=317_002, seconds=3600)
    )
    priors = {s: Prior(NOMINAL[s], sd) for s, sd in (KNOWN | dict.fromkeys(("R_e", "R_c", "R_u"), 0.3)).items()}
    identifier, doubt = WindowIdentifier(StringModel(12, (1, 6, 12), "full", priors)), []
    for tick in ticks_of(log, 12, (1, 6, 12)):
        job = identifier.add(tick)
        if job is not None:
            fit = job.run()
            doubt.append(fit.doubt)
            identifier.accept(fit)
    assert len(doubt) == 3
    assert max(doubt) < 1.3


def test_a_hopeless_window_leaves_the_numbers_of_the_file_although_the_inlet_is_noisy():
    # Bug: what the inlet's noise adds to the squares was subtracted as before, from squares that no longer counted.
    square, inlet, y, _ = measured(8, minutes=11, noise=0.02, R_e=5.5 * TABLE_1["R_e"])
    inlet = inlet + np.random.default_rng(3).normal(0.0, 1.0, len(inlet))
    known = model(**TABLE_1)
    priors = {s: replace(p, rel_sd=min(p.rel_sd, 0.6)) for s, p in known.priors.items()}
    identifier, doubt = WindowIdentifier(replace(known, priors=priors)), []
    for tick in ticks(square, inlet, y):
        if (job := identifier.add(tick)) is not None:
            fit = job.run()
            doubt.append(fit.doubt)
            identifier.accept(fit)
    assert min(doubt) > HOPELESS
    for name, prior in priors.items():
        error, sd = off(identifier, name, prior.value)
        assert abs(error) < 0.01
        assert sd > 0.99 * np.sqrt(np.log1p(prior.rel_sd**2))


def test_a_window_teaches_less_and_less_from_doubted_to_hopeless():
    shares = [hopeless(f) for f in np.linspace(1.0, 10.0, 1000)]
    assert shares == sorted(shares)
    assert max(np.diff(shares)) < 0.01
    assert (hopeless(DOUBTED), hopeless(HOPELESS)) == (0.0, 1.0)
