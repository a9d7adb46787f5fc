"""A string model from known facts of the cell, and a config from a log and its DBC: as `init` writes them."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from bms_gateway.config.load import cell_list
from bms_gateway.config.model_file import write_model
from bms_gateway.errors import UsageError, clipped, counted, did_you_mean, whole_number
from bms_gateway.frames.vocabulary import Quantity
from bms_gateway.records.kind import log_kind
from bms_gateway.setup.proposal import Proposed
from bms_gateway.setup.propose import propose
from bms_gateway.setup.settle import missing, settle
from bms_gateway.setup.vehicle_logs import read_traffic
from bms_gateway.setup.write import AIR, LIQUID
from bms_gateway.thermal import Condition, Prior, StringModel
from bms_gateway.thermal.cells import CellFacts, cell_of, cell_priors, cell_tolerances
from bms_gateway.workbench.looking import measured_flow, surfaces

MODEL: Final = "model.toml"
MOST_CELLS: Final = 400
CALLED: Final[Mapping[Quantity, str]] = {
    "current": "current",
    "coolant_inlet": "coolant inlet",
    "voltage": "voltage",
    "soc": "SOC",
    "coolant_flow": "coolant flow",
    "surface": "surface temperature",
    "cell_voltage": "voltage",
}
"""Words for each quantity before its identifier."""
MEDIA: Final = ("liquid", "air")
COOLS: Final[Mapping[str, str]] = {"forced": "air", "plate": "liquid", "liquid": "liquid"}
"""Coolant of cells with this cooling."""
FLOW_SD: Final = 0.3
PER_L_MIN: Final = 1e-3 / 60.0


def with_model(files: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Write the model described in a form, if no file was named; it has the sensors of the first table.

    Raises
    ------
    UsageError
        An entry is unknown or not plausible; with the nearest valid choice.
    """
    form = files.get("form")
    if files.get("model") or not form:
        return files
    tables = [Path(t) for t in files["tables"]]
    log = next((t for t in tables if log_kind(t) is not None), None)
    if log is not None and not files.get("config"):
        raise UsageError(f"{log.name}: a CAN log needs its gateway config; or drop its DBC, and one is made")
    text = str(form.get("sensors") or "").strip()
    sensors = _cells("sensors", text) if text else surfaces(tables, files.get("columns") or (), files.get("each") or ())
    if not sensors:
        raise UsageError("model: no surface is mapped: say which column is the surface of which cell")
    cells = _count(str(form.get("cells") or "").strip(), max(sensors))
    if max(sensors) > cells:
        raise UsageError(f"model: a sensor sits on cell {max(sensors)}, the string has {counted(cells, 'cell')}")
    words = str(form.get("cell") or "")
    if not words.strip():
        raise UsageError("model: name the cell, such as lg_m50 or '21700 5Ah 69g 25mOhm 2p'")
    cell = cell_of(words)
    condition: Condition = "single" if cells == 1 else "natural"
    given = str(form.get("flow") or "").strip()
    flow = _flow(given)
    if not given and cells > 1 and (seen := measured_flow(tables, files.get("columns") or (), files.get("each") or ())):
        raise UsageError(
            f"model: {seen}: state under 'Coolant flow past them' what flows past one cell after another, in l/min; 0 "
            "if each cell has coolant of its own"
        )
    medium = str(form.get("medium") or "").strip() or COOLS.get(cell.cooling, "")
    if medium and medium not in MEDIA:
        raise UsageError(f"model: the coolant '{medium[:40]}' is not known{did_you_mean(medium, MEDIA)}")
    if flow is not None:
        cell = _flowed_past(cell, medium, words)
    priors = cell_priors(cell, conduction=cells > 1)
    if flow is not None and cells > 1:
        condition = "full"
        volumetric = AIR if medium == "air" else LIQUID[0]
        priors["C_f"] = Prior(min(max(volumetric * flow, 1e-2), 1e5), FLOW_SD)
    model = StringModel(
        cells,
        sensors,
        condition,
        {name: Prior(float(f"{p.value:.4g}"), p.rel_sd) for name, p in priors.items()},
        coolant="ntu" if condition == "full" else "bulk",
        capacity_Ah=None if cell.capacity_Ah is None else cell.capacity_Ah * cell.parallel,
        flow=flow if condition == "full" else None,
        tolerances=cell_tolerances(cell, cells),
        cell_format=cell.name,
    )
    path = folder / MODEL
    write_model(
        model,
        path,
        f"From the form of the workbench: {words.strip()}, {counted(cells, 'cell')}, cooling: {cell.cooling}.",
    )
    return {**files, "model": str(path)}


def with_config(files: dict[str, Any], folder: Path) -> tuple[dict[str, Any], list[str]]:
    """Make a config and a model from logs and DBC files, as `init` does; return them with notes.

    Raises
    ------
    UsageError
        They are not enough for a config.
    """
    logs = [Path(t) for t in files["tables"] if log_kind(Path(t)) is not None]
    if files.get("config") or not files.get("dbc") or not logs:
        return files, []
    words = str((files.get("form") or {}).get("cell") or "").strip()
    cell = cell_of(words) if words else None
    traffic = read_traffic(logs, [_beside(Path(d), folder) for d in files["dbc"]])
    proposal = propose(traffic, chemistry=cell.chemistry if cell is not None else None)
    if (why_not := missing(proposal, traffic)) is not None:
        raise UsageError(why_not.replace(": give the vehicle's DBC with --dbc", ": drop the vehicle's DBC too"))
    string = files.get("string") or "string_1"
    strings = [f"string_{k}" for k in range(1, len(proposal.cells) + 1)]
    if string not in strings:  # the request may come from another machine: no path is made from it
        raise UsageError(f"open: the log has no string '{clipped(string, 60)}'{did_you_mean(string, strings)}")
    settled = settle(proposal, traffic, folder, cell=cell, logs=logs)
    mine = strings.index(string) + 1
    own = settled.written.numbering.get(mine)
    said = [*proposal.remarks, *([own] if own else []), *settled.written.notes]
    if cell is None:
        said.append("The cell is unknown: name it in the form, and the bands of the cores get narrower.")
    said += (taken_for(p) for p in proposal.signals if p.string in (None, mine))
    model = settled.written.config.parent / f"{string}.toml"
    config, named = str(settled.written.config), files.get("model")
    return {**files, "config": config, "string": string, "strings": strings, "model": named or str(model)}, said


def taken_for(p: Proposed) -> str:
    """Say how a signal is interpreted, by its label, and what it has read."""
    of = [*([] if p.index is None else [f"cell {p.index}"]), *([] if p.string is None else [f"string_{p.string}"])]
    where = f" of {', '.join(of)}" if of else ""
    label = CALLED[p.role]
    key = "" if label.lower() == p.role else f" ({p.role}{'' if p.index is None else f' {p.index}'})"
    low, high = p.observed
    sure = "" if p.sure else " (likely, not sure: check it)"
    paths = " and ".join(half.path for half in p.single)
    return f"{label}{where}{key}: {paths}, {low:.4g} to {high:.4g}{sure}."


def _beside(dbc: Path, folder: Path) -> Path:
    """Put a DBC into the tab's folder, where the config finds it."""
    if dbc.parent == folder:
        return dbc
    copy = folder / dbc.name
    try:
        copy.write_bytes(dbc.read_bytes())
    except OSError as e:
        raise UsageError(f"{dbc}: cannot be read: {e.strerror}") from None
    return copy


def _flowed_past(cell: CellFacts, medium: str, words: str) -> CellFacts:
    """Return the cell with a cooling that fits the flowing coolant, if none is stated; still air does not flow."""
    if not medium:
        raise UsageError("model: a coolant flows past the cells: say whether it is a liquid or air")
    if cell.cooling != "still":
        return cell
    if "still" in words.split():
        raise UsageError("model: a coolant flows past the cells, so they are not in still air: say what cools them")
    if medium == "air":
        return replace(cell, cooling="forced")
    return replace(cell, cooling="liquid" if cell.shape == "cylinder" else "plate")


def _cells(what: str, text: str) -> tuple[int, ...]:
    try:
        return tuple(sorted(set(cell_list(text))))
    except ValueError:
        raise UsageError(f"model: {what} '{text}': list cells as 1,3,5-8") from None


def _count(text: str, least: int) -> int:
    if not text:
        return least
    number = whole_number(text)
    if number is None or not 1 <= number <= MOST_CELLS:
        raise UsageError(f"model: cells '{clipped(text, 60)}': must be a number from 1 to {MOST_CELLS}")
    return number


def _flow(text: str) -> float | None:
    if not text:
        return None
    try:
        flow = float(text.replace(",", "."))
    except ValueError:
        flow = float("nan")
    if not 0.0 <= flow < 1e5:
        raise UsageError(f"model: coolant flow '{text}': must be a number of l/min, 0 where none flows")
    if flow == 0.0:
        return None
    return float(f"{flow * PER_L_MIN:.4g}")
