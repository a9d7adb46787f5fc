"""A session elsewhere: files that are named by paths of another machine, and what a diagnosis said, kept with it."""

import json
from pathlib import Path

import pytest

from bms_gateway.errors import UsageError
from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.recall import recalled
from bms_gateway.workbench.session import additions_of, diagnoses_of
from bms_gateway.workbench.site import Site, session_files
from tests.support.desk_steps import done, files
from tests.support.page_steps import FIT_S, seen_compared, seen_diagnosed
from tests.truth.packs import pack as make_pack
from tests.workbench.conftest import served

REMAINS = "Something unknown remains"


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    """With an effect that no catalogue knows."""
    return make_pack(tmp_path_factory.mktemp("pack"), effect="sun_load", seconds=800)


@pytest.fixture(scope="module")
def diagnosed(pack):
    """A session in which an effect that is no help was added by force, as it is mailed; and what its page showed."""
    desk = Desk("sender")
    try:
        desk.open(files(pack))
        done(desk)
        desk.diagnose()
        done(desk)
        desk.add(["coolant_delay"], force=True)
        state = done(desk)
        return json.dumps(desk.session()), state
    finally:
        desk.close()


def resumed(text, at):
    """State of another desk after this session was opened with these files."""
    session = json.loads(text)
    desk = Desk("receiver")
    try:
        desk.resume(at, additions_of(session), session["notes"], diagnoses_of(session))
        return done(desk), desk.session()
    finally:
        desk.close()


def confirmed(text, at):
    """What remains of each step after the diagnoses of a session were computed by the desk that opened it."""
    session = json.loads(text)
    desk = Desk("confirms")
    try:
        desk.resume(at, additions_of(session), session["notes"], diagnoses_of(session))
        done(desk)
        desk.confirm()
        return [s["remains"] for s in done(desk)["steps"]]
    finally:
        desk.close()


def told(diagnosed):
    """What stands on the page of a diagnosis but for what only its own process can draw."""
    return {
        **{k: v for k, v in diagnosed.items() if k != "recalled"},
        "ranking": [{k: v for k, v in r.items() if k != "drawn"} for r in diagnosed["ranking"]],
    }


@pytest.mark.slow
def test_what_a_diagnosis_said_is_there_again(diagnosed, pack, tmp_path):
    text, before = diagnosed
    assert before["diagnosed"]["remains"]
    renamed, model = tmp_path / "other name.csv", tmp_path / "pack.toml"
    renamed.write_bytes(pack.hidden.read_bytes())
    model.write_text("# A comment more.\n" + pack.model.read_text())
    state, session = resumed(text, {**files(pack, renamed), "model": str(model)})
    assert told(state["diagnosed"]) == told(before["diagnosed"])
    assert state["diagnosed_of"] == before["diagnosed_of"] == "refitted"
    assert state["dropped"] == ""
    assert [s["name"] for s in state["steps"]] == [s["name"] for s in before["steps"]]
    assert all(REMAINS in s["remains"] for s in state["steps"])
    assert not any(r["drawn"] for r in state["diagnosed"]["ranking"])
    again = json.loads(text)
    assert {k: session[k] for k in ("digest", "diagnosed")} == {k: again[k] for k in ("digest", "diagnosed")}


@pytest.mark.slow
def test_what_a_changed_file_says_of_the_cores_is_not_believed(diagnosed, pack):
    """Records and model are those of the file, only its words are others."""
    text, before = diagnosed
    session = json.loads(text)
    core = session["diagnosed"][0]["said"]["core"]
    assert not core["proven"]
    core |= {"proven": True, "sd_K": 1e-3, "centre_sd_K": 1e-3, "why": [], "sentence": "All is well."}
    state, written = resumed(json.dumps(session), files(pack))
    assert state["diagnosed"]["recalled"] is True
    assert state["diagnosed"]["core"] == before["diagnosed"]["core"]
    assert "All is well" not in json.dumps([state, written])
    # nor that nothing remains
    said = session["diagnosed"][0]["said"]
    assert said["remains"]
    session["diagnosed"][0]["said"] = {**said, "remains": False, "verdict": "adequate", "tag": "adequate"}
    state, _ = resumed(json.dumps(session), files(pack))
    assert state["diagnosed"]["recalled"] is True
    left = [s["remains"] for s in state["steps"]]
    assert all(x.startswith("By the session file alone, nothing unknown remains") for x in left[:2])
    assert left[2].startswith("Something unknown remains: the addition")  # which was made again here
    # and where it is computed here, it is said as it was
    assert confirmed(json.dumps(session), files(pack)) == [s["remains"] for s in before["steps"]]


def test_until_the_cores_are_computed_here_nothing_of_the_file_is_said_of_them():
    # Bug: it stood on the page until the comparison had ended, and stayed where that was cancelled.
    core = {"proven": True, "sd_K": 1e-3, "centre_sd_K": 1e-3, "why": [], "rests_on": None, "sentence": "All is well."}
    kept = {"digest": {"records": "r", "model": "m"}, "astray": [], "diagnosed": [{"step": 0, "said": {"core": core}}]}
    kept["diagnosed"][0]["said"]["ranking"] = []
    found, why = recalled(kept, {"records": "r", "model": "m"})
    assert why == ""
    assert found["0"]["core"] == {**dict.fromkeys(core), "proven": False, "why": [], "sentence": ""}


@pytest.mark.slow
def test_of_other_measurements_or_another_model_it_is_left_out_and_said(diagnosed, pack, tmp_path):
    text, _ = diagnosed
    state, session = resumed(text, files(pack, pack.clean))
    assert state["diagnosed"] is None
    assert state["dropped"] == (
        "The session’s diagnosis is left out: these are not the measurements that it was made of. Diagnose again."
    )
    assert session["diagnosed"] == []
    model = tmp_path / "pack.toml"
    lines = pack.model.read_text().splitlines()
    k = next(i for i, line in enumerate(lines) if line.startswith("R_e"))
    model.write_text("\n".join([*lines[:k], lines[k].replace("0.", "0.1", 1), *lines[k + 1 :]]))
    assert model.read_text() != pack.model.read_text()
    state, _ = resumed(text, {**files(pack), "model": str(model)})
    assert state["diagnosed"] is None
    assert "this is not the model that it was made of" in state["dropped"]


@pytest.mark.slow
def test_without_a_diagnosis_too_other_files_are_said_to_be_others(diagnosed, pack):
    session = json.loads(diagnosed[0])
    session |= {"diagnosed": [], "added": []}
    state, _ = resumed(json.dumps(session), files(pack))
    assert state["dropped"] == ""
    state, _ = resumed(json.dumps(session), files(pack, pack.clean))
    assert state["dropped"] == (
        "The readings are not those with which the session was saved: what it added is fitted anew."
    )


@pytest.mark.slow
def test_of_a_model_that_is_not_reached_it_is_left_out_and_said(diagnosed, pack):
    session = json.loads(diagnosed[0])
    session["diagnosed"][0] |= {"step": 1, "after": ["coolant_delay"]}
    session["added"][0]["force"] = False  # refused then
    state, _ = resumed(json.dumps(session), files(pack))
    assert state["refusal"]["names"] == "coolant arrives late (coolant_delay)"
    assert state["diagnosed"] is None
    assert "later model is left out" in state["dropped"]


@pytest.mark.slow
def test_after_other_additions_it_is_left_out_and_said(diagnosed, pack):
    session = json.loads(diagnosed[0])
    kept = session["diagnosed"][0]
    later = {**kept, "step": 1, "after": ["coolant_delay"]}
    assert diagnoses_of({**session, "diagnosed": [kept, later]})["astray"] == []
    assert diagnoses_of({**session, "diagnosed": [{k: x for k, x in kept.items() if k != "after"}]})["astray"] == []
    session["diagnosed"] = [kept, {**later, "after": ["radial_gradient"]}]
    state, _ = resumed(json.dumps(session), files(pack))
    assert state["diagnosed_of"] == "refitted"  # not of the model with the addition
    assert "these are not the additions after which it was made" in state["dropped"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "wrong",
    [
        {"digest": []},
        {"digest": {"records": 1}},
        {"diagnosed": {}},
        {"diagnosed": [{"step": 0, "said": {}}]},
        {"diagnosed": [{"step": -1}]},
    ],
)
def test_what_no_diagnosis_said_is_one_line(diagnosed, wrong):
    session = json.loads(diagnosed[0])
    with pytest.raises(UsageError, match="session: "):
        diagnoses_of({**session, **wrong})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "wrong"),
    [("verdict", 3), ("ranking", [{}]), ("core", None), ("selected", [None])],
)
def test_no_field_of_it_is_of_another_type(diagnosed, place, wrong):
    session = json.loads(diagnosed[0])
    session["diagnosed"][0]["said"][place] = wrong
    with pytest.raises(UsageError, match="what a diagnosis said"):
        diagnoses_of(session)


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [float("inf"), 10**400, -(10**301), True, "3"])
def test_no_number_of_a_ranking_is_of_another_type(diagnosed, wrong):
    session = json.loads(diagnosed[0])
    session["diagnosed"][0]["said"]["ranking"][0]["needs"] = wrong
    with pytest.raises(UsageError, match="what a diagnosis said"):
        diagnoses_of(session)


@pytest.mark.slow
def test_a_session_with_one_scale_for_all_bars_opens_too(diagnosed):
    session = json.loads(diagnosed[0])
    said = session["diagnosed"][0]["said"]
    now = json.loads(json.dumps(said))
    del said["core"]["rests_on"]
    for r in said["ranking"]:
        del r["group"], r["against"], r["needs"]
    roles = ("named", "tied", "next", "instead")
    said |= {"needs": 0.1, "groups": dict.fromkeys(roles, "Part"), "against": dict.fromkeys(("", *roles), "log-odds")}
    (one,) = diagnoses_of(session)["diagnosed"]
    assert one["said"].keys() == now.keys()
    assert one["said"]["core"] == {**now["core"], "rests_on": None}
    for r, new in zip(one["said"]["ranking"], now["ranking"], strict=True):
        assert r == {**new, "group": "Part" if new["role"] else "Weighed", "against": "log-odds", "needs": 0.1}


def test_files_of_another_machine_are_found_beside_the_session(tmp_path):
    desk = Desk("receiver")
    try:
        named = {
            "tables": ["/home/anna/drive 1.csv", "C:\\Users\\anna\\drive 2.csv"],
            "model": "/home/anna/pack.toml",
            "config": "",
        }
        with pytest.raises(UsageError) as e:
            session_files(Site(), desk, named)
        assert "upload drive 1.csv, drive 2.csv and pack.toml too" in str(e.value)
        for name in ("drive 1.csv", "pack.toml"):
            (desk.folder / name).write_text("x")
        with pytest.raises(UsageError) as e:
            session_files(Site(), desk, named)
        assert "upload drive 2.csv too: it lies" in str(e.value)
        (desk.folder / "drive 2.csv").write_text("x")
        found = session_files(Site(), desk, named)
        assert (found["tables"], found["model"]) == (["drive 1.csv", "drive 2.csv"], "pack.toml")
        here = tmp_path / "pack.toml"  # a path of this machine goes before an upload, but not for those from afar
        here.write_text("x")
        assert session_files(Site(), desk, {**named, "model": str(here)})["model"] == str(here)
        assert session_files(Site(local=False), desk, {**named, "model": str(here)})["model"] == "pack.toml"
    finally:
        desk.close()


@pytest.mark.slow
def test_a_mailed_session_opens_with_its_files_beside_it(window, pack, tmp_path):
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        seen_diagnosed(page)
        page.idle(FIT_S)
        verdict, effects = page.text("#panel-diagnose .verdict"), page.text("#panel-diagnose .effects")
        tag, core = page.text("#panel-diagnose .tag"), page.text("#panel-diagnose .core")
        assert effects
        assert not page.there("#recalled")
        page.click("#tab-take")
        session = page.run("return fetch(document.querySelector('#take-session').href).then(r => r.text())")
    assert str(pack.folder) in session
    mail = tmp_path / "mail"
    mail.mkdir()
    (mail / "session.json").write_text(session.replace(str(pack.folder), "/home/somebody else"))
    for path in (pack.hidden, pack.model):
        (mail / path.name).write_bytes(path.read_bytes())
    with served(tmp_path) as url:
        page = window(url)
        page.wait("return document.querySelector('#panel-open').getClientRects().length")
        page.upload("#session-file", mail / "session.json")
        page.wait("return document.querySelector('#error-text').innerText.includes('hidden.csv and pack.toml')")
        page.upload("#tables-file", mail / "hidden.csv")
        page.wait("return document.querySelector('#error-text').innerText.includes('upload pack.toml too')")
        page.upload("#model-file", mail / "pack.toml")
        page.wait("return document.querySelector('#panel-diagnose .verdict')", patience_s=FIT_S)
        page.idle(FIT_S)
        assert page.text("#error-text") == ""
        page.click("#tab-diagnose")
        assert page.text("#panel-diagnose .verdict") == verdict
        assert page.text("#panel-diagnose .effects") == effects
        # a file can be changed by anybody: what is only read from it says so
        assert "taken from the session file and was not computed here" in page.text("#recalled")
        assert page.text("#panel-diagnose .tag") == f"{tag}, by the session file"
        assert page.text("#panel-diagnose .core") == core
        page.picture(tmp_path / "recalled.png")
        assert REMAINS in page.text("#doubt")
        assert page.text("#confirm") == "Compute it again"
        assert all("/api/resume" in m for m in page.complaints())  # the two that lacked files
    with served(tmp_path) as url:  # all at once; and another record under the same name
        (mail / "hidden.csv").write_bytes(Path(pack.clean).read_bytes())
        page = window(url)
        page.wait("return document.querySelector('#panel-open').getClientRects().length")
        page.upload("#session-file", "\n".join(str(mail / n) for n in ("session.json", "hidden.csv", "pack.toml")))
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-diagnose")
        assert "these are not the measurements that it was made of" in page.text("#panel-diagnose")
        assert page.text("#panel-diagnose .verdict") == ""
        assert REMAINS not in page.text("#doubt")
