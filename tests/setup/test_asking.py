"""What `init` asks on a terminal, and what it makes of the answers: run on a pseudo-terminal, as a user does."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from tests.setup.vehicles import imperial, write

ROOT = Path(__file__).parents[2]
INLET = (
    "coolant_inlet: Accessories.AmbientTemp (18.89 … 18.89 °C; unit degF; the temperature of the surroundings)? [Y/n] "
)


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory):
    """Log and DBC in which only the inlet is unsure."""
    return write(imperial(), tmp_path_factory.mktemp("imperial"))


def init(vehicle, out: Path, answers: str) -> tuple[int, str]:
    """Run `init` on a terminal on which the answers are typed; status and what the terminal shows."""
    log, dbc = vehicle
    ours, its = pty.openpty()
    words = ["init", str(log), "--dbc", str(dbc), "--cell", "catl_lf280", "--out", str(out)]
    program = subprocess.Popen(
        [sys.executable, "-m", "bms_gateway", *words], stdin=its, stdout=its, stderr=subprocess.DEVNULL, cwd=ROOT
    )
    os.close(its)
    os.write(ours, answers.encode())
    shown = b""
    try:
        while piece := os.read(ours, 4096):
            shown += piece
    except OSError:  # the other end is closed
        pass
    os.close(ours)
    return program.wait(timeout=60), shown.decode().replace("\r\n", "\n")


def test_what_is_not_sure_is_asked_and_left_out_if_refused(vehicle, tmp_path) -> None:
    status, shown = init(vehicle, tmp_path / "v", "n\n")
    assert status == 0
    assert INLET in shown
    assert shown.count("[Y/n]") == 1
    text = (tmp_path / "v" / "gateway.toml").read_text()
    assert "coolant_inlet = { constant_C = " in text
    assert "AmbientTemp" not in text


@pytest.mark.parametrize("answers", ["\n", "j\n", "\x04"], ids=["enter", "ja", "end of input"])
@pytest.mark.plain_cases(1)
def test_what_is_agreed_to_is_taken(vehicle, tmp_path, answers) -> None:
    status, shown = init(vehicle, tmp_path / "v", answers)
    assert status == 0
    assert INLET in shown
    assert 'coolant_inlet = "Accessories.AmbientTemp"' in (tmp_path / "v" / "gateway.toml").read_text()


@pytest.fixture(scope="module")
def brief(tmp_path_factory):
    """The first 50 s of the log, in which nothing is sure."""
    log, dbc = write(imperial(), tmp_path_factory.mktemp("brief"))
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(line for line in lines if float(line[1:18]) < 1_700_000_050))
    return log, dbc


def test_after_a_no_the_next_best_is_offered_with_its_reasons(brief, tmp_path) -> None:
    """A refused current once left the config without any."""
    status, shown = init(brief, tmp_path / "v", "n\ny\n\n\n\n\n")
    assert status == 0, shown
    first = shown.index("current: BatteryElectrical.PackCurrent (")
    second = shown.index("next best current: DriveUnit.InverterDcCurrent (")
    assert first < second < shown.index("voltage: BatteryElectrical.PackVoltage")
    assert "unit A; named as a current" in shown[second:].partition("[Y/n]")[0]
    text = (tmp_path / "v" / "gateway.toml").read_text()
    assert 'current = "DriveUnit.InverterDcCurrent"' in text
    assert shown.count("current: BatteryElectrical.PackCurrent (") == 1


def test_where_all_are_refused_nothing_is_written(brief, tmp_path) -> None:
    status, shown = init(brief, tmp_path / "v", "n\n" * 20)
    assert status == 1
    assert "no signal is a current of the pack: nothing was written" in shown
    assert not (tmp_path / "v").exists()


def test_a_config_is_written_over_only_by_consent(vehicle, tmp_path) -> None:
    there = tmp_path / "gateway.toml"
    there.write_text("# mine\n")
    status, shown = init(vehicle, tmp_path, "n\n")
    assert status == 1
    assert f"{there} is there already. Overwrite it? [Y/n] " in shown
    assert [p.name for p in tmp_path.iterdir()] == ["gateway.toml"]
    assert there.read_text() == "# mine\n"
    status, shown = init(vehicle, tmp_path, "y\ny\n")
    assert status == 0
    assert INLET in shown
    assert "[[string]]" in there.read_text()
    assert (tmp_path / "gateway.toml.bak").read_text() == "# mine\n"
