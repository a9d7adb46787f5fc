"""Values of a multiplexer that no frame can carry select nothing, however large they are."""

import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import load_config
from tests.config.files import DBC, write


@pytest.mark.parametrize("value", [256, 2**32, 2**63, 10**20 - 1, 10**300])
def test_a_value_that_the_multiplexer_cannot_have_is_no_reason_to_end(tmp_path, monkeypatch, value):
    """The table of values was made of whole numbers of 64 bits: one beyond them ended `check` with a traceback."""
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "tables"))
    path = write(tmp_path)
    (tmp_path / "vehicle.dbc").write_text(DBC.replace("SG_ T2 m0 ", f"SG_ T2 m{value} "))
    assert main(["check", str(path)]) == 0
    table = load_config(path).database.compile(["Temps.T1", "Temps.T2"])
    sound = load_config(write(tmp_path)).database.compile(["Temps.T1", "Temps.T2"])
    assert table.switches.declared.tolist() == sound.switches.declared.tolist()
