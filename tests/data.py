"""Where the real measurements lie: outside the project, never committed."""

import os
from pathlib import Path

import pytest


def data_dir() -> Path:
    """Folder of the measurements: `BMS_GATEWAY_DATA`, else beside the checkout."""
    named = os.environ.get("BMS_GATEWAY_DATA")
    return Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"


def need(*parts: str) -> Path:
    """Path of one file or folder of the measurements; skips the test, saying why, where it is absent."""
    path = data_dir().joinpath(*parts)
    if not path.exists():
        pytest.skip(f"real data not here: {'/'.join(parts)} (set BMS_GATEWAY_DATA)")
    return path
