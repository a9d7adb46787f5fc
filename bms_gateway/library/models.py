"""String models for people who write Python: from a file, to a file, and of a cell that is known by its name."""

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from numbers import Integral
from pathlib import Path

from bms_gateway.config import model_file
from bms_gateway.errors import ConfigError
from bms_gateway.thermal import CONDITIONS, Condition, Prior, StringModel
from bms_gateway.thermal.cells import cell_of, cell_priors, cell_tolerances

COOLANT_SD = 0.3
"""Relative standard deviation of a stated heat capacity flow."""

__all__ = ["StringModel", "cell_model", "read_model", "write_model"]


def read_model(path: Path | str) -> StringModel:
    """Read a string model from its file (TOML).

    Parameters
    ----------
    path : Path or str

    Returns
    -------
    StringModel

    Raises
    ------
    ConfigError
        One line: file, key, what is wrong, the nearest valid choice.
    """
    return model_file.read_model(Path(path))


def write_model(model: StringModel, path: Path | str, heading: str = "") -> None:
    """Write a string model as a file (TOML) that every command takes; the file is complete or untouched.

    Parameters
    ----------
    model : StringModel
    path : Path or str
    heading : str
        Written on top as a comment.

    Raises
    ------
    ConfigError
        The place cannot be written.
    """
    model_file.write_model(model, Path(path), heading)


def cell_model(
    cell: str,
    cells: int = 1,
    sensors: Sequence[int] = (1,),
    condition: Condition = "single",
    *,
    coolant_W_K: float | None = None,
) -> StringModel:
    """Make the model of a string from what is known of its cells, as the command `cells` states it.

    Parameters
    ----------
    cell : str
        Published cell or format, then what else is known: ``"lg_m50"``, ``"21700 5Ah 69g 25mOhm forced 2p"``.
    cells : int
        Cells in a row along the coolant.
    sensors : sequence of int
        Cells (from 1) with a thermocouple on their surface.
    condition : {"single", "full", "natural", "no-conduction"}
        How cells exchange heat: not at all; by coolant and conduction; by conduction; by coolant.
    coolant_W_K : float, optional
        Heat capacity flow C_f of the coolant, W/K; needed if the coolant warms from cell to cell.

    Returns
    -------
    StringModel
        Its priors are as wide as the uncertainty of these figures.

    Raises
    ------
    ConfigError, UsageError
        No such cell or condition, a sensor on no cell, no heat capacity flow.

    Examples
    --------
    >>> model = cell_model("21700 5Ah 69g 25mOhm", cells=3, sensors=(1, 3), condition="natural")
    >>> model.sensors, model.capacity_Ah, model.priors["R_e"].rel_sd
    ((1, 3), 5.0, 0.4)
    """
    if condition not in CONDITIONS:
        raise ConfigError(f"condition '{condition}': valid: {', '.join(CONDITIONS)}")
    if not isinstance(cells, Integral) or cells < 1:
        raise ConfigError(f"cells: {cells!r}: a whole number from 1 on is expected")
    if not isinstance(sensors, Sequence) or not all(isinstance(k, Integral) for k in sensors):
        raise ConfigError(f"sensors: {sensors!r}: numbers of cells are expected, such as (1, {cells})")
    if wrong := [k for k in sensors if not 1 <= k <= cells]:
        raise ConfigError(f"sensors: cell {wrong[0]} does not exist; valid: 1 to {cells}")
    if coolant_W_K is not None and not (isfinite(coolant_W_K) and coolant_W_K > 0.0):
        raise ConfigError(f"coolant_W_K: {coolant_W_K!r}: a number above 0 is expected, W/K")
    facts = cell_of(cell)
    bare = StringModel(cells, tuple(sorted(set(sensors))), condition, {}, cell_format=cell)
    priors = cell_priors(facts, conduction=bare.has_conduction)
    if bare.has_coolant_path:
        if coolant_W_K is None:
            raise ConfigError(f'coolant_W_K: missing; condition = "{condition}" with several cells needs it')
        priors["C_f"] = Prior(coolant_W_K, COOLANT_SD)
    capacity = None if facts.capacity_Ah is None else facts.capacity_Ah * facts.parallel
    return replace(bare, priors=priors, capacity_Ah=capacity, tolerances=cell_tolerances(facts, cells))
