"""While an effect is being fitted its bars show the closest fits, and say so; then they stand at the step's error."""

from contextlib import contextmanager

import pytest

from tests.support.page_steps import FIT_S, seen_added, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import faults
from tests.workbench.conftest import served

FOUND = """
const road = await import('/page/road.js');
const stair = (x) => ({trained_K: x, held_K: x, floor_K: 0.05, core_K: 1});
road.trial({names: 'heat (a)', step: '+ heat (a)', before: stair(0.5), after: stair(arguments[0]), picture: 0});
"""
"""What the server tells of an addition on its way."""
LAST = "const b = [...document.querySelectorAll('.bars')[0].querySelectorAll('.bar')].at(-1);"


@contextmanager
def at_add(window, folder):
    """The page of a compared model, where effects are added."""
    pack = make_pack(folder, seconds=600)
    with served(folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-add")
        yield page


@pytest.mark.slow
def test_bars_of_a_fit_on_its_way_say_what_they_show(window, axe, tmp_path):
    with at_add(window, tmp_path) as page:
        for error_K in (0.4, 0.2):
            page.run(FOUND, error_K)
            assert page.run(LAST + "return b.className") == "bar fitting"
            assert page.run(LAST + "return b.lastChild.textContent") == f"{error_K:.2f}"
        # the bar of an error that is the noise ends at the line of the noise
        page.run(
            FOUND,
            page.run(
                LAST
                + "return parseFloat(document.querySelector('.stairs figcaption').innerText.match(/alone, (\\S+)/)[1])"
            ),
        )
        page.run("document.querySelectorAll('.bar i').forEach(i => { i.style.transition = 'none'; })")
        top, line = page.run(
            LAST + "return [b.firstChild.getBoundingClientRect().top,"
            " document.querySelector('.bars').lastChild.getBoundingClientRect().bottom]"
        )
        assert top == pytest.approx(line, abs=2.0)
        assert page.text("#bar-names").endswith("3 + heat (a), being fitted (closest fit so far)")
        assert "the bar stands at the error that is stated for the step" in page.text("#fitting-told")
        assert faults(page, axe) == []


@pytest.mark.slow
def test_the_core_of_a_fit_on_its_way_has_no_bar_and_says_why(window, axe, tmp_path):
    # Bug: it stood at 2.0 K while the fit ran, and ended at 14 K.
    with at_add(window, tmp_path) as page:
        page.run(FOUND, 0.3)
        core = (
            "const f = [...document.querySelectorAll('.stairs figure')].at(-1);"
            "const b = [...f.querySelectorAll('.bar')].at(-1);"
        )
        height = "parseFloat(b.style.getPropertyValue('--h'))"
        assert page.run(f"{core} return [b.lastChild.textContent, {height}]") == ["…", 0.0]
        assert page.run(core + "return f.querySelector('figcaption').textContent").endswith(
            "…: judged when the fit has ended"
        )
        assert "being fitted (closest fit so far) not judged yet" in page.run(core + "return f.lastChild.ariaLabel")
        assert faults(page, axe) == []


@pytest.mark.slow
def test_bars_end_at_the_error_that_is_stated(window, tmp_path):
    pack = make_pack(tmp_path)
    with served(tmp_path, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        seen_added(page)
        assert not page.there("#fitting-told")
        stated = page.run(
            "const { desk } = JSON.parse(sessionStorage.workbench);"
            "const told = await fetch(`/api/state?desk=${desk}`).then(r => r.json());"
            "return told.steps.map(s => s.stair.held_K)"
        )
        shown = (
            "return [...document.querySelectorAll('.bars')[1].querySelectorAll('.bar b')].map(b => Number(b.innerText))"
        )
        assert page.run(shown) == pytest.approx(stated, rel=0.01)


@pytest.mark.slow
def test_a_core_that_is_not_known_has_the_highest_bar(window, axe, tmp_path):
    """Its bar had no height, so the band seemed to grow when an effect made the core known."""
    with at_add(window, tmp_path) as page:
        page.run(FOUND.replace("after: stair(arguments[0])", "after: {...stair(arguments[0]), core_known: false}"), 0.3)
        *others, (text, height) = page.run(
            "return [...[...document.querySelectorAll('.bars')].at(-1).querySelectorAll('.bar')]"
            ".map(b => [b.lastChild.textContent, parseFloat(b.style.getPropertyValue('--h'))])"
        )
        assert (text, height) == ("?", 100.0)
        assert len(others) >= 2
        assert all(h < 90.0 and t != "?" for t, h in others)
        assert faults(page, axe) == []
