"""Root writes folders of results beside another user, and runs in a folder of theirs."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bms_gateway.cli.init import keep
from bms_gateway.errors import UsageError
from bms_gateway.report.csv_out import ResultFolder
from bms_gateway.report.processes import processes
from tests.support.other_user import NOT_ROOT, OTHER, home, untouched

__all__ = ["home"]


@NOT_ROOT
@pytest.mark.parametrize("name", ["gateway.toml", "gateway.toml.bak"])
def test_a_config_is_kept_through_no_link_of_another_user(home, name):
    """What a file of root's says was copied to where everybody reads it."""
    out = home / "out"
    out.mkdir()
    (out / "gateway.toml").write_text("[bus]\n")
    (out / name).unlink(missing_ok=True)
    (out / name).symlink_to(home.parent / "secret" / ("file" if name == "gateway.toml" else "new"))
    os.lchown(out / name, OTHER, OTHER)
    os.chown(out, OTHER, OTHER)
    with pytest.raises(UsageError, match="cannot be kept"):
        keep(out / "gateway.toml")
    assert untouched(home)
    assert sorted(p.name for p in out.iterdir()) == sorted({"gateway.toml", name})


def test_a_config_that_is_no_file_is_not_said_to_be_kept(tmp_path):
    os.mkfifo(tmp_path / "gateway.toml")
    with pytest.raises(UsageError, match=r"cannot be kept as gateway\.toml\.bak: it is no file"):
        keep(tmp_path / "gateway.toml")
    assert not (tmp_path / "gateway.toml.bak").exists()


def test_a_kept_config_has_the_mode_of_the_one_it_was(tmp_path):
    (tmp_path / "gateway.toml").write_text("password")
    (tmp_path / "gateway.toml").chmod(0o600)
    keep(tmp_path / "gateway.toml")
    kept = tmp_path / "gateway.toml.bak"
    assert (kept.read_text(), kept.stat().st_mode & 0o777) == ("password", 0o600)


@NOT_ROOT
def test_results_reach_no_other_folder_whatever_becomes_of_their_names(home):
    """The folder of the unfinished results was found by its name: a link in its place led to a folder of root's."""
    out = home / "out"
    out.mkdir()
    os.chown(out, OTHER, OTHER)
    with ResultFolder(out, {}) as folder:
        (part,) = out.iterdir()
        part.rename(out / "away")
        part.symlink_to(home.parent / "secret")
        folder.create("broadcast.log").close()
        folder.write_summary(frames=1, duration_s=1.0, dropped=0, rejected={})
    assert untouched(home)
    assert {"summary.json", "estimates.csv", "broadcast.log"} <= {p.name for p in out.iterdir()}
    assert (out / "summary.json").owner() == "root"


def test_a_folder_that_has_the_name_of_a_result_leaves_all_earlier_results_as_they_were(tmp_path):
    (tmp_path / "summary.json").mkdir()
    (tmp_path / "estimates.csv").write_text("earlier")
    with (
        pytest.raises(UsageError, match=r"summary\.json: is a folder"),
        ResultFolder(tmp_path, {}) as folder,
    ):
        folder.write_summary(frames=1, duration_s=1.0, dropped=0, rejected={})
    assert (tmp_path / "estimates.csv").read_text() == "earlier"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["estimates.csv", "summary.json"]


RUN = """
from bms_gateway.report.processes import processes
from bms_gateway.workbench.process import Worker
import threading
if __name__ == "__main__":
    with processes(1) as pool:
        print(pool.submit(abs, -1).result())
    gone = threading.Event()
    worker = Worker(lambda worker, answer: gone.set() if answer is None else None)
    worker.ask({})
    worker.end()
"""


def test_helpers_load_no_module_of_the_folder_in_which_the_program_runs(tmp_path):
    """They looked there first, and root ran what another user had put there."""
    folder, program = tmp_path / "folder", tmp_path / "bin" / "program.py"
    folder.mkdir()
    program.parent.mkdir()
    program.write_text(RUN)
    for module in ("multiprocessing", "json", "pickle", "signal"):
        (folder / f"{module}.py").write_text("open('loaded', 'a').close()\nraise SystemExit(1)\n")
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    words = [sys.executable, program]
    done = subprocess.run(words, cwd=folder, env=env, capture_output=True, text=True, timeout=60, check=False)
    assert (done.stdout, done.returncode) == ("1\n", 0), done.stderr
    assert not (folder / "loaded").exists()


def test_the_environment_is_as_before(monkeypatch):
    for value in (None, "1"):
        if value is None:
            monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
        else:
            monkeypatch.setenv("PYTHONSAFEPATH", value)
        with processes(1) as pool:
            assert pool.submit(abs, -1).result() == 1
        assert os.environ.get("PYTHONSAFEPATH") == value
