"""What `init` and `check` say of logs out of order, cells with other numbers, messages that are there twice."""

import subprocess
import sys

import pytest

from bms_gateway.cli.main import main
from bms_gateway.errors import UsageError
from bms_gateway.thermal.cells import cell_of
from tests.setup.vehicles import drive, plain, write


@pytest.fixture
def odd(tmp_path):
    """A vehicle with thermocouples on cells 1, 4, 6 and 9."""
    d = drive(8)
    return write(plain({f"CellTemp{n}": d.surface[:, k] for k, n in enumerate((1, 4, 6, 9))}, unit="degC"), tmp_path)


def test_logs_out_of_order_are_refused(odd, tmp_path, capsys) -> None:
    log, dbc = odd
    lines = log.read_text().splitlines(keepends=True)
    parts = [tmp_path / "a.log", tmp_path / "b.log"]
    for k, part in enumerate(parts):
        part.write_text("".join(lines[k * len(lines) // 2 : (k + 1) * len(lines) // 2]))
    words = ["--dbc", str(dbc), "--yes", "--out", str(tmp_path / "v")]
    assert main(["init", str(parts[1]), str(parts[0]), *words]) == 2
    assert "give the logs in order of time" in capsys.readouterr().err
    assert main(["init", *map(str, parts), *words]) == 0
    config = str(tmp_path / "v" / "gateway.toml")
    assert main(["check", config, "--log", str(parts[1]), "--log", str(parts[0])]) == 2


def test_cells_whose_channels_have_other_numbers_are_told(odd, tmp_path, capsys) -> None:
    log, dbc = odd
    assert main(["init", str(log), "--dbc", str(dbc), "--yes", "--out", str(tmp_path / "v")]) == 0
    told = "1 = CellTemp1, 2 = CellTemp4, 3 = CellTemp6, 4 = CellTemp9"
    assert told in capsys.readouterr().err


def test_a_message_that_is_there_twice_is_told_in_our_words_only(odd, tmp_path) -> None:
    log, dbc = odd
    text = dbc.read_text()
    first = text.index("BO_ 256 ")
    dbc.write_text(text + "\n" + text[first : text.index("BO_ ", first + 4)].replace("Elec:", "Elec2:"))
    words = [sys.executable, "-m", "bms_gateway", "init", str(log), "--dbc", str(dbc), "--yes", "--out", "v"]
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert "is in the DBC files twice" in done.stderr
    assert all(line.startswith("bms-gateway:") for line in done.stderr.splitlines())


@pytest.mark.parametrize("text", ["21700 5Ah 2p 4p", "21700 5Ah 3Ah", "21700 70g 0.08kg"])
def test_words_that_contradict_each_other_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="contradict each other"):
        cell_of(text)
    assert cell_of("21700 5Ah 4p 4p").parallel == 4


def test_check_counts_the_steps_of_the_thermocouples(tmp_path, capsys) -> None:
    sd = {}
    for bits in ("16@1- (0.01,0)", "16@1- (1,0)"):
        folder = tmp_path / bits[7:11].strip("(,")
        folder.mkdir()
        d = drive(8)
        vehicle = plain({f"CellTemp{k + 1}": d.surface[:, k] for k in range(4)}, bits, "degC")
        log, dbc = write(vehicle, folder)
        assert main(["init", str(log), "--dbc", str(dbc), "--yes", "--out", str(folder / "v")]) == 0
        capsys.readouterr()
        main(["check", str(folder / "v" / "gateway.toml")])
        row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("string_1 "))
        sd[bits] = float(row.split()[-1])
    fine, coarse = sd.values()
    assert coarse > 1.3 * fine
