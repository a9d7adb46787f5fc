"""Five strings of twelve cells with sensors on the end cells, truth by an independent integrator, as CAN traffic."""

import numpy as np

from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Engine, Estimated, drive
from tests.acceptance.drives import EPOCH_S, frames_of, string_drive

S = 1_000_000_000


def test_with_right_parameters_every_core_is_found_within_two_minutes(tmp_path) -> None:
    """Start temperatures unknown, another one in each string, cores above or below their surfaces."""
    config = tmp_path / "gateway.toml"
    text = shipped("deploy/example/gateway.toml").read_text().replace('"window"', '"off"', 1)
    config.write_text(text)
    model = shipped("deploy/example/string.toml").read_text()
    (tmp_path / "string.toml").write_text(model)
    loaded = load_config(config)
    starts = [(37.0, 0.0), (30.0, 6.0), (25.0, 0.0), (41.0, 3.0), (20.0, -2.0)]
    drives = [string_drive(3, seed, start, gap) for seed, (start, gap) in enumerate(starts)]
    frames = frames_of(loaded.plan, loaded.database, drives, seed=3)
    worst: dict[int, float] = {}
    for event in drive(Engine(loaded.plan, loaded.database), [frames]):
        if isinstance(event, Estimated):
            k = event.time_ns // S - EPOCH_S
            index = int(event.string.split("_")[1]) - 1
            error = np.abs(event.core - drives[index][2][k])
            worst[k] = max(worst.get(k, 0.0), float(np.max(error)))
    seconds = max(k for k, w in worst.items() if not w <= 1.0) + 1 if any(not w <= 1.0 for w in worst.values()) else 0
    print(f"all 60 cores within 1 K of the truth from second {seconds} on")
    assert seconds < 120
