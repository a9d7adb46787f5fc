"""Frames and time in, frames and events out: no I/O, no clock."""
