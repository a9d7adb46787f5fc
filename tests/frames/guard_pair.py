"""The guard and its plain counterpart, fed with the same samples."""

import numpy as np

from bms_gateway.frames.guard import Guard
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.rules import Rule
from tests.frames.plain_guard import PlainGuard

S = 1_000_000_000


Sample = tuple[int, int, float, Quality]


class Both:
    """The guard and the rules in words, given the same samples."""

    def __init__(self, rules: tuple[Rule, ...]) -> None:
        self.rules = rules
        self.guard, self.plain = Guard(rules), PlainGuard(list(rules))

    def judge(self, samples: list[Sample], t1_ns: int, active: bool | list[bool]) -> list[Quality]:
        on = [active] * len(self.rules) if isinstance(active, bool) else active
        told = self.guard.update(
            np.array([s[0] for s in samples], np.int64),
            np.array([s[1] for s in samples], np.intp),
            np.array([s[2] for s in samples], np.float64),
            np.array([s[3] for s in samples], np.uint8),
            t1_ns,
            active if isinstance(active, bool) else np.array(active),
        )
        expected = self.plain.update(samples, t1_ns, on)
        channels = self.plain.channels
        assert told.quality.tolist() == expected
        np.testing.assert_array_equal(told.value, [c.value for c in channels])
        assert told.time_ns.tolist() == [c.value_ns for c in channels]
        assert told.channel_quality.tolist() == [self.plain.quality_at(c, t1_ns) for c in range(len(channels))]
        assert told.rejected.tolist() == [[c.rejected.get(q, 0) for q in range(16)] for c in channels]
        held = [c.waits and self.plain.quality_at(k, t1_ns) == Quality.JUMPY for k, c in enumerate(channels)]
        assert told.held.tolist() == held
        return expected
