"""The way from files to a better model, step by step, as the page asks for it; no browser, the real worker."""

import csv
import shlex
import time
import tomllib

import numpy as np
import pytest

from bms_gateway.cli.main import main
from bms_gateway.config.model_file import parse_model, read_model
from bms_gateway.errors import UsageError
from bms_gateway.workbench.commands import Leg, command_lines, config_lines
from bms_gateway.workbench.desk import GONE, Desk
from bms_gateway.workbench.form import with_model
from tests.store.ring import drove
from tests.support.desk_steps import done, files
from tests.support.page_steps import ADDED
from tests.truth.packs import pack as make_pack


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"))


@pytest.fixture(scope="module")
def desk():
    desk = Desk("test")
    yield desk
    desk.close()


@pytest.fixture(scope="module")
def opened(desk, pack):
    desk.open(files(pack))
    return done(desk)


@pytest.fixture(scope="module")
def progress():
    """Shares and words told while the diagnosis ran."""
    return []


@pytest.fixture(scope="module")
def diagnosed(desk, opened, progress):
    desk.diagnose()
    while (job := desk.state()["job"]) is not None:
        progress.append((job["share"], job["text"]))
        time.sleep(0.01)
    return done(desk)


@pytest.fixture(scope="module")
def trials():
    """Errors told while the addition was being fitted."""
    return []


@pytest.fixture(scope="module")
def added(desk, diagnosed, trials):
    desk.add(["entropic_heat"])
    with desk.changed:
        while (job := desk.state()["job"]) is not None and job["kind"] == "add":
            if job.get("trial") not in [None, *trials[-1:]]:
                trials.append(job["trial"])
            desk.changed.wait(1.0)
    return done(desk)


def test_opening_compares_too(opened):
    assert opened["error"] == ""
    assert opened["opened"]["sensors"] == [1, 3]
    assert [s["name"] for s in opened["steps"]] == ["from its file", "refitted"]
    cells = opened["steps"][1]["variant"]["cells"]
    assert [c["error_K"] is None for c in cells] == [False, True, False]
    assert {"surface-0-1", "surface-0-3", "drive-0", "core-0-2"} <= set(opened["figures"])


def test_a_figure_has_every_step_with_its_band(desk, opened):
    figure = desk.figure("surface-0-1")
    assert [x["name"] for x in figure["steps"]] == ["from its file", "refitted"]
    for x in figure["steps"]:
        low, high = x["low"]["y"], x["high"]["y"]
        assert all(a < b for a, b in zip(low, high, strict=True) if a is not None)
        assert len(x["model"]["x"]) == len(x["model"]["y"]) > 1000
        left = [e for e in x["each"]["y"] if e is not None]
        low, high = figure["layout"]["yaxis2"]["range"]
        assert np.mean([low <= e <= high for e in left]) > 0.99
    assert desk.figure("surface-0-2") is None


def test_a_window_of_a_figure_holds_every_sample(desk, opened, pack):
    """Those of the table, as they were written; and one more on each side, so that the line reaches the edges."""
    with pack.hidden.open(newline="") as f:
        rows = [r for r in csv.DictReader(f) if 300.0 <= float(r["time_s"]) <= 330.0]
    figure = desk.figure("surface-0-1", (5.0, 5.5))
    measured = figure["data"][0]
    assert measured["name"] == "measured"
    inside = [y for x, y in zip(measured["x"], measured["y"], strict=True) if 5.0 <= x <= 5.5]
    np.testing.assert_allclose(inside, [float(r["surface_1_C"]) for r in rows if r["surface_1_C"]], atol=1e-3)
    assert len(measured["x"]) == len(inside) + 2
    assert [len(s["model"]["x"]) for s in figure["steps"]] == [len(inside) + 2] * 2
    assert figure["layout"]["yaxis"]["range"] == desk.figure("surface-0-1")["layout"]["yaxis"]["range"]


def test_the_hidden_effect_is_named_and_drawn(desk, diagnosed):
    d = diagnosed["diagnosed"]
    assert d["verdict"] == "missing_effect"
    assert d["selected"] == ["entropic_heat"]
    first = d["ranking"][0]
    assert first["role"] == "named"
    assert first["reach"] > first["needs"]
    assert first["effects"][0]["equation"]
    curve = desk.curves("entropic_heat")["surface-0-1"]
    assert len(curve["x"]) == len(curve["y"]) > 50
    left = [abs(x) for x in curve["residual"] if x is not None]
    assert max(left) < 0.1  # of a sensor's noise of 0.05 K, averaged over minutes


def test_the_error_falls_on_held_out_blocks(added):
    filed, before, after = (s["stair"] for s in added["steps"])
    assert filed["held_K"] > 3.0 * filed["floor_K"]
    assert after["held_K"] < 1.2 * after["floor_K"] < 0.5 * before["held_K"]
    assert after["core_K"] < before["core_K"]
    assert added["compared"] is not None


def test_each_step_has_its_own_tables(added):
    filed, before, after = (s["tables"] for s in added["steps"])
    assert filed == before
    assert (before["of"], after["of"]) == ("refitted", ADDED)
    assert "(entropic_heat.dUdT)" in after["parameters"]
    assert "(entropic_heat.dUdT)" not in before["parameters"]
    assert "parameters" not in added["compared"]


def test_every_step_stays_in_the_picture_on_one_axis(desk, added):
    assert [s["name"] for s in added["steps"]] == ["from its file", "refitted", ADDED]
    figure = desk.figure("surface-0-3")
    assert [x["name"] for x in figure["steps"]] == [s["name"] for s in added["steps"]]
    sizes = [np.sqrt(np.mean([e**2 for e in x["each"]["y"] if e is not None])) for x in figure["steps"]]
    assert sizes[2] < 0.2 * min(sizes[:2])
    low, high = figure["layout"]["yaxis2"]["range"]
    for x in figure["steps"]:  # the one which is furthest off too; peaks of noise may be cut
        errors = np.array([e for e in x["each"]["y"] if e is not None])
        assert np.mean((low <= errors) & (errors <= high)) > 0.98
    assert high - low > 2.5 * sizes[0] > 12.0 * sizes[2]
    assert [x["name"] for x in desk.figure("core-0-2")["steps"]] == [s["name"] for s in added["steps"]]


def test_the_errors_fall_while_it_is_fitted(added, trials):
    """From the model without, as the stairs have it, to what is kept; each step seen lower than the one before."""
    _, before, after = (s["stair"] for s in added["steps"])
    held = [t["after"]["held_K"] for t in trials]
    assert len(trials) > 2
    assert all(t["before"] == before for t in trials)
    assert trials[0]["after"] == before
    assert held == sorted(held, reverse=True)
    assert held[-1] == pytest.approx(after["held_K"], rel=0.02)


def test_the_ranking_stays_in_sight_after_an_addition(added):
    assert added["diagnosed"]["selected"] == ["entropic_heat"]
    assert added["diagnosed_of"] == "refitted"


def test_what_the_gates_refuse_says_why_and_can_be_forced_and_undone(desk, added):
    desk.add(["current_offset"])
    refused = done(desk)
    assert len(refused["steps"]) == 3
    assert refused["refusal"]["refused"]
    desk.add(["current_offset"], force=True)
    forced = done(desk)
    assert [s["forced"] for s in forced["steps"]] == [False, False, False, True]
    assert "--force" in forced["commands"][-1]
    assert "by force" in desk.model()
    desk.undo()
    back = done(desk)
    assert [s["name"] for s in back["steps"]] == ["from its file", "refitted", ADDED]
    assert back["compared"] == added["compared"]


@pytest.mark.slow
def test_the_commands_do_the_same(desk, added, pack, monkeypatch, tmp_path, capsys):
    """The last line of the page, typed, gives the page's model and a report."""
    monkeypatch.chdir(tmp_path)
    *_, line = added["commands"]
    words = shlex.split(line)
    assert words[:3] == ["bms-gateway", "add", "entropic_heat"]
    assert main(words[1:]) == 0
    capsys.readouterr()
    assert (tmp_path / "report.html").stat().st_size > 1e6
    out = read_model(tmp_path / words[words.index("--out") + 1])
    assert repr(out) == repr(parse_model(desk.model()))


def test_the_report_is_that_of_the_command(desk, added):
    path = desk.report()
    text = path.read_text()
    path.unlink()
    assert "bms-gateway add entropic_heat" in text
    assert "Model with an effect added" in text


def test_files_that_cannot_be_read_leave_all_as_it_was(desk, added, tmp_path):
    bad = tmp_path / "bad.csv"
    bad.write_bytes(b"\x00\xff rubbish")
    before = desk.state()
    desk.open({**before["files"], "tables": [str(bad)]})
    after = done(desk)
    assert "bad.csv" in after["error"]
    assert "\n" not in after["error"]
    assert after["steps"] == before["steps"]


def test_one_thing_at_a_time_and_cancel_ends_it_at_once(desk, added):
    desk.diagnose()
    with pytest.raises(UsageError, match="still looking for the missing effect"):
        desk.undo()
    desk.cancel()
    state = desk.state()
    assert state["job"] is None
    assert state["error"] == ""
    desk.compare()  # by a fresh process, which reads the files anew
    assert done(desk)["error"] == ""


def test_a_process_that_dies_is_told_and_replaced(pack):
    desk = Desk("dying")
    try:
        desk.open(files(pack))
        desk._worker._process.kill()
        state = done(desk)
        assert state["error"] == GONE
        desk.open(files(pack))
        assert done(desk)["error"] == ""
        assert done(desk)["compared"]
    finally:
        desk.close()
    assert not desk.folder.exists()


def test_progress_moves(diagnosed, progress):
    shares = [share for share, _ in progress]
    assert shares == sorted(shares)
    assert len(set(shares)) > 2
    assert any("refitting with" in text for _, text in progress)


@pytest.mark.slow
def test_a_log_with_its_config_and_a_table_are_two_records(desk, added, pack, tmp_path, capsys):
    config, log = tmp_path / "gateway.toml", tmp_path / "drive.log"
    config.write_text(f'[bus]\nchannel = "vcan0"\n[[string]]\nname = "one"\nmodel = "{pack.model}"\n')
    assert main(["encode", str(pack.hidden), "--config", str(config), "--out", str(log)]) == 0
    capsys.readouterr()
    desk.open({**files(pack), "tables": [str(log), str(pack.clean)], "config": str(config)})
    state = done(desk)
    assert state["error"] == ""
    assert [r["cells"] for r in state["opened"]["records"]] == [[1, 3], [1, 3]]
    assert {"surface-0-1", "surface-1-1", "core-1-2"} <= set(state["figures"])
    assert all("--config" in line for line in state["commands"])


@pytest.fixture(scope="module")
def gateway(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gateway")
    drove(folder, 130)
    return folder


def of_gateway(gateway, **recent):
    common = {"tables": [], "config": str(gateway / "gateway.toml"), "string": "string_1", "columns": []}
    return {**common, "model": str(gateway / "string.toml"), "recent": {"last": "100s", "store": "", **recent}}


@pytest.fixture(scope="module")
def recent(desk, gateway):
    desk.open(of_gateway(gateway))
    return done(desk)


def test_the_gateways_recent_window_is_the_table_that_export_writes(
    desk, recent, gateway, monkeypatch, tmp_path, capsys
):
    assert recent["files"]["tables"] == ["recent.csv"]
    assert recent["opened"]["records"][0]["minutes"] == pytest.approx(100 / 60, abs=0.05)
    monkeypatch.chdir(tmp_path)
    words = shlex.split(recent["commands"][0])
    assert words[:2] == ["bms-gateway", "export"]
    assert main(words[1:]) == 0
    capsys.readouterr()
    assert (tmp_path / "recent.csv").read_bytes() == (desk.folder / "recent.csv").read_bytes()
    assert "recent.csv" in recent["commands"][1]


def test_a_window_once_taken_stays_while_the_gateway_goes_on(desk, recent, gateway):
    """Opened again with another file it is the same table; asked for anew it is a new one."""
    taken = desk.folder / "recent.csv"
    before = taken.read_bytes()
    desk.open({**of_gateway(gateway), "tables": [str(taken)], "recent": None})
    assert done(desk)["commands"] == recent["commands"]
    desk.open(of_gateway(gateway, last="60s"))
    assert done(desk)["files"]["tables"] == ["recent_2.csv"]
    assert taken.read_bytes() == before


def test_a_state_directory_alone_says_where_to_look(desk, recent, gateway):
    desk.open({**of_gateway(gateway, store=str(gateway / "lib")), "config": ""})
    lines = done(desk)["commands"]
    assert lines[0].endswith("--string string_1")
    assert "--string" not in lines[1]
    assert (desk.folder / desk.state()["files"]["tables"][0]).read_bytes() == (desk.folder / "recent.csv").read_bytes()


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"last": "2 hours"}, "did you mean 2h"),
        ({"store": "/nowhere"}, "no such directory"),
        ({"string": "string_9"}, "did you mean"),
        ({"string": ""}, "--string is needed"),
    ],
)
def test_a_window_that_cannot_be_taken_is_one_line(desk, recent, gateway, asked, says):
    before = desk.state()["files"]
    window = {k: v for k, v in asked.items() if k != "string"}
    desk.open({**of_gateway(gateway, **window), **{k: v for k, v in asked.items() if k == "string"}})
    after = done(desk)
    assert says in after["error"]
    assert "\n" not in after["error"]
    assert after["files"] == before


def test_command_lines_quote_what_a_shell_would_cut():
    given = {
        "tables": ["a b.csv", "c.csv"],
        "model": "m.toml",
        "columns": ["current_A=-I A"],
        "config": "",
        "string": "",
    }
    way = [Leg(diagnosed=True), Leg(["entropic_heat", "cell_cooling:3"])]
    lines = [shlex.split(line) for line in command_lines(given, way)]
    assert [line[1] for line in lines] == ["compare", "diagnose", "add"]
    assert lines[2][2:4] == ["entropic_heat", "cell_cooling:3"]
    assert lines[2].count("--data") == 2
    assert "a b.csv" in lines[2]
    assert "current_A=-I A" in lines[0]
    assert lines[2][lines[2].index("--out") + 1] == "m_with_1.toml"
    assert 'model = "m_with_1.toml"' in config_lines(given, 1)
    odd = {**given, "model": """m"o'del\\<b>.toml""", "string": 'a "b"'}
    (string,) = tomllib.loads(config_lines(odd, 0))["string"]
    assert string == {"name": 'a "b"', "model": """m"o'del\\<b>.toml"""}


def test_an_effect_that_is_named_twice_is_refused(pack):
    """It was added twice in spite of its refusal, and no command could read the model."""
    desk = Desk("twice")
    try:
        desk.open(files(pack))
        assert done(desk)["opened"]
        for force in (False, True):
            desk.add(["entropic_heat", "entropic_heat"], force=force)
            told = done(desk)
            assert told["error"] == "add: entropic_heat is there twice"
    finally:
        desk.close()


def test_the_cores_of_a_model_that_was_not_fitted_are_not_claimed(pack):
    """By the page they were known as well as those of the refitted model, 5 K away."""
    desk = Desk("filed")
    try:
        desk.open(files(pack))
        state = done(desk)
        filed, refitted = state["steps"]
        assert filed["core"]["proven"] is False
        assert filed["core"]["sentence"].startswith("Core not judged: ")
        assert refitted["core"]["sentence"] != filed["core"]["sentence"]
        figure = desk.figure("core-0-1")
        assert next(s["proven"] for s in figure["steps"]) is False
    finally:
        desk.close()


def test_a_coolant_that_is_none_is_refused(pack, tmp_path):
    form = {"cell": "a123_32157", "flow": "570", "medium": "lava"}
    wanted = {"tables": [str(pack.hidden)], "model": "", "columns": [], "form": form}
    with pytest.raises(UsageError, match="the coolant 'lava' is not known; valid: air, liquid"):
        with_model(wanted, tmp_path)
