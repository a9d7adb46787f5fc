"""Sizes and time constants of the changes that a sound pack shows, by which the heat filter judges its states."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bms_gateway.health.heat.layout import Bools, Layout
from bms_gateway.thermal import Floats, StringModel

HOUR_S = 3600.0
LOAD_SD, LOAD_S = 0.25, 7200.0
"""ln of the heat: R_e changes with temperature and charge. A greater sd of the identified R_e replaces the first."""
BRISK_SD, BRISK_ALONE_SD, BRISK_S = 0.1, 0.25, 900.0
"""ln of the heat within minutes: R_e changes with the charge, and overpotentials build up. The second number holds for
strings with fewer than `REFERENCE` sensors, where other cells do not show a common change."""
FLOW_SD, FLOW_S = 0.30, 3600.0
"""Share of the films' conductance: changes of a flow that is not on the bus."""
INLET_SD, INLET_S = 1.0, 1800.0
"""K: the inlet's sensor against the coolant that reaches the first cell."""
STREAM_SD, STREAM_ALONE_SD, STREAM_S = 0.05, 0.01, 1800.0
"""Share of the coolant's warming along the string: changes of a flow that is not on the bus. The second number holds
for strings with fewer than `REFERENCE` sensors, which do not show it."""
ENTROPY_SD, ENTROPY_S = 2e-4, 1800.0
"""V/K: the entropic coefficient, which changes with the charge."""
BIAS_SD = 0.3
"""K: differences of thermocouples of class 1."""
OWN_SD, OWN_S = 0.03, 12 * HOUR_S
"""ln: differences of the cells of one string, in heat and in R_u."""
HEAT_RATE, HEAT_S = 1e-4, HOUR_S
"""K/s of a cell's own heat capacity: permanent heat that no model has. Faults are far above."""
REFERENCE = 3
"""Number of sensors of a string from which a single one can be compared with the others."""
LEAST_GAP_SD = 0.05
"""Least relative sd of R_c, for the core of a cell with heat of its own."""


@dataclass(frozen=True, slots=True)
class Usual:
    """Sizes and time constants for S strings.

    Attributes
    ----------
    sd : ndarray (S, N)
        Of each state except the temperatures.
    lasts_s : ndarray (N − 2n,)
        Time constants of the states other than the temperatures, s; infinite for constants.
    C : ndarray (S, a), J/K
        Heat capacities of the cells that sensors observe.
    gap_sd, beside_sd : ndarray (S,)
        Relative sd of R_c and of R_cc.
    alone : ndarray of bool (S,)
        The string has fewer than `REFERENCE` sensors.
    """

    sd: Floats
    lasts_s: Floats
    C: Floats
    gap_sd: Floats
    beside_sd: Floats
    alone: Bools

    @classmethod
    def of(cls, models: Sequence[StringModel], at: Layout, C: Floats) -> "Usual":
        """Take the sizes of strings from their models."""
        sd = np.zeros((len(models), at.states))
        sd[:, at.load] = [max(LOAD_SD, m.priors["R_e"].rel_sd) for m in models]
        sd[:, at.flow] = [max(FLOW_SD, m.priors["R_u"].rel_sd) for m in models]
        sd[:, at.inlet], sd[:, at.entropy] = INLET_SD, ENTROPY_SD
        known = [np.hypot(m.priors["R_c"].rel_sd, m.tolerances["cell_R_c"]) for m in models]
        beside_sd = np.array([m.priors["R_cc"].rel_sd if m.has_conduction else 0.0 for m in models])
        alone = np.array([len(m.sensors) < REFERENCE for m in models])
        sd[:, at.brisk] = np.where(alone, BRISK_ALONE_SD, BRISK_SD)
        sd[:, at.stream] = np.where(alone, STREAM_ALONE_SD, STREAM_SD)
        sd[:, at.bias] = BIAS_SD
        sd[:, at.heat] = HEAT_RATE * C
        sd[:, at.own_load] = sd[:, at.own_flow] = OWN_SD
        lasts = np.full(at.states, np.inf)
        lasts[at.load], lasts[at.flow], lasts[at.inlet], lasts[at.entropy] = LOAD_S, FLOW_S, INLET_S, ENTROPY_S
        lasts[at.brisk], lasts[at.stream] = BRISK_S, STREAM_S
        lasts[at.heat], lasts[at.own_load], lasts[at.own_flow] = HEAT_S, OWN_S, OWN_S
        return cls(sd, lasts[at.nodes :], C, np.maximum(LEAST_GAP_SD, np.array(known)), beside_sd, alone)
