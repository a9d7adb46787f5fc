"""Numbers with a unit as the page writes them, in a real browser."""

import pytest

from tests.workbench.conftest import served

pytestmark = pytest.mark.slow

WRITTEN = {
    0.09996: "0.100 K",
    0.9997: "1.00 K",
    9.996: "10.0 K",
    -0.09996: "−0.100 K",
    0.1234: "0.123 K",
    0.0: "0 K",
    27.26: "27.3 K",
    1234.5: "1235 K",
}


def test_amounts_have_three_digits_also_where_they_are_rounded_up(window, tmp_path):
    with served(tmp_path) as url:
        page = window(url)
        written = page.run(
            "return import('/page/util.js').then(({ K }) => arguments[0].map((x) => K(x)));", list(WRITTEN)
        )
    assert dict(zip(WRITTEN, written, strict=True)) == WRITTEN


def test_times_of_the_live_page_are_of_the_wall_and_have_a_date_where_it_is_another_day(window, tmp_path):
    with served(tmp_path) as url:
        page = window(url)
        today, yesterday, beside, without, of = page.run(
            "return import('/page/util.js').then(({ when }) => {"
            "const now = new Date(), day = 86400000; now.setHours(12, 0, 30, 0);"
            "const at = (ms) => ({ wall_ms: ms, at: 30, age: 0, first_s: ms / 1e3 - 30 }), old = now.getTime() - day;"
            "return [when(at(now.getTime()), 10), when(at(old), 10), when(at(old), 10, old),"
            " when({ wall_ms: null, first_s: 1 }, 9),"
            "  [now.getTime() - 20000, old - 20000].map(ms => [new Date(ms).toLocaleTimeString('sv-SE'), "
            "    new Date(ms).toLocaleString('sv-SE')])]; });"
        )
    # Swedish times are those of ISO 8601, but for the T
    assert today == beside == of[0][0]  # beside a time of the same day no date is needed
    assert yesterday == of[1][1]
    assert without == "0:00:10"  # of the frames' own clock: their first estimate was at 1 s
