"""Frames and time in, frames and events out: no I/O, no clock."""

from bms_gateway.engine.drive import drain, drive
from bms_gateway.engine.engine import Engine
from bms_gateway.engine.events import (
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
from bms_gateway.engine.plan import Channel, Plan, StringPlan

__all__ = [
    "Channel",
    "Decoded",
    "Engine",
    "Estimated",
    "Event",
    "Job",
    "Judged",
    "Judgement",
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
