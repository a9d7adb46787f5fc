"""The engine: one stream however frames come, silence and restarts as one step, no fault of the bus gets out."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.bus.virtual import VirtualPack
from bms_gateway.engine import Cells, Engine, Estimated, Event, Notice, Parameters, SendFrames, StartJob, drain, drive
from bms_gateway.errors import StateError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.own_dbc import own_signal
from bms_gateway.frames.quality import Quality
from bms_gateway.identify.window import WindowJob
from tests.engine.engines import engine
from tests.engine.packs import EPOCH_S, cut, database, plan, text, traffic
from tests.truth.string import TruthString, rk4

S = 1_000_000_000


def estimates(events: list, string: str = "string_1") -> list[Cells]:
    return [s for e in events if isinstance(e, Estimated) for s in e.strings() if s.string == string]


FRAMES = traffic(45)
WHOLE = text(list(drive(engine(), [FRAMES])))


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, len(FRAMES)), max_size=60))
def test_the_stream_does_not_depend_on_how_frames_are_cut(edges: list[int]) -> None:
    assert text(list(drive(engine(), cut(FRAMES, edges)))) == WHOLE


def test_frame_by_frame_with_timers_in_between_is_the_same_stream() -> None:
    live, out = engine(), []
    for i in range(len(FRAMES)):
        t = int(FRAMES.time_ns[i])
        while (deadline := live.next_deadline()) is not None and deadline <= t:
            live.handle_timer(now_ns=t)  # as a shell does that wakes late
        live.receive(FRAMES[i : i + 1], now_ns=t)
        out += list(drain(live))
    assert text(out) == WHOLE


@pytest.mark.slow
def test_when_a_result_comes_before_its_time_changes_nothing_and_a_late_one_counts_from_then_on() -> None:
    """A live shell brings a result some ticks later; it counts from its due time on, and is waited for after it."""
    frames = traffic(1250, strings=1)

    def run(delay_s: int) -> list[Event]:
        e, out, waiting = engine(1), [], []
        for batch in cut(frames, list(range(0, len(frames), 17))):
            if not len(batch):
                continue
            now = int(batch.time_ns[-1])
            e.receive(batch, now_ns=now)
            while (event := e.next_output()) is not None:
                (waiting if isinstance(event, StartJob) else out).append(event)
            while waiting and now >= waiting[0].time_ns + delay_s * 10**9:
                job = waiting.pop(0)
                e.finish(job.job_id, job.job.run())
        return out

    in_time, late, never = run(0), run(40), run(10_000)
    assert text(in_time) == text(run(20))
    (at_first, look, due), (_, seen, then), only = (
        [e.time_ns for e in out if isinstance(e, Parameters)] for out in (in_time, late, never)
    )
    assert look + 10 * 10**9 <= seen <= look + 13 * 10**9
    assert due + 10 * 10**9 <= then <= due + 13 * 10**9
    assert only == [at_first]
    assert text(e for e in in_time if e.time_ns < look) == text(e for e in never if e.time_ns < look)


@pytest.mark.parametrize("edges", [[], list(range(0, 20_000, 170))])
@pytest.mark.plain_cases(1)
def test_a_job_is_run_once_however_many_ticks_a_batch_holds(monkeypatch: pytest.MonkeyPatch, edges: list[int]) -> None:
    runs = []
    run = WindowJob.run
    monkeypatch.setattr(WindowJob, "run", lambda job: runs.append(job) or run(job))
    list(drive(engine(1), cut(traffic(1250, strings=1), edges)))
    assert runs
    assert len({id(job) for job in runs}) == len(runs)


def test_a_timer_is_stamped_with_its_deadline_not_with_the_wake_up() -> None:
    e = engine()
    e.receive(FRAMES[:30], now_ns=int(FRAMES.time_ns[29]))
    list(drain(e))
    deadline = e.next_deadline()
    assert deadline is not None
    e.handle_timer(now_ns=deadline + 400_000_000)
    stamps = {x.time_ns for x in drain(e)}
    assert stamps == {deadline}
    assert e.next_deadline() == deadline + S


def test_every_core_has_a_band_or_is_not_available() -> None:
    for e in estimates(list(drive(engine(), [FRAMES]))):
        assert (np.isfinite(e.core) == np.isfinite(e.core_sd)).all()
        assert (np.isnan(e.core) == (e.quality == Quality.NOT_AVAILABLE)).all()
        known = np.isfinite(e.core)
        assert (np.isfinite(e.centre) == known).all()
        assert (np.isfinite(e.centre_sd) == known).all()
        assert (e.centre[known] >= np.maximum(e.core, e.surface)[known]).all()


def currents(frames: FrameBatch, later_s: int) -> FrameBatch:
    """The frames of the strings' currents alone, later by some time: a bus that wakes before its thermocouples do."""
    ids = [database().resolve(own_signal(k, "current")).can_id for k in (1, 2)]
    keep = np.isin(frames.can_id, ids)
    return FrameBatch(frames.time_ns[keep] + later_s * S, frames.can_id[keep], frames.length[keep], frames.data[keep])


def left(warm: Estimated, seconds: int, *, driven_on: bool) -> tuple[np.ndarray, np.ndarray]:
    """Core and surface after so long, inlet as at the drive's end, by the independent integrator.

    Without current, or with the drive's mean heat, which dies away in ten minutes.
    """
    series = next(iter(VirtualPack(plan(), 1).segments(45)))[0].series
    last, current = series["coolant_inlet", None].value[-1], series["current", None]
    truth = TruthString.of(4, R_cc=4.0, C_f=11.33)
    heat = driven_on * np.mean(current.at(np.arange(0.0, 44.0, 0.1)) ** 2) * truth.R_e
    fading = np.exp(-(np.arange(seconds) + 0.5) / 600.0)[:, None] * heat
    still, inlet = np.zeros(seconds), np.full(seconds + 1, last)
    core, surface = rk4(truth, still, inlet, (warm.core, warm.surface), heat=fading)
    return core[-1], surface[-1]


def test_a_silent_bus_is_left_alone_and_the_next_frame_wakes_the_engine() -> None:
    events = list(drive(engine(), [FRAMES, currents(FRAMES, 3600)]))
    sent = np.array([e.time_ns for e in events if isinstance(e, SendFrames)]) // S - EPOCH_S
    assert sent.max() > 3600
    assert not ((sent > 45 + 60) & (sent < 3600)).any()
    assert [n.code for n in events if isinstance(n, Notice) and n.code in ("silent", "awake")] == ["silent", "awake"]
    first = next(e for e in estimates(events) if e.time_ns >= (EPOCH_S + 3600) * S)
    before = [e for e in estimates(events) if e.time_ns < (EPOCH_S + 3600) * S][-1]
    core, surface = left(before, 3600 - 105, driven_on=False)
    assert np.abs(first.core - core).max() < 0.5
    assert np.abs(first.surface - surface).max() < 0.5
    assert (first.core_sd > 0).all()


def test_a_restart_goes_on_where_it_was() -> None:
    """Stored state, JSON and back, no time in between: the estimate is inside its old band from the first tick on."""
    half = int(np.searchsorted(FRAMES.time_ns, (EPOCH_S + 30) * S))
    one = engine()
    before = estimates(list(drive(one, [FRAMES[:half]])))[-1]
    state = json.loads(json.dumps(one.snapshot()))
    two = engine()
    two.restore(state)
    after = estimates(list(drive(two, [FRAMES[half:]])))[0]
    assert (np.abs(after.core - before.core) < 2 * before.core_sd + 0.5).all()
    assert (after.core_sd < before.core_sd + 1.0).all()
    fresh = next(e for e in estimates(list(drive(engine(), [FRAMES[half:]]))) if np.isfinite(e.core).all())
    assert (after.core_sd < fresh.core_sd).all()


@pytest.mark.parametrize("parked_s", [240, 1200, 8 * 3600])
def test_a_stored_state_is_carried_over_the_time_off(parked_s: int) -> None:
    """The drive may have gone on unseen, or the vehicle been parked: both are in the band."""
    one = engine()
    warm = estimates(list(drive(one, [FRAMES])))[-1]
    two = engine()
    two.restore(json.loads(json.dumps(one.snapshot())))
    woken = estimates(list(drive(two, [currents(FRAMES, parked_s)])))[0]
    core, surface = left(warm, parked_s - 44, driven_on=True)
    assert np.abs(woken.core - core).max() < 0.5
    assert np.abs(woken.surface - surface).max() < 0.5
    at_rest, _ = left(warm, parked_s - 44, driven_on=False)
    assert (np.abs(woken.core - at_rest) < woken.core_sd).all()
    if parked_s > 3600:
        # nobody saw the coolant: 5 K either way, seen through a cell about as slow as the coolant's own wandering
        assert woken.core_sd == pytest.approx(5.0 / np.sqrt(2.0), abs=0.3)


def test_a_state_of_another_model_file_is_not_used_and_said_so() -> None:
    one = engine()
    list(drive(one, [FRAMES]))
    two = Engine(plan(rel_sd=0.2), database())
    two.restore(json.loads(json.dumps(one.snapshot())))
    told = [e.text for e in drain(two) if isinstance(e, Notice)]
    assert told == [f"string_{k}: new or changed, starts from its model file" for k in (1, 2)]
    later = FrameBatch(FRAMES.time_ns + 100 * S, FRAMES.can_id, FRAMES.length, FRAMES.data)
    assert np.isnan(estimates(list(drive(two, [later])))[0].core).all()


@pytest.mark.parametrize(
    "state", [{}, {"version": 99}, {"version": 1, "tick_end_ns": 5}, {"version": 1, "tick_end_ns": 5, "estimators": 3}]
)
def test_a_foreign_state_is_refused_in_one_line(state: dict) -> None:
    with pytest.raises(StateError, match="stored state"):
        engine().restore(state)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_nothing_on_the_bus_raises_or_puts_a_nan_on_it(seed: int) -> None:
    """Random payloads, lengths, stamps and order under our own identifiers."""
    rng = np.random.default_rng(seed)
    n = 400
    frames = FRAMES[:n]
    data, length, time = frames.data.copy(), frames.length.copy(), frames.time_ns.copy()
    hit = rng.random(n) < 0.3
    data[hit] = rng.integers(0, 256, (int(hit.sum()), 8))
    short = rng.random(n) < 0.1
    length[short] = rng.integers(0, 9, int(short.sum()))
    jump = np.array([0, -(10**9), 10**9, 10**13, -(10**13)])
    time += rng.choice(jump, n, p=[0.97, 0.01, 0.01, 0.005, 0.005])
    order = np.argsort(np.arange(n) + rng.choice([0.0, 5.0], n, p=[0.9, 0.1]), kind="stable")
    noisy = FrameBatch(time[order], frames.can_id[order], length[order], data[order])
    e = engine()
    for event in drive(e, cut(noisy, rng.integers(0, n, 5).tolist())):
        if isinstance(event, Estimated):
            assert np.array_equal(np.isfinite(event.core), np.isfinite(event.core_sd))
            known = np.isfinite(event.core)
            assert (np.abs(event.core[known]) < 400).all()


def test_irrelevant_frames_are_no_sign_of_life() -> None:
    chatter_t = np.arange(EPOCH_S, EPOCH_S + 300, dtype=np.int64) * S
    n = len(chatter_t)
    chatter = FrameBatch(chatter_t, np.full(n, 0x123, np.uint32), np.full(n, 8, np.uint8), np.zeros((n, 8), np.uint8))
    e = engine()
    out = list(drive(e, [FRAMES]))
    out += list(drive(e, [chatter[50:]]))
    e.handle_timer(now_ns=(EPOCH_S + 300) * S)
    out += list(drain(e))
    assert e.next_deadline() is None
    assert [x.code for x in out if isinstance(x, Notice)][-1] == "silent"
    assert estimates(out)[-1].quality[0] == Quality.STALE


def test_a_sensor_that_dies_is_told_once_marks_its_cell_and_widens_the_band() -> None:
    frames = traffic(120)
    message = database().message(own_signal(1, "surface", 1).split(".")[0])
    dead = (frames.can_id == message.can_id) & (frames.time_ns > (EPOCH_S + 60) * S)
    rest = FrameBatch(frames.time_ns[~dead], frames.can_id[~dead], frames.length[~dead], frames.data[~dead])
    known = plan(rel_sd=0.01)  # or the band is that of the parameters, whatever the sensors do
    events = list(drive(Engine(known, database()), [rest]))
    told = [n for n in events if isinstance(n, Notice) and n.string == "string_1" and n.code == "sensor"]
    assert len(told) == 2  # both sensors of the string are in frames of this message
    assert all("nothing new" in n.text for n in told)
    last, healthy = estimates(events)[-1], estimates(list(drive(Engine(known, database()), [frames])))[-1]
    assert last.quality.tolist() == [Quality.STALE, Quality.ESTIMATED, Quality.ESTIMATED, Quality.STALE]
    assert healthy.quality[0] == Quality.GOOD
    assert (last.core_sd > healthy.core_sd).all()


def test_the_recursive_method_tells_its_parameters_once_a_minute() -> None:
    by_rls = replace(plan(1), strings=tuple(replace(s, identify="rls") for s in plan(1).strings))
    told = [
        e.time_ns // S - EPOCH_S
        for e in drive(Engine(by_rls, database()), [traffic(200, strings=1)])
        if isinstance(e, Parameters)
    ]
    assert told[0] == 1  # what is known at the start
    assert all(t % 60 == 40 for t in told[1:])  # whole minutes of bus time
    assert len(told) == 4


def test_no_sensor_is_blamed_in_the_first_seconds_after_a_start_and_after_a_pause() -> None:
    """One that is dead from the beginning is told after the grace time, once."""
    frames = traffic(40)
    message = database().message(own_signal(1, "surface", 1).split(".")[0])
    dead = (frames.can_id == message.can_id) & (frames.time_ns > (EPOCH_S + 3) * S)
    rest = FrameBatch(frames.time_ns[~dead], frames.can_id[~dead], frames.length[~dead], frames.data[~dead])
    again = FrameBatch(rest.time_ns + 7200 * S, rest.can_id, rest.length, rest.data)
    told = [n for n in drive(engine(), [rest, again]) if isinstance(n, Notice) and n.level == 4]
    seconds = {n.time_ns // S - EPOCH_S for n in told}
    assert any(10 <= t < 40 for t in seconds)
    assert not any(t < 10 or 7200 <= t < 7210 for t in seconds)
