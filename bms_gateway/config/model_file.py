"""String model files (TOML): reading into `thermal.StringModel`, and writing back what was read.

Numbers are written with the unit that people use (mΩ, K/W) and checked against the physical bounds of
`thermal.KINDS`, which catch a slipped unit. Reading what was written gives the same model, bit for bit.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from bms_gateway.config.commissioning import CommissioningTable, read_commissioning, write_commissioning
from bms_gateway.config.effect_tables import (
    Correlation,
    EffectTable,
    read_correlation,
    read_effects,
    shown,
    write_correlation,
    write_effects,
)
from bms_gateway.config.posterior import PosteriorTable, read_posterior, write_posterior
from bms_gateway.config.toml import Section, parse_toml, read_text, validate
from bms_gateway.config.units import PARAMETER_UNITS, parameter_factor
from bms_gateway.errors import ConfigError, UsageError
from bms_gateway.thermal import CELL_SYMBOLS, KINDS, Condition, Coolant, Prior, Share, StringModel, exchange
from bms_gateway.thermal.parameters import DEFAULT_TOLERANCES
from bms_gateway.whole import whole_text

# A relative sd above 3 (a factor of e^3 either way) is a slip, for example per cent in place of a share.
MAX_REL_SD = 3.0


class Parameter(Section):
    """`{ value | values, unit, rel_sd | fixed = true }`."""

    value: float | None = None
    values: list[float] | None = None
    unit: str
    rel_sd: float | None = Field(default=None, gt=0.0, le=MAX_REL_SD)
    fixed: bool = False


class Flow(Section):
    """The nominal coolant flow: a number, not something to identify."""

    value: float = Field(gt=0.0)
    unit: str
    fixed: Literal[True] = True


class Known(Section):
    """`[before]`: priors before any data; `[parameters]` has the same form."""

    C_c: Parameter
    C_s: Parameter
    R_e: Parameter
    R_c: Parameter
    R_u: Parameter
    R_cc: Parameter | None = None
    C_f: Parameter | None = None


class Parameters(Known):
    """`[parameters]`."""

    coolant_flow: Flow | None = None


class Part(Section):
    """`{ value, sd }` of a number from 0 to 1; an sd of 0 means known exactly."""

    value: float = Field(ge=0.0, le=1.0)
    sd: float = Field(ge=0.0, le=1.0)

    @property
    def share(self) -> Share:
        """Return it in the form of the model."""
        return Share(self.value, self.sd)


class Cell(Section):
    """`[cell]`: format as in `thermal.cells.cell_of`; the last two as in `thermal.centre`."""

    format: str | None = None
    capacity_Ah: float | None = Field(default=None, gt=0.0, le=10_000.0)
    centre_share: Part | None = None
    core_probe: Part | None = None


class Tolerances(Section):
    """`[tolerances]`: differences that are no missing effect; shares of the value and K."""

    cell_R_e: float = Field(default=DEFAULT_TOLERANCES["cell_R_e"], ge=0.0, le=1.0)
    cell_R_u: float = Field(default=DEFAULT_TOLERANCES["cell_R_u"], ge=0.0, le=1.0)
    cell_R_c: float = Field(default=DEFAULT_TOLERANCES["cell_R_c"], ge=0.0, le=1.0)
    surface_offset_K: float = Field(default=DEFAULT_TOLERANCES["surface_offset_K"], ge=0.0, le=20.0)
    inlet_offset_K: float = Field(default=DEFAULT_TOLERANCES["inlet_offset_K"], ge=0.0, le=20.0)


class ModelFile(Section):
    """The whole file."""

    # 1,000 cells in one string: its matrices are dense, and no pack has more in one row.
    cells: int = Field(ge=1, le=1000)
    sensors: list[int]
    condition: Condition
    coolant: Coolant = "bulk"
    effects: list[str] = Field(default_factory=list)
    effect: dict[str, EffectTable] = Field(default_factory=dict)
    cell: Cell = Cell()
    parameters: Parameters
    tolerances: Tolerances = Tolerances()
    correlation: Correlation | None = None
    before: Known | None = None
    commissioning: CommissioningTable | None = None
    posterior: PosteriorTable | None = None


def read_model(path: Path) -> StringModel:
    """Read a string model.

    Raises
    ------
    ConfigError
        One line with file, key, fault and the nearest valid choice.
    """
    return parse_model(read_text(path, "model file"), str(path))


def parse_model(text: str, where: str = "model") -> StringModel:
    """Read a string model from TOML text; error lines call it `where`."""
    data = parse_toml(text, where, "model file")
    if "string" in data and "parameters" not in data:
        raise ConfigError(f"{where}: is a gateway config; a model file is needed, as its [[string]] entries name them")
    file = validate(ModelFile, data, where)
    try:
        return _model(file)
    except ConfigError as e:
        raise ConfigError(f"{where}: {e}") from None


def write_model(model: StringModel, path: Path, heading: str = "") -> None:
    """Write a string model, with a heading as a comment; the file is complete or untouched.

    Raises
    ------
    ConfigError
        The place cannot be written.
    """
    comment = "".join(f"# {' '.join(line.split())}\n" for line in heading.splitlines())
    try:
        with whole_text(path) as file:
            file.write(comment + format_model(model))
    except OSError as e:
        raise ConfigError(f"{path}: cannot be written: {e.strerror}") from None


def format_model(model: StringModel) -> str:
    """Write a string model as TOML text, comments and all; `parse_model` gives the same model back."""
    effects, tables = write_effects(model.effects)
    lines = [
        f"cells = {model.cells}",
        f"sensors = {list(model.sensors)}  # measured surfaces, 1-based",
        f'condition = "{model.condition}"  # full | natural | no-conduction | single',
        f'coolant = "{model.coolant}"  # bulk | ntu',
        f"effects = {effects}",
    ]
    lines += _cell_lines(model)
    lines += ["", "[parameters]"]
    lines += [_parameter_line(name, model.priors[name]) for name in KINDS if name in model.priors]
    if model.flow is not None:
        lines.append(f'coolant_flow = {{ value = {model.flow!r}, unit = "m3/s" }}')
    lines += ["", "[tolerances]", *(f"{name} = {float(value)!r}" for name, value in model.tolerances.items())]
    lines += tables
    if model.correlation is not None:
        lines += write_correlation(model.correlation)
    if model.commissioning is not None:
        lines += write_commissioning(model.commissioning)
    if model.posterior is not None:
        lines += write_posterior(model.posterior)
    if model.before is not None:
        lines += ["", "[before]  # known before any data: what a fit starts from"]
        lines += [_parameter_line(name, model.before[name]) for name in KINDS if name in model.before]
    return "\n".join(lines) + "\n"


def _model(file: ModelFile) -> StringModel:
    sensors = _sensors(file)
    model = StringModel(
        cells=file.cells,
        sensors=sensors,
        condition=file.condition,
        priors=_priors(file.parameters, "parameters", file.cells),
        coolant=file.coolant,
        capacity_Ah=file.cell.capacity_Ah,
        flow=_flow(file),
        tolerances=file.tolerances.model_dump(),
        effects=read_effects(file.effects, file.effect, file.cells, sensors),
        centre_share=None if file.cell.centre_share is None else file.cell.centre_share.share,
        core_probe=None if file.cell.core_probe is None else file.cell.core_probe.share,
        cell_format=_format(file.cell.format),
    )
    model = replace(model, priors=_complete(model, model.priors, "parameters"))
    if file.before is not None:
        before = _complete(model, _priors(file.before, "before", file.cells), "before")
        model = replace(model, before=before)
    if file.correlation is not None:
        model = replace(model, correlation=read_correlation(file.correlation, model.priors, model.effects))
    if file.commissioning is not None:
        model = replace(model, commissioning=read_commissioning(file.commissioning, model))
    if file.posterior is not None:
        model = replace(model, posterior=read_posterior(file.posterior, model))
    if model.has_coolant_path:
        exchange(model.nominal)
    return model


def _format(words: str | None) -> str | None:
    """Check the description of the cell now: a fault in it would stop a diagnosis half-way."""
    if words is not None:
        # the service starts faster without it: its models name no format as a rule
        from bms_gateway.thermal.cells import cell_of

        try:
            cell_of(words)
        except UsageError as e:
            raise ConfigError(f"cell.format: {str(e).removeprefix('cell: ').removeprefix('cell ')}") from None
    return words


def _cell_lines(model: StringModel) -> list[str]:
    lines = [] if model.cell_format is None else [f"format = {json.dumps(model.cell_format, ensure_ascii=False)}"]
    lines += [] if model.capacity_Ah is None else [f"capacity_Ah = {model.capacity_Ah!r}"]
    shares = (
        ("centre_share", model.centre_share, "of R_c within the roll: how far its centre is above its mean"),
        (
            "core_probe",
            model.core_probe,
            "where a thermocouple in the core reads: 0 the mean of the roll, 1 its centre",
        ),
    )
    for key, share, what in shares:
        if share is not None:
            lines.append(f"{key} = {{ value = {float(share.value)!r}, sd = {float(share.sd)!r} }}  # {what}")
    return ["", "[cell]", *lines] if lines else []


def _sensors(file: ModelFile) -> tuple[int, ...]:
    for k in file.sensors:
        if not 1 <= k <= file.cells:
            raise ConfigError(f"sensors: cell {k} does not exist; valid: 1 to {file.cells}")
    if len(set(file.sensors)) < len(file.sensors):
        twice = next(k for k in file.sensors if file.sensors.count(k) > 1)
        raise ConfigError(f"sensors: cell {twice} is named twice")
    return tuple(sorted(file.sensors))


def _flow(file: ModelFile) -> float | None:
    flow = file.parameters.coolant_flow
    if flow is None:
        return None
    try:
        return flow.value * parameter_factor("coolant_flow", flow.unit)
    except ConfigError as e:
        raise ConfigError(f"parameters.coolant_flow: {e}") from None


def _priors(given: Known, key: str, cells: int) -> dict[str, Prior]:
    priors = {}
    for name in KINDS:
        p = getattr(given, name)
        if p is None:
            continue
        try:
            priors[name] = _prior(name, p, cells)
        except ConfigError as e:
            raise ConfigError(f"{key}.{name}: {e}") from None
    return priors


def _complete(model: StringModel, priors: Mapping[str, Prior], key: str) -> Mapping[str, Prior]:
    """Check that the file has every coupling of its condition, and ignore the others."""
    coupling = {"R_cc": model.has_conduction, "C_f": model.has_coolant_path}
    for name, needed in coupling.items():
        if needed and name not in priors:
            raise ConfigError(f'{key}.{name}: missing; condition = "{model.condition}" with several cells needs it')
    # A file may have couplings that its condition does not use: it stays valid when only the condition is changed.
    return {name: prior for name, prior in priors.items() if coupling.get(name, True)}


def _prior(name: str, p: Parameter, cells: int) -> Prior:
    kind = KINDS[name]
    if (p.value is None) == (p.values is None):
        raise ConfigError("needs either value or values")
    if p.fixed == (p.rel_sd is not None):
        raise ConfigError("needs either rel_sd (how well it is known) or fixed = true")
    if p.values is not None and name not in CELL_SYMBOLS:
        raise ConfigError("is one number for the whole string; use value")
    if p.values is not None and len(p.values) != cells:
        raise ConfigError(f"{len(p.values)} values for {cells} cells")
    factor = parameter_factor(name, p.unit)
    written = p.values if p.values is not None else [p.value]
    si = np.array(written, dtype=np.float64) * factor
    for number, x in zip(written, si, strict=True):
        if not kind.lower <= x <= kind.upper:
            low, high = kind.lower / factor, kind.upper / factor
            raise ConfigError(f"{number:g} {p.unit} is not plausible; valid: {low:g} to {high:g} {p.unit}")
    return Prior(si if p.values is not None else float(si[0]), p.rel_sd or 0.0)


def _parameter_line(name: str, prior: Prior) -> str:
    known = "fixed = true" if prior.fixed else f"rel_sd = {float(prior.rel_sd)!r}"
    numbers = np.atleast_1d(np.asarray(prior.value, dtype=np.float64))
    text, unit = shown(numbers, KINDS[name].unit, PARAMETER_UNITS[name])
    value = f"value = {text[0]}" if np.ndim(prior.value) == 0 else f"values = [{', '.join(text)}]"
    return f'{name} = {{ {value}, unit = "{unit}", {known} }}'
