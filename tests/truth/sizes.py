"""How large the hidden effects are: one table, in the units shown to people, and what a log must contain to show them.

Medium: a structured error of the surface of a few tenths of a kelvin with 5 cells, 3 sensors, 0.1 K of noise, before
any refit; weak about a third of it, strong about two and a half times. Where an effect is bounded (a share) or only
shows after the parameters have had their say, the numbers go by what is left after that. `±`: the sign is drawn.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Size:
    """Values of one parameter at the three sizes; `factor` brings the shown number to what `effects.py` takes."""

    name: str
    unit: str
    weak: float
    medium: float
    strong: float
    signed: bool = False
    factor: float = 1.0

    def at(self, label):
        """Value at a label, or at a multiple of medium given as a number."""
        return self.medium * label if isinstance(label, int | float) else getattr(self, label)


def _one(name, unit, weak, medium, strong, **more):
    return (Size(name, unit, weak, medium, strong, **more),)


SIZES = {
    "entropic_heat": _one("dUdT", "mV/K", 0.08, 0.22, 0.55, signed=True),
    "voltage_heat": _one("swing", "1", 0.05, 0.14, 0.35),
    "resistance_temperature": _one("B", "K", 600.0, 1800.0, 4200.0),
    "resistance_soc": (Size("s_1", "1", 0.08, 0.22, 0.55, signed=True), Size("s_2", "1", 0.03, 0.1, 0.25)),
    "resistance_asymmetry": _one("a", "1", 0.05, 0.16, 0.4),
    "charge_transfer": (Size("I_0", "A", 80.0, 30.0, 9.0), Size("E", "K", 4000.0, 5000.0, 6000.0)),
    "hysteresis": (Size("V", "mV", 6.0, 18.0, 45.0, factor=1e-3), Size("Q", "Ah", 0.15, 0.15, 0.15)),
    "polarization": (Size("R_1", "mOhm", 0.18, 0.5, 1.3, factor=1e-3), Size("tau", "s", 60.0, 60.0, 60.0)),
    "radial_gradient": _one("phi", "1", 0.25, 0.6, 1.0),
    "resistance_drift": _one("a", "1/h", 0.03, 0.09, 0.22, signed=True),
    "cooling_drift": _one("a", "1/h", 0.03, 0.09, 0.22, signed=True),
    "flow_dependent_cooling": _one("n", "1", 0.1, 0.28, 0.65),
    "natural_convection": _one("n", "1", 0.06, 0.15, 0.3),
    "ambient_loss": (Size("G", "W/K", 0.03, 0.09, 0.22), Size("P", "W", 0.2, 0.5, 1.2, signed=True)),
    "core_loss": (Size("G", "W/K", 0.03, 0.09, 0.22), Size("P", "W", 0.2, 0.5, 1.2, signed=True)),
    "surface_joule": _one("R_s", "mOhm", 0.06, 0.15, 0.4, factor=1e-3),
    "busbar_joule": _one("R_s", "mOhm", 0.08, 0.22, 0.55, factor=1e-3),
    "end_plate": (Size("G", "W/K", 0.03, 0.08, 0.2), Size("P", "W", 0.12, 0.35, 0.9, signed=True)),
    "coolant_delay": _one("tau", "s", 6.0, 18.0, 45.0),
    "coolant_bypass": _one("b", "1", 0.1, 0.25, 0.5),
    "cell_resistance": _one("a", "1", 0.1, 0.25, 0.6),
    "cell_cooling": _one("a", "1", 0.1, 0.25, 0.6),
    "cell_conduction": _one("a", "1", 0.2, 0.6, 1.5),
    "neighbour_heat": _one("P", "W", 0.35, 1.0, 2.5),
    "phase_change": (
        Size("L", "J", 120.0, 350.0, 900.0),
        Size("T_m", "°C", 4.0, 4.0, 4.0),
        Size("w", "K", 0.7, 0.7, 0.7),
    ),
    "thermocouple_lag": _one("tau", "s", 1.5, 4.0, 10.0),
    "thermocouple_offset": _one("b", "K", 0.25, 0.7, 1.8, signed=True),
    "thermocouple_contact": _one("g", "1", 0.05, 0.15, 0.35),
    "inlet_offset": _one("b", "K", 0.25, 0.6, 1.5, signed=True),
    "current_offset": _one("b", "A", 0.8, 2.2, 5.5, signed=True),
}
"""`T_m` is counted from the pack's mean inlet."""

USUAL = {
    "entropic_heat": 1.1,
    "resistance_temperature": 0.9,
    "resistance_asymmetry": 0.9,
    "charge_transfer": 0.6,
    "polarization": 0.5,
    "ambient_loss": 0.8,
    "natural_convection": 0.6,
    "coolant_delay": 0.2,
    "thermocouple_lag": 0.4,
    "thermocouple_contact": 0.2,
    "thermocouple_offset": 0.3,
    "inlet_offset": 0.6,
    "current_offset": 0.15,
}
"""What every real pack has of each at once: sd of the size, in multiples of medium. The share of the roll is apart."""

ON_A_CELL = ("cell_resistance", "cell_cooling", "cell_conduction", "neighbour_heat")
ON_A_SENSOR = ("thermocouple_offset", "thermocouple_contact")
AFTER_A_CELL = ("coolant_bypass",)
LOCATED = ON_A_CELL + ON_A_SENSOR + AFTER_A_CELL
LEAST_CELLS = dict.fromkeys(ON_A_CELL, 2) | {
    "busbar_joule": 3,
    "end_plate": 3,
    "coolant_bypass": 4,
    "neighbour_heat": 1,
}
"""Strings that are shorter cannot have the effect, or have it under another name."""


@dataclass(frozen=True)
class Needs:
    """What shows an effect: cycles, inlet and flow profiles to choose from, columns that must be there."""

    cycles: tuple = ("urban", "us06", "mixed")
    inlets: tuple = ("steps", "sine")
    flows: tuple = ("constant",)
    columns: tuple = ("flow", "soc")


NEEDS = {
    "entropic_heat": Needs(cycles=("sweep", "pulses")),
    "voltage_heat": Needs(columns=("flow", "soc", "voltage")),
    "resistance_temperature": Needs(cycles=("urban", "mixed"), inlets=("steps",)),
    "resistance_soc": Needs(cycles=("sweep",), inlets=("constant", "sine")),
    "resistance_asymmetry": Needs(cycles=("sweep", "pulses")),
    "charge_transfer": Needs(cycles=("mixed", "pulses"), inlets=("steps",)),
    "hysteresis": Needs(cycles=("pulses",)),
    "polarization": Needs(cycles=("pulses",)),
    "radial_gradient": Needs(cycles=("pulses", "mixed")),
    "resistance_drift": Needs(cycles=("urban",), inlets=("constant", "sine")),
    "cooling_drift": Needs(cycles=("urban",)),
    "flow_dependent_cooling": Needs(flows=("steps",)),
    "natural_convection": Needs(cycles=("mixed", "pulses")),
    "ambient_loss": Needs(inlets=("steps",)),
    "core_loss": Needs(inlets=("steps",)),
    "surface_joule": Needs(cycles=("pulses", "mixed")),
    "busbar_joule": Needs(cycles=("pulses", "mixed")),
    "end_plate": Needs(inlets=("steps",)),
    "coolant_delay": Needs(inlets=("steps",)),
    "coolant_bypass": Needs(inlets=("steps",), flows=("constant", "steps")),
    "phase_change": Needs(cycles=("mixed",), inlets=("steps",)),
    "neighbour_heat": Needs(flows=("steps",)),
    "inlet_offset": Needs(flows=("steps",)),
    "current_offset": Needs(cycles=("us06", "pulses", "sweep")),
}
ANY = Needs()
"""For effects that ask for nothing special."""
