"""The physics: parameters, the string of cells, its discretisation and simulation."""

from bms_gateway.thermal.discretize import DiscreteString, discretize
from bms_gateway.thermal.disturbance import HEAT_GAIN_SD, Disturbance, Start, gathered_noise, start_spread
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
    Posterior,
    Prior,
    Share,
    StringModel,
    StringParameters,
)
from bms_gateway.thermal.simulate import simulate
from bms_gateway.thermal.string import ContinuousString, continuous, coolant_path, exchange, film, steady_state

__all__ = [
    "CELL_SYMBOLS",
    "CONDITIONS",
    "HEAT_GAIN_SD",
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
    "Posterior",
    "Prior",
    "Share",
    "Start",
    "StringModel",
    "StringParameters",
    "continuous",
    "coolant_path",
    "discretize",
    "exchange",
    "film",
    "gathered_noise",
    "simulate",
    "start_spread",
    "steady_state",
]
