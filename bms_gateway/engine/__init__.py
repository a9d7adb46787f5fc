"""Frames and time in, frames and events out: no I/O, no clock."""

from bms_gateway.engine.driver import drain, drive
from bms_gateway.engine.engine import Engine
from bms_gateway.engine.events import (
    Alerted,
    Cells,
    Decoded,
    Estimated,
    Event,
    Job,
    Judged,
    Judgement,
    Level,
    Notice,
    Parameters,
    SendFrames,
    StartJob,
)
from bms_gateway.engine.forecast_result import Forecast, Foreseen
from bms_gateway.engine.plan import Channel, Plan, StringPlan
from bms_gateway.engine.readings import Layout

__all__ = [
    "Alerted",
    "Cells",
    "Channel",
    "Decoded",
    "Engine",
    "Estimated",
    "Event",
    "Forecast",
    "Foreseen",
    "Job",
    "Judged",
    "Judgement",
    "Layout",
    "Level",
    "Notice",
    "Parameters",
    "Plan",
    "SendFrames",
    "StartJob",
    "StringPlan",
    "drain",
    "drive",
]
