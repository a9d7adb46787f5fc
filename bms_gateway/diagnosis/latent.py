r"""The heat that a fitted model misses, over time, and the feature that this heat follows.

The residual u is modelled as the response of the fitted string, linear about its mean, to a heat q(t) in the core or at
the surface of each sensed cell. The heat is linear between knots and a random walk from knot to knot,

.. math::
    u = \sum_j h_j q_j + J \delta + e, \qquad q_{j+1} - q_j \sim N(0, s^2), \qquad e \sim N(0, \sigma^2),

solved at once as a Gaussian regression, with s by its marginal likelihood. The result is that of a Kalman smoother with
the same walk, without its loop over the readings; gaps and stamps between the instants need no special care, and the
evidence for core against surface is a by-product. The numbers of the fit may move too (δ, with their priors), because
they have absorbed a part of the missing heat.

The feature that the heat follows is not taken from this curve, which is smooth and depends on the priors. It is found
from the readings: by the share of the misfit that vanishes if a heat proportional to the feature is added and all
numbers are refitted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.linalg

from bms_gateway.diagnosis.regimes import slope
from bms_gateway.diagnosis.residuals import structure
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import MapFit, stacked
from bms_gateway.thermal import Floats
from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.trajectory import reference

Node = Literal["core", "surface"]
KNOTS, LEAST_S = 60, 30.0
"""Knots per record, and least time between two: the surface shows no faster change of the core's heat."""
MOST_KNOTS = 1_200
"""Knots of all thermocouples of a record together: the regression costs their third power."""
WALKS_W = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Random steps between two knots, W; the one with the greatest marginal likelihood is used."""
START_W = 5.0
"""W: sd of the heat at the first knot."""
FOLLOWS = 0.3
"""Least share of the misfit that a feature must explain to be named."""
MISSING_Z = 6.0
APART = 3.0
"""Tempered log-odds, 20 to 1, by which a feature must explain more than another to be told apart from it."""


@dataclass(frozen=True, slots=True)
class Heat:
    """Missing heat at one cell over one record, assumed to be made at one node.

    Attributes
    ----------
    node : {"core", "surface"}
    record, cell : int
    time_s : ndarray (K,), s since the record began
    heat_W, sd_W : ndarray (K,)
        Positive if the cell makes more heat than the model.
    """

    node: Node
    record: int
    cell: int
    time_s: Floats
    heat_W: Floats
    sd_W: Floats

    @property
    def rms_W(self) -> float:
        """Root mean square."""
        return float(np.sqrt(np.mean(self.heat_W**2)))


@dataclass(frozen=True, slots=True)
class Follow:
    """A feature, with the share of the misfit that a heat proportional to it explains.

    Attributes
    ----------
    node : {"core", "surface"}
    feature, title, unit : str
    share : float
        Share of the misfit above the noise, 0…1, with all numbers of the fit refitted.
    odds : float
        Tempered log-odds of that heat against none.
    slope : float
        W per unit; negative for less heat than the model has.
    correlation : float
        Correlation of the feature with the heat over time, for a scatter plot.
    values : tuple of ndarray
        The feature at the knots of each heat of that node in turn.
    """

    node: Node
    feature: str
    title: str
    unit: str
    share: float
    odds: float
    slope: float
    correlation: float
    values: tuple[Floats, ...]


@dataclass(frozen=True, slots=True)
class Latent:
    """Missing heat, and the features that it follows.

    Attributes
    ----------
    heats : tuple of Heat
        The core's of all records and cells, then the surface's.
    node : {"core", "surface"}
        Node of the heat that follows the best feature; without such a feature, the node that `odds` favour.
    odds : float
        Tempered log-odds of the core against the surface for a heat with any course.
    follows : tuple of Follow
        Features at both nodes, the one that explains most first.
    sentence : str
    """

    heats: tuple[Heat, ...]
    node: Node
    odds: float
    follows: tuple[Follow, ...]
    sentence: str

    @property
    def alike(self) -> tuple[Follow, ...]:
        """The features that explain the misfit best and cannot be told apart: one, if it is the only one."""
        return alike(self.follows)


def alike(follows: Sequence[Follow]) -> tuple[Follow, ...]:
    """Return the first of some features, and those that explain the misfit nearly as well."""
    return tuple(f for f in follows if follows[0].odds - f.odds < APART)


def latent(fit: MapFit) -> Latent:
    """Find the missing heat of a fit."""
    s = structure(fit)
    nodes: tuple[Node, Node] = ("core", "surface")
    solved = {node: _deconvolved(fit, node) for node in nodes}
    odds = (solved["core"][1] - solved["surface"][1]) / s.inflation
    asked = [f for node in nodes for f in _follows(fit, node, solved[node][0], s.inflation)]
    follows = tuple(sorted(asked, key=lambda f: -f.odds))
    heats = (*solved["core"][0], *solved["surface"][0])
    node: Node = "core" if odds > 0.0 else "surface"
    if follows[0].share > FOLLOWS:  # a free curve fits at core and surface alike; a feature fits at one of them only
        node = follows[0].node
    return Latent(heats, node, odds, follows, follow_sentence(node, heats, follows, missing=s.z > MISSING_Z))


def _deconvolved(fit: MapFit, node: Node) -> tuple[list[Heat], float]:
    """Heat at each sensed cell of each record, and the log evidence for this explanation of the readings."""
    problem = fit.problem
    y, sigma, _, _, _ = stacked(problem)
    weight = np.concatenate([np.sqrt(p.count) / p.at.sigma for p in problem.places])  # of means at the fit's places
    sd = np.concatenate([[c.sd for c in problem.coordinates], fit.linear.sd])
    away = np.concatenate([fit.theta - [c.prior for c in problem.coordinates], fit.nu])
    places = [(r, k) for r, m in enumerate(problem.records) for k in _sensed(m)]
    knots = [_knots(m) for m in problem.records]
    widths = [len(knots[r]) for r, _ in places]
    D = np.zeros((len(weight), sum(widths) + len(sd)))
    edges = np.cumsum([0, *(len(p.first) for p in problem.places)])
    for (r, k), K, last in zip(places, widths, np.cumsum(widths), strict=True):
        at = problem.places[r].at
        hats = _hats(3600.0 * at.drive.hours, knots[r])
        heat = np.zeros((at.drive.N, problem.model.cells, K))
        heat[:, k - 1] = hats
        D[edges[r] : edges[r + 1], last - K : last] = _response(fit, r, at, node, heat)
    D[:, sum(widths) : len(D.T) - len(fit.nu)] = fit.J
    D[:, len(D.T) - len(fit.nu) :] = fit.linear.J
    D *= weight[:, None]
    A, b = D.T @ D, D.T @ problem.gathered((y - fit.y) / sigma)
    del D
    b[-len(sd) :] -= away / sd**2
    best: tuple[float, Floats, Floats] | None = None
    for walk in WALKS_W:
        walks = [_walk(K, walk) for K in widths]
        factor = scipy.linalg.cho_factor(A + scipy.linalg.block_diag(*walks, np.diag(1.0 / sd**2)))
        q = scipy.linalg.cho_solve(factor, b)
        log_det = 2.0 * float(np.sum(np.log(np.diag(factor[0]))))
        log_det -= sum(float(np.linalg.slogdet(w)[1]) for w in walks)
        log_evidence = 0.5 * float(b @ q) - 0.5 * log_det
        if best is None or log_evidence > best[0]:
            half = scipy.linalg.solve_triangular(factor[0], np.eye(len(b)), trans="T")
            best = (log_evidence, q, np.sqrt(np.sum(half**2, axis=0)))
    assert best is not None  # noqa: S101 - there are walks to choose from
    heats, first = [], 0
    for (r, k), K in zip(places, widths, strict=True):
        part = slice(first, first + K)
        first += K
        heats.append(Heat(node, r, k, knots[r], best[1][part], best[2][part]))
    return heats, best[0]


def _walk(K: int, sd: float) -> Floats:
    """Precision (K, K) of a random walk."""
    step = np.diff(np.eye(K), axis=0)
    prior = step.T @ step / sd**2
    prior[0, 0] += 1.0 / START_W**2
    return np.asarray(prior)


def _sensed(m: Measured) -> list[int]:
    return sorted({cell for kind, cell in m.channels if kind == "surface"})


def _knots(m: Measured) -> Floats:
    end = 3600.0 * float(m.drive.hours[-1]) + 0.5 * m.drive.dt
    most = min(KNOTS, MOST_KNOTS // len(_sensed(m)))
    return np.linspace(0.0, end, int(np.clip(end / LEAST_S, 2, most)) + 1)


def _hats(t: Floats, knots: Floats) -> Floats:
    """Linear interpolation between knots (N, K)."""
    at = np.clip((t - knots[0]) / (knots[1] - knots[0]), 0.0, len(knots) - 1.0)
    return np.asarray(np.maximum(1.0 - np.abs(at[:, None] - np.arange(len(knots))), 0.0))


def _response(fit: MapFit, r: int, m: Measured, node: Node, heat: Floats) -> Floats:
    """Simulate surface sensors (M, K), K, under heats (N, n, K), W, at one node of record `r`.

    `m` is this record or, in longer intervals, the places of its columns.
    """
    problem = fit.problem
    system, _ = problem.system(r, fit.theta, fit.nu, m)
    v, recursion = system.v, reference(system, fit.prediction.X[r].mean(axis=0))
    n, K = problem.model.cells, heat.shape[2]
    capacity = v.string.C_c if node == "core" else v.string.C_s
    w = np.zeros((K, problem.physics.states, m.drive.N)).T  # time runs fastest, as in a column of the recursion
    w[:, int(node == "surface") : 2 * n : 2] = heat / capacity[:, None]
    parts = []
    for span in m.spans:
        X = recursion.run(np.zeros((problem.physics.states, K)), w[span.first : span.last])
        parts.append(X[:, 1 : 2 * n : 2])
    surfaces = np.concatenate(parts)
    at = np.array([k - 1 for _, k in m.channels])[m.channel]
    after = np.minimum(m.row + 1, len(surfaces) - 1)
    return np.asarray((1.0 - m.share)[:, None] * surfaces[m.row, at] + m.share[:, None] * surfaces[after, at])


def _features(u: Drive, T_s: Floats, T_c: Floats) -> dict[str, tuple[str, str, Floats]]:
    """Title, unit and values (N,) of the features that a missing heat may follow."""
    found = {
        "I2": ("I²", "A²", u.I2),
        "I": ("I", "A", u.I),
        "I_abs_I": ("|I|I", "A²", np.sign(u.I) * u.I2),
        "I_abs": ("|I|", "A", u.I_abs),
        "I2_warmth": ("I² times the core's warmth, I²(T − mean T)", "A² K", u.I2[:, None] * (T_c - T_c.mean())),
        "T": ("core temperature, T − mean T", "K", T_c - T_c.mean()),
        "gap": ("surface over inlet, T_s − T_in", "K", T_s - u.T_in[:, None]),
        "inlet_slope": ("slope of the inlet, dT_in/dt", "K/min", 60.0 * slope(u)),
        "I2_time": ("I² times time", "A² h", u.I2 * u.hours),
        "time": ("time", "h", u.hours),
        "constant": ("a constant", "W", np.ones(u.N)),
    }
    if "soc" in u.known:
        found["soc"] = ("SOC", "1", u.soc)
        found["I_soc"] = ("I times SOC, I(SOC − mean)", "A", u.I * (u.soc - u.soc.mean()))
    if "flow" in u.known:
        found["flow"] = ("coolant flow", "1", u.flow)
    return found


def _follows(fit: MapFit, node: Node, heats: Sequence[Heat], inflation: float) -> list[Follow]:
    """Compute the share of the misfit for a heat proportional to each feature, equal in all cells."""
    tables = [_table(fit, r) for r in range(len(fit.problem.records))]
    names = [n for n in tables[0] if all(n in t and float(np.abs(t[n][2]).max()) > 0.0 for t in tables)]
    columns = np.concatenate(
        [
            _response(fit, r, m, node, np.stack([t[n][2] for n in names], axis=2))
            for r, (m, t) in enumerate(zip(fit.problem.records, tables, strict=True))
        ]
    )
    used = stacked(fit.problem)[4]
    r = fit.gathered(np.where(used, fit.r, 0.0))
    J = fit.weighed(fit.problem.averaged(columns))
    prior, sd = (np.array([getattr(c, k) for c in fit.problem.coordinates]) for k in ("prior", "sd"))
    rest = fit.products(r[:, None])[:, 0] - np.concatenate([(fit.theta - prior) / sd**2, fit.nu / fit.linear.sd**2])
    cross = fit.products(J)
    factor = scipy.linalg.cho_factor(fit.H)
    S = np.sum(J * J, axis=0) - np.sum(cross * scipy.linalg.cho_solve(factor, cross), axis=0)
    slopes = (J.T @ r - cross.T @ scipy.linalg.cho_solve(factor, rest)) / np.maximum(S, 1e-12)
    # what noise alone leaves of this: one for each mean of readings, less where some of them are held out
    one = np.ones(len(used))
    white = float(np.sum(fit.gathered(np.where(used, one, 0.0)) / fit.gathered(one)))
    excess = max(float(r @ r) - white, 1.0)
    found = []
    for i, name in enumerate(names):
        title, unit, _ = tables[0][name]
        values = tuple(_at_knots(fit, h, tables[h.record][name][2]) for h in heats)
        gain = float(slopes[i] ** 2 * S[i])
        share, odds = min(gain / excess, 1.0), 0.5 * gain / inflation
        correlation = _correlation(np.concatenate(values), np.concatenate([h.heat_W for h in heats]))
        found.append(Follow(node, name, title, unit, share, odds, float(slopes[i]), correlation, values))
    return found


def _table(fit: MapFit, r: int) -> dict[str, tuple[str, str, Floats]]:
    """Features of one record: title, unit and values (N, n)."""
    m, n = fit.problem.records[r], fit.problem.model.cells
    T_c, T_s = np.zeros((m.drive.N, n)), np.zeros((m.drive.N, n))
    for i, s in enumerate(m.spans):
        rows = np.arange(s.first, s.last) + i
        X = 0.5 * (fit.prediction.X[r][rows] + fit.prediction.X[r][rows + 1])
        T_c[s.first : s.last], T_s[s.first : s.last] = X[:, 0 : 2 * n : 2], X[:, 1 : 2 * n : 2]
    return {
        name: (title, unit, np.broadcast_to(x if x.ndim == 2 else x[:, None], (m.drive.N, n)))
        for name, (title, unit, x) in _features(m.drive, T_s, T_c).items()
    }


def _at_knots(fit: MapFit, h: Heat, x: Floats) -> Floats:
    """Means of a feature (N, n) of a heat's cell about its knots."""
    hats = _hats(3600.0 * fit.problem.records[h.record].drive.hours, h.time_s)
    return np.asarray(hats.T @ x[:, h.cell - 1] / np.maximum(hats.sum(axis=0), 1e-9))


def _correlation(x: Floats, q: Floats) -> float:
    if float(np.ptp(x)) == 0.0 or float(np.ptp(q)) == 0.0:
        return 0.0
    return float(np.corrcoef(x, q)[0, 1])


def follow_sentence(node: Node, heats: Sequence[Heat], follows: Sequence[Follow], *, missing: bool) -> str:
    """Say how much heat is missing and what it follows, the features in the order of what they explain."""
    if not missing:
        return "No heat is missing that the readings could show."
    size = float(np.sqrt(np.mean([h.rms_W**2 for h in heats if h.node == node])))
    where = "in the cores" if node == "core" else "at the surfaces"
    same = alike(follows)
    if follows[0].share > FOLLOWS and len(same) == 1:
        f = follows[0]
        less = "" if f.slope > 0.0 else "less "
        than = "" if f.slope > 0.0 else " than modelled"
        return (
            f"{100.0 * f.share:.0f} % of the misfit goes with {less or 'a '}heat {where}{than} that follows {f.title} "
            f"({watts(f.slope, f.unit)})."
        )
    if follows[0].share > FOLLOWS:
        titles = list(dict.fromkeys(f.title for f in same))
        which = f": {', '.join(titles[:-1])} and {titles[-1]} explain it alike" if len(titles) > 1 else ""
        if len({f.node for f in same}) > 1:
            where = "in the cores or at the surfaces"
        return f"The misfit goes with heat {where}; these readings do not tell what it follows{which}."
    return f"The readings ask for {size:.2g} W (rms) more or less heat {where}; it follows no single feature."


def watts(slope: float, unit: str) -> str:
    """Write a heat for each unit of what it follows: more or less than modelled, in W, mW or µW.

    Examples
    --------
    >>> watts(0.0084, "A²"), watts(-1.87e-5, "A²"), watts(-0.081, "A"), watts(1.4, "W")
    ('8.4 mW per A² more', '19 µW per A² less', '81 mW per A less', '1.4 W more')
    """
    size = abs(slope)
    scale, name = next(((k, n) for k, n in ((1.0, "W"), (1e3, "mW"), (1e6, "µW")) if size * k >= 1.0), (1e9, "nW"))
    per = "" if unit == "W" else f" per {'unit' if unit == '1' else unit}"
    return f"{float(f'{size * scale:.2g}'):g} {name}{per} {'more' if slope > 0.0 else 'less'}"
