"""The quality of a value, which accompanies it from the socket to the output frame."""

from enum import IntEnum
from typing import Final

AVAILABLE_SD_K: Final = 12.0
"""K: a core with a larger sd is sent as not available: it supports no decision, and the DBC's range ends there."""


class Quality(IntEnum):
    """Four bits on the bus (value table `Quality` in our DBC); the lowest number is the best."""

    GOOD = 0
    STALE = 1
    """Nothing new within the signal's time-out."""
    OUT_OF_RANGE = 2
    """Outside the DBC's or the plausible range."""
    NOT_AVAILABLE = 3
    """The sender says so (all ones, or a label of the value table)."""
    ERROR = 4
    """The sender says that its sensor failed, or the frame was too short to hold the signal."""
    STUCK = 5
    """It has not moved while everything around it did."""
    OPEN = 6
    """It reads like a broken wire (upper rail)."""
    SHORT = 7
    """It reads like a short circuit or a missing sensor (lower rail)."""
    JUMPY = 8
    """It moves faster than the measured quantity can."""
    COUNTER = 9
    """The alive counter repeated or skipped."""
    CRC = 10
    """The check sum did not match."""
    ESTIMATED = 11
    """No sensor of its own: a value from the model and its neighbours."""
    DOUBTFUL = 12
    """An estimate whose core is not proven: its model file, or evidence while driving, contradicts it."""
    NEVER = 15
    """Nothing was ever received."""
