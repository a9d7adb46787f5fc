"""Tables for `encode`, and its logs as cantools reads them."""

import tomllib

import cantools
import numpy as np

from bms_gateway.bus.logfile import read_log
from bms_gateway.frames.batch import EXTENDED
from tests.frames.payloads import OWN, parsed


def decode(log, config):
    """Signals of a log as cantools reads them: "Message.Signal" → (times, values)."""
    named = tomllib.loads(config.read_text()).get("bus", {}).get("dbc", [])
    databases = [parsed(OWN), *(cantools.database.load_file(config.parent / name) for name in named)]
    by_id = {m.frame_id | (EXTENDED if m.is_extended_frame else 0): m for db in databases for m in db.messages}
    found = {}
    for batch in read_log(log):
        for t, can_id, length, data in zip(batch.time_ns, batch.can_id, batch.length, batch.data, strict=True):
            message = by_id[int(can_id)]
            values = message.decode(bytes(data[:length]), decode_choices=False)
            for name, value in values.items():
                found.setdefault(f"{message.name}.{name}", []).append((t * 1e-9, value))
    return {name: np.array(pairs).T for name, pairs in found.items()}


def put(tmp_path, rows, name="t.csv"):
    (tmp_path / name).write_text(
        "time_s,current_A,coolant_inlet_C,surface_1_C,surface_3_C,surface_5_C\n" + "\n".join(rows)
    )
    return str(tmp_path / name)


def words_of(config, log):
    return ["--config", str(config), "--out", str(log)]
