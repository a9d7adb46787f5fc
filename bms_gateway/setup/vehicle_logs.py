"""Reads logs and DBC of a vehicle without a config, leniently; everything that was skipped is reported."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from bms_gateway.bus.backwards import how_to_sort
from bms_gateway.bus.logfile import LogNotes, read_log
from bms_gateway.config.dbc_files import dbc_text, own_dbc_text, read_dbc
from bms_gateway.config.read_bounds import bounded
from bms_gateway.engine.stamps import LONGEST_NS, Clock
from bms_gateway.errors import ConfigError, DataError
from bms_gateway.frames.batch import EXTENDED, FrameBatch
from bms_gateway.frames.dbc import parse_lenient
from bms_gateway.frames.decode import Samples, decode
from bms_gateway.frames.j1939 import MARK, parameter_group
from bms_gateway.frames.own_dbc import MAX_STRINGS, OWN_DBC, input_messages
from bms_gateway.frames.signal_info import MessageInfo, SignalInfo
from bms_gateway.frames.signal_table import SignalTable
from bms_gateway.report.progress import progress
from bms_gateway.setup.intervals import seen_s, silence_in

MOST_FRAMES: Final = 2_000_000
"""Most frames that are read: a quarter of an hour of a busy bus, which is enough to recognise its signals."""
BETWEEN_LOGS_NS: Final = 60_000_000_000
WRONG: Final = "the time stamps are wrong"
LEAST_S: Final = 1.0
"""A shorter log has no tick of the engine."""
CHUNK: Final = 100_000
"""Number of frames that are compared at once."""


@dataclass(slots=True)
class Traffic:
    """Frames of all logs on one time axis, and the messages of the DBC files that occur in them.

    Attributes
    ----------
    frames : FrameBatch
    messages : dict of name to MessageInfo
        Only those seen; if the source address of J1939 differs, with the identifier that was seen.
    corrected : list of str
        Faults of the DBC files that were corrected: the needed part is written as a new file. If there are none, a
        config may name the DBC files.
    readdressed : dict of message to str
        Why a config that names the DBC files may read a parameter group of J1939 from another address.
    remarks : list of str
        Faults of logs and DBC files, one sentence each.
    unknown : dict of int to int
        Number of frames of each identifier that no DBC contains.
    own : bool
        Whether the traffic uses our own DBC.
    dbc : tuple of Path
    """

    frames: FrameBatch
    messages: dict[str, MessageInfo]
    corrected: list[str] = field(default_factory=list)
    readdressed: dict[str, str] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    unknown: dict[int, int] = field(default_factory=dict)
    own: bool = False
    dbc: tuple[Path, ...] = ()

    def decode(self, signals: Sequence[SignalInfo]) -> Samples:
        """Decode signals of all frames, as the DBC declares them or with changed attributes."""
        known = dict(self.messages)
        for s in signals:
            message = known[s.message]
            known[s.message] = replace(message, signals={**message.signals, s.name: s})
        return decode(SignalTable.build(list(signals), known), self.frames)

    @property
    def seconds(self) -> float:
        """Length of the traffic without the silences."""
        return seen_s(self.frames.time_ns)


def read_traffic(logs: Iterable[Path], dbc: Sequence[Path]) -> Traffic:
    """Read logs and DBC files.

    Raises
    ------
    ConfigError, DataError, UsageError
        A log or a DBC that cannot be read at all, no frame in any log, or frames that show no movement.
    """
    logs = list(logs)
    remarks: list[str] = []
    frames = _frames(logs, remarks)
    if not len(frames):
        raise DataError(f"{', '.join(str(p) for p in logs)}: no data frames in there")
    messages: list[MessageInfo] = []
    corrected: list[str] = []
    ours_whole = read_dbc(OWN_DBC, own_dbc_text())
    own_ids = {m.name: m.can_id for m in ours_whole}
    foreign: list[Path] = []
    for file in dbc:
        found = _read(file, remarks, corrected)
        if found and all(own_ids.get(m.name) == m.can_id for m in found):
            continue  # our own DBC, which every config has
        foreign.append(file)
        messages += found
    ids, counts = np.unique(frames.can_id, return_counts=True)
    seen = dict(zip(ids.tolist(), counts.tolist(), strict=True))
    chosen, readdressed = _among(messages, seen, remarks, corrected)
    remarks += [
        f"{m.database}: {m.name}.{s.name} has a scale of zero, so that it always says {s.offset:g}: correct the DBC"
        for m in chosen.values()
        for s in m.signals.values()
        if s.scale == 0.0
    ][:MOST_SCALES]
    own = {m.can_id: m for m in ours_whole if m.name in _OWN_INPUTS}
    ours = {i: m for i, m in own.items() if i in seen and i not in {c.can_id for c in chosen.values()}}
    is_own = len(ours) >= 3 and not chosen
    if is_own:
        chosen = {m.name: m for m in ours.values()}
    known = {m.can_id for m in chosen.values()}
    unknown = {i: n for i, n in seen.items() if i not in known}
    traffic = Traffic(frames, chosen, corrected, readdressed, remarks, unknown, is_own, tuple(foreign))
    if why := _useless(traffic):
        wrong = "".join(f" ({r})" for r in remarks if WRONG in r)
        raise DataError(f"{', '.join(str(p) for p in logs)}: {why}{wrong}; record a drive of some minutes")
    return traffic


_OWN_INPUTS = frozenset(name for k in range(1, MAX_STRINGS + 1) for name in input_messages(k))


def _frames(logs: list[Path], remarks: list[str]) -> FrameBatch:
    parts: list[FrameBatch] = []
    total, end = 0, None
    for log in logs:
        notes, clock = LogNotes(), Clock()
        mine: list[FrameBatch] = []
        with progress(log.name, None) as advance:
            for batch in read_log(log, notes=notes):
                mine.append(clock.straighten(batch))
                total += len(batch)
                advance(len(batch))
                if total >= MOST_FRAMES:
                    break
        of_log = FrameBatch.concat(mine)
        if len(of_log):
            # logs of different days on one time axis
            shift = 0 if end is None else end + BETWEEN_LOGS_NS - int(of_log.time_ns[0])
            if int(of_log.time_ns[-1]) + shift > LONGEST_NS:
                raise DataError(f"{log}: by their stamps these logs last for centuries in all; give fewer of them")
            parts.append(replace(of_log, time_ns=of_log.time_ns + shift))
            end = int(parts[-1].time_ns[-1])
        if notes.broken:
            line, text = notes.broken_at[0]
            remarks.append(f"{log}: {notes.broken} damaged lines skipped, the first at line {line}: {text!r}")
        if faults := clock.faults():
            sort = f"; if its parts are in the wrong order, {how_to_sort(log)}" if clock.set_back else ""
            remarks.append(f"{log}: {WRONG}: {faults}; time only goes forward{sort}")
        if silence := silence_in(of_log.time_ns):
            remarks.append(f"{log}: {silence}")
        if total >= MOST_FRAMES:
            remarks.append(f"only the first {total} frames were looked at")
            break
    return FrameBatch.concat(parts)


MOST_SCALES: Final = 5
"""Scales of zero that are told."""


def _useless(traffic: Traffic) -> str | None:
    """Say why the movement of the bits identifies no signal; None if it may."""
    f = traffic.frames
    what = f"{len(f)} frame{'s' if len(f) > 1 else ''}"
    if traffic.seconds < LEAST_S:
        when = f"within {traffic.seconds:.3g} s" if traffic.seconds > 0 else "at one time"
        return f"{what} {when} show no movement"
    ids, first, which = np.unique(f.can_id, return_index=True, return_inverse=True)
    for start in range(0, len(f), CHUNK):
        part = slice(start, start + CHUNK)
        if (f.data[part] != f.data[first[which[part]]]).any():
            return None
    of_ids = f"{len(ids)} identifier{'s' if len(ids) > 1 else ''}"
    return f"no bit of {what} of {of_ids} changes in {traffic.seconds:.0f} s"


def _read(file: Path, remarks: list[str], corrected: list[str]) -> list[MessageInfo]:
    text = dbc_text(file)
    try:
        return read_dbc(str(file), text)
    except ConfigError as e:
        with bounded(str(file)):
            found = parse_lenient(str(file), text)
        if found is None:
            raise
        remarks.append(f"{e}. It was read in spite of that; what is needed of it is written anew")
        corrected.append(str(e))
        return found


def _among(
    messages: list[MessageInfo], seen: dict[int, int], remarks: list[str], corrected: list[str]
) -> tuple[dict[str, MessageInfo], dict[str, str]]:
    """Give the messages seen (of J1939 at the identifier seen), and why some need this identifier in the DBC."""
    chosen: dict[str, MessageInfo] = {}
    readdressed: dict[str, str] = {}
    by_id = {m.can_id: m for m in messages}
    for m in messages:
        if m.can_id in seen:
            if by_id[m.can_id] is not m or m.name in chosen:
                corrected.append(f"{m.database}: message {m.name} is in the DBC files twice; the last one was taken")
                remarks.append(corrected[-1])
            chosen[m.name] = m
    groups: dict[int, list[int]] = {}
    for i in seen:
        if i & EXTENDED and i not in by_id:
            groups.setdefault(parameter_group(i), []).append(i)
    known = Counter(parameter_group(m.can_id) for m in messages if m.can_id & EXTENDED)
    unmarked: dict[str, list[tuple[str, int]]] = {}
    for m in messages:
        if m.name in chosen or not m.can_id & EXTENDED:
            continue
        group = parameter_group(m.can_id)
        there = sorted(groups.get(group, []), key=lambda i: -seen[i])
        if there and not m.any_sender and known[group] == 1:
            unmarked.setdefault(m.database, []).append((m.name, there[0] & 0xFF))
        if there and m.any_sender:
            chosen[m.name] = _at(m, there[0])
            readdressed |= _readdressed(m, there, known[group])
            more = ", ".join(f"0x{i & 0xFF:02X}" for i in there[1:])
            others = f" (and from {more}: `[bus] source_address` in gateway.toml chooses)" if more else ""
            remarks.append(
                f"{m.name}: its parameter group comes from address 0x{there[0] & 0xFF:02X}{others}, "
                f"not from 0x{m.can_id & 0xFF:02X} as in the DBC"
            )
    at_home = Counter(m.database for m in chosen.values() if m.can_id & EXTENDED)
    # if most identifiers match the DBC, the last byte of the others is no address either
    remarks += [_unmarked(file, names) for file, names in unmarked.items() if len(names) > at_home[file]]
    return chosen, readdressed


def _readdressed(m: MessageInfo, there: list[int], known: int) -> dict[str, str]:
    """Say why a config that names the DBC may read another address than the first of these; empty if it does not."""
    if len(there) == 1 and known == 1:
        return {}
    why = f"{len(there)} addresses send it" if len(there) > 1 else "the DBC defines it for other addresses"
    return {m.name: f"{m.name} is read from address 0x{there[0] & 0xFF:02X}, and {why}"}


def _unmarked(file: str, elsewhere: list[tuple[str, int]]) -> str:
    """Report that messages, if they are of J1939, come from another source address, and how to have them read."""
    names = ", ".join(name for name, _ in elsewhere[:3]) + (" …" if len(elsewhere) > 3 else "")
    addresses = ", ".join(f"0x{address:02X}" for address in sorted({a for _, a in elsewhere})[:3])
    return (
        f"{file}: no frame has the identifier of {names}, but the same parameter group comes from another source "
        f"address, {addresses}. If the messages are of J1939, add this line at the end of the DBC: {MARK}"
    )


def _at(m: MessageInfo, can_id: int) -> MessageInfo:
    return replace(m, can_id=can_id, signals={n: replace(s, can_id=can_id) for n, s in m.signals.items()})
