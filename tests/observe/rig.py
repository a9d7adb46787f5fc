"""A bench for observers: strings of the truth simulator, their thermocouples, and the observer that follows them."""

from dataclasses import dataclass

import numpy as np

from bms_gateway.observe import AdaptiveObserver, Estimate
from bms_gateway.thermal import Prior, StringModel
from bms_gateway.thermal.parameters import DEFAULT_TOLERANCES
from tests.truth.cycle import repeated
from tests.truth.string import C_F, TABLE_1, TruthString, rk4

STRING = {**TABLE_1, "R_cc": 4.0, "C_f": C_F}


def model(cells=12, sensors=(1, 12), condition="full", rel_sd=None, tolerances=DEFAULT_TOLERANCES, **values):
    """A model with the right parameters, known exactly but for `rel_sd`."""
    sd = rel_sd or {}
    priors = {k: Prior(v, sd.get(k, 0.0)) for k, v in {**STRING, **values}.items()}
    return StringModel(cells, tuple(sensors), condition, priors, tolerances=tolerances)


def truth(cells=12, batch=(), **values):
    return TruthString.of(cells, batch=batch, **{"R_cc": 4.0, "C_f": C_F, **values})


def wander(rng, steps, sd, *shape, correlation=600.0):
    """A lasting error that wanders: stationary, of standard deviation `sd`; (steps, *shape)."""
    keep = np.exp(-1.0 / correlation)
    out = np.empty((steps, *shape))
    out[0] = rng.normal(0, sd, shape)
    for k in range(1, steps):
        out[k] = keep * out[k - 1] + np.sqrt(1 - keep**2) * sd * rng.normal(size=shape)
    return out


@dataclass
class Drive:
    """What is so and what is measured, (K + 1, S, n) or (K + 1, S); row 0 is the start."""

    core: np.ndarray
    surface: np.ndarray
    I2: np.ndarray
    inlet: np.ndarray
    y: np.ndarray

    @classmethod
    def of(
        cls,
        string,
        minutes,
        start,
        sensors,
        *,
        noise=0.1,
        seed=0,
        inlet=25.0,
        current=None,
        heat_error=0.0,
        inlet_error=0.0,
    ):
        rng = np.random.default_rng(seed)
        S, n = string.C_c.shape
        current = repeated(minutes) if current is None else current
        K = len(current)
        I2 = np.broadcast_to((current**2)[:, None], (K, S))
        heat = I2[:, :, None] * string.R_e + heat_error
        shown = np.broadcast_to(np.asarray(inlet, float), (K + 1, S))
        core, surface = rk4(string, np.zeros((K, S)), shown + inlet_error, start, heat=heat)
        y = np.full((K + 1, S, n), np.nan)
        at = np.array(sensors) - 1
        y[:, :, at] = surface[:, :, at] + rng.normal(0, noise, (K + 1, S, len(at)))
        return cls(core, surface, np.vstack((np.full((1, S), np.nan), I2)), shown.copy(), y)

    def __len__(self):
        return len(self.y)


def follow(observer: AdaptiveObserver, drive: Drive, start=0, stop=None, heat=None) -> list[Estimate]:
    """Step the observer through the drive's instants `start` … `stop`."""
    S, n = drive.y.shape[1:]
    none, now = np.full((S, n), np.nan), np.zeros((S, n))
    return [
        observer.step(drive.I2[k], none if heat is None else heat[k], drive.inlet[k], drive.y[k], now)
        for k in range(start, len(drive) if stop is None else stop)
    ]


def stacked(estimates, name):
    return np.stack([getattr(e, name) for e in estimates])
