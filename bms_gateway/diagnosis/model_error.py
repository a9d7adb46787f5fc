"""Fits with a model error: averaged readings, plausible priors, and a slow discrepancy.

The first search assumes that a model can follow a thermocouple to within its noise. This is right for a pack that two
nodes fit to the noise, and wrong for a real cell with a good thermocouple. There the error of two nodes exceeds the
noise, and every effect that can absorb a little of this error would seem to be found.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bms_gateway.diagnosis.slow_error import START, Discrepancy, Noise
from bms_gateway.identify.coordinates import Belief, Measured
from bms_gateway.identify.map_fit import FitEffort, FitStart, Linear, MapFit, map_fit
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import Floats
from bms_gateway.thermal.drive import Drive, Span

REFINEMENTS = 3
"""Number of updates of the sensitivities for the last digits: if heat follows the core, one is too few in a flat
valley."""
_MEANS = ("I", "I2", "I_abs", "T_in", "flow", "soc", "V", "IV", "hours")


@dataclass(frozen=True, slots=True)
class ModelError:
    """Constants of the regime, the same for every record.

    Attributes
    ----------
    floor : float, K·√s
        White model error: 0.05 K on the mean of a minute. With a quarter of it, effects of sensors are added that
        absorb the model error; with three times it, the right effects are lost; in between the named effects are the
        same.
    share : float
        Least size of the slow discrepancy as a share of the surface's range: two nodes are not more exact than half a
        per cent.
    blocks : int
        Approximate number of means in a record: enough for time constants of ten seconds in an hour …
    shortest, longest : float, s
        … and their limits. They are shorter than a surface's time constant, because faster changes are lost in a mean.
    start_core, start_surface : float, K
        sd of core and surface at the start of a record, about the first readings: a cell on a bench has rested.
    contact : float
        sd of thermocouple_contact: a glued bead has a few per cent; more is a bad mounting.
    lag : float, s
        sd of thermocouple_lag, for a bead without a sleeve.
    offset : float, K
        sd of thermocouple_offset after a soak.
    current_offset, current_share : float
        sd of current_offset: A, or this share of the peak, whichever is greater; shunts and Hall sensors are within.
    rounds : int
        Number of rounds in which fit and discrepancy are adapted to each other.
    numbers : float
        Share of the floor for fits of the numbers of a model with effects. The floor protects the choice of effects;
        after this choice, the readings' information on the numbers need not be reduced.
    """

    floor: float = 0.4
    share: float = 0.005
    blocks: int = 700
    shortest: float = 5.0
    longest: float = 15.0
    start_core: float = 0.5
    start_surface: float = 0.2
    contact: float = 0.05
    lag: float = 2.0
    offset: float = 0.5
    current_offset: float = 0.5
    current_share: float = 0.01
    rounds: int = 3
    numbers: float = 0.5

    @property
    def fine(self) -> "ModelError":
        """Regime in which the numbers of a model with effects are fitted."""
        return replace(self, floor=self.numbers * self.floor)

    def beliefs(self, records: Sequence[Measured]) -> dict[str, Belief]:
        """Priors that replace those of the catalogue."""
        peak = max(float(np.sqrt(m.drive.I2.max())) for m in records)
        return {
            "T_c0": Belief(0.0, self.start_core),
            "T_s0": Belief(0.0, self.start_surface),
            "thermocouple_contact.g": Belief(0.0, self.contact),
            "thermocouple_lag.tau": Belief(0.0, self.lag),
            "thermocouple_offset.b": Belief(0.0, self.offset),
            "T_in_late": Belief(0.0, 0.0),  # half a second is negligible for means over five
            "flow_late": Belief(0.0, 0.0),
            "current_offset.b": Belief(0.0, max(self.current_offset, self.current_share * peak)),
        }


@dataclass(slots=True)
class Bench:
    """Averaged records, and the settings that all fits to them share.

    Parameters
    ----------
    records : sequence of Measured
        As from `averaged`.
    settings : ModelError

    Attributes
    ----------
    beliefs : mapping of coordinate to Belief
    noise : Noise
    least : float, K
        Least size of the discrepancy.
    """

    records: Sequence[Measured]
    settings: ModelError
    beliefs: Mapping[str, Belief] = field(init=False)
    noise: Noise = field(init=False)
    least: float = field(init=False)

    def __post_init__(self) -> None:
        self.beliefs = self.settings.beliefs(self.records)
        self.noise = Noise(self.records)
        y = np.concatenate([m.y for m in self.records])
        self.least = self.settings.share * float(np.quantile(y, 0.99) - np.quantile(y, 0.01))


@dataclass(frozen=True, slots=True)
class Fit:
    """A fit with its discrepancy.

    Attributes
    ----------
    map : MapFit
    discrepancy : Discrepancy
    log_evidence : float
        Including the prior of the discrepancy.
    """

    map: MapFit
    discrepancy: Discrepancy
    log_evidence: float


EACH = FitEffort(iterations=8)
"""Effort of one fit of the numbers, after which the discrepancy is found again."""


def fit(
    bench: Bench,
    problem: Problem,
    theta: Floats,
    effort: FitEffort = EACH,
    *,
    parent: Fit | None = None,
    guess: Sequence[Floats] | None = None,
) -> Fit:
    """Fit numbers and discrepancy in turn, until they agree.

    Parameters
    ----------
    bench : Bench
    problem : Problem
        With the bench's records and beliefs.
    theta : ndarray (P,)
        Start.
    effort : FitEffort
        Of each fit of the numbers.
    parent : Fit, optional
        Fit of the same problem with fewer coordinates at the end; its discrepancy, nuisances and columns are the start.
    guess : sequence of ndarray, optional
        Trajectories near that of the start.
    """
    d = START if parent is None else parent.discrepancy
    if d.size < bench.least:
        d = replace(d, size=bench.least)
    # the cost of a trial that diverges is not finite; it is therefore refused
    with np.errstate(over="ignore", invalid="ignore"):
        sd = np.array([c.sd for c in problem.nuisances])
        if parent is None:
            prediction = problem.predict(theta, guess)
            columns = problem.columns(theta, prediction, problem.nuisances, 0)
            nu, J, guess = None, None, prediction.X
        else:
            columns, nu, J = parent.map.linear.J, parent.map.nu, parent.map.J
        y = np.concatenate([m.y for m in problem.records])
        best: Fit | None = None
        for _ in range(bench.settings.rounds):
            noise = bench.noise.at(d)
            found = map_fit(
                problem,
                FitStart(theta, nu, guess, J),
                effort,
                linear=Linear.of(problem, columns, sd, noise),
                noise=noise,
            )
            trial = Fit(found, d, found.log_evidence - 0.5 * d.strain)
            if best is None or trial.log_evidence > best.log_evidence:
                best = trial
            theta, nu, guess, J = found.theta, found.nu, found.prediction.X, found.J
            after = bench.noise.profile(y - found.y, bench.least)
            if after == d:
                break
            d = after
    assert best is not None  # noqa: S101 - there is at least one round
    return best


def averaged(m: Measured, settings: ModelError) -> Measured:
    """Join intervals and average readings; all are used, and the white floor is their least noise."""
    wanted = np.clip(m.drive.N * m.drive.dt / settings.blocks, settings.shortest, settings.longest)
    size = max(round(float(wanted) / m.drive.dt), 1)
    spans, drives, parts = [], [], []
    row = interval = old_row = 0
    for span in m.spans:
        blocks = max(len(span) // size, 1)
        k = min(size, len(span))
        drives.append({n: _means(getattr(m.drive, n), span.first, blocks, k) for n in _MEANS})
        spans.append(Span(interval, interval + blocks))
        parts.append(_readings(m, old_row, len(span), k, blocks, row))
        interval, row, old_row = interval + blocks, row + blocks + 1, old_row + len(span) + 1
    channel, rows, share, y, count = (np.concatenate([p[i] for p in parts]) for i in range(5))
    order = np.lexsort((rows, channel))
    dt = m.drive.dt * size
    sigma = np.empty(len(m.channels))
    for j in range(len(m.channels)):
        mine = channel == j
        per_block = float(np.median(count[mine])) if mine.any() else 1.0
        apart = max(dt, m.drive.N * m.drive.dt / max(int(mine.sum()), 1))
        noise = np.hypot(m.sigma0[j], m.step[j] / np.sqrt(12.0)) / np.sqrt(per_block)
        sigma[j] = max(float(noise), settings.floor / float(np.sqrt(apart)))
    drive = Drive(dt=dt, known=m.drive.known, **{n: np.concatenate([d[n] for d in drives]) for n in _MEANS})
    return replace(
        m,
        drive=drive,
        spans=tuple(spans),
        channel=channel[order],
        row=rows[order],
        share=share[order],
        y=y[order],
        used=np.ones(len(y), np.bool_),
        sigma0=sigma,
        step=np.zeros_like(sigma),
    )


def first_part(m: Measured, share: float) -> Measured:
    """Hold out the readings after this share of each record."""
    last = m.row + m.share
    return replace(m, used=last < share * float(last.max()))


def _means(x: Floats, first: int, blocks: int, size: int) -> Floats:
    return np.asarray(x[first : first + blocks * size].reshape(blocks, size).mean(axis=1))


def _readings(m: Measured, first_row: int, intervals: int, size: int, blocks: int, row: int) -> tuple[np.ndarray, ...]:
    """Channel, row, share, mean and count of the blocks of one span that have readings."""
    mine = np.flatnonzero((m.row >= first_row) & (m.row <= first_row + intervals))
    place = (m.row[mine] - first_row + m.share[mine]) / size
    mine, place = mine[place < blocks], place[place < blocks]
    cell = m.channel[mine] * blocks + place.astype(np.int64)
    most = len(m.channels) * blocks
    count = np.bincount(cell, minlength=most)
    there = np.flatnonzero(count)
    y = np.bincount(cell, m.y[mine], most)[there] / count[there]
    at = np.bincount(cell, place, most)[there] / count[there]
    before = np.minimum(at.astype(np.int64), blocks - 1)
    return there // blocks, before + row, at - before, y, count[there]
