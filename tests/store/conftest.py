"""What stands on this disk after a cut of power is no matter here: the recorder knows what was synced."""

import os

import pytest


@pytest.fixture(autouse=True)
def no_disk_is_waited_for(monkeypatch):
    """Syncing costs these thousands of saves minutes, on a slow disk more; processes of their own do sync."""
    monkeypatch.setattr(os, "fsync", lambda handle: os.fstat(handle) and None)
