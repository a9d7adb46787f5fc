"""Ctrl-C at any moment: the folder holds all of a new setup, or is as it was."""

import os
import signal
from contextlib import suppress

import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import shipped
from bms_gateway.setup.taken_back import taken_back

LOG = shipped("deploy/worked/drive.log.gz")
DBC = shipped("deploy/worked/vehicle.dbc")


def state(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture
def stopped_at(monkeypatch):
    """Interrupt a call, counted by its module's function, before or after it was done."""

    def stop(module, name, count, after):
        inner, calls = getattr(module, name), []

        def interrupted(*words, **more):
            calls.append(name)
            if len(calls) == count and not after:
                raise KeyboardInterrupt
            done = inner(*words, **more)
            if len(calls) == count:
                raise KeyboardInterrupt
            return done

        monkeypatch.setattr(module, name, interrupted)

    return stop


@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_config_that_is_there_stays_as_it_is(count, after, stopped_at, tmp_path, capsys):
    """Files get their names in turns: the copy of the old config, the model, the new config."""
    for name in ("gateway.toml", "string_1.toml", "notes.txt"):
        (tmp_path / name).write_text(f"# my {name}")
    before = state(tmp_path)
    stopped_at(os, "rename", count, after)
    assert main(["init", str(LOG), "--dbc", str(DBC), "--out", str(tmp_path), "--yes"]) == 130
    assert state(tmp_path) == before
    assert capsys.readouterr().err.splitlines()[-1] == "bms-gateway: stopped"


@pytest.mark.parametrize("count", [1, 2])
def test_nothing_new_is_left_with_the_folders_made_for_it(count, stopped_at, tmp_path):
    stopped_at(os, "rename", count, True)
    out = tmp_path / "deep" / "er"
    assert main(["init", str(LOG), "--dbc", str(DBC), "--out", str(out), "--yes"]) == 130
    assert list(tmp_path.iterdir()) == []


def test_an_unnamed_part_is_taken_back(monkeypatch, tmp_path):
    """The interrupt comes right after the system has made the file, before Python knows of it."""
    inner = os.open

    def opened(path, *words, **more):
        handle = inner(path, *words, **more)
        if str(path).endswith(".tmp"):
            os.close(handle)
            raise KeyboardInterrupt
        return handle

    monkeypatch.setattr(os, "open", opened)
    assert main(["init", str(LOG), "--dbc", str(DBC), "--out", str(tmp_path), "--yes"]) == 130
    assert list(tmp_path.iterdir()) == []


def test_a_guess_is_taken_back(stopped_at, tmp_path):
    stopped_at(os, "rename", 1, True)
    assert main(["init", str(LOG), "--out", str(tmp_path / "v"), "--yes"]) == 130
    assert list(tmp_path.iterdir()) == []


def test_a_config_is_not_kept_again_where_nothing_is_written(tmp_path, capsys):
    (tmp_path / "gateway.toml").write_text("# mine")
    assert main(["init", str(LOG), "--cell", "21700 5Ah 2p", "--out", str(tmp_path), "--yes"]) == 1
    assert {p.name for p in tmp_path.iterdir()} == {"gateway.toml", "guessed.dbc"}
    assert "guessed.dbc --cell '21700 5Ah 2p' --out" in capsys.readouterr().out  # the next command knows the cell too


def swallow(folder):
    with taken_back(folder):
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        (folder / "gateway.toml").write_text("# new")


def test_an_interrupt_that_a_library_swallows_is_heeded(tmp_path):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            swallow(tmp_path)
        assert list(tmp_path.iterdir()) == []
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
