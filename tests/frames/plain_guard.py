"""The rules of the guard as they are told in words, one sample of one channel after the other: an oracle for tests."""

import math
import statistics
from dataclasses import dataclass, field

from bms_gateway.frames.quality import Quality
from bms_gateway.frames.rules import Rule


@dataclass
class Channel:
    """What is remembered of one channel."""

    rule: Rule
    value: float = math.nan
    value_ns: int = 0
    last: Quality = Quality.NEVER
    received_ns: int | None = None
    # the latest usable sample, accepted or not
    previous: float = math.nan
    previous_ns: int = 0
    # trust
    cause: Quality = Quality.NEVER
    calm: int = 0
    needed: int = 1
    strikes: int = 0
    proven: bool = False
    # the value it stays at, for how many samples, how firmly, and since when
    anchor: float = math.nan
    held: int = 0
    held_s: float = 0.0
    firm: int = 0
    since: float = 0.0
    # the value it stayed at longest, and when it was last seen there
    home: float = math.nan
    home_held: int = 0
    home_held_s: float = 0.0
    home_seen: float = 0.0
    # active time
    clock: float = 0.0
    peers_move: bool = False
    moves_around: bool = False
    # of the last 600 samples or so, five repetitions to begin with: how many were the same as the one before, but for
    # those that have followed each other while others moved
    compared: int = 5
    repeats: float = 1.0
    run: int = 0
    # of the last 200 moves: how many went back against the move before, by more than one and a half of the least one
    moves: int = 0
    wide: float = 0.0
    least: float = math.inf
    rose: bool = False
    alone: bool = True
    peers_noisy: bool = False
    # beside its neighbours: samples accepted in a row, distance from the middle, usual step
    trust: int = 0
    distance: float = math.nan
    usual: float = 0.0
    # since a jump while it was good: what it read over its neighbours before, how near that is back, whether it has
    # read less since; where and when its last jump ended, whether it has moved from there, and since when it is back
    was: float = math.nan
    near: float = math.nan
    low: bool = False
    waits: bool = False
    landed: float = math.nan
    moved: bool = False
    jumped_ns: int = 0
    back_ns: int | None = None
    seen: bool = False
    changed: bool = False
    stepped_finely: bool = False
    rejected: dict[Quality, int] = field(default_factory=dict)

    @property
    def kind(self) -> tuple[str, int]:
        return self.rule.quantity, self.rule.group

    @property
    def noisy(self) -> bool:
        return self.repeats <= 0.2 or (self.wide >= 0.03 and self.moves >= 40)

    @property
    def doubted(self) -> bool:
        return self.rule.needs_proof and self.trust < 30


@dataclass
class Middle:
    """Medians of a group of three channels and more: level, distance from that, usual step, distance from home."""

    level: float = math.nan
    spread: float = math.nan
    usual: float = math.nan
    away: float = math.nan


class PlainGuard:
    """Channels and what they know of each other."""

    def __init__(self, rules: list[Rule]) -> None:
        self.channels = [Channel(r) for r in rules]
        self.end_ns: int | None = None
        self.fine: set[tuple[str, int]] = set()
        self.middles = {c.kind: Middle() for c in self.channels}
        self.levels: list[float] = []

    def update(self, samples: list[tuple[int, int, float, Quality]], t1_ns: int, active: list[bool]) -> list[Quality]:
        """Judge (time, channel, value, flag) of one interval, in order."""
        self.levels = [
            c.previous if c.cause == Quality.GOOD or not math.isnan(c.was) else math.nan for c in self.channels
        ]
        for c in self.channels:
            c.seen = c.changed = c.stepped_finely = False
            c.rejected = {}
        told = []
        for time_ns, number, value, flag in samples:
            c = self.channels[number]
            quality = c.last = self.judge(c, time_ns, value, flag)
            c.received_ns = time_ns
            if quality == Quality.GOOD and self.no_noise(c):
                quality = Quality.STUCK  # the sample, not its channel
            told.append(quality)
            if quality == Quality.GOOD:
                c.value, c.value_ns = value, time_ns
            else:
                c.rejected[quality] = c.rejected.get(quality, 0) + 1
        self.fine |= {c.kind for c in self.channels if c.stepped_finely}
        self.pass_time(t1_ns, active)
        return told

    def quality_at(self, number: int, t1_ns: int) -> Quality:
        c = self.channels[number]
        late = c.received_ns is not None and t1_ns - c.received_ns > c.rule.stale_after_ns
        return Quality.STALE if late else c.last

    def pass_time(self, t1_ns: int, active: list[bool]) -> None:
        step = 0.0 if self.end_ns is None else min(max((t1_ns - self.end_ns) * 1e-9, 0.0), 10.0)
        self.end_ns = t1_ns
        remembering = [c for c in self.channels if c.rule.remembers]
        if any(c.seen and c.doubted for c in remembering):
            for kind in self.middles:
                self.compare([c for c in remembering if c.kind == kind], kind)
        for c, on in zip(self.channels, active, strict=True):
            others = [o for o in remembering if o is not c and o.kind == c.kind]
            seen = [o for o in others if o.seen]
            if seen:
                c.peers_move = 2 * sum(o.changed for o in seen) >= len(seen)
            c.peers_noisy = bool(others) and 2 * sum(o.noisy for o in others) >= len(others)
            c.alone = not others
            c.moves_around = on if c.alone else c.peers_move
            if on and c.moves_around:
                c.clock += step

    def compare(self, group: list[Channel], kind: tuple[str, int]) -> None:
        """Find a group's middle at the end of an interval."""
        known = [c for c in group if not math.isnan(c.previous)]
        before, m = self.middles[kind], Middle()
        self.middles[kind] = m
        if len(known) >= 3:
            m.level = statistics.median(c.previous for c in known)
            m.spread = statistics.median(abs(c.previous - m.level) for c in known)
            m.usual = statistics.median(c.usual for c in known)
            m.away = statistics.median(abs(c.previous - c.home) for c in known)
        if abs(m.level - before.level) > 2.0:
            for c in group:
                c.distance = math.nan

    def judge(self, c: Channel, time_ns: int, value: float, flag: Quality) -> Quality:
        rule = c.rule
        quality = by_itself(rule, value, flag)
        if not rule.remembers:
            return quality
        usable = quality == Quality.GOOD
        known = not math.isnan(c.previous)
        step = abs(value - c.previous)
        seconds = max(time_ns - c.previous_ns, 0) * 1e-9
        jumped = usable and known and step > rule.jump + rule.jump_rate * seconds
        astray, far, strays = self.beside(c, value, seconds) if usable and c.doubted else (False, False, False)
        jumped |= known and astray
        low = usable and self.reads_less(c, time_ns, value, jumped)
        c.waits = low if usable else c.waits
        if usable:
            c.seen = True
            c.changed |= step > 0
            c.stepped_finely |= 0 < step < 0.0505
        is_fine = c.kind in self.fine
        limit = rule.stuck_after_s if is_fine else max(rule.stuck_after_s, 1800.0)
        settled = c.cause == Quality.STUCK or (c.home_held >= 2.0 * limit and c.home_held_s >= 2.0 * limit)
        moved, returned = self.follow(c, value, usable, min(seconds, 10.0))
        settled |= strays and c.firm == 3
        stands = c.clock - c.since > (15.0 if c.proven and not returned else 1.0) * limit
        frozen = self.freezes(c, usable and known, value - c.previous, 2.0 * limit) and is_fine
        came_home, before = returned and settled, c.cause
        stuck = usable and not jumped and (stands or frozen or (came_home and rule.needs_proof and is_fine))
        if usable:
            c.previous, c.previous_ns = value, time_ns
        if usable and known:
            c.usual += (step - c.usual) / 8
        if jumped or stuck or not usable:
            c.calm = 0
            c.cause = Quality.STUCK if stuck else Quality.JUMPY if jumped else quality
            if jumped or (stuck and came_home and before != Quality.STUCK):
                c.strikes = min(c.strikes + 1, 6)
                c.needed = 3 * 2**c.strikes
            else:
                c.needed = max(c.needed, 3)
            if usable:
                c.proven = False
            c.trust = 0
            return c.cause
        c.calm += 1
        c.proven |= moved and known and value != c.home
        if c.calm >= 300:
            c.strikes, c.needed = 0, 3
        follows = c.calm >= 8 or c.cause == Quality.GOOD or not far
        accepted = c.calm >= c.needed and (c.proven or not rule.needs_proof) and follows and not low
        c.trust = min(c.trust + 1, 30) if accepted else 0
        c.cause = Quality.GOOD if accepted else Quality.JUMPY if low else c.cause
        return c.cause

    def reads_less(self, c: Channel, time_ns: int, value: float, jumped: bool) -> bool:
        """Whether it has jumped in the last 15 minutes and reads less over its neighbours than before."""
        of_kind = [
            level
            for o, level in zip(self.channels, self.levels, strict=True)
            if o is not c and o.kind == c.kind and o.rule.remembers and not math.isnan(level)
        ]
        middle = statistics.median(of_kind) if len(of_kind) >= 2 else math.nan
        if jumped:
            if math.isnan(c.was) and c.cause == Quality.GOOD:
                c.was, c.near, c.low = c.previous - middle, max(0.5 * c.rule.jump, 3.0 * c.usual), False
            c.jumped_ns, c.back_ns, c.landed, c.moved = time_ns, None, value, False
            return False
        if math.isnan(c.was):
            return False
        c.moved |= value != c.landed
        over = value - middle - c.was
        if math.isnan(over) or over < -c.near:
            c.low, c.back_ns = True, None
        elif c.back_ns is None:
            c.back_ns = time_ns
        back = c.back_ns is not None and time_ns - c.back_ns >= 60 * 1_000_000_000
        late = time_ns - c.jumped_ns >= 900 * 1_000_000_000
        low = c.low and not ((back or late) and c.moved)
        if (c.low and not low) or (not c.low and (late or over <= c.near)):
            c.was = math.nan
        return low

    def beside(self, c: Channel, value: float, seconds: float) -> tuple[bool, bool, bool]:
        """Whether it goes astray, is far from its neighbours, and would come home alone."""
        middle = self.middles[c.kind]
        distance = value - middle.level
        off = distance - c.distance
        late = seconds > 10.0  # between rare frames a cell may leave its neighbours
        astray = not late and abs(off) > 2.0 and abs(off) > 6.0 * middle.usual
        c.distance = distance if astray or late or math.isnan(c.distance) else c.distance + off / 8
        far = abs(distance) > 4.0 and abs(distance) > 6.0 * middle.spread
        return astray, far, c.usual >= 0.2 and middle.away >= 0.1

    def freezes(self, c: Channel, compared: bool, step: float, limit: float) -> bool:
        """Whether it stands amid noise, its own of before and that of its peers."""
        if compared and step == 0 and c.moves_around:
            c.run = min(c.run + 1, 599)
        elif compared:
            more = 1 if step == 0 else c.run + 1
            c.compared = min(c.compared + more, 600)
            c.repeats += (more * (1.0 - c.repeats) - (step != 0)) / c.compared
            c.run = c.run if step == 0 else 0
            if step != 0:
                c.least = min(c.least, abs(step))
                wide = (step > 0) != c.rose and abs(step) > 1.5 * c.least
                c.moves = min(c.moves + 1, 200)
                c.wide += (wide - c.wide) / c.moves
                c.rose = step > 0
        return c.repeats <= 0.2 and c.peers_noisy and min(c.clock - c.since, c.held) > limit

    def no_noise(self, c: Channel) -> bool:
        """Whether it gives the same value more often in a row than its noise would, once in a billion samples."""
        if math.isinf(c.rule.stuck_after_s) or not c.noisy or not (c.peers_noisy or c.alone):
            return False
        if c.repeats <= 0.2:
            return c.run >= 5 and c.repeats**c.run < 1e-9
        return c.run >= 5 and c.run * (1.0 - c.repeats) > 20.7

    def follow(self, c: Channel, value: float, usable: bool, seconds: float) -> tuple[bool, bool]:
        """Whether the anchor has moved, and whether the channel has come home."""
        same, moved = value == c.anchor, False
        if usable:
            c.firm = min(c.firm + 1, 3) if same else c.firm - 1
            c.held += 1
            c.held_s += seconds
            moved = c.firm <= 0
            if moved:
                c.anchor, c.firm, c.held, c.held_s, c.since = value, 1, 1, 0.0, c.clock
        at_home = usable and same and c.anchor == c.home and c.firm >= 2
        longest = c.held > c.home_held
        returned = at_home and not longest and (c.clock > c.home_seen or c.cause == Quality.STUCK)
        if longest or c.clock - c.home_seen > 300.0:
            c.home, c.home_held, c.home_held_s, c.home_seen = c.anchor, c.held, c.held_s, c.clock
        elif at_home:
            c.home_seen = c.clock
        return moved, returned


def by_itself(rule: Rule, value: float, flag: Quality) -> Quality:
    """What range and rails say."""
    if flag not in (Quality.GOOD, Quality.OUT_OF_RANGE):
        return flag
    if value <= rule.low_rail:
        return Quality.SHORT
    if value >= rule.high_rail:
        return Quality.OPEN
    return flag if rule.lower <= value <= rule.upper else Quality.OUT_OF_RANGE
