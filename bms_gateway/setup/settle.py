"""Turns a proposal into files that the gateway runs with: reports what is missing, removes refused thermocouples."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from bms_gateway.config.load import load_config
from bms_gateway.engine import Engine, Estimated, Parameters, drive
from bms_gateway.engine.reasons import REASONS
from bms_gateway.frames.batch import EXTENDED, FrameBatch
from bms_gateway.frames.quality import Quality
from bms_gateway.records.signal_use import Use, signal_use
from bms_gateway.setup.picture import Cores
from bms_gateway.setup.proposal import Proposal
from bms_gateway.setup.vehicle_logs import Traffic
from bms_gateway.setup.write import Written, write_setup
from bms_gateway.thermal.cells import CellFacts

MOST_TICKS: Final = 3600
"""Greatest number of seconds that are estimated: enough for the first cores. A clock that jumps may turn a log of
minutes into weeks."""

PIECE_S: Final = 600.0


@dataclass(frozen=True, slots=True)
class Settled:
    """The written files, the first cores estimated with them, and the use of each signal.

    Attributes
    ----------
    notes : tuple of str
        Remarks for the user.
    """

    written: Written
    cores: Cores
    uses: dict[str, Use]
    notes: tuple[str, ...] = ()


def missing(proposal: Proposal, traffic: Traffic) -> str | None:
    """Say why no config can be made; None if one can be made."""
    if not traffic.messages:
        frequent = sorted(traffic.unknown, key=lambda i: -traffic.unknown[i])[:5]
        given = "is in the DBC" if traffic.dbc else "is known: give the vehicle's DBC with --dbc"
        return (
            f"none of the {len(traffic.unknown)} identifiers of these logs {given}; "
            f"the most frequent are {', '.join(f'0x{i & ~EXTENDED:X}' for i in frequent)}: no config was written"
        )
    lost = None
    if next(proposal.of("current"), None) is None:
        lost = "a current of the pack"
    elif not proposal.cells:
        lost = "a temperature of cells"
    if lost is None:
        return None
    where = "correct the DBC where the notes say it is wrong" if traffic.corrected else "is it in another DBC or log?"
    return f"no signal is {lost}: nothing was written; {where}"


def settle(proposal: Proposal, traffic: Traffic, out: Path, *, cell: CellFacts | None, logs: Iterable[Path]) -> Settled:
    """Write a config and its models, and estimate with them; leave out thermocouples whose samples are always refused.

    Raises
    ------
    UsageError
        The folder cannot be written.
    """
    logs = list(logs)
    written = write_setup(proposal, traffic, out, cell=cell, logs=logs)
    cores, uses, cut = _estimate(written.config, traffic)
    if _without_refused(proposal, uses):  # it is not a sensor
        written = write_setup(proposal, traffic, out, cell=cell, logs=logs)
        cores, uses, cut = _estimate(written.config, traffic)
    notes = written.numbered + written.notes
    if cut:
        notes += (f"the cores are of the first {MOST_TICKS / 3600:g} h of the log: analyze takes all of it",)
    return Settled(written, cores, uses, notes)


def _estimate(config: Path, traffic: Traffic) -> tuple[Cores, dict[str, Use], bool]:
    """Run the engine over the frames, up to `MOST_TICKS`; return whether frames remain."""
    loaded = load_config(config)
    engine = Engine(loaded.plan, loaded.database)
    cores, ticks = Cores(), 0
    for event in drive(engine, _pieces(traffic.frames)):
        if isinstance(event, Parameters):
            cores.learn(event)
        elif isinstance(event, Estimated):
            cores.take(event)
            ticks += 1
            if ticks == MOST_TICKS:
                break
    uses = signal_use(loaded.plan, loaded.database, engine, {s.name for s in loaded.plan.strings})
    return cores, uses, ticks == MOST_TICKS


def _pieces(frames: FrameBatch) -> Iterator[FrameBatch]:
    """Cut frames into pieces of `PIECE_S`: the engine processes all frames that it is given at once."""
    part = (frames.time_ns - frames.time_ns[0]) // int(PIECE_S * 1e9)
    edges = [0, *(np.flatnonzero(np.diff(part)) + 1).tolist(), len(frames)]
    for first, end in pairwise(edges):
        yield frames[first:end]


def _without_refused(proposal: Proposal, uses: Mapping[str, Use]) -> bool:
    """Leave out thermocouples whose samples the engine almost always refuses, as long as some remain."""
    refused = {}
    for signal, use in uses.items():
        if use.channel.quantity == "surface" and use.lost and use.refused:
            most = max(use.refused, key=lambda reason: use.refused[reason])
            refused[signal] = f"{use.seen - use.used} of {use.seen} samples refused: {REASONS[Quality[most.upper()]]}"
    if not refused or len(refused) == sum(p.role == "surface" for p in proposal.signals):
        return False
    proposal.leave_out(refused)
    return True
