"""Beyond the paper: several cells' R_e from two surfaces, on Fig 10's string, with and without cell voltages.

The truth is the product's own simulation of a string whose R_u, R_c, C_c, C_s, C_f, R_cc, sensor offsets and slow
disturbances are drawn; the model knows their scatter only. Every line uses the product's fit (`identify`) and its
observer (`observe`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bms_gateway.identify.cell_prior import SPREAD, CellSettings
from bms_gateway.identify.resistance_by_cell import CellFit, CellRecord, Known, fit_cells, numbers_of
from bms_gateway.observe import AdaptiveObserver
from bms_gateway.sensors.paper import C_F, R_CC, TABLE_1
from bms_gateway.thermal import (
    Disturbance,
    Floats,
    Prior,
    StringModel,
    StringParameters,
    continuous,
    discretize,
    simulate,
)
from bms_gateway.thermal.cycles import urban_assault

FIG_10 = (3.5e-3, 4.3e-3, 4.3e-3, 4.3e-3, 3.5e-3)
"""R_e of the cells, Ω: those without a sensor have the greater resistance."""
SENSORS = (1, 5)
SECONDS = 89 * 60
SWING_K, COMMISSIONING_K, PERIOD_S = 5.0, 8.0, 300.0
"""Swing of the inlet, K: usual and deliberate. Without a swing, the common level of R_e is known half as well."""
REL_SD = {"C_c": 0.05, "C_s": 0.05, "R_e": 0.6, "R_c": 0.05, "R_u": 0.1, "R_cc": 0.2, "C_f": 0.05}
"""Scatter of the string's means."""
RATIO_SD = 0.03
WARM_UP = 600
"""Seconds after which the cores are compared."""


@dataclass(frozen=True, slots=True)
class Line:
    """One way of finding the cells' R_e.

    Attributes
    ----------
    what : str
    sensors : tuple of int
    fitted, alike : bool
        Whether R_e is identified; whether all cells are assumed to have the same R_e.
    joint_sd : float or None
        Error of a cell's electrical resistance; None: no cell voltages on the bus.
    limit_sd, limit_core_K : float or None
        Limits that must hold.
    swing_K : float
        Swing of the coolant inlet.
    """

    what: str
    sensors: tuple[int, ...] = SENSORS
    fitted: bool = True
    alike: bool = False
    joint_sd: float | None = None
    limit_sd: float | None = None
    limit_core_K: float | None = None
    swing_K: float = SWING_K


LINES = (
    Line("nominal R_e", fitted=False),
    Line("one R_e for all cells", alike=True),
    Line("R_e of each cell, surfaces {1,5} only"),
    Line("R_e of each cell, {1,5} and cell voltages, joints 3 %", joint_sd=0.03, limit_sd=0.05, limit_core_K=2.0),
    Line("R_e of each cell, {1,5} and cell voltages, joints 1 %", joint_sd=0.01, limit_sd=0.025, limit_core_K=1.5),
    Line(
        "R_e of each cell, all surfaces sensed (commissioning run)",
        sensors=(1, 2, 3, 4, 5),
        limit_sd=0.035,
        limit_core_K=0.6,
        swing_K=COMMISSIONING_K,
    ),
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of one line over all seeds.

    Attributes
    ----------
    line : Line
    R_e_sd, R_e_rms : float
        Stated and true relative error of the cells' R_e; NaN if R_e is not identified.
    coverage : float
        Share of cells whose R_e lies within 1.96 sd.
    core_rmse_K : float
        Error of the cores without a sensor; of all cores if all have one.
    fits : tuple of CellFit
        One per seed; empty if R_e is not identified.
    """

    line: Line
    R_e_sd: float
    R_e_rms: float
    coverage: float
    core_rmse_K: float
    fits: tuple[CellFit, ...]

    @property
    def kept(self) -> bool:
        """Whether the limits hold; true if there are none."""
        sd, core = self.line.limit_sd, self.line.limit_core_K
        return (sd is None or self.R_e_sd <= sd) and (core is None or self.core_rmse_K <= core)


@dataclass(frozen=True, slots=True)
class Packs:
    """The true strings: one per seed.

    Attributes
    ----------
    current : ndarray (K,)
    inlet : ndarray (K + 1,)
        As measured.
    core : ndarray (S, K, n)
    readings : ndarray (S, K, n)
        Surfaces with offset and noise.
    R_e : ndarray (n,)
    ratio : ndarray (S,)
    joints : ndarray (S, n)
        In units of their sd.
    """

    current: Floats
    inlet: Floats
    core: Floats
    readings: Floats
    R_e: Floats
    ratio: Floats
    joints: Floats


def few_sensors(seeds: int = 4) -> tuple[Outcome, ...]:
    """Run every line on the same strings.

    Parameters
    ----------
    seeds : int
        Strings.

    Returns
    -------
    tuple of Outcome
        In the order of `LINES`.

    Notes
    -----
    About 0.5 s of CPU per seed and fitted line, and 1 s per line for the observers. Pure: the same arguments give
    the same result.

    References
    ----------
    Lin et al., Fig 10 and 11 (cells of unequal R_e, sensors on 1 and 5); the paper leaves the question open.
    """
    packs = {swing: _packs(seeds, SECONDS, swing) for swing in {line.swing_K for line in LINES}}
    return tuple(_outcome(line, packs[line.swing_K]) for line in LINES)


def string_model(sensors: tuple[int, ...] = SENSORS) -> StringModel:
    """Give the model of the gateway: Table 1, with the scatter of the string's means as priors."""
    values = {**TABLE_1, "R_cc": R_CC, "C_f": C_F}
    return StringModel(len(FIG_10), sensors, "full", {s: Prior(v, REL_SD[s]) for s, v in values.items()}, coolant="ntu")


def _packs(seeds: int, seconds: int, swing: float) -> Packs:
    cycle = urban_assault(np.random.default_rng(0))
    current = np.tile(cycle, seconds // len(cycle) + 1)[:seconds]
    t = np.arange(seconds + 1.0) * 2.0 * np.pi / PERIOD_S
    # not a pure sine, so that it excites more frequencies
    inlet = 25.0 + swing * (0.8 * np.sin(t) + 0.2 * np.sin(2.7 * t + 1.0))
    n, R_e, d = len(FIG_10), np.array(FIG_10), Disturbance()
    core, readings, ratio, joints = [], [], [], []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 10])
        p = _drawn(rng, R_e)
        own = np.stack([_slow(rng, seconds, d.heat_cell, d) for _ in range(n)], axis=1)
        disturbed = own + _slow(rng, seconds, d.heat_common, d)[:, None]
        heat = np.outer(current**2, p.R_e) + (disturbed[1:] + disturbed[:-1]) / 2.0
        met = inlet + _slow(rng, seconds, d.inlet, d)
        x = simulate(discretize(continuous(p), 1.0), np.full(2 * n, 25.0), heat, met)[1:]
        offset = rng.normal(0.0, CellSettings().offset_sd, n)
        core.append(x[:, 0::2])
        readings.append(x[:, 1::2] + offset + rng.normal(0.0, d.sensor, (seconds, n)))
        ratio.append(np.exp(rng.normal(0.0, RATIO_SD)))
        joints.append(rng.normal(size=n))
    return Packs(current, inlet, np.array(core), np.array(readings), R_e, np.array(ratio), np.array(joints))


def _drawn(rng: np.random.Generator, R_e: Floats) -> StringParameters:
    """Draw a pack: string's mean about Table 1, cells about their mean."""
    n = len(R_e)
    together = {s: np.exp(REL_SD[s] * rng.normal()) for s in ("R_u", "R_c", "C_c", "C_s", "C_f", "R_cc")}
    cells = {s: TABLE_1[s] * together[s] * np.exp(SPREAD[s] * rng.normal(size=n)) for s in ("R_u", "R_c", "C_c")}
    return StringParameters.of(
        n,
        C_c=cells["C_c"],
        C_s=TABLE_1["C_s"] * together["C_s"],
        R_e=R_e,
        R_c=cells["R_c"],
        R_u=cells["R_u"],
        R_cc=R_CC * together["R_cc"],
        C_f=C_F * together["C_f"],
        coolant="ntu",
    )


def _slow(rng: np.random.Generator, steps: int, sd: float, d: Disturbance) -> Floats:
    """Ornstein–Uhlenbeck process (steps + 1,) at 1 s."""
    a = float(np.exp(-1.0 / d.correlation))
    kicks = rng.normal(0.0, sd * np.sqrt(1.0 - a * a), steps).tolist()
    out = [float(rng.normal(0.0, sd))]
    for kick in kicks:
        out.append(a * out[-1] + kick)
    return np.array(out)


def _outcome(line: Line, packs: Packs) -> Outcome:
    model = string_model(line.sensors)
    fits = tuple(_fit(line, model, packs, i) for i in range(len(packs.core))) if line.fitted else ()
    core = _observed(model, packs, fits)
    unread = [k for k in range(model.cells) if k + 1 not in line.sensors] or list(range(model.cells))
    rmse = float(np.sqrt(np.mean(np.square(core - packs.core)[:, WARM_UP:, unread])))
    if not fits:
        return Outcome(line, np.nan, np.nan, np.nan, rmse, fits)
    error = np.log(np.array([f.R_e for f in fits]) / packs.R_e)
    sd = np.array([f.rel_sd for f in fits])
    stated, true = (float(np.sqrt(np.mean(a**2))) for a in (sd, error))
    return Outcome(line, stated, true, float(np.mean(np.abs(error) < 1.96 * sd)), rmse, fits)


def _readings(packs: Packs, sensors: tuple[int, ...]) -> Floats:
    y = np.full(packs.readings.shape, np.nan)
    at = [k - 1 for k in sensors]
    y[:, :, at] = packs.readings[:, :, at]
    return y


def _fit(line: Line, model: StringModel, packs: Packs, i: int) -> CellFit:
    y = _readings(packs, line.sensors)[i]
    settings = CellSettings(ratio_sd=RATIO_SD, joint_sd=line.joint_sd or CellSettings().joint_sd)
    if line.alike:
        settings = CellSettings(spread={**SPREAD, "R_e": 1e-3})
    R_el = None
    if line.joint_sd is not None:
        R_el = packs.R_e / packs.ratio[i] / (1.0 + line.joint_sd * packs.joints[i])
    record = CellRecord(packs.current**2, packs.inlet, y, np.zeros_like(y))
    return fit_cells(model, record, known=Known(R_el), settings=settings)


def _observed(model: StringModel, packs: Packs, fits: Sequence[CellFit]) -> Floats:
    """Estimate the cores (S, K, n) by the adaptive observer with the parameters found."""
    strings, K, n = packs.core.shape
    observer = AdaptiveObserver([model] * strings, 1.0)
    for i, fit in enumerate(fits):
        found = numbers_of(model, fit)
        observer.set_parameters(i, found.values, found.names, found.common, found.own)
    y, nothing, age = _readings(packs, model.sensors), np.full((strings, n), np.nan), np.zeros((strings, n))
    out = np.empty((strings, K, n))
    for k in range(K):
        I2, inlet = np.full(strings, packs.current[k] ** 2), np.full(strings, packs.inlet[k + 1])
        out[:, k] = observer.step(I2, nothing, inlet, y[:, k], age).core
    return out
