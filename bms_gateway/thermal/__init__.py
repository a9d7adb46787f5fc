"""The physics: parameters, the string of cells, its discretisation and simulation."""

from bms_gateway.thermal.discretize import DiscreteString, discretize
from bms_gateway.thermal.disturbance import Disturbance, Start, gathered_noise, start_spread
from bms_gateway.thermal.parameters import (
    CELL_SYMBOLS,
    CONDITIONS,
    KINDS,
    AddedEffect,
    Commissioning,
    Condition,
    Coolant,
    Floats,
    ParameterKind,
    Prior,
    StringModel,
    StringParameters,
)
from bms_gateway.thermal.simulate import simulate
from bms_gateway.thermal.string import ContinuousString, continuous, coolant_path, exchange, steady_state

__all__ = [
    "CELL_SYMBOLS",
    "CONDITIONS",
    "KINDS",
    "AddedEffect",
    "Commissioning",
    "Condition",
    "ContinuousString",
    "Coolant",
    "DiscreteString",
    "Disturbance",
    "Floats",
    "ParameterKind",
    "Prior",
    "Start",
    "StringModel",
    "StringParameters",
    "continuous",
    "coolant_path",
    "discretize",
    "exchange",
    "gathered_noise",
    "simulate",
    "start_spread",
    "steady_state",
]
