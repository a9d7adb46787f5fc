r"""What a record could show, computed before a diagnosis: the smallest visible size of each effect, and look-alikes.

A fit has columns J for all numbers that it may adjust. The part of an effect's column h that these cannot explain,

.. math:: S = h^T W h - h^T W J \, H^{-1} J^T W h,

determines the evidence: a strength s gains ½ s² S of log-likelihood, minus its Occam factor and its prior. Two effects
whose remaining columns are parallel cannot be distinguished.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.core_band import posterior
from bms_gateway.diagnosis.screen import Gain, screen
from bms_gateway.diagnosis.together import cells_in_words
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.thermal import Floats
from bms_gateway.thermal.effects import EffectParameter

VISIBLE_ODDS = 3.0
"""Log-odds that an effect needs in the search."""
ALIKE = 0.95
"""Cosine above which two effects look alike: distinguishing them needs ten times the evidence for one of them."""
LIKELY = 2.0
"""Sizes up to this number of prior sd count as usual."""


@dataclass(frozen=True, slots=True)
class Detectable:
    """The smallest size of one effect that would be found.

    Attributes
    ----------
    key, effect : str
    cell : int or None
    parameter, unit : str
    smallest : float
        Smallest size in the unit shown; infinite if no size within the effect's bounds is enough.
    typical : float
        Prior sd, in the unit shown.
    visible : bool
        Whether usual sizes would be found.
    """

    key: str
    effect: str
    cell: int | None
    parameter: str
    unit: str
    smallest: float
    typical: float
    visible: bool


@dataclass(frozen=True, slots=True)
class Alike:
    """Two effects that look alike: keys, and the cosine of their responses."""

    one: str
    other: str
    cosine: float


@dataclass(frozen=True, slots=True)
class Combination:
    """How well the records determine a product of parameters.

    Attributes
    ----------
    symbols : tuple of str
    meaning : str
    rel_sd : float
        Posterior, of the product.
    apart : mapping as tuple of (symbol, rel_sd)
        Relative sd of each factor alone.
    sentence : str
    """

    symbols: tuple[str, ...]
    meaning: str
    rel_sd: float
    apart: tuple[tuple[str, float], ...]
    sentence: str


@dataclass(frozen=True, slots=True)
class Absorbed:
    """Changes that free parameters absorb completely, and combinations of parameters that the records determine.

    Attributes
    ----------
    sentences : tuple of str
        Changes that no record can show as an effect while these parameters are free.
    combinations : tuple of Combination
    """

    sentences: tuple[str, ...]
    combinations: tuple[Combination, ...]

    @property
    def everything(self) -> tuple[str, ...]:
        """Return all of it in sentences."""
        return (*self.sentences, *(c.sentence for c in self.combinations))


@dataclass(frozen=True, slots=True)
class Card:
    """What the records can show.

    Attributes
    ----------
    effects : tuple of Detectable
        Effects in the order of the catalogue; of several starts, the most visible one.
    alike : tuple of Alike
        Pairs of visible effects, the most alike first.
    groups : tuple of tuple of str
        Keys that are linked by `alike`.
    sentences : tuple of str
    """

    effects: tuple[Detectable, ...]
    alike: tuple[Alike, ...]
    groups: tuple[tuple[str, ...], ...]
    sentences: tuple[str, ...]


def detectability(fit: MapFit, offered: Sequence[Candidate]) -> Card:
    """Compute what the records of a fit could show.

    Parameters
    ----------
    fit : MapFit
        Fit of the present model.
    offered : sequence of Candidate
    """
    gains = screen(fit, [c for c in offered if _sized(c)])
    gains = sorted(gains, key=lambda g: [c is g.candidate for c in offered].index(True))
    remaining = Projection(fit)
    columns = [g.columns[:, :1] for g in gains]
    S = remaining.gram(np.concatenate(columns, axis=1)) if columns else np.zeros((0, 0))
    families = len({c.name for c in offered})
    best: dict[str, tuple[Detectable, int]] = {}
    for i, g in enumerate(gains):
        places = sum(c.name == g.candidate.name for c in offered)
        found = _smallest(g, float(S[i, i]), float(np.log(families * places)))
        old = best.get(g.candidate.key)
        if old is None or found.smallest < old[0].smallest:
            best[g.candidate.key] = (found, i)
    effects = tuple(d for d, _ in best.values())
    seen = [(d, i) for d, i in best.values() if d.visible]
    alike = _alike(seen, S)
    groups = _groups(alike)
    return Card(effects, alike, groups, _sentences(effects, groups))


class Projection:
    """The part of responses that the numbers of a fit cannot explain."""

    def __init__(self, fit: MapFit) -> None:
        self._fit = fit
        self._factor = scipy.linalg.cho_factor(fit.H)

    def gram(self, columns: Floats) -> Floats:
        """Inner products (p, p) of the unexplained parts of the columns (M', p), K per unit, in units of the noise."""
        J = self._fit.weighed(columns)
        cross = self._fit.products(J)
        S = J.T @ J - cross.T @ scipy.linalg.cho_solve(self._factor, cross)
        return np.asarray(0.5 * (S + S.T))


def absorbed(fit: MapFit) -> Absorbed:
    """Find the changes that the free parameters of a fit absorb, and their products that the records determine."""
    names = [c.name for c in fit.problem.coordinates]
    several = len(fit.problem.records) > 1
    cov = posterior(fit)
    sentences = []
    if "R_e" in names:
        sentences.append("A gain of the current sensor and a change of all cells' R_e alike go into R_e.")
    if "R_c" in names:
        sentences.append("A change of all cells' R_c alike goes into R_c.")
    if "R_u" in names or "R_u@1" in names:
        sentences.append("A change of all cells' cooling alike goes into R_u.")
    found = []
    for symbols, meaning in PRODUCTS:
        own = tuple(f"{s}@1" if several and f"{s}@1" in names else s for s in symbols)
        if not all(s in names for s in own):
            continue
        index = [names.index(s) for s in own]
        product = float(np.sqrt(max(cov[np.ix_(index, index)].sum(), 0.0)))
        apart = tuple((s, float(np.sqrt(cov[i, i]))) for s, i in zip(symbols, index, strict=True))
        text = f"{'·'.join(symbols)} ({meaning}) is known to {_percent(product)}; "
        text += ", ".join(f"{s} alone to {_percent(x)}" for s, x in apart) + " (1 sd)."
        found.append(Combination(symbols, meaning, product, apart, text))
    found.sort(key=lambda c: c.rel_sd)
    return Absorbed(tuple(sentences), tuple(found))


PRODUCTS = (
    (("R_e", "R_c"), "core rise over the surface"),
    (("R_e", "R_u"), "surface rise over the coolant"),
    (("C_c", "R_c"), "time in which the core follows"),
)
"""Products of parameters that a steady string shows."""


def _sized(c: Candidate) -> bool:
    """Whether the effect vanishes at some value of its first parameter, so that it has a size."""
    return bool(c.strengths) and c.effect.parameters[0].neutral is not None


def _smallest(g: Gain, S: float, handicap: float) -> Detectable:
    c, p = g.candidate, g.candidate.strengths[0]
    width = 3.0 if p.log else p.sd
    S = max(S, 1e-12)
    # ½ s² S − ½ ln(1 + S w²) − ln(hypotheses) = log-odds wanted
    s = float(np.sqrt(2.0 / S * (VISIBLE_ODDS + handicap + 0.5 * np.log1p(S * width**2))))
    if p.log:
        # its whole response at the start's value is visible or not
        at = c.start.get(p.name, p.probe)
        return _stated(g, p, at / p.to_si if s <= 1.0 else np.inf, at / p.to_si, s <= 1.0)
    reach = max(abs(p.upper), abs(p.lower))
    return _stated(g, p, s / p.to_si if s <= reach else np.inf, p.sd / p.to_si, s <= LIKELY * p.sd)


def _stated(g: Gain, p: EffectParameter, smallest: float, typical: float, visible: bool) -> Detectable:
    c = g.candidate
    return Detectable(c.key, c.name, c.cell, p.name, p.unit, float(smallest), float(typical), bool(visible))


def _alike(seen: Sequence[tuple[Detectable, int]], S: Floats) -> tuple[Alike, ...]:
    if not seen:
        return ()
    index = [i for _, i in seen]
    part = S[np.ix_(index, index)]
    size = np.sqrt(np.maximum(np.diag(part), 1e-12))
    cosine = part / np.outer(size, size)
    a, b = np.triu_indices(len(seen), 1)
    pairs = [
        Alike(seen[i][0].key, seen[j][0].key, float(cosine[i, j]))
        for i, j in zip(a.tolist(), b.tolist(), strict=True)
        if abs(cosine[i, j]) > ALIKE
    ]
    return tuple(sorted(pairs, key=lambda x: -abs(x.cosine)))


def _groups(alike: Sequence[Alike]) -> tuple[tuple[str, ...], ...]:
    """Collect sets of keys that are linked, in the order in which they first appear."""
    groups: list[list[str]] = []
    for pair in alike:
        touched = [g for g in groups if pair.one in g or pair.other in g]
        merged = [key for g in touched for key in g]
        merged += [key for key in (pair.one, pair.other) if key not in merged]
        groups = [g for g in groups if g not in touched] + [merged]
    return tuple(tuple(g) for g in groups)


def _sentences(effects: Sequence[Detectable], groups: Sequence[Sequence[str]]) -> tuple[str, ...]:
    found = []
    blind = [d.key for d in effects if not d.visible]
    places: dict[str, int] = {}
    for d in effects:
        places[d.effect] = places.get(d.effect, 0) + 1
    hidden = [name for name, n in places.items() if sum(k.partition(":")[0] == name for k in blind) == n]
    partly = [k for k in blind if k.partition(":")[0] not in hidden]
    if blind:
        names = hidden + _spoken(partly)
        found.append(f"These records could not show {_listed(names)} at a usual size.")
    each = _cell_by_cell(groups)
    for names in (_spoken(g) for g in groups if g not in [g for own in each.values() for g in own.values()]):
        same = "look alike here" if len(names) > 1 else "looks the same at each of these cells"
        found.append(f"{_listed(names, 'and')} {same}.")
    for alike, own in each.items():
        found.append(f"In each of the {cells_in_words(sorted(own))}, {_listed(alike, 'and')} look alike here.")
    return tuple(found)


def _cell_by_cell(groups: Sequence[Sequence[str]]) -> dict[tuple[str, ...], dict[int, Sequence[str]]]:
    """Collect groups of the same effects that sit on one cell each, where several cells have such a group."""
    found: dict[tuple[str, ...], dict[int, Sequence[str]]] = {}
    for g in groups:
        parts = [key.partition(":") for key in g]
        cells = {cell for _, _, cell in parts}
        if len(cells) == 1 and "" not in cells:
            found.setdefault(tuple(sorted(name for name, _, _ in parts)), {})[int(cells.pop())] = g
    return {effects: own for effects, own in found.items() if len(own) > 1}


def _spoken(keys: Sequence[str]) -> list[str]:
    """Name effects with their cells, each effect once.

    Examples
    --------
    >>> _spoken(["end_plate", "phase_change:3", "coolant_bypass:1", "phase_change:2", "phase_change:4"])
    ['end_plate', 'phase_change (cells 2 to 4)', 'coolant_bypass (cell 1)']
    """
    cells: dict[str, list[int]] = {}
    for name, _, cell in (key.partition(":") for key in keys):
        cells.setdefault(name, []).extend([int(cell)] if cell else [])
    return [f"{name} ({cells_in_words(sorted(k))})" if k else name for name, k in cells.items()]


def _listed(names: Sequence[str], last: str = "or") -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"


def _percent(rel_sd: float) -> str:
    return f"± {100 * rel_sd:.2g} %"
