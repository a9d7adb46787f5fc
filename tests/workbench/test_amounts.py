"""Numbers with a unit as the page writes them, in a real browser."""

import pytest

from tests.workbench.conftest import served

pytestmark = pytest.mark.slow

WRITTEN = {
    0.09996: "0.100 K",
    0.9997: "1.00 K",
    9.996: "10.0 K",
    -0.09996: "-0.100 K",
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
