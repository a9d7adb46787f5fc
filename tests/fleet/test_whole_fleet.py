"""A run of a fleet: complete whatever a log holds, taken up where it was left, the same however it is spread."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from bms_gateway.cli.main import main
from bms_gateway.errors import UsageError
from bms_gateway.fleet.pool import DIED, on_this_machine
from bms_gateway.fleet.task import Outcome
from bms_gateway.fleet.vehicle_names import vehicle_of
from tests.fleet.packs import logs
from tests.truth.hidden import Scenario


@pytest.fixture(scope="module")
def traffic(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fleet")
    return logs(folder, {f"v{k}": Scenario(seed=k, seconds=60) for k in range(3)})


def fleet(some, config, out, *more):
    return main(["fleet", *map(str, some), "--config", str(config), "--out", str(out), *more])


def contents(out: Path) -> dict[str, bytes]:
    return {str(f.relative_to(out)): f.read_bytes() for f in sorted(out.rglob("*")) if f.is_file()}


def rows(out):
    return pq.read_table(out / "fleet.parquet").to_pylist()


@pytest.fixture(scope="module")
def first(traffic, tmp_path_factory):
    """A first run with one process; its results are not to be written to."""
    config, made = traffic
    out = tmp_path_factory.mktemp("first") / "out"
    assert fleet(made, config, out, "--jobs", "1") == 0
    return out


def test_one_row_per_log_and_string(first):
    found = rows(first)
    assert [r["vehicle"] for r in found] == ["v0", "v1", "v2"]
    assert {r["string"] for r in found} == {"string_1"}
    assert all(r["error"] is None and r["frames"] > 0 and r["worst_core_C"] is not None for r in found)


def test_two_processes_and_another_order_give_the_same_bytes(traffic, first, tmp_path):
    config, made = traffic
    assert fleet(made, config, tmp_path, "--jobs", "2") == 0
    assert contents(tmp_path) == contents(first)


def test_a_second_run_does_only_what_is_new_or_changed(traffic, tmp_path, capsys):
    config, made = traffic
    mine = [tmp_path / m.name for m in made]
    for a, b in zip(made, mine, strict=True):
        b.write_bytes(a.read_bytes())
    out = tmp_path / "out"
    assert fleet(mine[:2], config, out, "--jobs", "1", "--json", str(tmp_path / "1.json")) == 0
    assert fleet(mine, config, out, "--jobs", "1", "--json", str(tmp_path / "2.json")) == 0
    one, two = (json.loads((tmp_path / f"{k}.json").read_text()) for k in (1, 2))
    assert (one["analysed"], one["skipped"]) == (2, 0)
    assert (two["analysed"], two["skipped"]) == (1, 2)
    os.utime(mine[0], ns=(1, 1))
    assert fleet(mine, config, out, "--jobs", "1", "--json", str(tmp_path / "3.json")) == 0
    assert json.loads((tmp_path / "3.json").read_text())["analysed"] == 1
    assert len(list((out / "logs").iterdir())) == 3  # what the log was before has gone


def test_a_result_that_was_cut_short_is_made_anew(traffic, first, tmp_path):
    config, made = traffic
    out = tmp_path / "out"
    for name, data in contents(first).items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(data)
    part = sorted((out / "logs").iterdir())[0]
    part.write_bytes(part.read_bytes()[:100])
    assert fleet(made, config, out, "--jobs", "1") == 0
    assert contents(out) == contents(first)


def test_a_bad_log_has_a_row_that_says_why_and_does_not_end_the_run(traffic, tmp_path, capsys):
    config, made = traffic
    bad = tmp_path / "bad.log"
    bad.write_text("no log at all\n")
    assert fleet([bad, made[0], tmp_path / "nope.log"], config, tmp_path / "out", "--jobs", "1") == 1
    err = capsys.readouterr().err.splitlines()
    assert len(err) == 1
    assert "2 of 3 logs could not be used" in err[0]
    good, *wrong = rows(tmp_path / "out")
    assert good["vehicle"] == "v0"
    assert [(r["vehicle"], r["string"]) for r in wrong] == [("bad", None), ("nope", None)]
    assert "bad.log" in wrong[0]["error"]
    assert "No such file" in wrong[1]["error"]


def test_json_on_standard_output_is_alone_there(traffic, first, tmp_path, capsys):
    config, made = traffic
    assert fleet(made[:1], config, tmp_path / "out", "--jobs", "1", "--json", "-") == 0
    summary = json.loads(capsys.readouterr().out)
    assert (summary["logs"], summary["vehicles"], summary["rows"], summary["bad"]) == (1, 1, 1, [])
    assert summary["atlas"]["findings"] == []


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--jobs", "0"], "--jobs 0"),
        (["--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"], "--jobs is for this machine"),
        (["--vehicle", "("], "no regular expression"),
        (["--vehicle", "lorry"], "finds nothing in"),
        (["--json", "/nowhere/x.json"], "--json"),
        (["--shedule", "x"], "did you mean '--scheduler'"),
    ],
)
def test_a_slip_of_the_pen_is_told_in_one_line(traffic, tmp_path, capsys, more, says):
    config, made = traffic
    assert fleet(made, config, tmp_path / "out", *more) == 2
    err = capsys.readouterr().err.splitlines()
    assert len(err) == 1
    assert says in err[0]


def test_no_log_is_written_over(traffic, tmp_path, capsys):
    config, made = traffic
    assert fleet(made, config, tmp_path / "out", "--json", str(made[0])) == 2
    assert "this file is read by the command" in capsys.readouterr().err


def test_a_vehicle_is_named_by_file_folder_or_pattern():
    log = Path("a/van-7/2026-05-01.LOG.gz")
    assert vehicle_of(log, "file") == "2026-05-01"
    assert vehicle_of(log, "folder") == "van-7"
    assert vehicle_of(log, "van-([0-9]+)") == "7"
    assert vehicle_of(log, "van-[0-9]+") == "van-7"
    with pytest.raises(UsageError, match="empty name"):
        vehicle_of(log, "van-(x*)")


WITHOUT = """
import sys
sys.modules[{module!r}] = None
from bms_gateway.cli.main import main
if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize("module", ["pyarrow", "distributed"])
def test_a_missing_package_is_told_with_the_command_that_installs_it(traffic, tmp_path, module):
    config, made = traffic
    more = ["--scheduler", "tcp://127.0.0.1:1"] if module == "distributed" else []
    words = ["fleet", str(made[0]), "--config", str(config), "--out", str(tmp_path / "out"), *more]
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT.format(module=module), *words], capture_output=True, text=True, cwd=Path.cwd()
    )
    assert done.returncode == 2
    assert "pip install 'bms-gateway[fleet]'" in done.stderr
    assert len(done.stderr.splitlines()) == 1


class Deadly:
    """A task that takes the process down with which it is unpacked; once, or always."""

    def __init__(self, flag: Path, *, always: bool) -> None:
        self.flag, self.always = flag, always

    def __reduce__(self):
        return _die, (str(self.flag), self.always)


def _die(flag, always):
    if always or not Path(flag).exists():
        Path(flag).touch()
        os._exit(9)


class _Harmless:
    """What `analyse` takes for a task whose config is not there."""

    log = config = config_key = vehicle = "/nowhere"


@pytest.mark.slow
def test_a_process_that_is_killed_takes_only_its_own_log_along_and_what_nobody_foresaw_is_told(tmp_path):
    # the first dies, is done again, and is then nothing that could be analysed
    tasks = [Deadly(tmp_path / "once", always=False), Deadly(tmp_path / "always", always=True), _Harmless()]
    outcomes = dict(on_this_machine(tasks, 1))
    assert sorted(outcomes) == [0, 1, 2]
    assert outcomes[0].error.startswith("unexpected AttributeError")
    assert outcomes[1] == Outcome(error=DIED)
    assert "/nowhere" in outcomes[2].error
