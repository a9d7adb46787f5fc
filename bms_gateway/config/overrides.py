"""Corrections that a config makes to its DBC: range, byte order and sign of single signals."""

from dataclasses import replace

from bms_gateway.config.schema import GatewayConfig, Source
from bms_gateway.errors import ConfigError
from bms_gateway.frames.bits import Place
from bms_gateway.frames.database import Database
from bms_gateway.frames.signals import SignalInfo


def put_right(where: str, config: GatewayConfig, database: Database) -> Database:
    """Apply `minimum`, `maximum`, `byte_order` and `signed` of all signals of a config.

    Parameters
    ----------
    where : str
        What error lines call the config.
    config : GatewayConfig
    database : Database

    Raises
    ------
    ConfigError
        An override that the bits of the signal cannot follow, or two of one signal that differ.
    """
    changed: dict[str, tuple[str, SignalInfo]] = {}
    for number, string in enumerate(config.string, 1):
        if string.signals is None:
            continue
        for key, source in string.signals.sources():
            if source.signal is None or not source.overrides:
                continue
            place = f"string[{number}].signals.{key}"
            try:
                info = overridden(database.resolve(source.signal), source)
            except ConfigError as e:
                raise ConfigError(f"{where}: {place}: {e}") from None
            other, before = changed.setdefault(source.signal, (place, info))
            if before != info:
                raise ConfigError(f"{where}: {place}: '{source.signal}' is otherwise at {other}; say the same at both")
    return database.changed([info for _, info in changed.values()]) if changed else database


def overridden(info: SignalInfo, source: Source) -> SignalInfo:
    """Give a signal with the corrections of the config.

    Raises
    ------
    ConfigError
        The bits of the signal do not allow this correction.
    """
    place = info.place
    if source.byte_order is not None:
        place = turned(info, source.byte_order == "big_endian")
    if source.signed is not None:
        if info.is_float:
            raise ConfigError(f"signed: '{info.path}' is a floating-point number, which has a sign anyway")
        place = replace(place, signed=source.signed)
    minimum = info.minimum if source.minimum is None else source.minimum
    maximum = info.maximum if source.maximum is None else source.maximum
    if minimum is not None and maximum is not None and minimum >= maximum:
        raise ConfigError(
            f"'{info.path}': minimum {minimum:g} is not below maximum {maximum:g} "
            f"({'the latter' if source.maximum is None else 'the former'} as the DBC declares it)"
        )
    return replace(info, place=place, minimum=minimum, maximum=maximum)


def turned(info: SignalInfo, big_endian: bool) -> Place:
    """Give the same bytes in another order.

    Raises
    ------
    ConfigError
        They are not whole bytes, so that nothing says which bits would be meant.
    """
    place = info.place
    if place.big_endian == big_endian:
        return place
    first = place.first_bit
    if first // 8 == (first + place.size - 1) // 8:  # within one byte both orders are the same bits
        start = place.start + (place.size - 1) * (1 if big_endian else -1)
        return replace(place, start=start, big_endian=big_endian)
    if first % 8 or place.size % 8:
        raise ConfigError(f"byte_order: '{info.path}' is not of whole bytes; correct its bits in the DBC")
    return replace(place, start=first + 7 if big_endian else first, big_endian=big_endian)
