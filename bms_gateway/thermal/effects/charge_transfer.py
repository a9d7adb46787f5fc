"""Losses of the charge-transfer reaction, which grow more slowly than the current: Butler-Volmer kinetics."""

import numpy as np

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import activation
from bms_gateway.thermal.entropy import KELVIN
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

GAS, FARADAY = 8.314462618, 96485.33212
"""J/(mol K), C/mol."""
NONE = 1e5
"""A: exchange current that counts as infinite: its losses equal those of a quarter of a µΩ."""


class ChargeTransfer(Effect):
    r"""Symmetric Butler-Volmer overpotential with an exchange current that grows with temperature.

    .. math::
        q \to q + |I| \frac{2 R T_c}{F} \operatorname{asinh} \frac{|I|}{2 I_0(T_c)}, \qquad
        I_0(T_c) = I_0 \exp\bigl(-E (1/T_c - 1/298.15\,\mathrm{K})\bigr)

    Notes
    -----
    An interval is treated as one amplitude for a part of the time: amplitude mean(I²)/mean|I|, charge mean|I|. So the
    mean is right for a constant current, for pulses, for small currents (∝ I²) and for large ones (∝ \|I\|). Neither
    the root mean square nor the mean magnitude alone gives that.
    """

    name = "charge_transfer"
    title = "charge-transfer losses (Butler-Volmer)"
    equation = "Q_c -> Q_c + |I|*(2*R*T_c/F)*asinh(|I|/(2*I_0')), I_0' = I_0*exp(-E*(1/T_c - 1/298.15 K))"
    signature = "too much heat expected at large currents, too little at small ones, less so when warm"
    needs = "currents of many sizes, and a span of temperature"
    node = "core"
    warms = 1
    constants = True
    plausibility = -1.0
    confused_with = ("resistance_temperature", "resistance_soc")
    one_sided = True
    parameters = (
        EffectParameter(
            "I_0", "exchange current at 25 °C", "A", 1.0, 20.0, 1.5, 0.01, NONE, log=True, probe=20.0, neutral=NONE
        ),
        EffectParameter(
            "E", "activation temperature of it", "K", 1.0, 5000.0, 2000.0, 0.0, 15000.0, probe=5000.0, neutral=None
        ),
    )

    def starts(self, low: float, high: float) -> tuple[dict[str, float], ...]:
        """Try three starts: Tafel-like, medium and nearly ohmic."""
        return ({"I_0": 2.0}, {"I_0": 20.0}, {"I_0": 200.0})

    def heats(self, z: Point, p: Values, at: Floats) -> None:
        """Add the losses of the reaction."""
        amplitude = z.I2 / np.maximum(z.I_abs, 1e-12)
        half = amplitude / (2.0 * p["I_0"]) * activation(z.T_c, p["E"])
        z.core = z.core + z.I_abs * (2.0 * GAS / FARADAY) * (z.T_c + KELVIN) * np.arcsinh(half)
