"""Whether the windowed method may serve a string with effects, and with which inputs.

The method knows two nodes per cell, I²R_e and an inlet. Effects that change only the heat in the core and the inputs
leave this structure unchanged. The method then gets the mean square current that would make the same heat by the R_e in
force, and the inlet with the effects, and finds the growth of R_e and the changes of R_c and R_u.

For Lin et al., Eq 1, whose only heat is I²R_e.
"""

from dataclasses import replace

import numpy as np

from bms_gateway.thermal import Floats, StringModel
from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.physics import Physics


def heat_only(model: StringModel) -> bool:
    """Whether the model's effects change only the heat in the cores and the inputs.

    Examples
    --------
    >>> from bms_gateway.thermal import AddedEffect, Prior
    >>> table_1 = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79}
    >>> priors = {symbol: Prior(value) for symbol, value in table_1.items()}
    >>> falling = AddedEffect("resistance_temperature", None, {"B": 3000.0})
    >>> heat_only(StringModel(1, (1,), "single", priors, effects=(falling,)))
    True
    >>> heat_only(StringModel(1, (1,), "single", priors, effects=(AddedEffect("surface_joule", None, {"R_s": 1e-3}),)))
    False
    """
    physics = Physics(model)
    if physics.reads or physics.states > 2 * model.cells:
        return False

    # Two moments that differ in every input of an effect: any change shows in one of them.
    def two(first: float, second: float) -> Floats:
        return np.array([first, second])

    u = Drive(
        dt=1.0,
        I=two(80.0, -30.0),
        I2=two(6400.0, 900.0),
        I_abs=two(80.0, 30.0),
        T_in=two(20.0, 35.0),
        flow=two(1.0, 2.0),
        soc=two(0.9, 0.2),
        V=two(3.5, 3.1),
        IV=two(280.0, -93.0),
        hours=two(0.5, 2.0),
        known=frozenset(),
    )
    v = physics.numbers()
    memory, _ = physics.memory(u, v)
    rise = np.arange(2.0 * model.cells)
    z = physics.point(np.stack([50.0 + rise, 30.0 + rise]), u, v, memory)
    s = v.string
    same = (
        np.array_equal(np.broadcast_to(mine, z.T_c.shape), np.broadcast_to(plain, z.T_c.shape))
        for mine, plain in (
            (z.R_c, s.R_c),
            (z.R_u, s.R_u),
            (z.C_c, s.C_c),
            (z.C_s, s.C_s),
            (z.C_f, s.C_f * u.flow[:, None]),
            (z.surface, 0.0),
            (z.inner, (z.T_c - z.T_s) / s.R_c),
        )
    )
    if not all(same) or z.film_exponent != 0.0:
        return False

    # what takes heat from a warm core without current is a loss path, not a heat source
    rest = replace(u, I=0.0 * u.I, I2=0.0 * u.I2, I_abs=0.0 * u.I_abs, IV=0.0 * u.IV)

    def leaks(alone: Physics) -> bool:
        v = alone.numbers()
        still = alone.point(np.stack([50.0 + rise, 30.0 + rise]), rest, v, alone.memory(rest, v)[0]).core
        return bool(np.any(np.ptp(np.broadcast_to(still, (2, model.cells)), axis=0) > 0.0))

    return not any(leaks(Physics(replace(model, effects=(e,)))) for e in model.effects)
