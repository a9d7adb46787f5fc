"""A refit that is worse than the file is said in red wherever it stands, and its cores are no answer."""

import pytest

from tests.support.page_steps import FIT_S, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import faults
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser, and fits

RED = "return [...document.querySelectorAll(arguments[0])].map(e => [e.innerText, getComputedStyle(e).color])"
LINES = """
const own = document.querySelector('#plot-core').data;
return own.filter(t => t.mode === 'lines' && t.x.length > 2).map(t => t.name);
"""


CLOSE = {"C_c": 219.4, "C_s": 22.96, "R_e": 1.817, "R_c": 0.5209, "R_u": 1.236, "R_cc": 1.595, "C_f": 9.831}
"""Numbers, in the file's units, that follow this pack's surfaces to 0.9 K: they pay for what the model lacks. A fit
that allows for what it lacks follows them to 1.6 K."""


def file_that_pays(pack):
    """Write such numbers into the model file; what was known before any data stays in `[before]`."""
    head, known = pack.model.read_text().split("[parameters]")
    rows, *rest = known.partition("\n\n")
    wrong = [
        line if name not in CLOSE else f"{name} = {{ value = {CLOSE[name]}, {line.partition(', ')[2]}"
        for line in rows.splitlines()
        for name in [line.partition(" ")[0]]
    ]
    before = [line for line in rows.splitlines() if line.partition(" ")[0] in CLOSE]
    text = "\n".join([*wrong, "", "[before]", *before])
    pack.model.write_text(f"{head}[parameters]{text}{''.join(rest)}")


def test_a_refit_that_is_worse_is_red_and_its_core_is_no_answer(window, axe, tmp_path):
    """The bars, tiles and curves showed a core to ± 26 K as they show one that is known."""
    pack = make_pack(tmp_path, effect="phase_change")
    file_that_pays(pack)
    with served(tmp_path, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-compare")
        (told, color), *more = page.run(RED, "#panel-compare .worse")
        assert more == []
        assert told.startswith("This refit is worse than the model from its file: the error where fitted rises from ")
        assert color == "rgb(176, 0, 32)"
        assert told in page.text("#doubt")
        for cell in (1, 2, 3):
            page.click(f"#cell-{cell}")
            page.idle(FIT_S)
            assert "core not known (± " in page.text("#cell-told")
        assert page.run(LINES) == []
        assert "Core not known: ± " in page.run("return document.querySelector('#plot-core').textContent")
        assert "not known" in page.text("#panel-compare .cards")

        # where the bar stands
        page.click("#tab-add")
        page.type("#effect-name", "entropic_heat")
        page.press("Enter")
        page.idle(FIT_S)
        assert page.run("return document.querySelectorAll('.bars')[0].children[1].className") == "bar worse"
        assert page.run(RED, "#bars-worse .worse") == [[told, color]]
        assert page.run("return document.querySelectorAll('.bars')[2].children[1].lastChild.textContent") == "?"
        assert page.run("return document.querySelectorAll('.bar.worse i')[0].getBoundingClientRect().height") > 100
        assert page.run("const p = document.querySelector('#panels'); return p.scrollWidth <= p.clientWidth")
        for theme in ("dark", "light"):
            page.click("#theme")
            assert page.run("return document.documentElement.dataset.theme") == theme
            assert faults(page, axe) == [], theme
        page.picture(tmp_path / "worse.png")
        assert page.complaints() == []
