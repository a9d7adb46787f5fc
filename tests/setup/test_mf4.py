"""`init` on an MF4 log: it proposes what it proposes for the same frames in a candump log."""

import can
import pytest

from bms_gateway.bus.logfile import read_log
from bms_gateway.frames.batch import EXTENDED
from bms_gateway.setup.propose import propose
from bms_gateway.setup.vehicle_logs import read_traffic
from tests.data import need
from tests.setup.vehicles import VEHICLES, write


@pytest.mark.parametrize("name", ["german", "imperial"])
def test_an_mf4_log_gives_the_same_proposal(name: str, tmp_path) -> None:
    pytest.importorskip("asammdf")
    log, dbc = write(VEHICLES[name](), tmp_path)
    with can.Logger(tmp_path / "drive.mf4") as out:
        for batch in read_log(log):
            for t, i, n, data in zip(batch.time_ns, batch.can_id, batch.length, batch.data, strict=True):
                out(
                    can.Message(
                        timestamp=t / 1e9,
                        arbitration_id=int(i) & ~EXTENDED,
                        is_extended_id=bool(i & EXTENDED),
                        data=bytes(data[:n]),
                    )
                )
    expected, found = (propose(read_traffic([path], [dbc])) for path in (log, tmp_path / "drive.mf4"))
    assert found.signals
    assert [(p.role, p.path, p.index, p.sure) for p in found.signals] == [
        (p.role, p.path, p.index, p.sure) for p in expected.signals
    ]


@pytest.mark.parametrize("name", ["17BD1DB7_00000006_00000170", "2F6913DB_00000004_00000001"])
def test_a_log_of_css_electronics_without_a_battery_proposes_nothing_for_sure(name: str) -> None:
    pytest.importorskip("asammdf")
    log = need("conformance", "asammdf_css", f"{name}.MF4")
    found = propose(read_traffic([log], [need("dbc", "leaf_EV-can_ZE1.dbc")]))
    assert not [p.path for p in found.signals if p.sure]
