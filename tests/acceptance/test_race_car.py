"""Logs of a real car with its own DBC through `analyze`: what is sound is used, what is not is told with its reason."""

import json

import cantools
import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log
from tests.acceptance.drives import analyze
from tests.acceptance.race_logs import LOGS
from tests.config.race_car import PER_STRING, THERMISTORS, write_race_car
from tests.data import need
from tests.frames.payloads import OWN, parsed


@pytest.mark.parametrize("name", LOGS)
@pytest.mark.plain_cases(1)
def test_a_real_log_gives_sound_cores_and_right_reasons(name: str, tmp_path) -> None:
    log = need("can", f"{name}.log.gz")
    config = write_race_car(tmp_path)
    e = analyze(log, config, tmp_path / "out")
    last = e["time_s"] == e["time_s"][-1]
    quality = dict(zip(_channels(e["string"][last], e["cell"][last]), e["quality"][last], strict=True))
    raw = _series(log)
    # parked: one value nearly all the time (single dips happen), while the median sensor shows dozens
    parked = {k for k, v in raw.items() if len(v) > 20 and np.unique(v, return_counts=True)[1].max() >= 0.95 * len(v)}
    sentinel = {k for k, v in raw.items() if np.isin(v[-5:], [-100.0, 555.35]).all()}
    jumpy = {k for k, v in raw.items() if len(v) > 10 and (np.abs(np.diff(v[-20:])) > 5.0).sum() >= 3} - sentinel
    good = {k for k, q in quality.items() if q == "good"}
    print(f"{name}: {len(good)} good, parked {sorted(parked)}, sentinel {sorted(sentinel)}, jumpy {sorted(jumpy)}")
    assert len(good) >= 60
    print({k: str(quality[k]) for k in sorted(parked | jumpy | sentinel)})
    assert len(parked | jumpy | sentinel) >= 2
    assert all(quality[k] == "stuck" for k in parked - sentinel)
    assert all(quality[k] in ("open", "short", "out_of_range") for k in sentinel)
    wild = {k for k in jumpy if np.ptp(raw[k][-20:]) > 100.0}  # from rail to rail: any of the reasons is right
    assert all(quality[k] == "jumpy" for k in jumpy - wild)
    assert all(quality[k] in ("jumpy", "open", "short", "out_of_range") for k in wild)
    assert np.isfinite(e["core_C"][last]).sum() >= 60
    assert np.array_equal(np.isfinite(e["core_C"]), np.isfinite(e["core_sd_K"]))
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["rejected"]["stuck"] > 0
    _all_decode(tmp_path / "out" / "broadcast.log")


ACCEPTED = dict(zip(LOGS, (117, 132, 131), strict=True))
"""Of 141 thermistors, those that are none by their whole series (a rail, one value, drawn down from it) left out."""


@pytest.mark.parametrize("name", LOGS)
@pytest.mark.plain_cases(1)
def test_an_input_without_a_sensor_is_not_good_because_it_twitches(name: str, tmp_path) -> None:
    """Some inputs read 24.52 °C, and less by up to 13 K while the inverter switches; 246 of their cores were good."""
    log = need("can", f"{name}.log.gz")
    e = analyze(log, write_race_car(tmp_path), tmp_path / "out")
    channel = np.array(_channels(e["string"], e["cell"]))
    good, last = np.array(e["quality"]) == "good", e["time_s"] == e["time_s"][-1]
    assert np.count_nonzero(good & last) == ACCEPTED[name]
    raw = _series(log)
    parked = [k for k, v in raw.items() if np.mean(v == 24.52) > 0.3]
    mine = good & np.isin(channel, parked)
    assert np.count_nonzero(mine) <= 80
    for k in {int(c) for c in channel[mine]}:
        by = np.isin(channel, [c for c in raw if (c - 1) // PER_STRING == (k - 1) // PER_STRING and c not in parked])
        for t in e["time_s"][mine & (channel == k)]:
            now = e["time_s"] == t
            off = e["core_C"][now & (channel == k)] - np.median(e["core_C"][now & by & good])
            assert abs(off[0]) < 3.0, (k, t)  # such as pass at first show what their neighbours do


def _channels(strings: np.ndarray, cells: np.ndarray) -> list[int]:
    return [(int(s.split("_")[1]) - 1) * PER_STRING + int(c) for s, c in zip(strings, cells, strict=True)]


def _series(log) -> dict[int, np.ndarray]:
    """Readings of every thermistor, decoded by hand: 8-bit multiplexer, then three of 16 bits, 0.01 K − 100."""
    found: dict[int, list[float]] = {k: [] for k in range(1, THERMISTORS + 1)}
    identifier = cantools.database.load_file(need("dbc", "uwfe_2024CAR_fixed.dbc"), strict=False)
    can_id = identifier.get_message_by_name("BMU_ChannelTemp").frame_id
    for batch in read_log(log):
        for row in batch.data[(batch.can_id & 0x1FFF_FFFF) == can_id]:
            for j in range(3):
                k = 3 * int(row[0]) + j + 1
                if k in found:
                    found[k].append((int(row[1 + 2 * j]) + 256 * int(row[2 + 2 * j])) / 100 - 100)
    return {k: np.round(v, 2) for k, v in found.items() if v}


def _all_decode(broadcast) -> None:
    """No NaN, nothing out of range: cantools decodes each frame strictly, and the values are temperatures."""

    database = parsed(OWN)
    seen = 0
    for batch in read_log(broadcast):
        for can_id, length, data in zip(batch.can_id[::7], batch.length[::7], batch.data[::7], strict=True):
            message = database.get_message_by_frame_id(int(can_id) & 0x1FFF_FFFF)
            values = message.decode(bytes(data[:length]), decode_choices=False)
            assert all(np.isfinite(v) for v in values.values())
            seen += 1
    assert seen > 500
