"""Limits of a channel by its quantity and its DBC signal: range, rails, steps, constant values, age."""

import math
from dataclasses import dataclass

from bms_gateway.frames.signal_info import SignalInfo
from bms_gateway.frames.vocabulary import INPUTS, Quantity

__all__ = ["Rule", "default_rule"]


@dataclass(frozen=True, slots=True)
class Rule:
    """The limits of one channel, in its unit after scaling to SI (°C, A, V).

    Attributes
    ----------
    quantity : Quantity
    group : int
        Channels of one quantity and group (string) are peers: they move together.
    lower, upper : float
        Plausible range; outside is OUT_OF_RANGE.
    low_rail, high_rail : float
        A value at or below the low rail is SHORT, at or above the high rail OPEN; ∓inf for no rail.
    stale_after_ns : int
        Age from which the last value is STALE.
    jump, jump_rate : float
        Largest plausible step: jump + jump_rate · seconds between the samples; inf for no limit.
    stuck_after_s : float
        Active time after which an unmoved channel is STUCK; inf for never.
    needs_proof : bool
        The channel is not used before it has moved.
    round_ns : int
        Longest time from value to value if parts of a multiplexed message take turns; 0 for other signals. The last
        value is then stale after some of the observed periods, if that is later (`freshness.Turns`).
    """

    quantity: Quantity
    group: int = 0
    lower: float = -math.inf
    upper: float = math.inf
    low_rail: float = -math.inf
    high_rail: float = math.inf
    stale_after_ns: int = 5_000_000_000
    jump: float = math.inf
    jump_rate: float = 0.0
    stuck_after_s: float = math.inf
    needs_proof: bool = False
    round_ns: int = 0

    @property
    def remembers(self) -> bool:
        """Whether the rule needs the samples before the present one."""
        return math.isfinite(self.jump) or math.isfinite(self.stuck_after_s) or self.needs_proof


STUCK_FINE_S, FINE_K = 20.0, 0.01
STUCK_COARSE_S, COARSE_K = 1800.0, 0.5
"""At 0.01 K a cell under current moves in seconds; steps of 0.5 K may take half an hour. Geometric in between."""
PROOF_K = 0.05
"""Coarser signals may stand still for a whole drive: with this rule they would never be used."""
FASTEST_CYCLES = 5
"""Missed cycle times after which a value is stale; a second if the DBC states no cycle time."""
LONGEST_ROUND_NS = 60_000_000_000
"""Most parts of a multiplexer: a DBC may list thousands, of which few are sent."""


def default_rule(
    quantity: Quantity,
    info: SignalInfo | None,
    scale: float = 1.0,
    offset: float = 0.0,
    group: int = 0,
    turns: int = 1,
) -> Rule:
    """Choose the rule of a channel by its quantity and by its signal in the DBC.

    Parameters
    ----------
    quantity : Quantity
    info : SignalInfo or None
        None if the resolution, range and cycle time are unknown.
    scale, offset : float
        The channel's own: quantity = scale · decoded + offset.
    group : int
        Number of the string.
    turns : int
        Frames of its message per sample of a multiplexed signal.
    """
    this = INPUTS[quantity]
    lower, upper = this.plausible
    if quantity == "current":
        low_end, high_end = _ends(info, scale, offset)
        lower, upper = max(lower, low_end), min(upper, high_end)
    cycle_ns = 1_000_000_000 if info is None or info.cycle_ns is None else info.cycle_ns
    stale_after_ns = max(FASTEST_CYCLES * cycle_ns, 1_000_000_000)
    round_ns = min(turns * cycle_ns, LONGEST_ROUND_NS) if turns > 1 else 0
    if this.kind != "temperature":
        return Rule(quantity, group, lower, upper, stale_after_ns=stale_after_ns, round_ns=round_ns)
    step = abs(scale) * info.resolution if info is not None else 0.0
    low_rail, high_rail = _rails(info, scale, offset)
    # a temperature stays valid for some ticks of 1 s, even where the DBC names no cycle time
    stale_after_ns = max(stale_after_ns, 10_000_000_000)
    if not this.of_cells:
        # a thermostat may hold the inlet constant, and an opening valve may make it jump
        jump, rate = 10.0, 1.0
        return Rule(quantity, group, lower, upper, low_rail, high_rail, stale_after_ns, jump, rate, round_ns=round_ns)
    slope = math.log(STUCK_COARSE_S / STUCK_FINE_S) / math.log(COARSE_K / FINE_K)
    stuck = STUCK_FINE_S * (max(step, FINE_K) / FINE_K) ** slope
    return Rule(
        quantity,
        group,
        lower,
        upper,
        low_rail,
        high_rail,
        stale_after_ns,
        # inverter noise on good sensors stays under 2 K; at 20C a cell heats by 0.3 K/s
        jump=max(2.5, 2.5 * step),
        jump_rate=0.2,
        stuck_after_s=min(stuck, STUCK_COARSE_S),
        needs_proof=0.0 < step <= PROOF_K,
        round_ns=round_ns,
    )


def _rails(info: SignalInfo | None, scale: float, offset: float) -> tuple[float, float]:
    """Return the ends of the raw range, half a step inwards; none under J1939, where they mean not available."""
    if info is None or info.is_float or info.j1939:
        return -math.inf, math.inf
    low, high = info.raw_limits
    ends = sorted(scale * (raw * info.scale + info.offset) + offset for raw in (low + 0.5, high - 0.5))
    return ends[0], ends[1]


def _ends(info: SignalInfo | None, scale: float, offset: float) -> tuple[float, float]:
    """Return the ends of the range of a current's signal, half a step inwards: there the sensor is out of range.

    Zero does not count as an end, because an unsigned current reads zero at rest.
    """
    if info is None or info.is_float:
        return -math.inf, math.inf
    raw = max(info.raw_limits[0], info.raw_valid[0]), min(info.raw_limits[1], info.raw_valid[1])
    least, most = sorted(scale * (info.scale * limit + info.offset) + offset for limit in raw)
    half = 0.5 * abs(scale) * info.resolution
    return (-math.inf if abs(least) < half else least + half), (math.inf if abs(most) < half else most - half)
