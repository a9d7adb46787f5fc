"""What a case of the benchmark of honesty is, and what came of it: scores over two spans, and what was told."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from tests.benchmarks.honesty_scores import Score, score

SPANS = {"settled": 600.0, "late": 1800.0}
"""From when after the first row on, s; to the end."""
HONEST, WRONG = 0.9, 0.8
"""Share inside 2 sd from which a band is called honest, and below which it is wrong."""
UNITS = {"R_e": (1e3, "mOhm"), "C_c": (1, "J/K"), "C_s": (1, "J/K"), "C_f": (1, "W/K")}


class Case(Protocol):
    """One record whose cores are known and never shown.

    Attributes
    ----------
    label, kind : str
        Its name, and what it is counted with.
    time_s, core : ndarray (K,), (K, n)
        The truth: s as in the table, °C.
    numbers : mapping of str to float
        Of the data sheet, SI.
    has_voltage : bool
    cells : int
    """

    label: str
    kind: str
    time_s: np.ndarray
    core: np.ndarray

    @property
    def numbers(self) -> Mapping[str, float]: ...

    @property
    def has_voltage(self) -> bool: ...

    @property
    def cells(self) -> int: ...

    def write_table(self, folder: Path) -> Path:
        """Write what the product may see."""

    def write_config(self, folder: Path, priors: str, method: str = "window") -> Path:
        """Write gateway and model files with the data sheet's numbers, known as well as `priors` says."""


@dataclass
class Outcome:
    """One method on one case; `scores` by span is empty where it failed, and `error` says how, or was refused."""

    case: str
    kind: str
    priors: str
    method: str
    scores: dict[str, Score] = field(default_factory=dict)
    told: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    error: str = ""
    refused: bool = False

    def honest(self, span: str = "settled") -> bool:
        s = self.scores.get(span)
        return s is not None and s.inside >= HONEST

    def confidently_wrong(self, span: str = "settled") -> bool:
        """Whether there is a band, it is wrong, and nothing whatsoever was told in that span."""
        s = self.scores.get(span)
        return s is not None and s.sd > 0 and s.inside < WRONG and s.told == 0


def scored(
    case: Case, time_s: np.ndarray, core: np.ndarray, sd: np.ndarray, told: np.ndarray | None = None
) -> dict[str, Score]:
    """Score what was stated (K, n) in every span that the record has."""
    first, last = case.time_s[[0, -1]]
    true = np.column_stack([np.interp(time_s, case.time_s, c) for c in case.core.T])
    found = {}
    for name, since in SPANS.items():
        at = (time_s >= first + since) & (time_s <= last)
        if at.any():
            found[name] = score(core[at], sd[at], true[at], None if told is None else told[at])
    return found


def model_text(
    numbers: Mapping[str, float],
    rel_sd: Mapping[str, float],
    capacity_Ah: float,
    *,
    cells: int = 1,
    sensors: Iterable[int] = (1,),
    flow_m3_s: float | None = None,
) -> str:
    """Model file of a data sheet's numbers, SI, each known to `rel_sd`."""
    lines = [f"cells = {cells}", f"sensors = {list(sensors)}", f'condition = "{"full" if cells > 1 else "single"}"']
    lines += ["effects = []", "[cell]", f"capacity_Ah = {capacity_Ah}", "[parameters]"]
    for name, sd in rel_sd.items():
        factor, unit = UNITS.get(name, (1, "K/W"))
        lines.append(f'{name} = {{ value = {numbers[name] * factor:.6g}, unit = "{unit}", rel_sd = {sd} }}')
    if flow_m3_s is not None:
        lines.append(f'coolant_flow = {{ value = {flow_m3_s}, unit = "m3/s" }}')
    return "\n".join(lines) + "\n"
