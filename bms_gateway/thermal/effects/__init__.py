"""The catalogue: physical effects that a string model may lack, one file each, and one table that lists them.

A user's own effects are added by the entry point group `bms_gateway.effects`: a class derived from `Effect` whose entry
point has its name in model files.
"""

from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from types import MappingProxyType

from bms_gateway.errors import ConfigError, did_you_mean
from bms_gateway.thermal.effects.ambient_loss import AmbientLoss
from bms_gateway.thermal.effects.base import Effect, EffectParameter
from bms_gateway.thermal.effects.busbar_joule import BusbarJoule
from bms_gateway.thermal.effects.cell_conduction import CellConduction
from bms_gateway.thermal.effects.cell_cooling import CellCooling
from bms_gateway.thermal.effects.cell_resistance import CellResistance
from bms_gateway.thermal.effects.charge_transfer import ChargeTransfer
from bms_gateway.thermal.effects.coolant_bypass import CoolantBypass
from bms_gateway.thermal.effects.coolant_delay import CoolantDelay
from bms_gateway.thermal.effects.cooling_drift import CoolingDrift
from bms_gateway.thermal.effects.core_loss import CoreLoss
from bms_gateway.thermal.effects.current_offset import CurrentOffset
from bms_gateway.thermal.effects.end_plate import EndPlate
from bms_gateway.thermal.effects.entropic_curve import EntropicCurve
from bms_gateway.thermal.effects.entropic_heat import EntropicHeat
from bms_gateway.thermal.effects.flow_dependent_cooling import FlowDependentCooling
from bms_gateway.thermal.effects.hysteresis import Hysteresis
from bms_gateway.thermal.effects.inlet_offset import InletOffset
from bms_gateway.thermal.effects.natural_convection import NaturalConvection
from bms_gateway.thermal.effects.neighbour_heat import NeighbourHeat
from bms_gateway.thermal.effects.phase_change import PhaseChange
from bms_gateway.thermal.effects.polarization import Polarization
from bms_gateway.thermal.effects.radial_gradient import RadialGradient
from bms_gateway.thermal.effects.resistance_asymmetry import ResistanceAsymmetry
from bms_gateway.thermal.effects.resistance_drift import ResistanceDrift
from bms_gateway.thermal.effects.resistance_soc import ResistanceSoc
from bms_gateway.thermal.effects.resistance_temperature import ResistanceTemperature
from bms_gateway.thermal.effects.surface_joule import SurfaceJoule
from bms_gateway.thermal.effects.thermocouple_contact import ThermocoupleContact
from bms_gateway.thermal.effects.thermocouple_lag import ThermocoupleLag
from bms_gateway.thermal.effects.thermocouple_offset import ThermocoupleOffset
from bms_gateway.thermal.effects.voltage_heat import VoltageHeat

__all__ = ["Effect", "EffectParameter", "catalogue", "effect_named"]

GROUP = "bms_gateway.effects"
BUILT_IN: tuple[type[Effect], ...] = (
    EntropicHeat,
    VoltageHeat,
    ResistanceTemperature,
    ResistanceSoc,
    ResistanceAsymmetry,
    ChargeTransfer,
    Hysteresis,
    Polarization,
    RadialGradient,
    ResistanceDrift,
    CoolingDrift,
    FlowDependentCooling,
    NaturalConvection,
    AmbientLoss,
    CoreLoss,
    SurfaceJoule,
    BusbarJoule,
    EndPlate,
    CoolantDelay,
    CoolantBypass,
    CellResistance,
    CellCooling,
    CellConduction,
    NeighbourHeat,
    PhaseChange,
    ThermocoupleLag,
    ThermocoupleOffset,
    ThermocoupleContact,
    InletOffset,
    CurrentOffset,
)
"""Effects in the order in which the catalogue is shown."""
UNLISTED: Mapping[str, Effect] = MappingProxyType({EntropicCurve.name: EntropicCurve()})
"""Effects that a fit may use besides the catalogue, and that no user is offered."""


@cache
def catalogue() -> Mapping[str, Effect]:
    """All effects by name: the built-in ones in their order, then the user's own.

    Raises
    ------
    ConfigError
        An entry point cannot be loaded, is no effect, or has the name of another effect.
    """
    found = {cls.name: cls() for cls in BUILT_IN}
    for point in sorted(entry_points(group=GROUP), key=lambda e: e.name):
        try:
            cls = point.load()
        except (ImportError, AttributeError) as e:
            raise ConfigError(f"effect {point.name!r} of {point.value}: cannot be loaded: {e}") from None
        if not (isinstance(cls, type) and issubclass(cls, Effect)):
            raise ConfigError(f"effect {point.name!r} of {point.value}: is not a class derived from Effect")
        if cls.name in found:
            raise ConfigError(f"effect {point.name!r} of {point.value}: the name {cls.name!r} is taken")
        found[cls.name] = cls()
    return MappingProxyType(found)


def effect_named(name: str) -> Effect:
    """Return the effect of that name.

    Raises
    ------
    ConfigError
        There is none; the message suggests the nearest name.
    """
    if name in UNLISTED:
        return UNLISTED[name]
    try:
        return catalogue()[name]
    except KeyError:
        near = did_you_mean(name, catalogue())
        raise ConfigError(f"effect {name!r} is not in the catalogue{near} (all: bms-gateway effects)") from None
