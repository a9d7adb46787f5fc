"""What the inputs tell of themselves: which have begun or ceased to be good, which err, which never came."""

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.engine import Channel, Plan, integrals
from bms_gateway.engine.events import Level, Notice
from bms_gateway.engine.input_news import InputNews
from bms_gateway.engine.inputs import Inputs
from bms_gateway.engine.reasons import REASONS
from bms_gateway.engine.wiring import Wiring
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.own_dbc import own_signal
from bms_gateway.frames.quality import Quality
from tests.engine.input_frames import START, S, amps, frames, put, strings, ticks, volts
from tests.engine.packs import database


def with_charge() -> Plan:
    """The four strings, and the charge of the first, which is recorded alone."""
    one, *others = strings().strings
    charge = Channel("soc", None, own_signal(1, "soc"))
    return Plan((replace(one, channels=(charge, *one.channels)), *others))


def inputs() -> Inputs:
    return Inputs(with_charge(), database())


class News(InputNews):
    """News of inputs that were good when they were last told, and meters by hand."""

    def __init__(self, due_s: Mapping[int, float] | None = None) -> None:
        self.wiring, self.meters = Wiring.of(with_charge()), {}
        after = [S * (due_s or {}).get(i, 5) for i in range(len(self.wiring.channels))]
        super().__init__(self.wiring, self.meters, np.array(after, np.int64))
        self.wires = self.wiring.wires
        self.charge = self.wires[0].whole["soc"]
        self.quality[:] = Quality.GOOD
        self.changes(0)


def by_hand(monkeypatch: pytest.MonkeyPatch, **meter: object) -> Inputs:
    """Inputs whose currents are held against voltages by such a meter."""
    monkeypatch.setattr(integrals, "Ammeter", lambda _: SimpleNamespace(**meter))
    return inputs()


@pytest.mark.parametrize("before", [Quality.GOOD, *REASONS])
def test_an_input_is_told_when_it_begins_or_ceases_to_be_good(before: Quality) -> None:
    for now in Quality:
        made = News()
        i = made.wires[0].surface[3]
        made.quality[i] = before
        made.changes(8)
        made.quality[i] = now
        if now not in REASONS and now != Quality.GOOD:
            continue  # of estimates, never of an input
        told = made.changes(9)
        if before == Quality.NEVER:
            worth = now not in (Quality.NEVER, Quality.GOOD)
        else:
            worth = (now == Quality.GOOD) != (before == Quality.GOOD)
        signal = own_signal(1, "surface", 4)
        text = f"is not used: {REASONS.get(now)}" if now != Quality.GOOD else "is good again"
        level = Level.WARNING if now != Quality.GOOD else Level.NOTICE
        notice = Notice(9, level, "sensor", f"surface of cell 4 {text} ({signal})", "string_1", 4, "surface")
        assert told == [notice] * worth
        assert made.changes(10) == []


def test_what_belongs_to_no_cell_is_told_without_one() -> None:
    made = News()
    for i in (made.wires[1].whole["coolant_inlet"], made.wires[2].whole["coolant_inlet"]):
        if i >= 0:
            made.quality[i] = Quality.STALE
    (told,) = made.changes(9)
    signal = own_signal(1, "coolant_inlet")
    assert told.text == f"coolant inlet is not used: nothing new is received ({signal})"
    assert (told.string, told.cell) == ("string_1", None)


def test_what_is_only_recorded_is_told_to_nobody() -> None:
    made = News()
    made.quality[[made.charge, made.wires[0].current]] = Quality.STALE
    assert [n.text.split(" is ")[0] for n in made.changes(9)] == ["current"]
    assert [c.quantity for _, c, *_ in made.faults()] == ["current"]
    assert own_signal(1, "soc") not in made.unheard()["string_1"].split(", ")
    assert len(made.unheard()["string_1"].split(", ")) == 6


def test_faults_are_inputs_that_were_good_once_in_their_order() -> None:
    made = News()
    one, two = made.wires[0], made.wires[1]
    made.quality[one.current] = Quality.NEVER
    made.quality[two.surface[1]] = Quality.OPEN
    made.quality[one.voltage] = Quality.STALE
    assert [(name, c.quantity, c.cell, q) for name, c, q, _ in made.faults()] == [
        ("string_1", "voltage", None, Quality.STALE),
        ("string_2", "surface", 2, Quality.OPEN),
    ]


def test_an_input_is_missed_when_it_should_have_come_and_told_once() -> None:
    """A thermocouple whose multiplexer comes round every 33 s is not missed after ten."""
    wire = Wiring.of(with_charge()).wires[0]
    quick, slow = wire.surface[0], wire.surface[3]
    made = News({slow: 99})
    made.heard[:] = True
    made.heard[[slow, quick]] = False
    told = {}
    for second in range(1, 121):
        made.waited_ns = second * S
        if new := made.newly_missed():
            told[second] = new
        assert made.unheard() == {"string_1": f"{own_signal(1, 'surface', 1)}, {own_signal(1, 'surface', 4)}"}
        assert made.missed() == ({} if second < 10 else made.unheard() if second >= 99 else told[10])
    assert told == {10: {"string_1": own_signal(1, "surface", 1)}, 99: {"string_1": own_signal(1, "surface", 4)}}


def test_voltages_of_cells_that_never_came_are_no_news() -> None:
    one = strings().strings[0]
    cells = Channel("cell_voltage", 2, own_signal(1, "cell_voltage", 2))
    made = Inputs(Plan((replace(one, channels=(cells, *one.channels)),)), database())
    assert made.unheard() == {"string_1": ", ".join(c.signal for c in one.channels)}


@pytest.mark.parametrize(("stands", "said"), [((20.0,), "20"), ((-250.0, 250.0), "-250 and 250")])
def test_a_current_that_stands_is_told_with_its_values_and_anything_else_that_stands_without(stands, said) -> None:
    made = News()
    one, three = made.wires[0], made.wires[2]
    made.meters[three.current, 5] = SimpleNamespace(reversed=False, stands_at=(1.0,))
    made.meters[one.current, one.voltage] = SimpleNamespace(reversed=False, stands_at=stands)
    made.quality[[one.current, one.voltage]] = Quality.STUCK
    current, voltage = made.changes(9)
    why = f"it stands at {said} A while the voltage moves: stuck, saturated or clipped"
    assert current.text == f"current is not used: {why} ({own_signal(1, 'current')})"
    assert voltage.text == f"voltage is not used: {REASONS[Quality.STUCK]} ({own_signal(1, 'voltage')})"
    made.quality[one.current] = Quality.GOOD
    made.changes(10)
    made.quality[one.current] = Quality.STALE
    (again,) = made.changes(11)
    assert again.text == f"current is not used: nothing new is received ({own_signal(1, 'current')})"


def test_the_sign_of_a_current_is_told_when_it_turns() -> None:
    made = News()
    one = made.wires[0]
    meter = made.meters[one.current, one.voltage] = SimpleNamespace(reversed=True, stands_at=())
    (wrong,), nothing = made.changes(9), made.changes(10)
    meter.reversed = False
    (right,) = made.changes(11)
    signal = own_signal(1, "current")
    assert (wrong.time_ns, wrong.level, wrong.code, wrong.string) == (9, Level.WARNING, "current_sign", "string_1")
    assert wrong.text == (
        "current and voltage rise together: the sign of the current is wrong "
        f"(scale = -1 in its entry changes it) ({signal})"
    )
    assert nothing == []
    assert (right.level, right.code) == (Level.NOTICE, "current_sign")
    assert right.text == f"current and voltage move against each other again, as they should ({signal})"


def test_values_at_which_a_current_stands_are_turned_away_and_others_believed(monkeypatch) -> None:
    updates = []
    made = by_hand(
        monkeypatch,
        reversed=False,
        stands_at=(20.0, 30.0),
        update=lambda i, u: updates.append((i.tolist(), u.tolist())),
    )
    content = put(2, current=lambda t: 20.0 if t < 0.25 else 30.0 if t < 0.55 else 40.0)
    first, second = ticks(made, content, 2)
    assert made.rejected["stuck"] == 6
    assert np.isnan(first.means[0, 1])  # what is left covers less than half of it
    assert second.means[0, :2] == pytest.approx([40.0, 40.0])
    assert ("string_1", "current", Quality.STUCK) in [(name, c.quantity, q) for name, c, q, _ in made.faults()]
    assert updates[0] == (
        pytest.approx([20.0] * 3 + [30.0] * 3 + [40.0] * 4),
        pytest.approx([volts(k / 10) for k in range(10)]),
    )


def test_a_current_of_the_wrong_sign_keeps_its_square_and_gives_no_heat(monkeypatch) -> None:
    made = by_hand(monkeypatch, reversed=True, stands_at=(), update=lambda *_: None)
    r = ticks(made, put(2), 2)[-1]
    assert np.isnan(r.means[[2, 3], 0]).all()
    assert r.means[1, 0] == pytest.approx(np.mean([amps(1 + k / 10) ** 2 for k in range(10)]), rel=1e-3)


def test_frames_that_give_no_sample_are_counted_at_their_tick() -> None:
    made = inputs()
    some = frames(put(3))
    order = np.sort(np.append(np.arange(len(some)), [3, 3, len(some) - 1]))
    twice = FrameBatch(some.time_ns[order], some.can_id[order], some.length[order], some.data[order])
    surface = database().resolve(own_signal(1, "surface", 1)).can_id
    at = np.flatnonzero((twice.can_id == surface) & (twice.time_ns > START + 2 * S))
    twice.length[at[0]] = 1
    samples, counted = made.decode(twice), []
    for k in range(3):
        a, b = np.searchsorted(samples.time_ns, [START + k * S, START + (k + 1) * S])
        made.update(samples.between(a, b), START + k * S, START + (k + 1) * S)
        counted.append((made.rejected.get("repeated", 0), made.rejected.get("unknown_multiplexer", 0)))
    assert counted == [(2, 0), (2, 0), (3, 1)]
    assert len(samples.time_ns) == len(inputs().decode(some).time_ns) - 1


def test_a_tick_without_anything_new_turns_nothing_away() -> None:
    made = inputs()
    ticks(made, put(2), 2)
    before = dict(made.rejected)
    empty = made.decode(FrameBatch.empty())
    made.update(empty, START + 2 * S, START + 3 * S)
    assert made.rejected == before


def test_what_the_guard_says_of_an_input_is_told() -> None:
    made = Inputs(strings(), database())
    ticks(made, put(60, silent=20.0), 60)
    assert [(name, c.quantity, q) for name, c, q, _ in made.faults()] == [
        ("string_1", "coolant_flow", Quality.NOT_AVAILABLE),  # the frame still comes, for the inlet
        ("string_2", "surface", Quality.STALE),
        ("string_3", "soc", Quality.STALE),
    ]
    assert [(n.string, n.text.split(" is ")[0]) for n in made.changes(9)] == [
        ("string_1", "coolant flow"), ("string_2", "surface of cell 2"), ("string_3", "soc")
    ]  # fmt: skip
