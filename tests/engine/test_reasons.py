"""Reasons for which samples are not used have words for people, the most frequent first."""

from bms_gateway.engine.reasons import COUNTED, REASONS, REPEATED, UNKNOWN_MUX, unused
from bms_gateway.frames.quality import Quality

OF_ESTIMATES = {Quality.GOOD, Quality.ESTIMATED, Quality.DOUBTFUL}


def test_every_quality_that_a_sample_can_be_refused_with_has_words():
    assert set(REASONS) == set(Quality) - OF_ESTIMATES
    assert set(COUNTED) == {q.name.lower() for q in REASONS} | {UNKNOWN_MUX, REPEATED}
    assert len(set(COUNTED.values())) == len(COUNTED)


def test_the_most_frequent_reason_comes_first_and_none_is_lost():
    counts = {key: n for n, key in enumerate(COUNTED, 1)}
    told = unused(counts)
    assert list(told.values()) == sorted(counts.values(), reverse=True)
    assert list(told) == [COUNTED[key] for key in reversed(COUNTED)]
    assert unused({}) == {}
