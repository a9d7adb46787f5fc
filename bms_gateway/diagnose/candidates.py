"""Effects of the catalogue as they could be added to a model: where, and from which numbers a fit starts."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from bms_gateway.thermal import AddedEffect, StringModel
from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects import Effect, catalogue, effect_named

FLOW_MOVES = 0.01
"""Share by which the flow must move before an effect that lives on it is offered."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One effect at one place, with the numbers its fit starts from.

    Attributes
    ----------
    effect : Effect
    cell : int or None
    start : mapping of parameter to float, SI
    """

    effect: Effect
    cell: int | None = None
    start: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.effect.name

    @property
    def key(self) -> str:
        """As `AddedEffect.key`."""
        return self.name if self.cell is None else f"{self.name}:{self.cell}"

    def added(self, values: Mapping[str, float] | None = None) -> AddedEffect:
        """Return the effect as part of a model: numbers of the catalogue's start, or `values`."""
        start = {p.name: self.start.get(p.name, p.probe) for p in self.effect.parameters}
        return AddedEffect(
            self.name, self.cell, {**start, **(values or {})}, {p.name: p.sd for p in self.effect.parameters}
        )

    def put_into(self, model: StringModel, values: Mapping[str, float] | None = None) -> StringModel:
        """Add the effect to a model, last."""
        return replace(model, effects=(*model.effects, self.added(values)))


def places(effect: Effect, cells: int, sensors: tuple[int, ...]) -> tuple[int | None, ...]:
    """Cells on which an effect can sit."""
    if effect.place == "string":
        return (None,)
    if effect.place == "sensor":
        return sensors
    if effect.place == "gap":
        return tuple(range(1, cells - 1))  # what the stream loses after the last but one cell shows nowhere
    return tuple(range(1, cells + 1))


def candidates(model: StringModel, drive: Drive, surfaces: tuple[float, float]) -> tuple[Candidate, ...]:
    """All that could be added to a model, given what the record knows.

    Parameters
    ----------
    model : StringModel
    drive : Drive
        Its `known` tells which effects can be offered.
    surfaces : float, float
        Lowest and highest measured surface, °C.
    """
    there = {e.key for e in model.effects}
    found = []
    for effect in catalogue().values():
        if model.cells < effect.least_cells or not set(effect.signals) <= drive.known:
            continue
        if "flow" in effect.signals and float(np.std(drive.flow)) < FLOW_MOVES:
            continue
        for cell in places(effect, model.cells, model.sensors):
            found += [c for start in effect.starts(*surfaces) if (c := Candidate(effect, cell, start)).key not in there]
    return tuple(found)


def candidate_named(key: str, model: StringModel) -> Candidate:
    """Return the candidate that a user calls `key`, `name` or `name:cell`.

    Raises
    ------
    ConfigError
        No such effect.
    """
    name, _, cell = key.partition(":")
    return Candidate(effect_named(name), int(cell) if cell else None)
