"""A folder of another user beside one of root's, in which root must change nothing and tell nothing of."""

import os
from pathlib import Path

import pytest

OTHER = 65534  # nobody
NOT_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root can make folders of another user")


@pytest.fixture
def home(tmp_path):
    """A folder of another user, with its state; beside it a folder of root's."""
    for folder in (tmp_path, *tmp_path.parents):
        if folder.owner() == "root" and folder != Path("/"):
            folder.chmod(folder.stat().st_mode | 0o011)  # pytest keeps its folders shut; passing through is enough
    made = tmp_path / "home"
    made.mkdir()
    (made / "state").mkdir()
    for folder in (made, made / "state"):
        os.chown(folder, OTHER, OTHER)
    secret = tmp_path / "secret"
    secret.mkdir(mode=0o700)
    (secret / "file").write_text("for root alone")
    (secret / "file").chmod(0o600)
    return made


def untouched(home):
    secret = home.parent / "secret"
    found = secret / "file"
    kept = (found.read_text(), found.stat().st_mode & 0o777, [p.name for p in secret.iterdir()])
    found.chmod(0o600)
    return kept == ("for root alone", 0o600, ["file"])
