"""What cannot be done is told in one line that names the culprit; nothing is written, and nothing is a traceback."""

import gzip
import os

import pytest

from bms_gateway.cli.main import main
from tests.setup.vehicles import VEHICLES, german, write

DBC = 'VERSION ""\nBU_: B\nBO_ 256 A: 8 B\n SG_ Speed : 0|16@1+ (0.1,0) [0|0] "rpm" B\n'


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "a.dbc").write_text(DBC)
    (tmp_path / "long.dbc").write_text(DBC.replace("0|16@1+", "60|16@1+").replace("Speed", "PackCurrent"))
    (tmp_path / "a.log").write_text("".join(f"({1e9 + k / 10:.6f}) can0 100#{k:04x}000000000000\n" for k in range(300)))
    (tmp_path / "empty.log").write_text("")
    (tmp_path / "text.log").write_text("this is no log\nat all\n")
    (tmp_path / "cut.log.gz").write_bytes(gzip.compress(b"(1.0) can0 100#00\n" * 9)[:20])
    (tmp_path / "bad.dbc").write_text("BO_ this is no DBC")
    (tmp_path / "wide.dbc").write_text('VERSION ""\nBU_: A\n', encoding="utf-16")
    (tmp_path / "dir").mkdir()
    os.mkfifo(tmp_path / "pipe")
    return tmp_path


@pytest.mark.parametrize(
    ("words", "status", "part"),
    [
        (["none.log"], 2, "none.log"),
        (["a.logg"], 2, "no log format"),
        (["dir"], 2, "directory"),
        (["empty.log"], 2, "no data frames"),
        (["text.log"], 2, "text.log"),
        (["cut.log.gz"], 2, "cut.log.gz"),
        (["a.log", "--dbc", "none.dbc"], 2, "none.dbc: no such file"),
        (["a.log", "--dbc", "n" * 300], 2, "cannot be read: File name too long"),
        (["a.log", "--dbc", "bad.dbc"], 2, "bad.dbc"),
        (["a.log", "--dbc", "dir"], 2, "dir: is a directory; expected a file"),
        (["a.log", "--dbc", "a.dbc", "--dbc", "pipe"], 2, "pipe: cannot be read: it came to no end in"),
        (["a.log", "--dbc", "cut.log.gz"], 2, "no text of a DBC"),
        (["a.log", "--dbc", "wide.dbc"], 2, "wide.dbc: is a DBC in UTF-16; save it as UTF-8 or Windows-1252"),
        (["a.log", "--dbc", "a.log"], 2, "a.log"),
        (["a.log", "--dbc", "a.dbc", "--cell", "nonsense"], 2, "nonsense"),
        (["a.log", "--dbc", "a.dbc", "--cell", ""], 2, "cell"),
        (["a.log", "--dbc", "a.dbc", "--out", "a.log"], 2, "is a file"),
        (["a.log", "--dbc", "a.dbc", "--out", ""], 2, "--out is empty"),
        (["a.log", "--dbc", "a.dbc", "--json", "dir"], 2, "is a directory"),
        (["a.log", "--dbc", "a.dbc", "--json", "a.log"], 2, "is read by the command"),
        (["a.log", "--dbcs", "a.dbc"], 2, "did you mean '--dbc'"),
        ([], 2, "LOG"),
        (
            ["a.log", "--dbc", "a.dbc"],
            1,
            "no signal is a current of the pack: nothing was written; is it in another DBC",
        ),
        (["a.log", "--dbc", "long.dbc"], 1, "nothing was written; correct the DBC where the notes say it is wrong"),
        (["a.log"], 1, "give the vehicle's DBC with --dbc"),
    ],
)
def test_one_line(words, status, part, folder, monkeypatch, capsys) -> None:
    monkeypatch.chdir(folder)
    assert main(["init", *words]) == status
    out, err = capsys.readouterr()
    told = err if status == 2 else out
    assert part in told
    assert "Traceback" not in out + err
    assert not list(folder.rglob("gateway.toml"))
    if status == 2:
        assert err.count("\n") == 1


def test_a_config_that_is_there_is_not_written_over(tmp_path, capsys) -> None:
    log, dbc = write(VEHICLES["terse"](), tmp_path)
    (tmp_path / "v").mkdir()
    (tmp_path / "v" / "gateway.toml").write_text("# mine")
    words = ["init", str(log), "--dbc", str(dbc), "--out", str(tmp_path / "v")]
    assert main(words) == 2
    assert "is there already" in capsys.readouterr().err
    assert (tmp_path / "v" / "gateway.toml").read_text() == "# mine"


def test_a_name_with_odd_letters_survives_in_the_config(tmp_path) -> None:
    log, dbc = write(VEHICLES["terse"](), tmp_path)
    odd = tmp_path / "my car's “DBC” ü.dbc"
    dbc.rename(odd)
    out = tmp_path / "deep" / "er"
    assert main(["init", str(log), "--dbc", str(odd), "--out", str(out)]) == 0
    assert main(["check", str(out / "gateway.toml"), "--log", str(log)]) == 0


def test_a_scale_of_zero_is_told(tmp_path, capsys) -> None:
    """The current is lost by it; the note says why."""
    vehicle = german()
    log, dbc = write(vehicle, tmp_path)
    text = dbc.read_text()
    assert "HVB_Strom_Ist : 7|16@0+ (0.1," in text
    dbc.write_text(text.replace("HVB_Strom_Ist : 7|16@0+ (0.1,", "HVB_Strom_Ist : 7|16@0+ (0,"))
    assert main(["init", str(log), "--dbc", str(dbc), "--out", str(tmp_path / "v"), "--yes"]) == 1
    told = [line for line in capsys.readouterr().err.splitlines() if "scale of zero" in line]
    assert len(told) == 1
    assert "HVB_Status1.HVB_Strom_Ist" in told[0]
