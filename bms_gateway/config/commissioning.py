"""`[commissioning]` of a model file: how well each cell's parameters are known after the commissioning run."""

import json

import numpy as np
from pydantic import Field

from bms_gateway.config.effect_tables import ROUNDING, shown
from bms_gateway.config.toml import Section
from bms_gateway.config.units import PARAMETER_UNITS, parameter_factor
from bms_gateway.errors import ConfigError, did_you_mean
from bms_gateway.identify.cell_prior import Layout
from bms_gateway.thermal import KINDS, Commissioning, Floats, StringModel

AGAIN = "run fit --cells again, or remove the table"


class Electrical(Section):
    """`electrical = { cells, values, unit }`: of the cells whose voltage was recorded."""

    cells: list[int]
    values: list[float]
    unit: str


class CommissioningTable(Section):
    """`[commissioning]`."""

    names: list[str] = Field(min_length=1)
    rel_sd: list[float]
    correlation: list[list[float]]
    electrical: Electrical | None = None


def read_commissioning(given: CommissioningTable, model: StringModel) -> Commissioning:
    """Read the table of a model whose other keys are read.

    Raises
    ------
    ConfigError
        The table does not belong to this model, or its correlation is not positive semidefinite.
    """
    if model.effects:
        raise ConfigError("commissioning: does not go with effects; remove the table, the cells keep their values")
    labels = Layout.of(model).labels
    for name in given.names:
        if name not in labels:
            raise ConfigError(f"commissioning.names: {name!r} is no number of this model{did_you_mean(name, labels)}")
        if given.names.count(name) > 1:
            raise ConfigError(f"commissioning.names: {name!r} is there twice")
    if missing := [label for label in labels if label not in given.names]:
        raise ConfigError(f"commissioning.names: {missing[0]!r} is missing; {AGAIN}")
    p = len(labels)
    if len(given.rel_sd) != p or min(given.rel_sd) <= 0.0:
        raise ConfigError(f"commissioning.rel_sd: {p} names need {p} numbers above 0")
    if len(given.correlation) != p or any(len(row) != p for row in given.correlation):
        raise ConfigError(f"commissioning.correlation: {p} names need {p} rows of {p} numbers")
    at = [given.names.index(label) for label in labels]
    matrix = np.array(given.correlation, dtype=np.float64)[np.ix_(at, at)]
    if not np.allclose(matrix, matrix.T, rtol=0.0, atol=ROUNDING):
        raise ConfigError("commissioning.correlation: must be symmetric")
    if not np.allclose(np.diag(matrix), 1.0, rtol=0.0, atol=ROUNDING) or np.linalg.eigvalsh(matrix)[0] <= 0.0:
        raise ConfigError(f"commissioning.correlation: this is no correlation matrix; {AGAIN}")
    return Commissioning(labels, np.array(given.rel_sd)[at], matrix, _electrical(given.electrical, model.cells))


def write_commissioning(c: Commissioning) -> list[str]:
    """Write the lines of the table."""
    rows = [f"  [{', '.join(repr(float(x)) for x in row)}]," for row in c.correlation]
    lines = [
        "",
        "[commissioning]  # from fit --cells: how well each cell's numbers are known, of their logarithms",
        f"names = {json.dumps(c.names)}",
        f"rel_sd = {[float(x) for x in c.rel_sd]}",
    ]
    known = np.flatnonzero(np.isfinite(c.electrical))
    if len(known):
        text, unit = shown(c.electrical[known], KINDS["R_e"].unit, PARAMETER_UNITS["R_e"])
        cells = [int(k) + 1 for k in known]
        lines.append(f'electrical = {{ cells = {cells}, values = [{", ".join(text)}], unit = "{unit}" }}')
    return [*lines, "correlation = [", *rows, "]"]


def _electrical(given: Electrical | None, cells: int) -> Floats:
    out = np.full(cells, np.nan)
    if given is None:
        return out
    if len(given.cells) != len(given.values) or len(set(given.cells)) < len(given.cells):
        raise ConfigError("commissioning.electrical: needs one value for each of its cells")
    for k in given.cells:
        if not 1 <= k <= cells:
            raise ConfigError(f"commissioning.electrical: cell {k} does not exist; valid: 1 to {cells}")
    try:
        factor = parameter_factor("R_e", given.unit)
    except ConfigError as e:
        raise ConfigError(f"commissioning.electrical: {e}") from None
    kind = KINDS["R_e"]
    for k, value in zip(given.cells, given.values, strict=True):
        out[k - 1] = value * factor
        if not kind.lower <= out[k - 1] <= kind.upper:
            raise ConfigError(f"commissioning.electrical: {value:g} {given.unit} of cell {k} is not plausible")
    return out
