"""The main button of a verdict adds what the gate of adding accepts, and nothing else."""

import json

import pytest

from bms_gateway.workbench.desk import Desk
from tests.support.desk_steps import done, files
from tests.support.page_steps import FIT_S, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.conftest import served

pytestmark = pytest.mark.slow  # a browser, and fits
WHY = "Nothing of this can be added without force: it ends at its bound. Record the cells once more."


def test_the_main_button_is_what_the_gate_accepts(window, tmp_path):
    """It named all effects of the verdict, and the gate then refused what the verdict itself had doubted."""
    pack = make_pack(tmp_path, seconds=800)
    desk = Desk("sender")
    try:
        desk.open(files(pack))
        done(desk)
        desk.diagnose()
        before = done(desk)["diagnosed"]
        session = desk.session()
    finally:
        desk.close()
    assert before["offer"] == before["selected"] == ["entropic_heat"]
    assert before["not_offered"] == ""
    refused = tmp_path / "refused.json"
    session["diagnosed"][0]["said"] |= {"offer": [], "not_offered": WHY}
    refused.write_text(json.dumps(session))
    old = tmp_path / "old.json"
    for key in ("offer", "not_offered"):
        del session["diagnosed"][0]["said"][key]
    old.write_text(json.dumps(session))
    with served(tmp_path) as url:
        page = window(url)
        for path, says in ((refused, WHY), (old, "The session is older: diagnose again")):
            page.upload("#session-file", "\n".join(map(str, (path, pack.hidden, pack.model))))
            seen_compared(page)
            page.idle(FIT_S)
            page.click("#tab-diagnose")
            assert says in page.text("#not-offered")
            assert not page.there("#add-named")
        page.click("#diagnose")
        page.wait("return document.querySelector('#add-named')", patience_s=FIT_S)
        page.idle(FIT_S)
        assert not page.there("#not-offered")
        page.click("#add-named")
        page.wait("return document.querySelectorAll('#panel-add .way li').length === 3", patience_s=FIT_S)
        page.idle(FIT_S)
        assert not page.there("#refusal")
        # of the newer model the verdict knows nothing
        page.click("#tab-diagnose")
        assert page.there("#found-for")
        assert page.run("return [...document.querySelectorAll('#panel-diagnose .main')].map(b => b.id)") == ["diagnose"]
        assert page.complaints() == []
