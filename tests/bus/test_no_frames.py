"""Logs in which no frame comes: they are left after so many lines, or so much of one line."""

import pytest

from bms_gateway.bus import foreign
from bms_gateway.bus.logfile import read_log
from bms_gateway.errors import DataError

HEADS = {
    ".asc": "date Thu Jan 1 00:00:00.000 am 2024\nbase hex  timestamps absolute\nno internal events logged\n",
    ".trc": ";$FILEVERSION=1.1\n;$STARTTIME=43474.5\n",
}
REMARKS = {".asc": "// nothing\n", ".trc": "; nothing\n"}
FRAMES = {
    ".asc": "   1.000000 1  123             Rx   d 2 01 02\n",
    ".trc": "     1)         1.0  Rx         0123  2  01 02\n",
}


def frames_of(path):
    return sum(len(batch) for batch in read_log(path))


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(foreign, "MOST_IDLE", 1000)


@pytest.mark.parametrize("kind", HEADS)
def test_remarks_without_end_are_no_log(tmp_path, kind):
    log = tmp_path / f"a{kind}"
    log.write_text(HEADS[kind] + FRAMES[kind] + 1001 * REMARKS[kind])
    with pytest.raises(DataError, match="1,000 lines in a row without a frame: not a log"):
        frames_of(log)


@pytest.mark.parametrize("kind", HEADS)
def test_remarks_between_frames_may_be_as_many_as_they_are(tmp_path, kind):
    log = tmp_path / f"a{kind}"
    log.write_text(HEADS[kind] + 5 * (500 * REMARKS[kind] + FRAMES[kind]))
    assert frames_of(log) == 5


@pytest.mark.parametrize("kind", [*HEADS, ".csv"])
def test_a_line_without_end_is_not_read_to_its_end(tmp_path, kind):
    """A file system shows a hole of any size as zeros."""
    log = tmp_path / f"a{kind}"
    log.write_text(HEADS.get(kind, "timestamp,arbitration_id,extended,remote,error,dlc,data\n"))
    with log.open("r+b") as file:
        file.truncate(1 << 40)
    with pytest.raises(DataError, match="no end of line in 64 MiB: not a log"):
        frames_of(log)
