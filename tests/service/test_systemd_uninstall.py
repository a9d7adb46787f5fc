"""The gateway is taken off a machine, under a real systemd: run as `test_systemd` is, and the last of its tests."""

import shutil
from pathlib import Path

import pytest

from tests.support.installed_service import CONFIG, ROOT, sh

pytestmark = [pytest.mark.systemd, pytest.mark.slow]


def test_uninstall_keeps_config_and_state_unless_purged(installed):
    sh(ROOT / "deploy" / "uninstall.sh")
    assert CONFIG.exists()
    assert not Path("/opt/bms-gateway").exists()
    sh(ROOT / "deploy" / "uninstall.sh", "--purge")
    assert not CONFIG.parent.exists()
    assert not shutil.which("bms-gateway", path="/opt/bms-gateway/venv/bin")
