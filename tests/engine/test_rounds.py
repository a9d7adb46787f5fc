"""The engine's round of ticks: jobs and results, silence and waking, counts and states, with estimators by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.engine import Engine, Notice, StartJob
from bms_gateway.engine.broadcast import Counts, State
from bms_gateway.engine.engine import AT_ONCE_NS, CLOCK_SET_NS, GRACE_TICKS, JOB_DUE_TICKS, LATEST_NS
from bms_gateway.engine.estimators import TickResult
from bms_gateway.engine.events import Decoded, Level
from bms_gateway.engine.input_news import UNHEARD_NS
from bms_gateway.errors import StateError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.quality import Quality
from tests.engine.packs import EPOCH_S, database, plan
from tests.engine.told_strings import said, with_channels

S = 1_000_000_000
START = EPOCH_S * S


class ByHand:
    """Estimators that do as they are told, and keep what they were told."""

    def __init__(self) -> None:
        self.jobs: dict[int, list] = {}
        self.ticks: list[int] = []
        self.gaps: list[tuple[float | None, bool]] = []
        self.accepted: list[tuple] = []
        self.newest = SimpleNamespace(core=np.full(4, np.nan), surface=np.full(4, np.nan))
        self.strings: list = []
        self.left: list[str] = []

    def step(self, readings, t1: int) -> TickResult:
        self.ticks.append(t1)
        return TickResult([], self.jobs.get(len(self.ticks), []))

    def accept(self, string: int, result: object, now: int) -> list[str]:
        self.accepted.append((string, result, now))
        return [f"accepted {result}"]

    def pass_time(self, gap: float | None, *, unseen: bool = False) -> None:
        self.gaps.append((gap, unseen))

    def snapshot(self) -> dict:
        return {"of": "estimators"}

    def restore(self, state: object) -> list[str]:
        assert state == {"of": "estimators"}
        return self.left


class Sender:
    """Keeps what is to be said of us."""

    def __init__(self) -> None:
        self.cycles = {0x100: S}
        self.told: list[tuple[int, State, Counts]] = []

    def encode(self, t1: int, estimators: object, state: State, counts: Counts) -> FrameBatch:
        self.told.append((t1, state, counts))
        return FrameBatch.empty()


def engine(silent_s: float = 60.0) -> tuple[Engine, ByHand, Sender]:
    made = Engine(replace(with_channels(), silent_after_ns=round(silent_s * S)), database())
    made.estimators, made.broadcast = ByHand(), Sender()
    return made, made.estimators, made.broadcast


def feed(made: Engine, frames: FrameBatch) -> list:
    made.receive(frames, now_ns=int(frames.time_ns.max()))
    return events(made)


def events(made: Engine) -> list:
    found = []
    while (event := made.next_output()) is not None:
        found.append(event)
    return found


class Job:
    """A job that counts how often it is run."""

    def __init__(self, result: object) -> None:
        self.result, self.runs = result, 0

    def run(self) -> object:
        self.runs += 1
        return self.result


def test_a_job_is_handed_out_and_its_result_counts_from_its_due_time_on() -> None:
    made, by_hand, _ = engine()
    jobs = [Job("first"), Job("second"), Job("third")]
    by_hand.jobs = {2: [(0, jobs[0]), (1, jobs[1])], 5: [(0, jobs[2])]}
    started = [e for e in feed(made, said(6)) if isinstance(e, StartJob)]
    assert [(e.job_id, e.job, e.time_ns, e.due_ns) for e in started] == [
        (k, job, START + t * S, START + (t + JOB_DUE_TICKS) * S)
        for k, job, t in ((1, jobs[0], 2), (2, jobs[1], 2), (3, jobs[2], 5))
    ]
    assert [made.awaits(k) for k in range(5)] == [False, True, True, True, False]
    made.finish(2, "of another thread")
    made.finish(7, "of nobody")
    made.finish(1, None)  # given back
    first = feed(made, said(26, start=6))
    assert by_hand.accepted == []
    told = feed(made, said(2, start=32))
    due = START + (2 + JOB_DUE_TICKS) * S
    assert by_hand.accepted == [(0, "first", due), (1, "of another thread", due)]
    assert [e for e in first + told if isinstance(e, str)] == ["accepted first", "accepted of another thread"]
    assert [job.runs for job in jobs] == [1, 0, 0]
    assert [made.awaits(k) for k in (1, 2, 3)] == [False, False, True]
    feed(made, said(9, start=34))
    assert by_hand.accepted[2:] == []
    assert jobs[2].runs == 0
    made.finish(3, "late")
    feed(made, said(1, start=43))
    assert by_hand.accepted[2:] == [(0, "late", due + 11 * S)]
    assert not made.awaits(3)


def test_a_job_that_begins_and_is_due_within_one_batch_is_run_there_and_then() -> None:
    made, by_hand, _ = engine()
    job = Job("at once")
    by_hand.jobs = {2: [(0, job)]}
    told = feed(made, said(2 + JOB_DUE_TICKS + 1))
    assert by_hand.accepted == [(0, "at once", START + (2 + JOB_DUE_TICKS) * S)]
    assert job.runs == 1
    handed_out = next(e for e in told if isinstance(e, StartJob))
    assert not made.awaits(handed_out.job_id)


def test_ticks_fall_on_whole_seconds_wherever_frames_begin() -> None:
    made, by_hand, _ = engine()
    some = said(4)
    feed(made, some[5:])
    assert by_hand.ticks == [START + k * S for k in (1, 2, 3)]
    assert made.next_deadline() == START + 4 * S
    made.handle_timer(now_ns=START + 4 * S - 1)
    assert len(by_hand.ticks) == 3
    made.handle_timer(now_ns=START + 6 * S)
    assert by_hand.ticks[3:] == [START + k * S for k in (4, 5, 6)]


def test_a_frame_at_the_deadline_closes_the_tick_and_counts_for_the_next() -> None:
    made, by_hand, sender = engine()
    some = said(2)
    at = int(np.searchsorted(some.time_ns, START + S))
    feed(made, some[:at])
    assert by_hand.ticks == []
    assert made.frames == 0
    feed(made, some[at : at + 1])
    assert by_hand.ticks == [START + S]
    assert made.frames == at
    made.handle_timer(now_ns=START + 2 * S)
    assert [counts.frames for *_, counts in sender.told] == [at, 1]


@pytest.mark.parametrize("by_timer", [True, False])
def test_a_bus_is_silent_when_nothing_came_for_just_so_long(by_timer: bool) -> None:
    made, by_hand, sender = engine(silent_s=5.1)
    some = said(3)
    last = int(some.time_ns[-1]) // S * S + 900_000_000
    assert int(some.time_ns[-1]) == last
    found = feed(made, some)
    if by_timer:
        made.handle_timer(now_ns=START + 30 * S)
        found += events(made)
    else:
        found += feed(made, said(3, start=20))
    silent = [e for e in found if isinstance(e, Notice) and e.code == "silent"]
    assert [(e.time_ns, e.level) for e in silent] == [(START + 8 * S, Level.NOTICE)]
    assert silent[0].text == "no wanted frame for 5.1 s: waiting for the bus, sending nothing"
    assert [t for t, state, _ in sender.told if state == State.SILENT] == [START + 8 * S]
    assert by_hand.ticks[:8] == [START + k * S for k in range(1, 9)]
    if by_timer:
        assert len(by_hand.ticks) == 8
        assert made.next_deadline() is None
        feed(made, said(1, start=20))
    else:
        assert by_hand.ticks[8:] == [START + 21 * S, START + 22 * S]
    assert by_hand.gaps == [(12.0, False)]


def test_waking_tells_how_long_it_was() -> None:
    made, by_hand, _ = engine(silent_s=2.0)
    before, after = said(3), said(1, start=95)
    silence_s = (int(after.time_ns[0]) - int(before.time_ns[-1])) * 1e-9
    assert 92.0 < silence_s < 93.0
    feed(made, before)
    made.handle_timer(now_ns=START + 10 * S)
    events(made)
    (woken,) = [e for e in feed(made, after) if isinstance(e, Notice)]
    assert (woken.time_ns, woken.level, woken.code) == (START + 95 * S, Level.INFO, "awake")
    assert woken.text == f"frames again after {silence_s:.0f} s: state carried over the gap"
    assert made.next_deadline() == START + 96 * S
    assert by_hand.gaps == [(90.0, False)]


def restored(tick_end: int | None, *, sure: bool = False) -> tuple[Engine, ByHand]:
    made, by_hand, _ = engine()
    made.restore({"version": 1, "tick_end_ns": tick_end, "estimators": {"of": "estimators"}}, sure=sure)
    return made, by_hand


@pytest.mark.parametrize(
    ("stopped", "gap"),
    [
        (START, None),
        (START - S, (1.0, False)),
        (START - AT_ONCE_NS, (2.0, False)),
        (START - AT_ONCE_NS - S, (3.0, True)),
        (START - 500 * S, (500.0, True)),
        (CLOCK_SET_NS, ((START - CLOCK_SET_NS) * 1e-9, True)),
        (CLOCK_SET_NS - 1, (None, True)),
        (5 * S, (None, True)),
        (START + 1, (None, True)),
        (START + 500 * S, (None, True)),
    ],
)
def test_a_stored_state_is_carried_over_the_time_since_as_far_as_clocks_tell_it(stopped: int, gap) -> None:
    made, by_hand = restored(stopped)
    told = [e.text for e in feed(made, said(1)) if isinstance(e, Notice)]
    if gap is None:
        assert (by_hand.gaps, told) == ([], [])
        return
    assert by_hand.gaps == [(None if gap[0] is None else pytest.approx(gap[0]), gap[1])]
    how_long = "a time that the clock does not tell" if gap[0] is None else f"{gap[0]:.0f} s"
    assert told == [f"frames again after {how_long}: state carried over the gap"]


def test_a_clock_that_was_not_set_tells_nothing_of_how_long_we_were_off() -> None:
    """It starts in 1970 again; a bus that slept meanwhile is another matter."""
    made, by_hand = restored(3000 * S)
    early = said(3)
    feed(made, FrameBatch(early.time_ns - START + 4000 * S, early.can_id, early.length, early.data))
    assert by_hand.gaps == [(None, True)]
    made.handle_timer(now_ns=4200 * S)
    feed(made, FrameBatch(early.time_ns - START + 4500 * S, early.can_id, early.length, early.data))
    ((gap, unseen),) = by_hand.gaps[1:]
    assert not unseen
    assert 400 < gap < 500


def test_a_state_by_the_clock_of_the_frames_tells_how_long_we_were_off_in_1970_too() -> None:
    made, by_hand = restored(3000 * S, sure=True)
    early = said(3)
    feed(made, FrameBatch(early.time_ns - START + 4000 * S, early.can_id, early.length, early.data))
    assert by_hand.gaps == [(pytest.approx(1000.0), True)]


def test_a_state_before_the_first_tick_is_no_gap() -> None:
    made, by_hand = restored(None)
    assert feed(made, said(1)) == []
    assert by_hand.gaps == []
    assert made.snapshot() == {"version": 1, "tick_end_ns": START, "estimators": {"of": "estimators"}, "alarms": {}}


@pytest.mark.parametrize("time", [0, LATEST_NS - 1])
def test_times_of_a_clock_are_taken(time: int) -> None:
    made, _ = restored(time)
    assert made.snapshot()["tick_end_ns"] == time


@pytest.mark.parametrize(("time", "shown"), [(-1, "-1e-09 s"), (LATEST_NS, "9e+09 s")])
def test_times_of_no_clock_are_refused(time: int, shown: str) -> None:
    with pytest.raises(StateError, match="is not the time of any clock") as refused:
        restored(time)
    assert f"its time, {shown} since 1970" in str(refused.value)


@pytest.mark.parametrize(("tick_end", "when"), [(None, 0), (START, START)])
def test_what_is_left_out_of_a_state_is_told(tick_end: int | None, when: int) -> None:
    made, by_hand, _ = engine()
    by_hand.left = ["one thing", "another"]
    made.restore({"version": 1, "tick_end_ns": tick_end, "estimators": {"of": "estimators"}})
    assert events(made) == [Notice(when, Level.NOTICE, "state", text) for text in by_hand.left]


def test_a_state_of_another_version_is_refused_by_its_number() -> None:
    made, _, _ = engine()
    with pytest.raises(StateError, match=r"^stored state has version 2, this program writes 1$"):
        made.restore({"version": 2, "tick_end_ns": None, "estimators": {"of": "estimators"}})


def test_sensors_are_blamed_from_the_tenth_tick_after_waking_on(monkeypatch: pytest.MonkeyPatch) -> None:
    made, _, _ = engine(silent_s=3.0)
    asked: list[int] = []
    made.inputs.changes = lambda t1: asked.append((t1 - START) // S) or []
    feed(made, said(14))
    assert asked == [GRACE_TICKS, 11, 12, 13]
    feed(made, said(13, start=100))
    assert asked[4:] == [14, 15, 16, 17, 110, 111, 112]  # the seventeenth tick is the one that finds the bus silent


def test_what_is_missed_is_told_at_the_tick_in_which_it_is() -> None:
    made, _, _ = engine(silent_s=3.0)
    asked: list[int] = []
    made.inputs.newly_missed = lambda: (
        {"string_1": "this, that", "string_2": "more"} if asked.append(0) or len(asked) == 10 else {}
    )
    told = [e for e in feed(made, said(14)) + feed(made, said(14, start=100)) if isinstance(e, Notice)]
    unheard = [e for e in told if e.code == "unheard"]
    assert unheard == [
        Notice(START + 10 * S, Level.WARNING, "unheard", f"not received so far: {what}", name)
        for name, what in (("string_1", "this, that"), ("string_2", "more"))
    ]


def test_frames_and_samples_are_counted_by_tick_and_losses_in_all() -> None:
    made, _, sender = engine()
    some = said(5)
    made.dropped = 3
    feed(made, some[:15])
    made.inputs.rejected = {"stuck": 2, "jumpy": 3}
    made.dropped = 4
    feed(made, some[15:])
    per_second = 13
    counts = [c for *_, c in sender.told]
    assert [c.frames for c in counts] == [per_second] * 4
    assert [c.rejected for c in counts[1:]] == [5 - counts[0].rejected, 0, 0]
    assert [c.dropped for c in counts] == [3, 4, 4, 4]
    assert [c.uptime_s for c in counts] == [1.0, 2.0, 3.0, 4.0]
    assert made.frames == 4 * per_second
    assert made.duration_s == pytest.approx(4.9)


@pytest.mark.parametrize(
    ("core", "current", "surface", "state"),
    [
        (np.nan, Quality.GOOD, Quality.GOOD, State.STARTING),
        (30.0, Quality.GOOD, Quality.GOOD, State.RUNNING),
        (30.0, Quality.STALE, Quality.GOOD, State.DEGRADED),
        (30.0, Quality.GOOD, Quality.STALE, State.DEGRADED),
    ],
)
def test_the_state_follows_cores_currents_and_surfaces(core, current, surface, state) -> None:
    made, by_hand, sender = engine()
    update = made.inputs.update

    def qualities(*what):
        return replace(
            update(*what),
            current_quality=np.array([current], np.uint8),
            quality=np.array([surface, Quality.ESTIMATED, Quality.ESTIMATED, Quality.STALE], np.uint8),
        )

    made.inputs.update = qualities
    by_hand.newest.core[1] = core
    feed(made, said(3))
    assert [told for _, told, _ in sender.told] == [state, state]


def test_a_batch_that_ends_in_a_silence_and_goes_on_after_it_wakes_at_its_own_frame() -> None:
    made, by_hand, _ = engine(silent_s=3.0)
    both = FrameBatch.concat([said(3), said(3, start=50)])
    feed(made, both)
    assert by_hand.ticks == [START + k * S for k in (*range(1, 7), 51, 52)]
    assert by_hand.gaps == [(44.0, False)]
    assert (made.woken_ns, made.started_ns) == (START + 50 * S, START)


def test_a_late_frame_counts_for_the_open_tick() -> None:
    made, by_hand, _ = engine()
    some = said(3)
    feed(made, some[:10])
    made.handle_timer(now_ns=START + S)
    taken = []
    update = made.inputs.update
    made.inputs.update = lambda samples, *span: taken.append((samples.time_ns.tolist(), span)) or update(samples, *span)
    made.receive(some[10:12], now_ns=START + S + 5)
    made.handle_timer(now_ns=START + 2 * S)
    ((stamps, span),) = taken
    assert set(stamps) == {START + S}
    assert span[:2] == (START + S, START + 2 * S)
    assert by_hand.ticks == [START + S, START + 2 * S]


def test_the_rules_stand_as_they_are_documented() -> None:
    assert (JOB_DUE_TICKS, GRACE_TICKS, UNHEARD_NS, AT_ONCE_NS) == (30, 10, 10 * S, 2 * S)
    assert np.datetime64("2020-01-01", "ns").astype(int) == CLOCK_SET_NS
    assert plan(1).silent_after_ns == 60 * S


def test_an_engine_has_counted_nothing_and_tells_nothing_more_unless_asked() -> None:
    made, _, _ = engine()
    assert (made.frames, made.dropped, made.recording, made.judging) == (0, 0, False, False)
    assert made.duration_s == 0.0
    assert made.sends == {0x100: S}
    made.broadcast = None
    assert made.sends == {}


def test_no_frame_is_of_the_future() -> None:
    made, by_hand, _ = engine()
    some = said(5)
    made.receive(FrameBatch.empty(), now_ns=START)
    strange = FrameBatch(some.time_ns, some.can_id + 1, some.length, some.data)
    made.receive(strange, now_ns=START)
    assert made.next_deadline() is None
    made.receive(some, now_ns=START + 2 * S + 5)
    assert by_hand.ticks == [START + S, START + 2 * S]
    assert made.duration_s == pytest.approx(2.0)
    made.handle_timer(now_ns=START + 3 * S)
    assert made.frames == len(some)


def test_one_frame_wakes_the_engine_for_its_own_second() -> None:
    made, by_hand, _ = engine()
    some = said(3)
    feed(made, some[12:13])
    assert made.next_deadline() == START + S
    feed(made, some[13:14])
    assert int(some.time_ns[13]) == START + S
    assert by_hand.ticks == [START + S]
    other, by_hand, _ = engine()
    feed(other, some[12:15])
    assert by_hand.ticks == [START + S]


def test_what_comes_after_timers_does_not_hide_the_silence_before_it() -> None:
    """The timer has taken all that came; it does not fire again before the next frames, which come much later."""
    made, by_hand, _ = engine(silent_s=3.0)
    feed(made, said(1))
    made.handle_timer(now_ns=START + S)
    feed(made, said(3, start=50))
    assert by_hand.ticks == [START + k * S for k in (1, 2, 3, 4, 51, 52)]
    assert by_hand.gaps == [(46.0, False)]
    assert made.frames == 3 * 13


@pytest.mark.parametrize("by_timer", [True, False])
@pytest.mark.parametrize(("silent_s", "tick"), [(5.1, 8), (5.15, 9)])
def test_a_silence_begins_with_the_last_frame(by_timer: bool, silent_s: float, tick: int) -> None:
    made, by_hand, _ = engine(silent_s)
    feed(made, said(3))  # the last one 2.9 s after the start
    if by_timer:
        made.handle_timer(now_ns=START + 40 * S)
    else:
        feed(made, said(1, start=40))
    assert by_hand.ticks == [START + k * S for k in range(1, tick + 1)]


@pytest.mark.parametrize("step", [1000, 7, 1])
def test_faults_of_time_are_told_at_their_tick_however_frames_are_cut(step: int) -> None:
    some = said(8)
    back = some.time_ns.copy()
    back[30:] -= 3600 * S  # within the third second
    back[60:] -= 10 * S  # within the fifth, as the next
    back[[62, 80]] += 9 * 3600 * S  # the other of them within the seventh
    odd = FrameBatch(back, some.can_id, some.length, some.data)
    made, _, _ = engine()
    told = []
    for k in range(0, len(odd), step):
        made.receive(odd[k : k + step], now_ns=START + 90 * 3600 * S)
        told += [e for e in events(made) if isinstance(e, Notice)]
    dropped = "frames dropped whose stamps lie far ahead of all others"
    assert told == [
        Notice(START + t * S, Level.WARNING, "clock", f"time stamps: clock set back {text}")
        for t, text in ((3, "1×"), (5, f"2×; 1 {dropped}"), (7, f"2×; 2 {dropped}"))
    ]


def test_what_was_held_before_a_gap_is_dropped_at_waking_and_only_then() -> None:
    made, _, _ = engine(silent_s=3.0)
    dropped: list[int | None] = []
    made.inputs.forget = lambda: dropped.append(made.next_deadline())
    feed(made, said(3))
    assert dropped == []
    feed(made, said(3, start=50))
    assert dropped == [START + 51 * S]


def test_a_record_is_of_what_the_guard_let_pass() -> None:
    made, _, _ = engine()
    made.recording = True
    update = made.inputs.update

    def bad(*what):
        found = update(*what)
        taken, good = made.inputs.good
        made.inputs.good = taken, good & (taken.value > 22.0)
        return found

    made.inputs.update = bad
    first, second = (e for e in feed(made, said(3)) if isinstance(e, Decoded))
    assert (first.time_ns, second.time_ns) == (START + S, START + 2 * S)
    taken, good = made.inputs.good
    assert 0 < good.sum() < len(good)
    for got, all_of_it in ((second.sample_ns, taken.time_ns), (second.input, taken.input), (second.value, taken.value)):
        assert got.tolist() == all_of_it[good].tolist()
