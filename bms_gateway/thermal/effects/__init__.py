"""The catalogue: physical effects that a string model may lack, one file each, and one table that lists them.

Effects of a user's own come in by the entry point group `bms_gateway.effects`: a class derived from `Effect`, named as
it is named in model files.
"""

from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from types import MappingProxyType

from bms_gateway.errors import ConfigError, did_you_mean
from bms_gateway.thermal.effects.base import Effect, EffectParameter
from bms_gateway.thermal.effects.resistance_temperature import ResistanceTemperature

__all__ = ["Effect", "EffectParameter", "catalogue", "effect_named"]

GROUP = "bms_gateway.effects"
BUILT_IN: tuple[type[Effect], ...] = (ResistanceTemperature,)


@cache
def catalogue() -> Mapping[str, Effect]:
    """All effects by name: the built-in ones in their order, then a user's own.

    Raises
    ------
    ConfigError
        An entry point that cannot be loaded, is no effect, or takes a name that is taken.
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
        There is none; says which is meant.
    """
    try:
        return catalogue()[name]
    except KeyError:
        raise ConfigError(f"effect {name!r} is not in the catalogue{did_you_mean(name, catalogue())}") from None
