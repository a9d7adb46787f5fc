"""Completion and manual page know every command and every option, and the shells take them."""

import shutil
import subprocess

import pytest

from bms_gateway.cli.main import COMMANDS, main


def printed(kind, capsys):
    assert main(["completion", kind]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("kind", ["bash", "zsh", "fish", "man"])
def test_every_command_and_its_options_are_there(kind, capsys):
    text = printed(kind, capsys).replace("\\-", "-")
    assert all(name in text for name in COMMANDS)
    for option in ("calibrate", "scheduler", "columns", "acknowledge" if kind != "man" else "truth"):
        assert option in text


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.parametrize(
    ("words", "expected"),
    [(["bms-gateway", "ana"], "analyze"), (["bms-gateway", "encode", "--co"], "--config --columns")],
)
def test_bash_completes(words, expected, capsys, tmp_path):
    file = tmp_path / "completion.bash"
    file.write_text(printed("bash", capsys))
    given = " ".join(words)
    ask = (
        f"source {file}; COMP_WORDS=({given}); COMP_CWORD={len(words) - 1}; _bms_gateway 2>/dev/null; "
        'echo "${COMPREPLY[*]}"'
    )
    told = subprocess.run(["bash", "-c", ask], capture_output=True, text=True, check=True).stdout.split()
    assert sorted(told) == sorted(expected.split())


def test_an_unknown_shell_is_one_line(capsys):
    assert main(["completion", "tcsh"]) == 2
    assert "bash" in capsys.readouterr().err
