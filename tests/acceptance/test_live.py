"""The service on a real vcan0 against the analysis of a recording of the same traffic."""

import os
import signal
import socket
import statistics
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import cantools
import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log
from bms_gateway.cli.main import main
from bms_gateway.config import own_dbc_text
from bms_gateway.frames.batch import FrameBatch

pytestmark = pytest.mark.vcan

SECONDS = 24
FIRST_S, AFTER_S = 6.0, 4.0  # before and after a stall, in which 85 frames a second wait


def program(*words: object, **how: object) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, "-m", "bms_gateway", *map(str, words)], **how)


def ready_service(config: Path, folder: Path) -> subprocess.Popen:
    """Start `run` and wait until it says READY: a slow guest may import for longer than any fixed pause."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(folder / "notify"))
        systemd.settimeout(120)
        environment = os.environ | {"NOTIFY_SOCKET": str(folder / "notify")}
        service = program("run", config, stderr=subprocess.PIPE, env=environment)
        while b"READY=1" not in systemd.recv(4096):
            pass
    return service


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> tuple[Path, Path]:
    """Drive with `replay` against `run` on vcan0 and record it with candump; returns config and recording."""
    return recorded_drive(tmp_path_factory.mktemp("live"))


def recorded_drive(folder: Path, stall_s: float = 0.0) -> tuple[Path, Path]:
    """As `recording`; for `stall_s` in the middle the service gets no processor time, and the drive is as long."""
    duration = FIRST_S + stall_s + AFTER_S if stall_s else SECONDS
    for name in ("gateway.toml", "string.toml"):
        (folder / name).write_text((Path("deploy/example") / name).read_text())
    config, log, recorded = folder / "gateway.toml", folder / "drive.log", folder / "recorded.log"
    assert main(["simulate", "--config", str(config), "--out", str(log), "--duration", f"{duration:g}"]) == 0
    with recorded.open("w") as out:
        candump = subprocess.Popen(["candump", "-L", "-r", str(4 << 20), "vcan0"], stdout=out)
        service = ready_service(config, folder)
        player = program("replay", log, "--to", "vcan0", stdout=subprocess.DEVNULL)
        if stall_s:
            time.sleep(FIRST_S)
            service.send_signal(signal.SIGSTOP)
            time.sleep(stall_s)
            service.send_signal(signal.SIGCONT)
        assert player.wait(120) == 0
        time.sleep(1.5)
        service.send_signal(signal.SIGTERM)
        _, err = service.communicate(timeout=30)
        assert service.returncode == 0, err.decode()
        candump.terminate()
        candump.wait()
    return config, recorded


def frames(path: Path) -> FrameBatch:
    return FrameBatch.concat(list(read_log(path)))


def ours(b: FrameBatch) -> FrameBatch:
    """Frames that the gateway itself sent: those of the node BMS_GATEWAY."""
    database = cantools.database.load_string(own_dbc_text(), "dbc")
    ids = [m.frame_id | 0x8000_0000 for m in database.messages if m.senders == ["BMS_GATEWAY"]]
    mine = np.isin(b.can_id, np.array(ids, np.uint32))
    return FrameBatch(b.time_ns[mine], b.can_id[mine], b.length[mine], b.data[mine])


def inputs_of(b: FrameBatch) -> np.ndarray:
    """Stamps of the frames that the service did not send, ns."""
    return b.time_ns[~np.isin(b.can_id, ours(b).can_id)]


def during_the_drive(b: FrameBatch) -> FrameBatch:
    """Our frames up to the last of the drive: the analysis ends there, the service waits on and goes on sending."""
    live = ours(b)
    return live[: np.searchsorted(live.time_ns, inputs_of(b)[-1])]


def test_live_and_analysed_broadcasts_are_the_same_bits(recording, tmp_path) -> None:
    config, recorded = recording
    assert main(["analyze", str(recorded), "--config", str(config), "--out", str(tmp_path)]) == 0
    live, offline = during_the_drive(frames(recorded)), frames(tmp_path / "broadcast.log")
    n = min(len(live), len(offline))
    per_tick = 60 + 5
    assert n > (SECONDS - 4) * per_tick
    assert abs(len(live) - len(offline)) < 4 * 90  # the recording ends somewhere within the last ticks
    assert live.can_id[:n].tolist() == offline.can_id[:n].tolist()
    assert live.data[:n].tolist() == offline.data[:n].tolist()


@pytest.mark.parametrize("stall_s", [14.0, 30.0])
def test_after_a_stall_the_broadcasts_are_those_of_the_analysed_recording(tmp_path, stall_s) -> None:
    """With over 1,024 frames waiting most got the time of their reading, and good sensors were told stale."""
    config, recorded = recorded_drive(tmp_path, stall_s)
    assert main(["analyze", str(recorded), "--config", str(config), "--out", str(tmp_path / "out")]) == 0
    everything = frames(recorded)
    live = during_the_drive(everything)
    inputs = inputs_of(everything)
    pause = int(np.diff(live.time_ns).argmax())
    waited = (inputs > live.time_ns[pause]) & (inputs < live.time_ns[pause + 1])
    assert np.diff(live.time_ns).max() > 0.8 * stall_s * 1e9
    assert np.count_nonzero(waited) > 1_024, "the stall is too short to say anything"
    sent = [(i, bytes(d)) for i, d in zip(live.can_id.tolist(), live.data, strict=True)]
    offline = frames(tmp_path / "out" / "broadcast.log")
    wanted = [(i, bytes(d)) for i, d in zip(offline.can_id.tolist(), offline.data, strict=True)]
    per_tick = 60 + 5
    assert sent[: 3 * per_tick] == wanted[: 3 * per_tick]
    # what was late by more than its cycle was not sent; all that was, and all from then on, is the same to the bit
    known = set(wanted)
    others = [(k - pause, one[0]) for k, one in enumerate(sent) if one not in known]
    assert others == []
    last = next(k for k in range(len(wanted) - 1, -1, -1) if wanted[k] == sent[-1])
    n = 3 * per_tick
    print(f"stall {stall_s:g} s: {np.count_nonzero(waited)} frames waited, {len(sent)} sent, {len(others)} differ")
    assert sent[-n:] == wanted[last + 1 - n : last + 1]


def test_our_frames_come_at_their_cycle_times_and_cantools_reads_them(recording) -> None:
    database = cantools.database.load_string(own_dbc_text(), "dbc")
    live = ours(frames(recording[1]))
    stamps: dict[tuple, list[int]] = {}
    for t, can_id, data in zip(live.time_ns.tolist(), live.can_id, live.data, strict=True):
        message = database.get_message_by_frame_id(int(can_id) & 0x1FFF_FFFF)
        values = message.decode(bytes(data), decode_choices=False)
        stamps.setdefault((message.name, values.get("mux")), []).append(t)
        assert message.cycle_time
    assert ("string_5_core", 12) in stamps
    assert ("gateway_status", None) in stamps
    for (name, _), times in stamps.items():
        cycle = 1e-3 * (database.get_message_by_name(name).cycle_time or 0)
        gaps = [(b - a) * 1e-9 for a, b in pairwise(times)]
        assert len(times) >= (SECONDS - 3) // cycle, name
        # a pause of the machine delays one frame, which is no drift and loses none; the cycle is that of the many
        assert abs(statistics.median(gaps) - cycle) < 0.05 * cycle + 0.01, (name, gaps)
        assert abs(sum(gaps) - len(gaps) * cycle) < 0.5 * cycle + 0.2, (name, gaps)
