"""Limits of a cell's format and mass on its numbers: a fit can ask for an R_c or a heat capacity that no such cell has.

The format is a word of the model file (`[cell] format`), as for `bms-gateway cells`. It limits R_c (the path across the
layers) and C_c + C_s (the mass). It does not limit R_e and R_u, which depend on age and surroundings.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bms_gateway.diagnosis.core_band import posterior
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.thermal import KINDS, Floats, StringModel
from bms_gateway.thermal.cells import CellFacts, Chemistry, cell_of, stated_parameters

DOUBTED, EXCLUDED = 2.5, 4.0
"""Distance from the format's value, in sd, above which a number is an alarm (one in eighty), and above which it is
excluded."""
TOTAL = "C_c + C_s"
OF = {"R_c": ("R_c",), TOTAL: ("C_c", "C_s")}
"""Quantities that a format limits, and the model's numbers whose sum each of them is."""


@dataclass(frozen=True, slots=True)
class Odd:
    """A number that a cell of this format does not have.

    Attributes
    ----------
    name : str
        `R_c` or `C_c + C_s`.
    value, expected : float
        SI.
    off : float
        Distance in sd, including the sd of the number itself.
    says : str
        One sentence.
    """

    name: str
    value: float
    expected: float
    off: float
    says: str

    @property
    def excluded(self) -> bool:
        """Whether the number is excluded, and not only doubtful."""
        return self.off > EXCLUDED


def facts_of(model: StringModel) -> CellFacts | None:
    """Return the facts of the cell in the model file; None if it names no format."""
    return None if model.cell_format is None else cell_of(model.cell_format)


def chemistry_of(model: StringModel) -> Chemistry | None:
    """Return the cell's chemistry; None if the model file does not name it."""
    facts = facts_of(model)
    return None if facts is None else facts.chemistry


def odd_declared(model: StringModel) -> tuple[Odd, ...]:
    """List the numbers of a model file that no cell of its format has."""
    values = {name: float(np.exp(np.mean(np.log(p.value)))) for name, p in model.priors.items()}
    names = ("C_c", "C_s", "R_c")
    return _odd(model, values, names, np.diag([model.priors[name].rel_sd ** 2 for name in names]))


def odd_fitted(fit: MapFit) -> tuple[Odd, ...]:
    """List the numbers of a fit that no cell of the model's format has."""
    model = fit.problem.model
    if model.cell_format is None:
        return ()
    place = {c.name: i for i, c in enumerate(fit.problem.coordinates) if c.name in ("C_c", "C_s", "R_c")}
    values = {name: float(np.exp(np.mean(np.log(p.value)))) for name, p in model.priors.items()}
    values |= {name: values[name] * float(np.exp(fit.theta[i])) for name, i in place.items()}
    at = list(place.values())
    return _odd(model, values, tuple(place), posterior(fit)[np.ix_(at, at)])


def _odd(model: StringModel, values: Mapping[str, float], names: tuple[str, ...], C: Floats) -> tuple[Odd, ...]:
    """Compare; `C` is the covariance of the logarithms of the `names`, other numbers being exact."""
    facts = facts_of(model)
    if facts is None:
        return ()
    stated, found = stated_parameters(facts), []
    for name, parts in OF.items():
        value, expected = (sum(x[p] for p in parts) for x in (values, {k: s.value for k, s in stated.items()}))
        share = np.array([values[n] / value if n in parts else 0.0 for n in names])
        # only the core's part of the mass is uncertain: the casing's share is small
        off = abs(np.log(value / expected)) / np.sqrt(stated[parts[0]].rel_sd ** 2 + share @ C @ share)
        if off > DOUBTED:
            kind = KINDS[parts[0]]
            shown = f"{value / kind.to_si:.2g} {kind.unit}"
            usual = f"{expected / kind.to_si:.2g} {kind.unit} ± {100.0 * stated[parts[0]].rel_sd:.0f} % (1 sd)"
            times = f"{value / expected:.2g} times" if value > expected else f"{100.0 * value / expected:.0f} % of"
            word = "is not possible for" if off > EXCLUDED else "is doubtful for"
            text = f"{name} = {shown} {word} a cell '{facts.name}': {times} its {usual} ({stated[parts[0]].formula})."
            found.append(Odd(name, value, expected, float(off), text))
    return tuple(found)
