"""What a file may give: more is told in one line, before memory is taken for it."""

import pytest

from bms_gateway.cli.main import main
from bms_gateway.errors import DataError
from bms_gateway.records import read
from bms_gateway.workbench import bench
from tests.cli.measured_tables import MODEL, encoded, table
from tests.config.files import OWN, write
from tests.config.model_texts import EXAMPLE

SECONDS = 100


def test_a_table_beyond_what_the_page_takes_is_told_with_its_line(tmp_path, monkeypatch):
    """One of 250 MiB was read, and made into a record of 2 GB."""
    file, model = table(tmp_path, seconds=SECONDS), tmp_path / "string.toml"
    model.write_text(EXAMPLE)
    columns = len(file.read_text().splitlines()[0].split(","))
    monkeypatch.setattr(bench, "MOST_NUMBERS", (SECONDS + 1) * (columns + 1) - 1)
    request = {"do": "open", "files": {"tables": [str(file)], "model": str(model)}, "folder": str(tmp_path)}
    with pytest.raises(
        DataError, match=r"bench.csv: line \d+: over [\d,]+ numbers, more than is taken in here; cut it"
    ):
        bench.Bench().answer(request, lambda *_: None, lambda _: None)
    monkeypatch.setattr(bench, "MOST_NUMBERS", (SECONDS + 1) * (columns + 1))
    opened = bench.Bench().answer(request, lambda *_: None, lambda _: None)
    assert opened["files"]["tables"] == [str(file)]


@pytest.mark.parametrize(
    ("most", "says"),
    [(500, r"[\d,]+ samples: over 500 numbers"), (4_000, "[\\d,]+ stamps of [0-9]+ signals: over 4,000")],
)
def test_a_log_beyond_it_is_told(tmp_path, most, says):
    """Each signal with stamps of its own made a column as long as all stamps together."""
    config = write(tmp_path, OWN)
    log = encoded(tmp_path, table(tmp_path, seconds=SECONDS), config)
    with pytest.raises(DataError, match=rf"\.log: {says}.*cut the log into several") as told:
        read.read_measurements([log], model=MODEL, config=config, reading=read.Reading(most=most))
    assert "\n" not in str(told.value)


def test_the_command_line_has_a_bound_for_logs_too(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(read, "MOST_OF_A_LOG", 500)
    config, model = write(tmp_path, OWN), tmp_path / "string.toml"
    model.write_text(EXAMPLE)
    log = encoded(tmp_path, table(tmp_path, seconds=SECONDS), config)
    capsys.readouterr()
    assert main(["compare", str(log), "--config", str(config), "--model", str(model)]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "samples: over 500 numbers" in told


def test_samples_of_other_strings_are_not_kept(tmp_path, monkeypatch):
    """Of a vehicle with many strings all were, to be looked through at the end."""
    config = write(tmp_path, OWN + '[[string]]\nname = "string_2"\nmodel = "string_1.toml"\n')
    log = tmp_path / "two.log"
    assert main(["simulate", "--config", str(config), "--out", str(log), "--duration", "20"]) == 0
    heard, accepted = [], read.accepted_samples
    monkeypatch.setattr(read, "accepted_samples", lambda *words: heard.append(accepted(*words)) or heard[-1])
    (record,) = read.read_measurements([log], model=MODEL, config=config, string="string_2")
    assert len(record.surface.y) > 20
    assert set(heard[0].input.tolist()) <= set(heard[0].inputs.values())
    assert len(heard[0].input) < 0.6 * heard[0].taken.sum()
