"""A small config for the bench: one string of four cells, its ends sensed, all signals of our own DBC."""

from pathlib import Path

from bms_gateway.config import shipped

LONG = {"cell-runaway", "thermocouple-slow", "thermocouple-stuck", "thermocouple-noisy"}
LONG |= {f"current-{kind}" for kind in ("stuck", "clipped", "saturated", "sign", "end-of-range")}
"""Scenarios that take many minutes of bench time."""

GATEWAY = """\
[bus]
channel = "vcan0"

[[string]]
name = "string_1"
model = "string.toml"
"""


def config(folder: Path) -> Path:
    """Write gateway.toml and string.toml; returns the path of the former."""
    model = shipped("deploy/example/string.toml").read_text(encoding="utf-8")
    small = model.replace("cells = 12", "cells = 4").replace("sensors = [1, 12]", "sensors = [1, 4]")
    assert small != model
    (folder / "string.toml").write_text(small, encoding="utf-8")
    file = folder / "gateway.toml"
    file.write_text(GATEWAY, encoding="utf-8")
    return file
