"""Whatever is typed, the program answers with the right exit status and without a traceback."""

import errno
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from bms_gateway import __version__
from bms_gateway.cli import check
from bms_gateway.cli.main import COMMANDS, main
from bms_gateway.errors import MissingExtraError
from tests.config.files import OWN, write

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_has_an_example(capsys, command):
    assert main([command, "--help"]) == 0
    out = capsys.readouterr().out
    assert f"usage: bms-gateway {command}" in out
    assert f"example:\n  bms-gateway {command}" in out


def test_help_lists_every_command(capsys):
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"\n  {command} " in out for command in COMMANDS)
    assert main([]) == 2
    assert main(["--version"]) == 0
    assert __version__ in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["chek"], "unknown command 'chek'; did you mean 'check'?"),
        (["--verson"], "unknown option '--verson'; did you mean '--version'?"),
        (["check"], "check: the following arguments are required: CONFIG"),
        (["check", "--jsn", "x"], "check: unknown option '--jsn'; did you mean '--json'?"),
        (["check", "--jsn=x"], "unknown option '--jsn'; did you mean '--json'?"),
        (["check", "a", "b"], "check: one argument too many: 'b'"),
        (["check", "a", "--json"], "check: argument --json: expected one argument"),
        (["check", "absent.toml"], "absent.toml: no such file"),
        (["simulate", "--config", "a", "--out", "b", "--seed", "x"], "argument --seed: invalid int value: 'x'"),
        (["simulate", "--config", "a", "--out", "b", "--cycle", "us6"], "no such cycle; did you mean 'us06'?"),
        (["simulate", "--config", "a", "--out", "b", "--seed", "-1"], "--seed -1: must not be negative"),
        (["simulate", "--config", "a", "--out", "b", "--duration", "0"], "--duration 0: at least 1 second"),
        (["simulate", "--config", "a", "--out", "b", "--duration", "nan"], "--duration nan: at least 1 second"),
        (
            ["simulate", "--config", "a", "--out", "b", "--duration", "1e12"],
            "--duration 1e+12: at most 2592000 seconds",
        ),
        (["demo", "--seed", "-1"], "demo: --seed -1: must not be negative"),
        (["demo", "--seconds", "1e12"], "demo: --seconds 1e+12: at most 86400"),
        (["replay", "a.log", "--to", "vcan9", "--speed", "fast"], "--speed 'fast': valid: 1"),
        (["replay", "a.log", "--to", "vcan9", "--speed", "-1"], "--speed '-1': valid: 1"),
    ],
)
def test_wrong_words_are_one_line_with_the_nearest_choice_and_status_2(capsys, words, says):
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("bms-gateway: error: ")
    assert err.count("\n") == 1
    assert says in err


def test_a_stop_by_the_user_is_clean(monkeypatch, capsys):
    def stopped(args):
        raise KeyboardInterrupt

    monkeypatch.setattr(check, "run", stopped)
    assert main(["check", "gateway.toml"]) == 130
    assert capsys.readouterr().err == "bms-gateway: stopped\n"


def test_an_error_of_several_lines_is_folded_into_one(monkeypatch, capsys):
    def lacking(args):
        raise MissingExtraError("a\nthing", "mf4")

    monkeypatch.setattr(check, "run", lacking)
    assert main(["check", "gateway.toml"]) == 2
    assert capsys.readouterr().err == (
        "bms-gateway: error: a thing needs an optional package: pip install 'bms-gateway[mf4]'\n"
    )


def run(*words, **how):
    return subprocess.run(
        [sys.executable, "-m", "bms_gateway", *words], capture_output=True, text=True, check=False, **how
    )


def test_as_a_process_it_gives_json_alone_on_standard_output(tmp_path):
    done = run("check", str(write(tmp_path, OWN)), "--json", "-")
    assert done.returncode == 0
    found = json.loads(done.stdout)
    assert found["ok"] is True
    assert found["strings"][0]["exact_rank"] == found["strings"][0]["states"] == 10
    assert len(found["strings"][0]["core_sd_K"]) == 5
    assert "string_1" in done.stderr


def test_json_that_cannot_be_written_is_one_line(tmp_path, capsys):
    assert main(["check", str(write(tmp_path, OWN)), "--json", str(tmp_path / "absent" / "a.json")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_a_closed_pipe_is_quiet(tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "bms_gateway", "--help"], stdout=writing, stderr=subprocess.PIPE, text=True, check=False
    )
    os.close(writing)
    assert done.stderr == ""
    assert done.returncode == 141


@pytest.mark.parametrize("words", [["--help"], ["effects"], ["completion", "bash"]])
def test_an_output_on_a_full_disk_is_one_line(words):
    """It was a traceback of `OSError`; with more output than one buffer it came from within the command."""
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "bms_gateway", *words], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.stderr == "bms-gateway: error: a result cannot be written: No space left on device\n"
    assert done.returncode == 2


def test_an_error_of_the_system_that_no_disk_makes_is_a_bug_to_be_seen(monkeypatch):
    def refused(args):
        raise ConnectionRefusedError(errno.ECONNREFUSED, "refused")

    monkeypatch.setattr(check, "run", refused)
    with pytest.raises(ConnectionRefusedError):
        main(["check", "gateway.toml"])


def test_without_standard_output_a_command_works_all_the_same(tmp_path):
    """Python has no `sys.stdout` then."""
    path, out = write(tmp_path, OWN), tmp_path / "out.json"
    line = f"exec {sys.executable} -m bms_gateway check {path} --json {out} >&-"
    done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(out.read_text())["ok"] is True


@pytest.mark.parametrize(
    "environment",
    [
        {"PYTHONIOENCODING": "ascii"},
        {"PYTHONIOENCODING": "utf-8"},
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    ],
)
@pytest.mark.plain_cases(1)
def test_any_encoding_of_the_terminal_and_any_name_of_a_file_will_do(tmp_path, environment):
    """Of what it cannot show, the codes are shown; JSON stays JSON in UTF-8."""
    folder = tmp_path / os.fsdecode(b"name\xff")  # no text in UTF-8
    folder.mkdir()
    path = str(write(folder, OWN))
    words = [sys.executable, "-m", "bms_gateway", "check", path]
    env = {**os.environ, **environment}
    plain = subprocess.run(words, capture_output=True, check=False, env=env)
    assert (plain.returncode, plain.stderr) == (0, b"")
    assert plain.stdout.rstrip().endswith(b": sound")
    to_pipe = subprocess.run([*words, "--json", "-"], capture_output=True, check=False, env=env)
    assert b"Traceback" not in to_pipe.stderr
    assert json.loads(to_pipe.stdout.decode())["ok"] is True
    to_file = subprocess.run([*words, "--json", str(tmp_path / "a.json")], capture_output=True, check=False, env=env)
    assert (to_file.returncode, to_file.stderr) == (0, b"")
    assert (tmp_path / "a.json").read_bytes() == to_pipe.stdout


def test_help_and_errors_need_nothing_heavy():
    code = (
        "import sys; from bms_gateway.cli.main import main; main(['chek']); main(['check', '--help']);"
        "heavy = {'numpy', 'pydantic', 'cantools', 'can', 'rich', 'scipy'} & set(sys.modules); assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


STARTED = (
    "import logging, sys; bare = set(sys.modules); from pathlib import Path; "
    "import bms_gateway.cli.run; from bms_gateway.config.load import load_config; "
    "import bms_gateway.bus.socketcan, bms_gateway.service.live, bms_gateway.service.fit_process; "
    "import bms_gateway.service.reporting, bms_gateway.service.baseline, bms_gateway.store; "
    "load_config(Path('deploy/example/gateway.toml')).engine(); "
    "print(*set(sys.modules) - bare)"
)


def loaded_by(code: str) -> set[str]:
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(out.stdout.split())


def test_the_service_starts_without_what_only_other_commands_need():
    """One import of scipy.signal in a room below once trebled the time to READY."""
    loaded = loaded_by(STARTED)
    tops = {m.split(".")[0] for m in loaded}
    checks = {"pydantic", "pydantic_core", "annotated_types", "typing_extensions", "typing_inspection"}
    assert tops - sys.stdlib_module_names - {m for m in tops if "sysconfig" in m} <= {"numpy", "bms_gateway"} | checks
    rooms = {m.split(".")[1] for m in loaded if m.startswith("bms_gateway.")}
    assert rooms == {
        *("errors", "thermal", "frames", "identify", "observe", "health"),
        *("engine", "bus", "config", "store", "service", "cli", "whole", "folders"),
    }
    needless = {f"thermal.{m}" for m in ("effects", "physics", "trajectory", "cycles")}
    needless |= {f"identify.{m}" for m in ("recursive", "regression", "least_squares", "map_fit", "problem")}
    needless |= {"identify.likelihood"}
    needless |= {f"observe.{m}" for m in ("effect_observer", "tangent", "open_loop", "luenberger")}
    assert all(importlib.util.find_spec(f"bms_gateway.{m}") for m in needless)
    needless |= {"bus.pythoncan", "bus.candump", "bus.logfile", "bus.traffic", "service.mqtt", "service.broker"}
    assert not loaded & {"numpy.ma", *(f"bms_gateway.{m}" for m in needless)}


def test_fits_and_effects_of_the_service_and_check_need_no_scipy():
    """It would take 27 MiB, in the service or in each process of a fit, and a fifth of the time of `check`."""
    code = (
        "import sys, bms_gateway.identify.posterior_fit, bms_gateway.identify.resistance_by_cell, "
        "bms_gateway.identify.recursive, bms_gateway.health.window_fit, bms_gateway.observe.effect_observer, "
        "bms_gateway.sensors; "
        "print(*sys.modules)"
    )
    assert not {m.split(".")[0] for m in loaded_by(code)} & {"scipy", "cantools", "can"}


def test_linear_algebra_runs_on_one_thread_unless_told_otherwise():
    # numpy reads the setting when it is loaded: the entry must not have loaded it by then
    code = (
        "import os, sys; from bms_gateway.cli.main import main; loaded = 'numpy' in sys.modules; "
        "main(['--version']); print(loaded, os.environ['OPENBLAS_NUM_THREADS'])"
    )
    for given, wanted in ((None, "1"), ("3", "3")):
        environment = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
        environment |= {} if given is None else {"OPENBLAS_NUM_THREADS": given}
        out = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        assert out.stdout.splitlines()[-1] == f"False {wanted}"
