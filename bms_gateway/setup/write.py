"""Writes a proposal as files: the config with reasons as comments, a model for each string, a DBC if one is needed."""

import json
import math
import os
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, get_args

import numpy as np

from bms_gateway.bus.logfile import interfaces_of
from bms_gateway.config.model_file import write_model
from bms_gateway.config.units import signal_conversion
from bms_gateway.engine.plan import Statistic
from bms_gateway.engine.statistics import stand_in
from bms_gateway.errors import UsageError
from bms_gateway.frames.dbc_text import format_dbc
from bms_gateway.frames.vocabulary import INPUTS, WHOLE
from bms_gateway.records.courses import UNLIKE
from bms_gateway.setup.capacity_shown import capacity_shown
from bms_gateway.setup.cell_numbers import left_out, renumbered
from bms_gateway.setup.inlet_told import inlet_told
from bms_gateway.setup.proposal import Proposal, Proposed
from bms_gateway.setup.resting import UNKNOWN_K, surroundings
from bms_gateway.setup.signal_words import of_liquid
from bms_gateway.setup.thermal_time import time_contradiction
from bms_gateway.setup.vehicle_logs import Traffic
from bms_gateway.thermal import Condition, Posterior, Prior, StringModel
from bms_gateway.thermal.cells import CellFacts, cell_of, cell_priors, cell_tolerances, stated_parameters
from bms_gateway.thermal.cells.facts import Cooling
from bms_gateway.thermal.parameters import DEFAULT_TOLERANCES
from bms_gateway.whole import whole_text

_PARALLEL: Final = re.compile(r"\d+p", re.IGNORECASE)
UNKNOWN_CELL: Final = "21700"
"""Format of an unknown cell: a round one of medium size."""
FLAT_CELL: Final = (0.148, 0.091, 0.027)
"""m; proportions of a prismatic cell. An unknown cell of low resistance is prismatic, or consists of round cells in
parallel."""
FLAT_OHM_M3: Final = 0.47e-6
"""Resistance times volume of flat cells."""
LEAST_FLAT_M3: Final = 1e-4
LARGE_CELL: Final = "4680"
LARGE_OHM: Final = 6e-3
"""Format of a large round cell, and its resistance over minutes."""
MOST_LARGE_OHM: Final = 10e-3
"""A greater capacity is implausible for a large round cell."""
UNKNOWN_SD: Final = {"C_c": 0.7, "C_s": 0.9, "R_e": 0.9, "R_c": 0.9, "R_u": 1.4, "R_cc": 1.0}
"""Of R_u: it is unknown whether the pack is in still air or cooled by liquid, which is a factor of fifteen."""
FROM_STEPS: Final = 1.2
"""Factor from the resistance by steps of a second to that over minutes."""
FROM_STEPS_SD: Final = 0.35
FROM_HEAT_SD: Final = 0.2
"""Of the resistance from all changes of the voltage: it includes joints, and depends on temperature and charge."""
LIQUID: Final = (3.6e6, 2e-3)
"""J/(m³ K) of water with glycol; flows above so many m³/s are of air."""
AIR: Final = 1190.0
UNKNOWN_DOUBT: Final = 0.35
"""Share of core minus surface that may be wrong; as for a model whose core no fit has proven."""
UNKNOWN_WHY: Final = "the cell is not known and its size is a guess: name the cell (bms-gateway init ... --cell)"
COOLING: Final[tuple[Cooling, Cooling]] = ("still", "liquid")
"""Extremes of cooling between which that of an unknown cell lies."""
NOT_TWICE: Final = 1.0 - 1e-5
"""Factor that avoids a scale which equals that of the DBC's unit by chance: a config with such a scale is refused,
because it seems to convert twice."""
MOST_SHOWN: Final = 3
USUAL_INTERFACE: Final = "can0"
KEYS: Final = {"max": "hottest", "min": "coldest", "mean": "mean"}
"""Keys of the config for the greatest, least and mean surface."""


@dataclass(frozen=True, slots=True)
class Written:
    """The written files, and remarks for the user.

    Attributes
    ----------
    config : Path
    files : tuple of Path
        All of them.
    notes : tuple of str
        Remarks on all strings.
    numbering : dict of int to str
        By string, from 1: which channels its cells are, where the names have other numbers.
    """

    config: Path
    files: tuple[Path, ...]
    notes: tuple[str, ...]
    numbering: dict[int, str]

    @property
    def numbered(self) -> tuple[str, ...]:
        """The numbering of the first strings; the config has it of all."""
        more = len(self.numbering) - MOST_SHOWN
        rest = (f"… and of {more} more strings; {self.config.name} lists all",) if more > 0 else ()
        return (*list(self.numbering.values())[:MOST_SHOWN], *rest)


def write_setup(
    proposal: Proposal, traffic: Traffic, out: Path, *, cell: CellFacts | None, logs: Iterable[Path]
) -> Written:
    """Write gateway.toml, its models and, where the DBC is unsound, the part of it that is needed.

    Raises
    ------
    UsageError
        The folder cannot be written, or already contains a gateway.toml.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise UsageError(f"--out {out}: cannot be made: {e.strerror}") from None
    notes: list[str] = []
    files = []
    names: list[str] = []
    if not traffic.own:
        names, more = _dbc(proposal, traffic, out, notes)
        files += more
    of_string = {k: renumbered(proposal, k) for k in range(1, len(proposal.cells) + 1)}
    numbering = {k: told for k, told in of_string.items() if told is not None}
    told_first = left_out(proposal)
    notes += [told_first] if told_first is not None else []
    notes += inlet_told(proposal)
    proposal.against_cell.clear()
    lumped, resistance = lump(proposal, cell, notes)
    if cell is not None and _unsaid_cooling(proposal, cell):
        notes.append(
            f"the bus has a coolant, and '{cell.name}' does not say how the cell is cooled: R_u lies between still air "
            f"and liquid; --cell '{cell.name} liquid' says it (valid: {', '.join(get_args(Cooling))})"
        )
    elif cell is not None and cell.cooling == "still" and not _said_cooling(cell):
        notes.append(
            f"R_u is that of '{cell.name}' in still air, as no cooling is named; --cell '{cell.name} forced' says that "
            f"a fan moves it (valid: {', '.join(get_args(Cooling))})"
        )
    try:
        for string, cells in enumerate(proposal.cells, 1):
            path = out / f"string_{string}.toml"
            model = _model(proposal, string, cells, lumped, cell is not None, resistance)
            heading = [_heading(lumped, cell is not None, resistance), *([x] if (x := numbering.get(string)) else [])]
            write_model(model, path, "\n".join(heading))
            files.append(path)
            if cell is not None and (told := time_contradiction(proposal, string, model, cell.name)) is not None:
                notes.append(told)
        config = out / "gateway.toml"
        with whole_text(config) as file:
            file.write(_config(proposal, names, list(logs)))
    except OSError as e:
        raise UsageError(f"--out {out}: cannot be written: {e.strerror}") from None
    return Written(config, (config, *files), tuple(notes), numbering)


def _dbc(proposal: Proposal, traffic: Traffic, out: Path, notes: list[str]) -> tuple[list[str], list[Path]]:
    """Name the DBC files; only if something of them had to be changed, write the needed part anew, and say why."""
    used = [half.series.info for p in proposal.signals for half in p.single]
    changed = [traffic.readdressed[m] for m in dict.fromkeys(s.message for s in used) if m in traffic.readdressed]
    why = [*traffic.corrected, *changed]
    if not why:
        return [os.path.relpath(p, out) for p in traffic.dbc], []
    path = out / "vehicle.dbc"
    told = f"{why[0]}; and {len(why) - 1} more" if len(why) > 1 else why[0]
    notes.append(f"{path.name} is a copy of the part of the DBC that gateway.toml needs, because of this: {told}")
    comment = (
        f"The part of the vehicle's DBC that gateway.toml needs, written by bms-gateway init because of this: {told}"
    )
    infos = [traffic.messages[info.message].signals[info.name] for info in used]
    with whole_text(path) as file:
        file.write(format_dbc(traffic.messages.values(), infos, comment))
    return [path.name], [path]


def lump(proposal: Proposal, cell: CellFacts | None, notes: list[str]) -> tuple[CellFacts, float | None]:
    """Determine how many cells in parallel form one cell of the model, and their measured resistance.

    `--cell` decides if it gives the number; otherwise the capacity from current and SOC, and only then the resistance.
    """
    told = cell_of(UNKNOWN_CELL) if cell is None else cell
    said = any(_PARALLEL.fullmatch(word) for word in told.name.split())
    shown = None if cell is None else capacity_shown(proposal)
    if shown is not None and told.capacity_Ah is not None:
        told, said = _by_charge(told, told.capacity_Ah, shown, said, notes), True
        has_Ah = told.parallel * (told.capacity_Ah or 0.0)
        if not 1.0 / UNLIKE < shown / has_Ah < UNLIKE:
            which = f"the cell, {told.parallel} in parallel," if told.parallel > 1 else "the cell"
            _against(
                proposal,
                notes,
                f"current and SOC give {shown:.3g} Ah, {which} has {has_Ah:.3g} Ah: "
                "the scale or the offset of the current is wrong, or it is another cell",
            )
    per_cell = _per_cell(proposal)
    if per_cell is None:
        if cell is None:
            notes.append("the log does not show the resistance of the cells: name the cell with --cell")
        return told, None
    one = 0.035 if cell is None else stated_parameters(replace(told, parallel=1))["R_e"].value
    if told.parallel == 1 and not said and one / per_cell > 1.7:
        count = min(max(round(one / per_cell), 2), 200)
        what = "cells like a 21700" if cell is None else told.name
        notes.append(
            f"voltage and current give {1e3 * per_cell:.2g} mΩ per cell in series: taken for {count} {what} "
            f"in parallel; --cell '… 1p' or '… {count}p' says how many"
        )
        told = replace(told, parallel=count)
    elif per_cell / (one / told.parallel) > 3.0 or per_cell / (one / told.parallel) < 0.33:
        text = (
            f"voltage and current give {1e3 * per_cell:.2g} mΩ per cell in series, {told.name} would have "
            f"{1e3 * one / told.parallel:.2g} mΩ: is it this cell, and so many in parallel?"
        )
        if cell is None:
            notes.append(text)
        else:
            _against(proposal, notes, text)
    return told, per_cell


def _against(proposal: Proposal, notes: list[str], text: str) -> None:
    """Note reasons of the log against the named cell; the current may be wrong instead."""
    notes.append(text)
    proposal.against_cell.append(text)
    for p in proposal.of("current"):
        p.sure = False


def _per_cell(proposal: Proposal) -> float | None:
    """Resistance of one cell in series over minutes; None if the log does not determine it."""
    if not proposal.series_cells or proposal.resistance is None:
        return None
    over_minutes = proposal.heat_resistance or FROM_STEPS * proposal.resistance
    return over_minutes / proposal.series_cells


def _by_charge(cell: CellFacts, one_Ah: float, shown_Ah: float, said: bool, notes: list[str]) -> CellFacts:
    """Count cells in parallel by the capacity from the log, unless `--cell` gives the number."""
    if not said and shown_Ah > UNLIKE * one_Ah:
        cell = replace(cell, parallel=min(max(round(shown_Ah / one_Ah), 2), 200))
        notes.append(
            f"current and SOC give {shown_Ah:.3g} Ah: taken for {cell.parallel} {cell.name} in parallel; "
            f"--cell '… {cell.parallel}p' says how many"
        )
    return cell


def _model(
    proposal: Proposal, string: int, cells: int, lumped: CellFacts, known: bool, resistance: float | None
) -> StringModel:
    flow = next(proposal.of("coolant_flow", string), None)
    nominal = abs(flow.factor) * flow.series.middle if flow is not None else 0.0
    condition: Condition = "single" if cells == 1 else "full" if nominal > 0 else "natural"
    priors = cell_priors(lumped, conduction=cells > 1)
    liquid = _unsaid_cooling(proposal, lumped)
    if not known:
        priors = unknown_priors(lumped, resistance, conduction=cells > 1)
    elif liquid:
        still, cooled = (cell_priors(replace(lumped, cooling=c), conduction=False)["R_u"].value for c in COOLING)
        priors["R_u"] = Prior(math.sqrt(still * cooled), UNKNOWN_SD["R_u"])
    if resistance is not None:
        priors["R_e"] = Prior(
            min(max(resistance, 1e-5), 1.0), FROM_HEAT_SD if proposal.heat_resistance else FROM_STEPS_SD
        )
    if condition == "full":
        by_volume = AIR if nominal > LIQUID[1] else LIQUID[0]
        priors["C_f"] = Prior(min(max(by_volume * nominal, 1e-2), 1e5), 0.3)
    priors = {name: Prior(float(f"{p.value:.4g}"), p.rel_sd) for name, p in priors.items()}
    capacity = None if lumped.capacity_Ah is None else lumped.capacity_Ah * lumped.parallel
    model = StringModel(
        cells,
        tuple(
            sorted(_cell(p, cells) for p in proposal.of("surface") if p.string == string and not _spare(proposal, p))
        ),
        condition,
        priors,
        coolant="ntu" if condition == "full" else "bulk",
        capacity_Ah=capacity,
        flow=float(f"{nominal:.4g}") if nominal > 0 else None,
        tolerances=cell_tolerances(replace(lumped, cooling="liquid") if liquid else lumped, cells)
        | _rounded(proposal, string),
        cell_format=_in_words(lumped) if known else None,
    )
    # a wrong size or a wrong current may fit the drive well: the core is not proven
    against = [text for p in proposal.of("current", string) for text in p.against]
    doubts = (
        *(() if known else (UNKNOWN_WHY,)),
        *(f"the current may be another one: {text}" for text in against),
        *proposal.against_cell,
    )
    if not doubts:
        return model
    values, sds = model.free_numbers
    return replace(model, posterior=Posterior(values, sds, 0.0, UNKNOWN_DOUBT, False, doubts))


def _rounded(proposal: Proposal, string: int) -> dict[str, float]:
    """Tolerance of thermocouples that are sent in coarse steps: a reading is off by up to half a step.

    The error of rounding is uniform, and it stays as long as the reading does: no mean of many samples removes it.
    """
    step_K = max((p.resolution for p in proposal.of("surface", string)), default=0.0)
    off_K = step_K / math.sqrt(12.0)
    usual_K = DEFAULT_TOLERANCES["surface_offset_K"]
    return {"surface_offset_K": float(f"{math.hypot(off_K, usual_K):.2g}")} if off_K > usual_K else {}


def _unsaid_cooling(proposal: Proposal, cell: CellFacts) -> bool:
    """Whether the inlet's name says liquid coolant while the description of the cell does not say its cooling."""
    return not _said_cooling(cell) and any(of_liquid(p.series.info) for p in proposal.of("coolant_inlet"))


def _said_cooling(cell: CellFacts) -> bool:
    return any(word in get_args(Cooling) for word in cell.name.split())


def unknown_priors(lumped: CellFacts, resistance: float | None, *, conduction: bool) -> dict[str, Prior]:
    """Priors of a cell of unknown kind: the mean over the kinds with this resistance.

    R_c of a flat or a large round cell is several times that of small round cells in parallel. R_u is the geometric
    mean of still air and liquid. The standard deviations cover all kinds.
    """
    still, cooled = (
        [cell_priors(replace(c, cooling=cooling), conduction=conduction) for c in _possible(lumped, resistance)]
        for cooling in COOLING
    )
    values = {name: float(np.mean([v[name].value for v in still])) for name in still[0]}
    values["R_u"] = math.sqrt(values["R_u"] * float(np.mean([v["R_u"].value for v in cooled])))
    return {name: Prior(value, max(still[0][name].rel_sd, UNKNOWN_SD[name])) for name, value in values.items()}


def _possible(lumped: CellFacts, resistance: float | None) -> list[CellFacts]:
    """Kinds that an unknown cell of this resistance may be: small round ones in parallel (`lumped`), large, flat."""
    found = [lumped]
    if not resistance:
        return found
    if resistance < MOST_LARGE_OHM:
        found.append(replace(cell_of(LARGE_CELL), parallel=max(round(LARGE_OHM / resistance), 1)))
    volume = FLAT_OHM_M3 / resistance
    if volume >= LEAST_FLAT_M3:
        grown = (volume / math.prod(FLAT_CELL)) ** (1 / 3)
        length, width, thickness = (grown * side for side in FLAT_CELL)
        found.append(CellFacts("flat", "prismatic", (length, width, thickness)))
    return found


def _in_words(cell: CellFacts) -> str:
    """Describe a cell as `cell_of` reads it, with the number in parallel."""
    told = cell_of(cell.name).parallel == cell.parallel
    bare = " ".join(word for word in cell.name.split() if not _PARALLEL.fullmatch(word))
    return cell.name if told else f"{bare} {cell.parallel}p"


def _heading(lumped: CellFacts, known: bool, resistance: float | None) -> str:
    lines = ["One cell of the model per thermocouple: the cell that it sits on, and those like it."]
    if known:
        side = f", {lumped.parallel} in parallel" if lumped.parallel > 1 else ""
        lines.append(f"Cell: {lumped.name}{side}. Formulas and sources: bms-gateway cells '{lumped.name}'")
    else:
        lines.append(
            "THE CELL IS UNKNOWN: its size is a guess, and so the cores are sent as doubtful. [posterior] says it."
        )
        lines.append("bms-gateway init … --cell '21700 5Ah 69g 25mOhm 2p' (or lg_m50, pouch …) makes it better.")
    if resistance is not None:
        lines.append("R_e is from pack voltage and current in the log.")
    lines.append("A record with a thermocouple in the core is worth more than all priors: bms-gateway fit --calibrate.")
    return "\n".join(lines)


def _config(proposal: Proposal, dbc: list[str], logs: list[Path]) -> str:
    shown = ", ".join(p.name for p in logs[:3]) + (" …" if len(logs) > 3 else "")
    lines = [
        f"# Proposed by bms-gateway init from {shown}. Lines with (?) are likely, not sure: check them.",
        "",
        "[bus]",
        'interface = "socketcan"',
        _channel(logs),
    ]
    if dbc:
        lines.append(f"dbc = {json.dumps(dbc, ensure_ascii=False)}")
    lines.append("transmit = false                 # true: send the cores on the bus too")
    inlet = next(proposal.of("coolant_inlet"), None)
    if inlet is None:
        sd_K = max(surroundings(proposal, string).sd_K for string in range(1, len(proposal.cells) + 1))
        lines += ["", "[observer]", f"inlet_K = {sd_K:.1f}                    # the coolant is not measured"]
    elif not inlet.sure:
        lines += [
            "",
            "[observer]",
            f"inlet_K = {UNKNOWN_K}                    # the coolant is not measured for sure",
        ]
    for string, cells in enumerate(proposal.cells, 1):
        lines += ["", "[[string]]", f'name = "string_{string}"', f'model = "string_{string}.toml"', "[string.signals]"]
        lines += _string(proposal, string, cells)
    if proposal.remarks:
        lines += ["", "# About the files:", *(f"# {' '.join(r.split())}" for r in proposal.remarks)]
    return "\n".join(lines) + "\n"


def _channel(logs: list[Path]) -> str:
    """Name the interface of the logs; of several that which has most frames."""
    count = sum((interfaces_of(log) for log in logs), Counter[str]())
    names = [name for name, _ in count.most_common()] or [USUAL_INTERFACE]
    line = f"channel = {json.dumps(names[0])}"
    if len(names) > 1:
        line += f"                 # (?) the log has {', '.join(names[1:])} too; the gateway listens on one"
    return line


def _string(proposal: Proposal, string: int, cells: int) -> list[str]:
    current = next(proposal.of("current", string))
    lines = _current(current)
    inlet = next(proposal.of("coolant_inlet", string), None)
    if inlet is not None:
        lines += _line("coolant_inlet", inlet)
    else:
        around = surroundings(proposal, string)
        what = "the lowest readings of the string" + (" at rest" if around.rest else "")
        lines.append(f"coolant_inlet = {{ constant_C = {around.value_C:.1f} }}  # (?) the bus has none: {what}")
    voltage = next(proposal.of("voltage", string), None)
    if voltage is not None and (voltage.string == string or proposal.series_cells):
        part = share(proposal, cells)
        lines += _line("voltage", voltage, part, guessed=part != 1.0 and proposal.series_guessed)
    for role in (q for q in WHOLE if not INPUTS[q].electrical and not INPUTS[q].needed):
        found = next(proposal.of(role, string), None)
        if found is not None:
            lines += _line(role, found)
    lines.append("[string.signals.surface]")
    if string not in proposal.numbered and (told := left_out(proposal)) is not None:
        lines.append(f"# {told}")
    if (told := renumbered(proposal, string)) is not None:
        lines.append(f"# {told}")
    for p in sorted((p for p in proposal.of("surface") if p.string == string), key=lambda p: p.index or 0):
        own = _line(str(p.index or KEYS[p.statistic or "max"]), p, cells=cells)
        lines += [*own[:-1], f"# {own[-1]}"] if _spare(proposal, p) else own
    volted = [p for p in proposal.of("cell_voltage") if p.string == string]
    if volted:
        lines.append("[string.signals.cell_voltage]")
        for p in sorted(volted, key=lambda p: p.index or 0):
            lines += _line(str(p.index), p)
    return lines


def _current(p: Proposed) -> list[str]:
    """Lines of the current: one, or one for each direction where two signals carry it."""
    if not p.halves:
        return _line("current", p)
    why = [f"# current: {' '.join(text.split())}" for text in p.why if "left out" not in text]
    halves = [replace(half, why=own.why) for half, own in zip(p.single, p.halves, strict=True)]
    return [*why, *(line for half in halves for line in _line(f"current.{half.way}", half))]


def _spare(proposal: Proposal, p: Proposed) -> bool:
    """Whether the hottest core does not need this reading: least or mean beside the greatest of the same cells."""
    beside = (q.statistic for q in proposal.of("surface") if q.string == p.string and q.index is None)
    return p.index is None and p.statistic != "max" and "max" in beside


def share(proposal: Proposal, cells: int) -> float:
    """Share of a voltage that belongs to a string of the model, which has a cell for each thermocouple."""
    if not proposal.series_cells:
        return 1.0
    return cells / proposal.series_cells


def _cell(p: Proposed, cells: int) -> int:
    """Cell of the model for a reading: its cell, or the one that stands for its cells."""
    if p.index is not None:
        return p.index
    kind: Statistic = "max" if p.statistic == "max" else "min" if p.statistic == "min" else "mean"
    return stand_in(kind, range(1, cells + 1))


def _line(key: str, p: Proposed, part: float = 1.0, cells: int = 1, *, guessed: bool = False) -> list[str]:
    """One key of the config with its reasons, short; `guessed`: a sure signal whose scale is a guess."""
    scale, offset = p.written
    fields = [f'{p.statistic}_of = "1-{cells}"'] if p.role == "surface" and p.index is None else []
    fields += [f"signal = {json.dumps(p.path, ensure_ascii=False)}"]
    if part * scale != 1.0:
        stated = float(f"{part * scale:.6g}")
        if abs(stated) == signal_conversion(p.role, p.series.info.unit)[0] != 1.0:
            stated = float(f"{NOT_TWICE * stated:.6g}")
        fields.append(f"scale = {stated!r}")
    if offset != 0.0:
        fields.append(f"offset = {part * offset!r}")
    for name, value in p.overrides.items():
        text = str(value).lower() if isinstance(value, bool) else json.dumps(value)
        fields.append(f"{name} = {text}")
    value = json.dumps(p.path, ensure_ascii=False) if len(fields) == 1 else f"{{ {', '.join(fields)} }}"
    low, high = p.observed
    comment = f"{'' if p.sure and not guessed else '(?) '}{low:.4g} … {high:.4g} {INPUTS[p.role].unit}".rstrip()
    if part != 1.0:
        comment += " of the pack; the share of this string's cells" if p.string is None else " of the string; the "
        comment += "share of the cells with a thermocouple" if p.string is not None else ""
    lines = []
    if not INPUTS[p.role].of_cells or p.statistic or p.overrides:
        lines = [f"# {key}: {' '.join(why.split())}" for why in p.why if "left out" not in why]
    return [*lines, f"{key} = {value}  # {' '.join(comment.split())}"]
