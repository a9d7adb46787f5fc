"""What `init` reads has the bounds of every config, on its second, lenient way too."""

import resource

import pytest

from bms_gateway.config import bounds
from bms_gateway.errors import ConfigError
from bms_gateway.setup.vehicle_logs import read_traffic

LOG = "(1700000000.000000) can0 123#11\n"


@pytest.mark.parametrize("dear", ["memory", "time"])
def test_a_dbc_that_costs_too_much_is_refused_in_one_line(tmp_path, monkeypatch, dear):
    """A hundred thousand messages of one identifier are refused, and were then read once more without a bound."""
    if dear == "time":
        monkeypatch.setattr(bounds, "READ_S", 0.2)
        monkeypatch.setattr(bounds, "READ_MIB", 4000)
    (tmp_path / "a.log").write_text(LOG)
    dbc = tmp_path / "a.dbc"
    dbc.write_text('VERSION ""\nBS_:\nBU_: X\n' + "BO_ 1 x: 8 X\n" * 100_000)
    before = resource.getrusage(resource.RUSAGE_SELF)
    with pytest.raises(ConfigError, match=r"a\.dbc: reading it takes over") as told:
        read_traffic([tmp_path / "a.log"], [dbc])
    after = resource.getrusage(resource.RUSAGE_SELF)
    assert "\n" not in str(told.value)
    assert after.ru_maxrss - before.ru_maxrss < 250 * 1024
    assert after.ru_utime - before.ru_utime < 20.0
