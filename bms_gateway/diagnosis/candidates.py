"""Candidates: effects of the catalogue with the place and the start values at which a model could get them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from bms_gateway.diagnosis.current_sensor import rests_at_zero
from bms_gateway.thermal import AddedEffect, StringModel
from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects import Effect, EffectParameter, catalogue


@dataclass(frozen=True, slots=True)
class Candidate:
    """One effect at one place, with the start values of its fit.

    Attributes
    ----------
    effect : Effect
    cell : int or None
    start : mapping of parameter to float, SI
    free : tuple of str, optional
        Parameters that the record can determine; the others stay neutral. All by default.
    """

    effect: Effect
    cell: int | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    free: tuple[str, ...] | None = None

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    @property
    def key(self) -> str:
        """As `AddedEffect.key`."""
        return self.name if self.cell is None else f"{self.name}:{self.cell}"

    def is_free(self, p: EffectParameter) -> bool:
        """Whether a fit may move the parameter."""
        return self.free is None or p.name in self.free

    @property
    def strengths(self) -> tuple[EffectParameter, ...]:
        """Free parameters with a value at which the effect vanishes; a score exists only for these."""
        return tuple(p for p in self.effect.parameters if p.neutral is not None and self.is_free(p))

    @property
    def follows_charge(self) -> bool:
        """Whether its law depends on the state of charge, always or with its present numbers."""
        return "soc" in self.effect.signals or (self.name == "entropic_heat" and len(self.strengths) > 1)

    @property
    def begin(self) -> dict[str, float]:
        """Start of a fit, by parameter (SI)."""
        return {
            p.name: p.neutral if p.neutral is not None and not self.is_free(p) else self.start.get(p.name, p.probe)
            for p in self.effect.parameters
        }

    def added(self, values: Mapping[str, float] | None = None) -> AddedEffect:
        """Return the effect as part of a model, with the catalogue's start values or with `values`."""
        sd = {p.name: p.sd if self.is_free(p) else 0.0 for p in self.effect.parameters}
        return AddedEffect(self.name, self.cell, {**self.begin, **(values or {})}, sd)

    def put_into(self, model: StringModel, values: Mapping[str, float] | None = None) -> StringModel:
        """Add the effect to a model, as its last one."""
        return replace(model, effects=(*model.effects, self.added(values)))


def places(effect: Effect, cells: int, sensors: tuple[int, ...]) -> tuple[int | None, ...]:
    """Cells on which an effect can be."""
    if effect.place == "string":
        return (None,)
    if effect.place == "sensor":
        return sensors
    if effect.place == "gap":
        return tuple(range(1, cells - 1))  # no surface shows a loss of coolant that begins after the next-to-last cell
    return tuple(range(1, cells + 1))


INSTEAD = frozenset({"voltage_heat"})
"""Effects that replace the source of the heat. They are not missing physics: the heat's cause stays unknown."""


def excluded(effect: Effect, drive: Drive) -> str:
    """Say why a record rules an effect out; empty if it does not."""
    if effect.name == "current_offset" and rests_at_zero(drive):
        return "the current reads zero where it rests"
    return ""


def candidates(model: StringModel, drive: Drive, surfaces: tuple[float, float]) -> tuple[Candidate, ...]:
    """List all candidates for a model, given the columns of the record.

    Parameters
    ----------
    model : StringModel
    drive : Drive
        Its `known` decides which effects can be offered.
    surfaces : float, float
        Lowest and highest measured surface, °C.
    """
    there = {e.key for e in model.effects}
    found = []
    for effect in catalogue().values():
        if model.cells < effect.least_cells or not set(effect.signals) <= drive.known or excluded(effect, drive):
            continue
        free = effect.determined(drive)
        if not free:
            continue
        for cell in places(effect, model.cells, model.sensors):
            found += [
                c for start in effect.starts(*surfaces) if (c := Candidate(effect, cell, start, free)).key not in there
            ]
    return tuple(found)
