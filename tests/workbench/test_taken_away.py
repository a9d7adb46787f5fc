"""What is taken away from the page: the commands run word for word with the files that were saved."""

import json
import re
import shlex
import tomllib
from urllib.parse import quote, unquote

import pytest

from bms_gateway.bus.logfile import write_log
from bms_gateway.cli.main import main
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Engine
from bms_gateway.workbench.commands import Leg, command_lines, config_lines, told_of_model
from bms_gateway.workbench.live_estimates import Watch
from bms_gateway.workbench.site import Site
from bms_gateway.workbench.sources import Playback
from bms_gateway.workbench.steps import Frame, way_of
from tests.support.desk_steps import done
from tests.support.doors import ask, serving
from tests.support.vehicle_traffic import traffic
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import come

JSON = {"Content-Type": "application/json"}
BYTES = {"Content-Type": "application/octet-stream"}
EXAMPLE = "deploy/example/gateway.toml"


def saved(server, desk, folder, what, name=""):
    """Save what the page offers, under the name that a browser gives it."""
    status, body, headers = ask(server, "GET", f"/api/take?desk={desk.name}&what={what}&name={quote(name)}")
    assert status == 200, body
    told = headers["Content-Disposition"]
    wide, plain = re.search(r"filename\*=UTF-8''(\S+)", told), re.search(r'filename="([^"]+)"', told)  # RFC 6266, 4.3
    called = unquote(wide[1]) if wide else plain[1]
    (folder / called).write_bytes(body)
    return called


def opened(server, desk, pack, table):
    """Upload a pack's table, describe the cell in the form, and open them."""
    where = f"?desk={desk.name}"
    ask(server, "POST", f"/api/upload{where}&name={quote(table)}", pack.hidden.read_bytes(), **BYTES)
    body = {"tables": [table], "model": "", "form": {"cell": "a123_32157", "cells": "3", "flow": "0"}}
    assert ask(server, "POST", f"/api/open{where}", json.dumps(body), **JSON)[0] == 200
    return done(desk)


def typed(commands, folder, monkeypatch):
    """Type the commands where the files lie."""
    monkeypatch.chdir(folder)
    for line in commands:
        program, *words = shlex.split(line)
        assert program == "bms-gateway"
        assert main(words) == 0, line


@pytest.mark.slow
def test_commands_on_uploads_run_with_the_files_that_are_saved(tmp_path, monkeypatch):
    """The model of the form was named `model.toml`, which nobody had, and letters beyond ASCII were lost."""
    pack = make_pack(tmp_path, seconds=900)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    with serving() as server:
        desk = server.site.new_desk()
        table = "-Prüfstand, Tag 1.csv"
        assert opened(server, desk, pack, table)["error"] == ""
        desk.add(["entropic_heat"], force=True)
        state = done(desk)
        assert [s["words"] for s in state["steps"]] == [[], [], ["entropic_heat"]]
        assert sorted(state["read"]) == [table, "model.toml"]
        for name in state["read"]:
            assert saved(server, desk, elsewhere, "file", name) == name
        newest = saved(server, desk, elsewhere, "model", "taken.toml")
        typed(state["commands"], elsewhere, monkeypatch)
        (string,) = tomllib.loads(state["config"])["string"]
        assert string == {"name": "string_1", "model": "model_with_1.toml"}
        made, taken = (tomllib.loads((elsewhere / x).read_text()) for x in (string["model"], newest))
        assert made == taken


@pytest.mark.slow
def test_the_numbers_of_a_refit_are_written_by_a_command_and_the_page_says_so(tmp_path, monkeypatch):
    """The page showed a refit; the file was the untouched one, and neither word nor command told of its numbers."""
    pack = make_pack(tmp_path, seconds=900)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    with serving() as server:
        desk = server.site.new_desk()
        where = f"?desk={desk.name}"
        state = opened(server, desk, pack, "day.csv")
        told, refitted = state["model_told"], state["steps"][-1]
        assert told.startswith("This file holds the numbers from before, not the refitted ones.")
        assert "model_fitted.toml" in told
        assert state["commands"][-1].endswith("--html report.html")
        for name in state["read"]:
            saved(server, desk, elsewhere, "file", name)
        assert saved(server, desk, elsewhere, "model", "model.toml") == "model.toml"
        typed(state["commands"], elsewhere, monkeypatch)
        written = tomllib.loads((elsewhere / "model_fitted.toml").read_text())
        core = refitted["core"]
        assert written["posterior"]["core_proven"] is core["proven"]
        (elsewhere / "model.toml").write_bytes((elsewhere / "model_fitted.toml").read_bytes())
        ask(server, "POST", f"/api/upload{where}&name=fitted.toml", (elsewhere / "model.toml").read_bytes(), **BYTES)
        body = {"tables": ["day.csv"], "model": "fitted.toml"}
        assert ask(server, "POST", f"/api/open{where}", json.dumps(body), **JSON)[0] == 200
        again = done(desk)["steps"][-1]
        assert again["core"]["sd_K"] == core["sd_K"]
        assert again["stair"] == refitted["stair"]


@pytest.mark.parametrize(("refitted", "writes"), [("", False), ("refused", False), ("fits", True)])
def test_what_is_said_of_the_model_file_is_what_the_commands_can_do(refitted, writes):
    files = {"tables": ["a.csv"], "model": "packs/s 1.toml", "config": "", "string": "", "columns": ["time_s=t"]}
    way = [Leg(refitted=refitted)]
    fits = [shlex.split(x) for x in command_lines(files, way) if x.startswith("bms-gateway fit ")]
    data = ["a.csv", "--model", "packs/s 1.toml", "--columns", "time_s=t", "--out", "s 1_fitted.toml"]
    assert fits == ([["bms-gateway", "fit", *data]] if writes else [])
    assert ("s 1_fitted.toml" in told_of_model(files, way)) is writes
    assert bool(told_of_model(files, way)) is bool(refitted)
    assert told_of_model(files, [Leg(), Leg(["entropic_heat"])]) == ""


@pytest.mark.parametrize(("severity", "said"), [("warn", "fits"), ("stop", "refused")])
def test_a_fit_is_offered_after_a_comparison_where_the_checks_allow_it(severity, said):
    first, checks = Frame("", "refitted"), [{"severity": severity}]
    assert [leg.refitted for leg in way_of([first], checks)] == [""]
    first.compared = {}
    assert [leg.refitted for leg in way_of([first], checks)] == [said]
    assert [leg.refitted for leg in way_of([first, Frame("", "+ a")], checks)] == ["", ""]


@pytest.mark.slow
def test_commands_on_a_window_of_the_live_page_run_with_what_it_exports(tmp_path, monkeypatch):
    """They named a table that the page exports under another name, and a string that is another one."""
    log, elsewhere = tmp_path / "drive.log", tmp_path / "elsewhere"
    elsewhere.mkdir()
    write_log(log, [traffic(420.0)])
    config = load_config(shipped(EXAMPLE))
    engine, source = Engine(config.plan, config.database), Playback([log])
    watch = Watch(engine, "log", log.name, 500e3, source.traffic)
    source.start(engine, watch)
    come(lambda: watch.whole, "the end of the log")
    with serving(Site(watch=watch)) as server:
        watch.steer("test", {"seek": 419, "play": False})
        desk = server.site.new_desk()
        stretch = f"/api/signals?desk={desk.name}&string=1&view=test&from=11&to=401"
        exported = ask(server, "GET", stretch)
        body = {"string": 1, "span": 0, "ends": [11.0, 401.0], "view": "test"}
        assert ask(server, "POST", f"/api/window?desk={desk.name}", json.dumps(body), **JSON)[0] == 200
        state = done(desk)
        assert state["error"] == ""
        assert state["read"] == ["window_of_string_2.csv", "string_2.toml"]
        for name in state["read"]:
            saved(server, desk, elsewhere, "file", name)
        assert 'filename="window_of_string_2.csv"' in exported[2]["Content-Disposition"]
        assert (elsewhere / "window_of_string_2.csv").read_bytes() == exported[1]
        typed(state["commands"], elsewhere, monkeypatch)
        (string,) = tomllib.loads(state["config"])["string"]
        assert string == {"name": "string_2", "model": "string_2.toml"}


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ({"model": "pack.toml"}, "pack"),
        ({"model": "pack.toml", "string": "left"}, "left"),
        ({"model": "a b.toml"}, "string_1"),
        ({"model": "model.toml", "form": {"cell": "lg_m50"}}, "string_1"),
    ],
)
def test_the_string_of_the_config_is_called_as_it_was(given, name):
    (string,) = tomllib.loads(config_lines({"tables": [], "string": "", **given}, 1))["string"]
    assert string["name"] == name


def test_no_name_of_a_file_is_taken_for_an_option():
    files = {"tables": ["-a.csv"], "model": "-m.toml", "config": "", "string": "", "columns": []}
    lines = [shlex.split(x) for x in command_lines(files, [Leg(), Leg(["entropic_heat"])])]
    assert not any(word in ("-a.csv", "-m.toml", "-m_with_1.toml") for line in lines for word in line)
    assert lines[1][lines[1].index("--out") + 1] == "./-m_with_1.toml"
