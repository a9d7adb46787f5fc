"""The guard judges whole batches as the rules in words judge one sample after the other, whatever sensors do."""

import numpy as np
import pytest

from bms_gateway.frames.quality import Quality
from bms_gateway.frames.rules import Rule
from tests.frames.guard_pair import Both, S

FINE = Rule("surface", 0, -40.0, 150.0, -50.0, 200.0, 5 * S, 2.5, 0.25, 4.0, needs_proof=True)
INLET = Rule("coolant_inlet", 0, -40.0, 120.0, -60.0, 210.0, 10 * S, 10.0, 1.0)
COARSE = Rule("surface", 1, -40.0, 150.0, -50.0, 200.0, 5 * S, 2.5, 0.25, 4.0)
CURRENT = Rule("current", 0, -500.0, 500.0, stale_after_ns=2 * S)
RULES = (FINE, FINE, INLET, FINE, CURRENT, COARSE, COARSE, FINE)
ALONE = (CURRENT, FINE)
STEP = 1 / 64
COARSE_STEP = 1 / 16  # over a twentieth of a kelvin: no proof that the signal is fine


class Sensor:
    """Walks, stands, jumps, breaks, and comes back to where it stood, for a while each."""

    WAYS = ("walk", "walk", "walk", "stand", "stand", "flicker", "park", "jumpy", "rails", "flagged", "edge")

    def __init__(self, rng: np.random.Generator, step: float) -> None:
        self.rng, self.step = rng, step
        self.at = self.parked = 25.0
        self.way, self.left = "walk", 0

    def next(self) -> tuple[float, Quality]:
        rng = self.rng
        if self.left == 0:
            self.way = self.WAYS[rng.integers(len(self.WAYS))]
            self.left = int(rng.choice([3, 10, 40, 400 if self.way in ("walk", "stand") else 60]))
            if self.way == "park" and rng.random() < 0.5:
                self.parked = self.at
        self.left -= 1
        flag = Quality.GOOD
        value = self.at
        if self.way == "walk":
            value = self.at + self.step * float(rng.integers(-2, 3))
        elif self.way == "flicker":
            value = self.at + self.step * float(rng.random() < 0.3)
        elif self.way == "park":
            return (self.parked if rng.random() < 0.9 else self.parked - 1.5), flag
        elif self.way == "jumpy":
            value = self.at + float(rng.choice([0.0, 0.0, 0.0, 2.5, 2.75, -2.75, 3.0, -6.0, 9.5, 10.25, 12.0]))
        elif self.way == "rails":
            return float(
                rng.choice([-40.0, -50.0, -50.5, -60.0, 120.0, 150.0, 150.5, 200.0, 210.0, np.nan, self.at])
            ), flag
        elif self.way == "flagged":
            flag = Quality(rng.choice([Quality.GOOD, Quality.CRC, Quality.NOT_AVAILABLE, Quality.OUT_OF_RANGE]))
        elif self.way == "edge":
            return float(rng.choice([-40.0, 150.0])), flag
        self.at = float(np.clip(value, -40.0, 150.0))
        return self.at, flag


def compare(rules: tuple[Rule, ...], steps: tuple[float, ...], seed: int, intervals: int) -> set[int]:
    """Drive both guards with the same faults; qualities met."""
    rng = np.random.default_rng(seed)
    sensors = [Sensor(rng, s) for s in steps]
    both = Both(rules)
    both.judge([], 0, active=True)
    now, active, met = 0, True, set[int]()
    silent = {c for c in range(len(rules)) if rng.random() < 0.5}
    for k in range(intervals):
        length = S * int(rng.choice([1, 1, 1, 1, 2, 9, 10, 11, 30])) // int(rng.choice([1, 1, 1, 2]))
        if rng.random() < 0.02:
            active = not active
        if k > 10 and rng.random() < 0.02:
            silent = {c for c in range(len(rules)) if rng.random() < 0.3}
        several = 3 if rng.random() < 0.1 else 1
        samples = [
            (now + int(rng.integers(0, 4)) * (length // 4), c, *sensors[c].next())
            for _ in range(several)
            for c in rng.permutation(len(rules)).tolist()
            if c not in silent and rng.random() < 0.95
        ]
        now += length
        met |= set(both.judge(samples, now, active if k % 2 else [active and bool(rng.random() < 0.9) for _ in rules]))
    return met


def told_of(
    rules: tuple[Rule, ...], series: np.ndarray, step_s: int = 1, *, begun: bool = False, both: Both | None = None
) -> np.ndarray:
    """What becomes of one sample per channel and interval of `series` (T, C), under current.

    Where it has `begun` an interval without samples ended at bus time 0, so that the first one has a length.
    """
    both = both or Both(rules)
    if begun:
        both.judge([], 0, active=True)
    end = step_s * S
    return np.array(
        [
            both.judge([(k * end, c, float(v), Quality.GOOD) for c, v in enumerate(row)], (k + 1) * end, active=True)
            for k, row in enumerate(series)
        ]
    )


EVERY = {
    *(Quality.GOOD, Quality.OUT_OF_RANGE, Quality.NOT_AVAILABLE, Quality.STUCK, Quality.OPEN, Quality.SHORT),
    *(Quality.JUMPY, Quality.CRC, Quality.NEVER),
}


@pytest.mark.parametrize("seed", range(4))
def test_a_string_with_an_inlet_and_a_coarse_string_beside_it(seed):
    steps = (STEP, STEP, STEP, STEP, 40.0, COARSE_STEP, COARSE_STEP, STEP)
    assert compare(RULES, steps, seed, 600) == EVERY


@pytest.mark.parametrize("seed", range(2))
def test_a_sensor_without_peers(seed):
    assert compare(ALONE, (40.0, STEP), seed, 1_200) >= {Quality.GOOD, Quality.STUCK, Quality.NEVER}


def test_no_channel_that_remembers():
    compare((CURRENT, CURRENT), (40.0, 300.0), 0, 100)


def wobble(n: int) -> np.ndarray:
    """Moves at every sample, finely, and stands nowhere."""
    return 25.0 + STEP * (np.arange(n) % 7) + STEP * np.arange(n)


def test_a_jump_is_forgiven_after_300_calm_samples_and_not_before():
    rule = Rule("surface", jump=2.5)
    for calm, wait in ((299, 12), (300, 6), (301, 6)):
        series = wobble(calm + 40)
        series[10:] += 5.0
        series[10 + calm + 1 :] += 5.0
        told = told_of((rule,), series[:, None])[:, 0]
        assert np.count_nonzero(told[: 10 + calm + 1] == Quality.JUMPY) == 6
        assert np.count_nonzero(told[10 + calm + 1 :] == Quality.JUMPY) == wait
    for calm, wait in ((299, 6), (300, 3)):  # nor does another fault then cost what the jump did
        series = wobble(calm + 40)
        series[10:] += 5.0
        series[10 + calm + 1] = 500.0
        told = told_of((Rule("surface", upper=400.0, jump=2.5),), series[:, None])[:, 0]
        assert np.count_nonzero(told == Quality.OUT_OF_RANGE) == wait


@pytest.mark.parametrize("away", range(294, 304))
def test_a_home_is_remembered_for_300_s(away):
    stay, back = np.full(40, 24.5), np.full(6, 24.5)
    told = told_of((FINE,), np.concatenate([wobble(20), stay, 24.5 + wobble(away) - 24.0, back])[:, None])[:, 0]
    assert (told[-2:] == Quality.STUCK).all() == (away < 302)  # two samples pass until it has left


@pytest.mark.parametrize("second", range(2, 14))
def test_of_two_places_the_first_is_home_until_the_second_was_held_longer(second):
    stay, other = np.full(8, 24.5), np.full(second, 24.5 + STEP)
    gone = 24.5 + 2 * STEP + wobble(5) - 25.0
    told_of((FINE,), np.concatenate([wobble(20), stay, other, gone, np.full(5, 24.5)])[:, None])


def test_one_that_never_moved_stands_too_long_after_4_s_and_one_that_has_after_60():
    parked, frozen = np.full(100, 24.5), np.r_[wobble(15), np.full(85, 27.0)]  # soon: it has shown no noise
    told = told_of((FINE, FINE), np.stack([parked, wobble(100)], axis=1))[:, 0]
    assert told.tolist().index(Quality.STUCK) == 6  # current flowed from the second interval on; after more than 4 s
    told = told_of((FINE, FINE), np.stack([frozen, wobble(100)], axis=1))[:, 0]
    assert told.tolist().index(Quality.STUCK) == 15 + 61


@pytest.mark.parametrize(
    ("lively", "quiet", "earliest", "latest"),
    [(1, 0, 307, 310), (6, 0, 307, 310), (4, 4, 307, 310), (3, 4, 360, 380), (0, 0, 360, 380)],
)
def test_one_that_freezes_amid_noise_stands_too_long_after_8_s(lively, quiet, earliest, latest):
    """Amid others of which most stand about, though they move, it may stand for 60; alone too."""
    rng = np.random.default_rng(8)
    series = 25.0 + STEP * rng.integers(-20, 20, (400, 1 + lively + quiet))
    series[300:, 0] = series[299, 0]
    still = series[:, 1 + lively :]
    still[:] = 25.0 + STEP * (np.minimum(np.arange(400), 300)[:, None] // 3 + rng.integers(0, 2, quiet))
    still[300::2] += STEP
    both = Both((FINE,) * (1 + lively + quiet))
    told = told_of(both.rules, series[:earliest], both=both)[:, 0]
    assert (told[10:305] == Quality.GOOD).all()
    found = earliest - 1
    while both.plain.channels[0].last != Quality.STUCK:  # of the channel: its samples are held back before
        found += 1
        both.judge([(found * S, c, float(v), Quality.GOOD) for c, v in enumerate(series[found])], (found + 1) * S, True)
    assert earliest <= found <= latest


@pytest.mark.parametrize(("twice", "least"), [(0, 20), (1, 24)])
@pytest.mark.parametrize("more", range(-4, 4))
def test_a_fifth_that_repeats_is_noise_and_more_is_not(twice, least, more):
    """Five repetitions to begin with are a fifth of 25, one more of 30; the run that goes on is none yet.

    Of that run 9 are more than 8 s amid noise; one alone may stand for 60, but 13 are held back: 0.2¹³ = 8·10⁻¹⁰.
    """
    noise = wobble(least + more + 1)
    noise = np.insert(noise, 13, noise[[12] * twice])
    series = np.stack([np.r_[noise, np.full(20, noise[-1])], wobble(len(noise) + 20)], axis=1)
    told = told_of((FINE, FINE), series)[:, 0].tolist()
    assert told[len(noise) + 7] == Quality.GOOD
    assert (told[len(noise) + 8] == Quality.STUCK) == (more >= 0)
    told = told_of((FINE,), series[:, :1])[:, 0].tolist()
    assert told[len(noise) + 11] == Quality.GOOD
    assert (told[len(noise) + 12] == Quality.STUCK) == (more >= 0)


@pytest.mark.parametrize(("moves", "becomes"), [(23, Quality.GOOD), (24, Quality.STUCK)])
def test_of_a_fifth_that_repeats_are_peers_that_are_noisy_too(moves, becomes):
    """Twice the same within a second among `moves` others, and then no more: with the first five 6 of 30."""
    both, noise, by = Both((FINE, FINE)), wobble(40), wobble(moves + 1)
    noise[30:] = noise[29]
    peer = {k: [float(v)] for k, v in enumerate(by[:20])} | {20: [float(v) for v in (by[19], *by[20:])]}
    told = []
    for k, v in enumerate(noise[:39]):
        samples = [(k * S, 0, float(v), Quality.GOOD), *((k * S, 1, p, Quality.GOOD) for p in peer.get(k, []))]
        told.append(both.judge(samples, (k + 1) * S, active=True)[0])
    assert told[37] == Quality.GOOD
    assert told[38] == becomes


@pytest.mark.parametrize(("repeats", "becomes"), [(115, Quality.STUCK), (116, Quality.GOOD)])
def test_what_repeats_is_counted_over_600_samples(repeats, becomes):
    """After 595 others 5 of 600, then 5 (599 - n) / 600 + n for n repetitions: a fifth, of 600, up to n = 115.97."""
    both, noise, peer = Both((FINE, FINE)), wobble(598), wobble(40)
    values = [*np.array_split(noise[:590], 20), np.r_[noise[590:596], np.full(repeats, noise[595]), noise[596]]]
    values += [noise[596:597]] * 11  # two more until it has left, the last one after more than 8 s
    told = []
    for k, some in enumerate(values):
        samples = [(k * S, 1, float(peer[k]), Quality.GOOD), *((k * S, 0, float(v), Quality.GOOD) for v in some)]
        told.append(both.judge(samples, (k + 1) * S, active=True)[-1])
    assert told[-2:] == [Quality.GOOD, becomes]


@pytest.mark.parametrize(("moved", "becomes"), [(964, Quality.GOOD), (965, Quality.STUCK)])
def test_a_run_of_any_length_is_forgotten_as_one_of_599(moved, becomes):
    """The sample that ends it leaves 599 of 600, each further one 599/600 of that: the 964th is below a fifth."""
    both, noise, peer = Both((FINE, FINE)), wobble(100 + moved), wobble(60)
    values = [*np.split(noise[:100], 20), np.full(700, noise[99]), *np.array_split(noise[100:], 4)]
    values += [noise[-1:]] * 9
    told = []
    for k, some in enumerate(values):
        samples = [(k * S, 1, float(peer[k]), Quality.GOOD), *((k * S, 0, float(v), Quality.GOOD) for v in some)]
        told.append(both.judge(samples, (k + 1) * S, active=True)[-1])
    assert told[-2:] == [Quality.GOOD, becomes]


def test_frames_that_are_not_believed_repeat_nothing():
    """Of 44 others the share is 5 of 49: ten repetitions would be held back, nine are more than 8 s."""
    noise = wobble(60)
    noise[2::4] = noise[1::4]
    both = Both((FINE, FINE))
    told = []
    for k, v in enumerate([*noise, *np.full(10, noise[-1])]):
        flag = Quality.CRC if k % 4 == 2 and k < 60 else Quality.GOOD
        samples = [(k * S, 0, float(v), flag), (k * S, 1, float(wobble(80)[k]), Quality.GOOD)]
        told.append(both.judge(samples, (k + 1) * S, active=True)[0])
    assert told.index(Quality.STUCK) == 68


def test_one_that_never_gives_a_value_twice_is_held_back_at_the_fifth_repetition_and_no_sooner():
    moving = wobble(1010)
    frozen = np.r_[moving[:1000], np.full(10, moving[999])]
    told = told_of((FINE,) * 3, np.stack([frozen, moving, moving], axis=1))[:, 0]
    assert (told[10:1004] == Quality.GOOD).all()
    assert (told[1004:] == Quality.STUCK).all()


def test_a_run_that_noise_does_not_give_is_held_back_and_the_next_other_value_counts():
    rng = np.random.default_rng(8)
    series = 25.0 + STEP * rng.integers(-60, 60, (400, 3))
    series[300:307, 0] = series[299, 0]
    told = told_of((FINE,) * 3, series)[:, 0]
    assert (told[10:305] == Quality.GOOD).all()
    assert told[306:308].tolist() == [Quality.STUCK, Quality.GOOD]  # its channel would be stuck from 308 on


@pytest.mark.parametrize(("step_s", "least"), [(1, 7), (2, 6)])
@pytest.mark.parametrize("stay", range(4, 11))
def test_a_home_held_for_8_s_and_8_samples_proves_something(step_s, least, stay):
    """Its first sample takes no time; until it has left two more pass."""
    away = 24.5 + STEP + wobble(6) - 25.0
    series = np.concatenate([wobble(20), np.full(stay, 24.5), away + STEP, np.full(3, 24.5)])
    told = told_of((FINE,), series[:, None], step_s)[:, 0]
    assert (told[-1] == Quality.STUCK) == (stay >= least)


@pytest.mark.parametrize("short_ns", [0, 1])
def test_samples_of_one_stamp_hold_a_home_for_no_time(short_ns):
    at = [*range(20), 20, 20, *range(21, 31), *range(31, 34)]
    values = [*wobble(20), *np.full(8, 24.5), *(24.5 + STEP + wobble(4) - 25.0), *np.full(3, 24.5)]
    both = Both((FINE,))
    for k, v in zip(at, values, strict=True):
        stamp = k * S - short_ns * (k > 20)
        told = both.judge([(stamp, 0, float(v), Quality.GOOD)], k * S + S, active=True)
    assert (told == [Quality.STUCK]) == (short_ns == 0)


def test_a_coarse_one_stands_too_long_after_half_an_hour():
    for begun, first in ((False, 182), (True, 181)):
        told = told_of((COARSE,), np.full((190, 1), 24.0), step_s=10, begun=begun)[:, 0]
        assert told.tolist().index(Quality.STUCK) == first


@pytest.mark.parametrize(
    ("flag", "value", "becomes"),
    [
        (Quality.CRC, 200.0, Quality.CRC),
        (Quality.NOT_AVAILABLE, -50.0, Quality.NOT_AVAILABLE),
        (Quality.ERROR, 160.0, Quality.ERROR),
        (Quality.OUT_OF_RANGE, 200.0, Quality.OPEN),
        (Quality.OUT_OF_RANGE, -50.0, Quality.SHORT),
        (Quality.OUT_OF_RANGE, 25.0, Quality.OUT_OF_RANGE),
    ],
)
def test_a_rail_says_more_than_a_range_but_nothing_of_a_frame_that_is_not_believed(flag, value, becomes):
    assert Both((FINE,)).judge([(0, 0, value, flag)], S, active=True) == [becomes]


def test_one_that_was_stuck_and_has_moved_since_may_come_home_at_rest():
    both = Both((FINE,))
    driven = [*wobble(20), *np.full(70, 26.0), *(26.0 + wobble(20) - 24.5)]
    parked = [*np.full(120, 28.0), *(28.0 + wobble(5) - 24.5), *np.full(4, 28.0)]
    told = [
        both.judge([(k * S, 0, float(v), Quality.GOOD)], (k + 1) * S, active=k < len(driven))[0]
        for k, v in enumerate([*driven, *parked])
    ]
    assert Quality.STUCK in told[:90]
    assert set(told[-60:]) == {Quality.GOOD}


def test_a_dip_from_home_is_no_return_to_it():
    """Neither is a sample that cannot be used."""
    for dip in (28.0 + STEP, 500.0):
        both = Both((FINE,))
        at_home = np.full(30, 28.0)
        series = [
            *wobble(20),
            *at_home,
            *(28.0 + wobble(6) - 24.5),
            *np.full(4, 28.0),
            dip,
            *np.full(3, 28.0),
            dip,
            dip,
        ]
        for k, v in enumerate([*series, *(28.5 + wobble(20) - 25.0), *np.full(6, 28.0), dip, *np.full(3, 28.0)]):
            both.judge([(k * S, 0, float(v), Quality.GOOD)], (k + 1) * S, active=k % 3 == 0)
