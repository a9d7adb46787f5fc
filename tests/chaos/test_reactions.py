"""When a record shows that a fault did not reach the estimates."""

from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.chaos.observed_run import Seen
from bms_gateway.chaos.reaction import Unmoved

NONE = np.full(2, np.nan)
SOUND, NOT_SENT, ODD = (0, 11), (15, 15), (0, 8)


def record(*seconds: tuple[int, tuple[int, int]]) -> SimpleNamespace:
    """Frames and qualities of each second, after one second of five frames that is sound."""
    seen = [
        Seen(float(k), n, 1, np.array(q, np.uint8), NONE, NONE, {}) for k, (n, q) in enumerate([(5, SOUND), *seconds])
    ]
    return SimpleNamespace(before=lambda: seen[0], since=lambda: seen[1:], end_s=float(len(seconds)))


@pytest.mark.parametrize(
    ("seconds", "untouched"),
    [
        ([(5, SOUND)] * 3, True),
        ([(5, SOUND), (10, SOUND), (0, NOT_SENT), (5, SOUND)], True),  # the tick came at the edge of two seconds
        ([(5, SOUND), (0, NOT_SENT), (5, SOUND)], False),
        ([(0, NOT_SENT)] * 3, False),
        ([(10, SOUND), (0, NOT_SENT), (0, NOT_SENT)], False),
        ([(5, SOUND), (5, ODD), (5, SOUND)], False),
        ([], False),
    ],
)
def test_estimates_are_untouched_where_each_tick_is_sent_with_the_qualities_of_before(seconds, untouched):
    found = Unmoved().first_s(record(*seconds))
    assert found == (float(len(seconds)) if untouched else None)
