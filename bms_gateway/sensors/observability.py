r"""Precision with which surface sensors determine the cores of a string.

There are three answers, and they differ. The *exact rank* of the observability matrix counts the states that noise-free
readings would determine; it is computed without rounding. The *paper's rank* is the rank of the same matrix in double
precision. The entries span so many decades that rounding alone loses rank, but the published tables rest on it, so it
is reproduced under its own name. The *steady standard deviation* of each core is the answer for users.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bms_gateway.sensors.exact import exact_rank
from bms_gateway.sensors.paper import paper_rank
from bms_gateway.sensors.pbh import hidden_states
from bms_gateway.sensors.steady import steady_core_sd
from bms_gateway.thermal import Disturbance, Floats, StringParameters

SHORT = 100
"""Largest string whose observability matrix is computed, exactly or in double precision; this takes seconds at most."""


@dataclass(frozen=True, slots=True)
class Observability:
    """The three answers for one set of sensors.

    Attributes
    ----------
    states : int
        2n.
    exact_rank : int
    paper_rank : int or None
        None for strings of more than a hundred cells, whose matrix has millions of entries of nearly zero.
    core_sd : ndarray (n,), K
    """

    states: int
    exact_rank: int
    paper_rank: int | None
    core_sd: Floats

    @property
    def observable(self) -> bool:
        """Whether noise-free readings determine every temperature."""
        return self.exact_rank == self.states

    @property
    def worst_cell(self) -> int:
        """Cell (1-based) with the least certain core."""
        return int(np.argmax(self.core_sd)) + 1


def observability(p: StringParameters, sensors: Sequence[int], disturbance: Disturbance | None = None) -> Observability:
    """Give the three answers for surface sensors at the cells `sensors` (1-based).

    References
    ----------
    Lin et al., Eq 20–21.

    Examples
    --------
    >>> p = StringParameters.of(5, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79, R_cc=4, C_f=11.33)
    >>> o = observability(p, (1, 5))
    >>> o.exact_rank, o.observable, np.round(o.core_sd, 2)
    (10, True, array([0.69, 0.64, 0.63, 0.63, 0.48]))
    """
    paper = paper_rank(p, sensors) if p.cells <= SHORT else None
    return Observability(2 * p.cells, determined_states(p, sensors), paper, steady_core_sd(p, sensors, disturbance))


def determined_states(p: StringParameters, sensors: Sequence[int]) -> int:
    """Count the states that noise-free readings determine: the exact rank, by the faster method for long strings.

    References
    ----------
    Lin et al., Eq 20.

    Examples
    --------
    >>> p = StringParameters.of(600, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79, R_cc=32, C_f=11.33)
    >>> determined_states(p, [300])
    1200
    """
    hidden = hidden_states(p, sensors) if p.cells > SHORT else None
    return exact_rank(p, sensors) if hidden is None else 2 * p.cells - hidden
