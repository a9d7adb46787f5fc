"""Corrections that a config makes to its DBC: range, byte order, sign and bits of single signals."""

from dataclasses import replace

from bms_gateway.config.schema import GatewayConfig, Source
from bms_gateway.errors import ConfigError
from bms_gateway.frames.bits import Place
from bms_gateway.frames.database import Database
from bms_gateway.frames.signal_info import SignalInfo


def put_right(where: str, config: GatewayConfig, database: Database) -> Database:
    """Apply `minimum`, `maximum`, `byte_order`, `signed` and `mask` of all signals of a config.

    Parameters
    ----------
    where : str
        Name of the config in error lines.
    config : GatewayConfig
    database : Database

    Raises
    ------
    ConfigError
        The bits of a signal do not allow an override, or two overrides of one signal differ.
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
    """Return a signal with the corrections of the config.

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
    if source.mask is not None:
        info, place = _masked(info, place, source.mask)
    minimum = info.minimum if source.minimum is None else source.minimum
    maximum = info.maximum if source.maximum is None else source.maximum
    if minimum is not None and maximum is not None and minimum >= maximum:
        raise ConfigError(
            f"'{info.path}': minimum {minimum:g} is not below maximum {maximum:g} "
            f"({'the latter' if source.maximum is None else 'the former'} as the DBC declares it)"
        )
    return replace(info, place=place, minimum=minimum, maximum=maximum)


def _masked(info: SignalInfo, place: Place, mask: int) -> tuple[SignalInfo, Place]:
    """Reduce a signal to the bits of a mask; the value of each bit and the labels are kept.

    Raises
    ------
    ConfigError
        The mask is not one run of ones within the signal, or the signal is a floating-point number.
    """
    if info.is_float:
        raise ConfigError(f"mask: '{info.path}' is a floating-point number; it has no bits to leave out")
    low = (mask & -mask).bit_length() - 1
    run = mask >> low
    if run & (run + 1):
        raise ConfigError(f"mask: {mask:#x} is not one run of ones, as 0x0FFF or 0xFF00")
    if mask >= 1 << place.size:
        raise ConfigError(f"mask: '{info.path}' has {place.size} bits; valid: up to {(1 << place.size) - 1:#x}")
    size, above = run.bit_length(), place.size - mask.bit_length()
    if place.big_endian:  # the start is the most significant bit
        first = place.first_bit + above
        start = 8 * (first // 8) + 7 - first % 8
    else:
        start = place.start + low
    choices = {raw >> low: text for raw, text in info.choices.items() if raw == raw & mask}
    start_raw = None if info.start_raw is None else float((int(info.start_raw) & mask) >> low)
    # the raw values of J1939 for "not available" belong to the whole signal
    whole = info.j1939 and size == info.place.size
    info = replace(info, scale=info.scale * 2**low, choices=choices, start_raw=start_raw, j1939=whole)
    return info, replace(place, start=start, size=size)


def turned(info: SignalInfo, big_endian: bool) -> Place:
    """Return the same bytes in the other order.

    Raises
    ------
    ConfigError
        They are not whole bytes, so the meant bits are not determined.
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
