"""A report of the page shows the steps that are ticked there, under the same names, whatever became of its process."""

import re

import pytest

from bms_gateway.workbench.desk import Desk
from tests.report.html_page import Page
from tests.support.desk_steps import done, files
from tests.support.page_steps import ADDED
from tests.truth.packs import pack as make_pack

FORCED = "+ thermocouples answer late (thermocouple_lag), by force"
ALL = ["from its file", "refitted", FORCED, ADDED]


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A tab with an addition by force, and one that the readings ask for."""
    pack, desk = make_pack(tmp_path_factory.mktemp("pack"), seconds=700), Desk("steps")
    desk.open(files(pack))
    done(desk)
    for words, force in ((["thermocouple_lag"], True), (["entropic_heat"], False)):
        desk.add(words, force=force)
        done(desk)
    assert [s["name"] for s in desk.state()["steps"]] == ALL
    yield desk
    desk.close()


def reported(desk, ticked=None):
    """Names of the models in a figure, what is said to have been added, and the whole text."""
    path = desk.report(ticked)
    text = path.read_text(encoding="utf-8")
    path.unlink()
    page = Page(text)
    names = dict.fromkeys(d["name"] for d in page.figures(text)["overlay-1-1"]["data"])
    added = re.search(r'<section id="missing".*?</section>', text, re.DOTALL)
    return (
        [n for n in names if n != "measured"],
        added[0] if added else "",
        page.text.replace("\N{NO-BREAK SPACE}", " "),
    )


@pytest.mark.slow
def test_a_report_shows_the_steps_of_the_page(desk):
    """The step "refitted" was left out, and so was what had been added by force before."""
    drawn, added, text = reported(desk)
    assert drawn == ALL
    heads = re.findall("<h3>(.*?)</h3>", added)
    assert [h.replace("\N{NO-BREAK SPACE}", " ") for h in heads] == [FORCED, ADDED]
    cards = re.search(r"Error on held-out blocks((?:[\d.]+ → ){3}[\d.]+ K)", text)
    assert cards, text[:2000]
    stairs = [s["stair"]["held_K"] for s in desk.state()["steps"]]
    assert [float(x) for x in re.findall(r"[\d.]+", cards[1])] == pytest.approx(stairs, rel=0.006, abs=6e-4)
    # the two models of the newest addition are always there, older ones where they are ticked
    assert reported(desk, [1, 3])[0] == ALL[1:]
    assert reported(desk, [0, 3])[0] == [ALL[0], *ALL[2:]]


@pytest.mark.slow
def test_a_report_of_a_process_that_began_anew_has_the_same_steps(desk):
    desk.diagnose()
    desk.cancel()  # with the process, what it kept of the addition ends
    drawn, _, text = reported(desk)
    assert drawn == ALL
    assert "Model with an effect added" in text
    assert reported(desk, [0, 3])[0] == [ALL[0], *ALL[2:]]
