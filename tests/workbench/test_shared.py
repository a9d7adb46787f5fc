"""What several tabs ask of the same records and the same model is computed once."""

import json
import threading
from collections import Counter

import pytest

from bms_gateway.workbench import desk as desks
from bms_gateway.workbench.shared import MOST_BYTES, Shared, key_of
from tests.support.desk_steps import done, files
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import come

TABS = 8


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"), cells=1, sensors=(1,), seconds=900)


@pytest.fixture
def asked(monkeypatch):
    """How often processes were asked for what."""
    count, ask = Counter(), desks.Worker.ask

    def counting(self, request):
        count[request["do"]] += 1
        ask(self, request)

    monkeypatch.setattr(desks.Worker, "ask", counting)
    return count


@pytest.fixture
def tabs():
    shared = Shared()
    opened = [desks.Desk(f"tab {k}", shared) for k in range(TABS)]
    yield opened
    for one in opened:
        one.close()
    shared.close()


def same(a, b):
    """What of a state does not count the changes of its own tab."""
    return {k: v for k, v in a.items() if k != "version"} == {k: v for k, v in b.items() if k != "version"}


@pytest.mark.slow
def test_eight_tabs_fit_once(pack, tabs, asked):
    """Each of eight duplicates fitted anew, and they took the processor from each other."""
    for tab in tabs:
        tab.open(files(pack))
    states = [done(tab) for tab in tabs]
    assert all(s["error"] == "" and s["compared"] for s in states)
    assert asked == {"open": TABS, "compare": 1}
    for tab in tabs:
        tab.add(["entropic_heat"], force=True)
    states = [done(tab) for tab in tabs]
    assert asked == {"open": TABS, "compare": 2, "add": 1}
    assert all(same(s, states[0]) for s in states)
    first = tabs[0].figure("surface-0-1")
    assert all(tab.figure("surface-0-1") == first for tab in tabs)
    assert len(first["steps"]) == 3
    # one goes; what it computed stays with the others
    tabs[0].close()
    assert tabs[1].figure("surface-0-1") == first
    late = tabs[2]
    late.undo()
    late.add(["entropic_heat"], force=True)
    assert same(done(late), states[2])
    assert asked == {"open": TABS, "compare": 2, "add": 1}
    reports = [tabs[k].report().read_text() for k in (1, 3)]
    assert reports[0] == reports[1]
    assert asked["report"] == 1


@pytest.mark.slow
def test_who_waits_takes_over_from_one_who_cancels(pack, tabs, asked):
    one, other = tabs[:2]
    for tab in (one, other):
        tab.open(files(pack))
        done(tab)
    one.diagnose()
    come(lambda: (one.state()["job"] or {}).get("share"), "progress")
    other.diagnose()
    come(lambda: (other.state()["job"] or {}).get("share"), "progress of the other's work")
    assert asked["diagnose"] == 1
    one.cancel()
    assert one.state()["job"] is None
    assert other.state()["job"]["kind"] == "diagnose"
    assert done(other)["diagnosed"]["sentence"]
    assert asked["diagnose"] == 2


@pytest.mark.slow
def test_one_who_cancels_what_another_computes_ends_nothing(pack, tabs, asked):
    one, other = tabs[:2]
    for tab in (one, other):
        tab.open(files(pack))
        done(tab)
    one.diagnose()
    other.diagnose()
    other.cancel()
    assert other.state()["job"] is None
    assert done(one)["diagnosed"]["sentence"]
    assert other.state()["diagnosed"] is None
    assert asked["diagnose"] == 1


@pytest.mark.slow
def test_other_records_and_other_models_are_others(pack, tabs, asked, tmp_path):
    other = make_pack(tmp_path, cells=1, sensors=(1,), seconds=900, seed=22)
    model = tmp_path / "changed.toml"
    model.write_text(pack.model.read_text() + "\n# another text\n")
    for tab, given in zip(
        tabs, (files(pack), files(pack, other.hidden), {**files(pack), "model": str(model)}), strict=False
    ):
        tab.open(given)
    for tab in tabs[:3]:
        assert done(tab)["compared"]
    assert asked["compare"] == 3


def test_only_what_fits_is_shared():
    request = {"do": "compare", "files": {"tables": ["a"]}, "folder": "x", "text": "m", "name": "refitted"}
    assert key_of(request, "") == ""
    assert key_of({**request, "do": "track"}, "a") == ""
    assert key_of(request, "a") == key_of({**request, "folder": "y", "files": {}}, "a")
    assert key_of(request, "a") != key_of(request, "b")
    assert key_of(request, "a") != key_of({**request, "text": "n"}, "a")


class Tab:
    """Hears."""

    def __init__(self, folder):
        self.folder, self.heard = folder, threading.Event()

    def hear_shared(self, key, answer):
        self.answer = answer
        self.heard.set()


def test_the_oldest_answers_go_when_they_take_too_much_room(tmp_path, monkeypatch):
    monkeypatch.setattr("bms_gateway.workbench.shared.MOST_BYTES", 3000)
    assert MOST_BYTES > 1 << 20
    shared, tab = Shared(), Tab(tmp_path)
    try:
        for k in range(4):
            name = f".series-{k:016x}.npz"
            (tmp_path / name).write_bytes(b"x" * 1200)
            assert shared.ask(f"key {k}", tab)
            shared.answered(f"key {k}", {"done": {"kept": {"file": name}}}, tmp_path)
        assert shared.ask("key 0", tab)  # gone
        (tmp_path / ".series-0000000000000003.npz").unlink()
        assert not shared.ask("key 3", tab)
        assert tab.heard.wait(30)
        assert json.dumps(tab.answer) == json.dumps({"done": {"kept": {"file": ".series-0000000000000003.npz"}}})
        assert (tmp_path / ".series-0000000000000003.npz").read_bytes() == b"x" * 1200
    finally:
        shared.close()
