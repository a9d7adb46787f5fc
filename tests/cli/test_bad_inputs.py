"""Bad inputs are told in one line that blames the right thing, with exit status 2; and nothing is written."""

import pytest

from bms_gateway.cli.main import main
from tests.cli.bad_inputs import ALL, Case
from tests.cli.bad_inputs.case import sound, spoil


@pytest.mark.parametrize("case", ALL, ids=lambda case: case.name)
def test_one_line(case: Case, tmp_path, monkeypatch, capsys) -> None:
    sound(tmp_path)
    spoil(tmp_path, case)
    monkeypatch.chdir(tmp_path)
    before = {p.name for p in tmp_path.iterdir()}
    status = main(case.words.split())
    out, err = capsys.readouterr()
    told = [line for line in err.splitlines() if "error:" in line]
    assert (status, len(told)) == (2, 1), (out[-300:], err)
    assert "Traceback" not in out + err
    assert all(word.lower() in told[0].lower() for word in case.blame), told[0]
    assert {p.name for p in tmp_path.iterdir()} <= before | {"results", "my_vehicle", "f"}


def test_they_are_145_and_more() -> None:
    assert len({case.name for case in ALL}) == len(ALL) >= 145
