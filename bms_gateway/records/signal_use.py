"""The use of each configured signal: seen, used, refused and why, observed and allowed range, and how to correct it."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from bms_gateway.config.units import signal_conversion
from bms_gateway.engine import Engine
from bms_gateway.engine.inputs import Inputs
from bms_gateway.engine.plan import Channel, Plan
from bms_gateway.engine.reasons import WRONG_SIGN, why_not
from bms_gateway.frames.database import Database
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.signal_info import SignalInfo
from bms_gateway.frames.vocabulary import INPUTS, OPTIONAL

ROUNDED: Final = 1e-9
"""A smaller offset is a rounding error of the conversion of a unit."""
WORTH_A_WORD: Final = 0.05
"""Share of refused samples above which a signal is reported; at every start a few samples are refused."""
LOST: Final = 0.5
"""Share of refused samples above which a signal counts as not used."""
UNLIKE: Final = 8.0
"""Ratio between the resistance from current and voltage and that of the model, above which a signal or the model is
wrong; the resistance of an unnamed cell is known to a factor of three."""
OF_A_CELL_V: Final = (1.2, 4.6)
"""Range of the mean voltage of a cell over a log, for all chemistries; lithium titanate goes down to 1.5 V."""
USUAL_V: Final = 3.6
"""Mean voltages of most cells in vehicles: 3.3 V (iron phosphate) to 3.8 V (nickel and cobalt)."""
OTHER_UNITS: Final = {
    "temperature": (("K", 1.0, -273.15), ("°C and not in K", 1.0, 273.15)),
    "current": (("mA", 1e-3, 0.0),),
    "voltage": (("mV", 1e-3, 0.0),),
}
"""Units that a signal may have instead of its unit in the DBC: right value = scale · value by the DBC + offset."""
NOT_TAKEN: Final = "nothing is estimated from it with this config"


@dataclass(frozen=True, slots=True)
class Use:
    """One signal, for all strings that use it.

    Attributes
    ----------
    key : str
        Key in the config, such as `string_1.current` or `string_2.surface.3`; the first one if several strings use the
        signal.
    channel : Channel
    info : SignalInfo
        The signal with the corrections of the config.
    seen, used : int
    refused : dict of reason to int
    observed : (float, float) or None
        Least and greatest value of all samples, used or refused, in the DBC's unit; None if there was no sample.
    allowed : (float, float)
        Range that the DBC (or the config in its place) and the gateway accept, in the DBC's unit.
    taken : bool
        Whether an estimator uses it.
    stated : bool
        Whether the config names it; signals of our own DBC that the config does not name need not be sent.
    sender : int or None
        Source address from which its parameter group comes, if the DBC names another one.
    """

    key: str
    channel: Channel
    info: SignalInfo
    seen: int
    used: int
    refused: dict[str, int]
    observed: tuple[float, float] | None
    allowed: tuple[float, float]
    taken: bool = True
    stated: bool = True
    sender: int | None = None

    @property
    def lost(self) -> bool:
        """Whether the config names a signal of which (nearly) nothing is used."""
        if not self.taken or (not self.stated and self.channel.quantity in OPTIONAL):
            return False
        return self.used < LOST * self.seen or self.used == 0

    @property
    def cut(self) -> bool:
        """Whether a part of a current is beyond its range: its heat is missing, and its numbers may be wrong bits."""
        beyond = self.refused.get("out_of_range", 0)
        return self.taken and self.channel.quantity == "current" and beyond > WORTH_A_WORD * self.seen

    def document(self) -> dict[str, Any]:
        """For machines."""
        return {
            "seen": self.seen,
            "used": self.used,
            "refused": self.refused,
            "observed": None if self.observed is None else [_short(x) for x in self.observed],
            "allowed": [_short(x) for x in self.allowed],
            "unit": self.info.unit,
            "key": self.key,
        } | ({} if self.taken else {"note": NOT_TAKEN})


def signal_use(plan: Plan, database: Database, engine: Engine, stated: set[str]) -> dict[str, Use]:
    """Collect how an engine used each of its signals.

    Parameters
    ----------
    plan : Plan
    database : Database
    engine : Engine
        After the traffic.
    stated : set of str
        Names of the strings whose signals the config names.

    Returns
    -------
    dict of signal ("Message.Signal") to Use
        In the order of the plan; a signal that several strings take is told once.
    """
    found: dict[str, Use] = {}
    for string, wire in zip(plan.strings, engine.wires, strict=True):
        for c in string.carried:
            if c.signal is None or c.signal in found:
                continue
            i = wire.of(c)
            info = database.resolve(c.signal)
            key = f"{string.name}.{c.quantity}{_part(c)}"
            allowed = allowed_range(c, info)
            if i < 0:
                found[c.signal] = Use(key, c, info, 0, 0, {}, None, allowed, False, string.name in stated)
                continue
            half = engine.inputs.both_ways.half(i, c.way)
            counts = engine.counts[i] if half is None else half.counted(engine.counts[i])
            low, high = (float(x) for x in engine.extremes[:, i if half is None else half.signal])
            refused = {
                Quality(q).name.lower(): int(n) for q, n in enumerate(counts.tolist()) if n and q != Quality.GOOD
            }
            observed = (low, high) if math.isfinite(low) and math.isfinite(high) else None
            seen, used = int(counts.sum()), int(counts[Quality.GOOD])
            found[c.signal] = Use(
                key,
                c,
                info,
                seen,
                used,
                refused,
                observed,
                allowed,
                True,
                string.name in stated,
                engine.senders.get(info.can_id),
            )
    return found


def channel_of(uses: dict[str, Use], string: str, cell: int) -> str | None:
    """Give the signal of a cell's thermocouple, if the config names one."""
    key = f"{string}.surface.{cell}"
    return next((signal for signal, use in uses.items() if use.key == key and use.stated), None)


def _part(c: Channel) -> str:
    """Give what the config writes after the quantity: a cell, a statistic, or a direction of the current."""
    if c.way != 0:
        return ".discharge" if c.way > 0 else ".charge"
    return f".{c.statistic}_of" if c.statistic is not None else "" if c.cell is None else f".{c.cell}"


def allowed_range(c: Channel, info: SignalInfo) -> tuple[float, float]:
    """Give the accepted range in the DBC's unit: the declared range, as far as the bits hold it and it is plausible."""
    raw = max(info.raw_valid[0], info.raw_limits[0]), min(info.raw_valid[1], info.raw_limits[1])
    low, high = sorted(x * info.scale + info.offset for x in raw)
    ends = sorted((x - c.offset) / c.scale for x in INPUTS[c.quantity].plausible)
    return max(low, ends[0]), min(high, ends[1])


def advice(uses: dict[str, Use]) -> Iterator[str]:
    """For each signal that is not used as configured, say what was seen and which line of the config corrects it.

    Signals that never come are last: they may be all signals of a string that is not on this bus.
    """
    elsewhere = {use.info.message: use for use in uses.values() if use.sender is not None}
    for message, use in elsewhere.items():
        named = use.info.can_id & 0xFF
        yield f"{message} is read from source address {use.sender}, the first that sends it; the DBC names {named}"
    wanted = {s: use for s, use in uses.items() if use.taken and (use.stated or use.channel.quantity not in OPTIONAL)}
    for signal, use in wanted.items():
        # no sensor has moved at first; this is reported only if the sensor never moves
        waiting = 0 if use.lost else use.refused.get("never", 0)
        lost = use.seen - use.used
        if lost - waiting <= WORTH_A_WORD * use.seen or not use.refused:
            continue
        most = max(use.refused, key=lambda reason: use.refused[reason] * (use.lost or reason != "never"))
        share = f"{use.key} ({signal}) refused {100 * lost / use.seen:.0f} %"
        if most == "out_of_range" and use.observed is not None:
            (low, high), (least, most_allowed), unit = use.observed, use.allowed, use.info.unit
            allowed = (
                f"allowed {least:g} … {most_allowed:g}" if least <= most_allowed else "the DBC allows no such value"
            )
            ends = f"observed {low:g} … {high:g} {unit}, {allowed}"
            yield f"{share}: {ends}: {_remedy(signal, use)}"
        else:
            yield f"{share}, mostly: {why_not(use.channel.quantity, Quality[most.upper()])}"
    for signal, use in wanted.items():
        if not use.seen:
            yield f"{use.key}: {signal} never comes in this log: is it another message, bus or source address?"


def contradictions(plan: Plan, inputs: Inputs) -> Iterator[str]:
    """List currents that contradict their voltage, and voltages that contradict the number of cells.

    A current is contradicted in its sign, or in a size that such a cell cannot have.

    Parameters
    ----------
    plan : Plan
    inputs : Inputs
        After the traffic.
    """
    yield from _other_cells(plan, inputs)
    model = {s.name: s.model for s in plan.strings}
    for string, channel, meter in inputs.compared():
        where = f"{string}.current ({channel.source})"
        if meter.reversed:
            yield f"{where}: {WRONG_SIGN}"
        expected = float(np.sum(model[string].nominal.R_e))
        ratio = meter.resistance / expected
        if not ratio > UNLIKE and not ratio < 1.0 / UNLIKE:  # nor where there is nothing to compare
            continue
        n = model[string].cells
        shown, own = (1e3 * x / n for x in (meter.resistance, expected))
        power = 3 * round(math.log10(ratio) / 3)
        unit = power and abs(math.log10(ratio) - power) < math.log10(UNLIKE)
        mend = f"scale = {10.0**power:g} in its entry corrects it if the unit is wrong" if unit else "check its scale"
        yield (
            f"{where}: where it steps, the voltage steps as if a cell had {shown:.3g} mΩ, and the model file says "
            f"{own:.3g} mΩ: {mend}, else look at R_e of the model and at the scale of the voltage"
        )


def _other_cells(plan: Plan, inputs: Inputs) -> Iterator[str]:
    """List voltages that are impossible for the number of cells, and the likely number of cells."""
    for string, wire in zip(plan.strings, inputs.wires, strict=True):
        meter, n = inputs.ammeter(wire), string.model.cells
        if meter is None or math.isnan(meter.volts) or OF_A_CELL_V[0] <= meter.volts / n <= OF_A_CELL_V[1]:
            continue
        volts, likely = meter.volts, max(round(meter.volts / USUAL_V), 0)
        ratio = meter.resistance / float(np.sum(string.model.nominal.R_e))
        if likely > n and abs(math.log(ratio)) < abs(
            math.log(ratio * n / likely)
        ):  # a cell of the model is several in series
            continue
        signal = next(c.signal for c in string.channels if c.quantity == "voltage")
        if likely:
            mend = f"it is that of about {likely} cells in series: correct cells in the model file"
        else:
            mend = "is it the voltage of a battery, in this unit?"
        if likely > n:
            mend += f", or multiply the scale of the voltage by {n / likely:.3g} if it is that of the whole pack"
        yield (
            f"{string.name}.voltage ({signal}): {volts:.3g} V on average are {volts / n:.3g} V for each of the {n} "
            f"cells of the model, and no cell has such a voltage: {mend}"
        )


def _remedy(signal: str, use: Use) -> str:
    """Give the config line with which the observed range would be accepted, or another likely reason."""
    assert use.observed is not None  # noqa: S101 — asked for only where something was observed
    c, info, (low, high) = use.channel, use.info, use.observed
    ends = sorted((x - c.offset) / c.scale for x in INPUTS[c.quantity].plausible)
    if low == high and not info.is_float and round((low - info.offset) / info.scale) == info.raw_limits[1]:
        return "all its bits are one in each frame: nothing is measured there"
    if (mend := _unit(signal, use)) is not None:
        return mend
    if high < ends[0] or low > ends[1]:
        believed = f"{ends[0]:g} … {ends[1]:g}"
        return f"no value of a {c.quantity.replace('_', ' ')} ({believed} in this unit): set scale and offset"
    if c.quantity == "current" and info.raw_limits[0] >= 0 and high > 0.9 * (info.raw_limits[1] * info.scale):
        return f"two's complement? {{ {', '.join([*_written(signal, use), 'signed = true'])} }} reads it so"
    fields = _written(signal, use)
    stated = len(fields)
    if info.minimum is not None and low < info.minimum:
        fields.append(f"minimum = {max(low, ends[0]):g}")
    if info.maximum is not None and high > info.maximum:
        fields.append(f"maximum = {min(high, ends[1]):g}")
    if len(fields) == stated:
        return "its ends are where the sensor has run out of range"
    real = f"if that is real, set minimum/maximum: {use.key.split('.', 1)[1]} = {{ {', '.join(fields)} }}"
    return real + (", else look at its byte order, sign and factor in the DBC" if c.quantity == "current" else "")


def _written(signal: str, use: Use) -> list[str]:
    """Give the keys that the config's line already has; the corrected line keeps them."""
    c = use.channel
    own, shift = _stated(use)
    fields = [] if c.statistic is None else [f'{c.statistic}_of = "{_cells(c.among)}"']
    fields.append(f'signal = "{signal}"')
    if not math.isclose(own, 1.0):
        fields.append(f"scale = {own:g}")
    if abs(shift) > ROUNDED:
        fields.append(f"offset = {shift:g}")
    return fields


def _stated(use: Use) -> tuple[float, float]:
    """Scale and offset as the config has them, without the conversion of the DBC's unit."""
    factor, offset = signal_conversion(use.channel.quantity, use.info.unit)
    own = use.channel.scale / factor
    return own, use.channel.offset - own * offset


def _cells(among: Sequence[int]) -> str:
    return f"{among[0]}-{among[-1]}" if len(among) == among[-1] - among[0] + 1 else ",".join(map(str, among))


def _unit(signal: str, use: Use) -> str | None:
    """Give the config line that reads the observed values in another unit than the DBC says; None where none fits."""
    assert use.observed is not None  # noqa: S101 — asked for only where something was observed
    c, observed = use.channel, use.observed
    low, high = INPUTS[c.quantity].plausible
    least, most = sorted(c.scale * x + c.offset for x in observed)
    if low <= least and most <= high:
        return None
    kind = INPUTS[c.quantity].kind
    for unit, scale, offset in OTHER_UNITS.get(kind, ()):
        a, b = scale * least + offset, scale * most + offset
        if not (low <= a and b <= high):
            continue
        own, shift = _stated(use)
        fields = [f'signal = "{signal}"']
        if not math.isclose(scale * own, 1.0):
            fields.append(f"scale = {scale * own:g}")
        if abs(scale * shift + offset) > ROUNDED:
            fields.append(f"offset = {scale * shift + offset:g}")
        declared = use.info.minimum, use.info.maximum
        if declared[0] is not None and observed[0] < declared[0]:
            fields.append(f"minimum = {observed[0]:g}")
        if declared[1] is not None and observed[1] > declared[1]:
            fields.append(f"maximum = {observed[1]:g}")
        return f"is it in {unit}? {use.key.split('.', 1)[1]} = {{ {', '.join(fields)} }} reads it so"
    return None


def _short(x: float) -> float | None:
    return float(f"{x:.7g}") if math.isfinite(x) else None
