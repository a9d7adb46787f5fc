r"""Tests that can show a wrong core without a thermocouple in it, although the model explains the surface.

An error of the heat and an error of R_c or C_c can cancel in the surface. They do not cancel in other knowledge:

* each number has a plausible range, from the data sheet or from the properties of lithium-ion cells;
* R_c and the heat capacity follow from format and mass of the cell, if the model file states them;
* all numbers together: the strain :math:`\sum ((\theta - \mu)/s)^2` over the directions that the record has determined
  is a χ² with as many degrees of freedom;
* energy: energy that entered at the terminals and was not stored has become heat;
* activation: the overpotential falls with temperature as the heat does;
* the last part of the record is predicted from the first part;
* other records of the same cells under other cooling have the same physics.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from bms_gateway.diagnosis.core_band import core_bands
from bms_gateway.diagnosis.geometry import DOUBTED, odd_fitted
from bms_gateway.identify.coordinates import Coordinate, Measured
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.thermal import KINDS, Floats
from bms_gateway.thermal.drive import Drive, cut
from bms_gateway.thermal.effects import effect_named
from bms_gateway.thermal.entropy import KELVIN
from bms_gateway.thermal.physics import with_effect
from bms_gateway.thermal.warmth import REFERENCE

FAR = 2.5
"""Distance of a number from its data sheet, in sd of its prior, above which it is an alarm: one in eighty by chance."""
ACTIVATION = frozenset({"resistance_temperature.B", "charge_transfer.E"})
"""Numbers, K, whose prior in the catalogue is the plausible range of all lithium-ion chemistries."""
BEYOND = 2.0
"""Half width of a plausible range, sd."""
STRAINED = 0.05
"""The strain of all numbers together is an alarm if its probability is below this."""
DISAGREE = 0.05
"""Records disagree if the probability of the distances between each record and all together is below this."""
LEAST_MORE = 0.05
"""Share of a variance that the other records must have removed for a difference to be meaningful."""
ENERGY = 0.35
"""Tolerance between heat by temperature and by voltage: heat capacities are known to 10 %, the open-circuit voltage
under load to some millivolts, and both errors enter."""
HEARD = 10.0
"""The core by the voltage's heat is considered if this heat explains the surface worse by at most these log-odds."""
LOAD_S = 30.0
"""s: time constant of the part of the overpotential that is slower than a step but faster than the open-circuit
voltage."""
APART = 0.3
"""Least share of the current that is not correlated with the charge."""
WINDOW_S = 300.0
"""s: time over which losses are averaged before their slope over the temperature is taken."""


@dataclass(frozen=True, slots=True)
class Witness:
    """Statement of one witness.

    Attributes
    ----------
    name : str
    says : str
        One sentence.
    value, limit : float
        The figure, and the limit of an alarm.
    alarm : bool
        Whether it contradicts the core.
    """

    name: str
    says: str
    value: float
    limit: float
    alarm: bool


def witnesses(f: MapFit, records: Sequence[Measured], tail: tuple[float, float] | None) -> tuple[Witness, ...]:
    """Ask all witnesses about one fit.

    Parameters
    ----------
    f : MapFit
        The chosen model with its final numbers, on averaged records.
    records : sequence of Measured
        As given, not averaged.
    tail : float, float or None
        RMSE of the last part without and with the chosen effects, K; None if none is chosen.
    """
    found = [*implausible(f), *(Witness(f"format {o.name}", o.says, o.off, DOUBTED, True) for o in odd_fitted(f))]
    found.append(strain(f))
    if tail is not None:
        found.append(_tail(tail))
    for r, m in enumerate(records):
        if "voltage" in m.drive.known:
            found += [w for w in (energy(f, r, m), activation(f, r, m)) if w is not None]
    return tuple(found)


def implausible(f: MapFit) -> list[Witness]:
    """Numbers of a fit that are far from their declared or usual values; others are not named."""
    found = []
    for c, z in zip(f.problem.coordinates, f.theta.tolist(), strict=True):
        if c.name in ACTIVATION:
            p = effect_named(c.name.partition(".")[0]).parameter(c.name.rpartition(".")[2])
            off = (z - p.prior) / p.sd
            text = f"{c.name} = {z:.0f} K is not plausible: usual are {p.prior:.0f} ± {p.sd:.0f} K (1 sd)"
            limit = BEYOND
        elif c.effect is None or c.name.startswith("current_offset"):
            off, limit = (z - c.prior) / c.sd, FAR
            text = _far(c, z)
        else:
            continue
        if abs(off) > limit:
            found.append(Witness(f"number {c.name}", text + ".", abs(off), limit, True))
    return found


def _far(c: Coordinate, z: float) -> str:
    symbol = c.name.split("@")[0]
    if symbol in KINDS:
        change = 100.0 * np.expm1(z - c.prior)
        return f"{symbol} ends {change:+.0f} % off what is declared ({100.0 * c.sd:.0f} % tolerance)"
    if c.effect is not None:
        return f"{c.name} = {z:.2f} A is more than a current sensor's offset ({c.sd:.2g} A)"
    what = "the core starts" if c.name.startswith("T_c0") else "the surface starts"
    return f"{what} {z:+.1f} K off ({c.sd:.1f} K are usual after a rest)"


def strain(f: MapFit) -> Witness:
    """All numbers together: the probability of their distance from their priors."""
    square, freedom = strain_of(f)
    p = float(chdtrc(max(freedom, 1), square))
    text = (
        f"All numbers together lie {np.sqrt(square):.1f} sd from what was known of them "
        f"({freedom} directions, p = {p:.2g})"
    )
    return Witness("strain", text + ".", p, STRAINED, p < STRAINED)


def strain_of(f: MapFit) -> tuple[float, int]:
    """Squared distance of all numbers of a fit from their priors, and its degrees of freedom."""
    keep = [i for i, c in enumerate(f.problem.coordinates) if c.record is None or not c.name.startswith("T_")]
    prior, sd = (np.array([getattr(f.problem.coordinates[i], k) for i in keep]) for k in ("prior", "sd"))
    u = (f.theta[keep] - prior) / sd
    posterior = f.covariance[np.ix_(keep, keep)] / np.outer(sd, sd)
    # directions that the record has determined: their posterior variance is below half of the prior variance
    value, axes = np.linalg.eigh(posterior)
    known = np.clip(1.0 - value, 0.0, 1.0)
    # if the prior is right, the variance of the estimate is the prior's variance less the posterior's
    return float(np.sum((axes.T @ u)[known > 0.5] ** 2 / known[known > 0.5])), int(np.sum(known > 0.5))


def agreement(joint: MapFit, alone: Sequence[MapFit]) -> tuple[Witness, ...]:
    r"""Whether each record alone agrees with all records together, in the numbers that they share.

    A record alone determines them with covariance :math:`C_i`, all together with :math:`C`; for the same physics, the
    difference of the two estimates has the covariance :math:`C_i - C` (Hausman, Specification tests in econometrics,
    1978).

    Parameters
    ----------
    joint : MapFit
    alone : sequence of MapFit
        Of the same model, one per record.
    """
    names = [c.name for c in joint.problem.coordinates if c.record is None]
    limit = DISAGREE / len(alone)
    found = []
    for one in alone:
        i, j = ([f.problem.index(n) for n in names] for f in (one, joint))
        apart = one.theta[i] - joint.theta[j]
        spread = one.covariance[np.ix_(i, i)]
        scale = np.sqrt(np.diag(spread))
        more = (spread - joint.covariance[np.ix_(j, j)]) / np.outer(scale, scale)
        value, axes = np.linalg.eigh(more)
        told = value > LEAST_MORE
        square = float(np.sum((axes.T @ (apart / scale))[told] ** 2 / value[told]))
        p = float(chdtrc(max(int(told.sum()), 1), square))
        z = np.abs(apart) / (scale * np.sqrt(np.maximum(np.diag(more), LEAST_MORE)))
        said = ", ".join(_compared(joint.problem.coordinates[j[k]], apart[k], z[k]) for k in np.argsort(-z)[:2])
        source = one.problem.records[0].source
        text = f"Alone, {source} asks for other numbers than all records together: {said} (all numbers: p = {p:.2g})"
        if p >= limit:
            text = f"Alone, {source} asks for the same numbers as all records together (p = {p:.2g})"
        found.append(Witness(f"records: {source}", text + ".", p, limit, p < limit))
    return tuple(found)


def _compared(c: Coordinate, apart: float, z: float) -> str:
    p = None if c.effect is None else effect_named(c.effect.partition(":")[0]).parameter(c.name.rpartition(".")[2])
    if p is None or p.log:
        return f"{c.name} {100.0 * np.expm1(apart):+.0f} % ({z:.1f} sd)"
    return f"{c.name} {apart / p.to_si:+.3g} {p.unit} ({z:.1f} sd)"


def _tail(tail: tuple[float, float]) -> Witness:
    ratio = tail[1] / max(tail[0], 1e-9)
    text = f"Fitted to the first 60 %, the error in the rest is {tail[1]:.2g} K, without the effects {tail[0]:.2g} K"
    return Witness("tail", text + ".", ratio, float(np.sqrt(0.5)), ratio > np.sqrt(0.5))


def heats(f: MapFit, r: int) -> Floats:
    """Irreversible heat (N, n), W, along a fitted trajectory; the reversible part cancels over a charge cycle."""
    problem = f.problem
    v, _ = problem.numbers(r, f.theta)
    for e in problem.model.effects:
        if e.name == "entropic_heat":
            v = with_effect(v, e.key, dict.fromkeys(e.values, 0.0))
    m = problem.records[r]
    memory, _ = problem.physics.memory(m.drive, v)
    parts, row = [], 0
    for span in m.spans:
        X = f.prediction.X[r][row : row + len(span) + 1]
        row += len(span) + 1
        at = slice(span.first, span.last)
        z = problem.physics.point(
            (X[1:] + X[:-1]) / 2.0, cut(m.drive, at.start, at.stop), v, {k: a[at] for k, a in memory.items()}
        )
        parts.append(z.core + np.zeros_like(z.T_c))
    return np.concatenate(parts)


def electric_heat(u: Drive) -> Floats | None:
    """Heat (N,) of one cell by its voltage, W: current times the gap from the open-circuit voltage.

    The open-circuit voltage is the part of the voltage that follows the charge, besides the parts that follow the
    current at once and within half a minute. None if the voltage is unknown over half of the record, or if the current
    hardly differs from its trend: a discharge at one current does not separate the two.
    """
    known = np.isfinite(u.V) & np.isfinite(u.IV)
    if known.mean() < 0.5:
        return None
    from scipy.signal import lfilter  # slow to load: only records with a voltage need it

    charge = np.cumsum(u.I) * u.dt / 3600.0
    a = float(np.exp(-u.dt / LOAD_S))
    slow = lfilter([1.0 - a], [1.0, -a], u.I)
    columns = np.stack([np.ones(u.N), charge, charge**2, -u.I, -slow], axis=1)
    steady = known & (np.abs(u.I2 - u.I**2) <= 1.0)
    rows = steady if steady.sum() > 10 * columns.shape[1] else known
    own = u.I[rows] - columns[rows, :3] @ np.linalg.lstsq(columns[rows, :3], u.I[rows], rcond=None)[0]
    if np.sqrt(np.mean(own**2)) < APART * np.sqrt(np.mean(u.I2[rows])):
        return None
    k = np.linalg.lstsq(columns[rows], u.V[rows], rcond=None)[0]
    return np.asarray(np.where(known, u.I * (columns[:, :3] @ k[:3]) - u.IV, np.nan))


def energy(f: MapFit, r: int, m: Measured) -> Witness | None:
    """Compare the energy that became heat by temperature and by voltage."""
    q = electric_heat(m.drive)
    if q is None:
        return None
    known = np.isfinite(q)
    square = float(np.sum(m.drive.I2[known]))
    by_voltage = float(np.sum(q[known])) / square
    thermal = heats(f, r).mean(axis=1)
    by_temperature = float(np.sum(thermal) / np.sum(f.problem.records[r].drive.I2))
    off = by_temperature / by_voltage - 1.0
    text = (
        f"The temperatures ask for {1e3 * by_temperature:.1f} mΩ of losses, the voltage for {1e3 * by_voltage:.1f} mΩ "
        f"({100.0 * off:+.0f} %)"
    )
    return Witness("voltage energy", text + ".", abs(off), ENERGY, abs(off) > ENERGY or by_voltage <= 0.0)


def by_voltage(f: MapFit, other: MapFit, r: int, odds: float) -> Witness:
    """Compare the cores of one record with those of a model with the voltage's heat.

    Parameters
    ----------
    f, other : MapFit
        The chosen model, and the present model with the voltage's heat.
    r : int
    odds : float
        Log evidence of the other over the chosen one: it counts only if it fits the surface about as well.
    """
    n = f.problem.model.cells
    source = f.problem.records[r].source
    cores = [x.prediction.X[r][:, 0 : 2 * n : 2] for x in (f, other)]
    apart = float(np.mean(cores[1] - cores[0]))
    limit = BEYOND * float(np.sqrt(np.mean(core_bands(f)[r].sd_K ** 2)))
    if odds < -HEARD:
        text = f"Heat from the voltage alone does not follow the surface of {source} (log-odds {odds:.0f}): not heard"
        return Witness("voltage heat", text + ".", abs(apart), limit, False)
    text = f"With its heat taken from the voltage the core of {source} is {apart:+.1f} K apart (limit {limit:.1f} K)"
    return Witness("voltage heat", text + ".", abs(apart), limit, abs(apart) > limit)


def activation(f: MapFit, r: int, m: Measured) -> Witness | None:
    """Compare the fall of the losses with temperature by the surface's fit and by the voltage."""
    q = electric_heat(m.drive)
    number = [i for i, c in enumerate(f.problem.coordinates) if c.name == "resistance_temperature.B"]
    if q is None or not number:
        return None
    size = max(round(WINDOW_S / m.drive.dt), 1)
    windows = m.drive.N // size
    coarse = f.problem.records[r]
    ratio = coarse.drive.dt / m.drive.dt
    n = f.problem.model.cells
    cores = f.prediction.X[r][:, 0 : 2 * n : 2].mean(axis=1)
    core = np.interp(np.arange(m.drive.N) / ratio, np.arange(len(cores)), cores)
    x, y, w = [], [], []
    for i in range(windows):
        at = slice(i * size, (i + 1) * size)
        good = np.isfinite(q[at])
        square = float(np.sum(m.drive.I2[at][good]))
        heat = float(np.sum(q[at][good]))
        if heat > 0.0 and square > 0.0:
            weight = m.drive.I2[at] * good
            x.append(1.0 / (float(np.average(core[at], weights=weight)) + KELVIN) - 1.0 / REFERENCE)
            y.append(np.log(heat / square))
            w.append(square)
    if len(x) < 4 or np.ptp(x) < 5e-5:
        return None
    A = np.stack([np.ones(len(x)), np.array(x)], axis=1) * np.sqrt(np.array(w))[:, None]
    b = np.array(y) * np.sqrt(np.array(w))
    k, *_ = np.linalg.lstsq(A, b, rcond=None)
    left = b - A @ k
    sd = float(np.sqrt(left @ left / max(len(x) - 2, 1) * np.linalg.inv(A.T @ A)[1, 1]))
    B, own = float(f.theta[number[0]]), float(np.sqrt(f.covariance[number[0], number[0]]))
    off = (B - float(k[1])) / float(np.hypot(sd, own))
    text = f"By the voltage the losses fall with B = {k[1]:.0f} ± {sd:.0f} K, by the surface with {B:.0f} ± {own:.0f} K"
    return Witness("voltage activation", text + " (1 sd).", abs(off), FAR, abs(off) > FAR)
