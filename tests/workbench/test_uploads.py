"""What a tab is given: how much of it, where it lies, what it may lead to, and that it goes."""

import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from urllib.parse import quote

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.cli.main import main
from bms_gateway.config import load_config
from bms_gateway.errors import ConfigError, UsageError
from bms_gateway.workbench import form, uploads
from bms_gateway.workbench import server as served
from bms_gateway.workbench.desk import Desk
from bms_gateway.workbench.form import with_config
from bms_gateway.workbench.site import Site, wanted_files
from bms_gateway.workbench.uploads import PREFIX, Uploads, safe_name, sweep
from tests.config.files import MAPPED, write
from tests.config.model_texts import EXAMPLE
from tests.support.desk_steps import done
from tests.support.doors import ask, serving

JSON = {"Content-Type": "application/json"}
BYTES = {"Content-Type": "application/octet-stream"}


def test_they_are_bounded_and_stay_in_their_folder(monkeypatch):
    with serving() as server:
        desk = server.site.new_desk()
        name = quote("../../evil.csv")
        status, body, _ = ask(server, "POST", f"/api/upload?desk={desk.name}&name={name}", b"a,b\n", **BYTES)
        assert (status, json.loads(body)) == (200, {"name": "evil.csv"})
        assert [p.name for p in desk.folder.iterdir()] == ["evil.csv"]
        monkeypatch.setattr(served, "LARGEST_UPLOAD", 10)
        status, body, _ = ask(server, "POST", f"/api/upload?desk={desk.name}&name=b.csv", b"x" * 11, **BYTES)
        assert status == 400
        assert b"too large" in body
        monkeypatch.setattr(uploads, "PER_DESK", 12)
        assert ask(server, "POST", f"/api/upload?desk={desk.name}&name=c.csv", b"x" * 10, **BYTES)[0] == 400
        assert [p.name for p in desk.folder.iterdir()] == ["evil.csv"]


@pytest.mark.parametrize("name", ["\U00020000" * 100, "a" * 300, "b/" * 2100], ids=["characters", "letters", "folders"])
@pytest.mark.parametrize("what", ["open", "look", "resume"])
def test_a_name_that_no_file_can_have_is_an_answer(what, name):
    with serving() as server:
        desk = server.site.new_desk()
        files = {"tables": [name], "model": name, "config": name}
        body = {"workbench_session": 1, "files": files} if what == "resume" else files
        status, answer, _ = ask(server, "POST", f"/api/{what}?desk={desk.name}", json.dumps(body).encode(), **JSON)
        assert status in (200, 400)  # what is named by its path is opened later, and told then
        assert status == 200 or json.loads(answer)["error"]


class Waiting(io.BytesIO):
    """An upload whose last part comes when it is told to."""

    def __init__(self, content):
        super().__init__(content)
        self.begun, self.go_on = threading.Event(), threading.Event()

    def read(self, size=-1):
        self.begun.set()
        assert self.go_on.wait(60)
        return super().read(size)


def test_what_is_still_on_its_way_counts(monkeypatch):
    """Eight uploads side by side put twice as much into a tab as it may hold: each saw only the finished ones."""
    monkeypatch.setattr(uploads, "PER_DESK", 100)
    here = Uploads()
    sources = [Waiting(b"x" * 40) for _ in range(2)]
    threads = [threading.Thread(target=here.receive, args=(s, 40, f"{i}")) for i, s in enumerate(sources)]
    for thread, source in zip(threads, sources, strict=True):
        thread.start()
        assert source.begun.wait(60)
    with pytest.raises(UsageError, match="this tab holds"):
        here.receive(io.BytesIO(b"x" * 40), 40, "2")
    for thread, source in zip(threads, sources, strict=True):
        source.go_on.set()
        thread.join(60)
    here.receive(io.BytesIO(b"x" * 20), 20, "3")
    assert sorted(p.name for p in here.folder.iterdir()) == ["0", "1", "3"]
    here.close()


@pytest.mark.parametrize("fault", [TimeoutError, ConnectionResetError, None])
def test_an_upload_that_breaks_off_leaves_nothing_and_gives_its_room_back(monkeypatch, fault):
    monkeypatch.setattr(uploads, "PER_DESK", 100)
    here = Uploads()

    class Broken(io.BytesIO):
        def read(self, size=-1):
            if fault and self.tell() > 50:
                raise fault
            return super().read(30)

    with pytest.raises(fault or UsageError):
        here.receive(Broken(b"x" * 60), 100, "a")
    assert list(here.folder.iterdir()) == []
    here.receive(io.BytesIO(b"x" * 100), 100, "b")
    here.close()


def test_a_tab_that_is_closed_meanwhile_is_one_line():
    here = Uploads()
    source = Waiting(b"x")
    source.go_on.set()
    here.close()
    with pytest.raises(UsageError, match="a: cannot be kept"):
        here.receive(source, 1, "a")
    assert not here.folder.exists()


@settings(deadline=None)
@given(st.text(max_size=60))
def test_a_safe_name_is_one_part_and_not_hidden(name):
    safe = safe_name(name)
    assert "/" not in safe
    assert "\\" not in safe
    assert not safe.startswith(".")


def test_a_name_stays_as_a_person_wrote_it():
    for name in ("Prüfstand, Tag 1 – Überlast.csv", "R&D #7 (50 %) 'warm'; 2nd=ok.csv", "電池.csv"):
        assert safe_name(name) == name
    assert safe_name(" . ./. .hidden") == "hidden"


HELD = """
import sys, time
from bms_gateway.workbench.uploads import Uploads
print(Uploads().folder, flush=True)
time.sleep(600)
"""


def test_what_a_killed_program_left_goes_at_the_next_start_and_nothing_else(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    running = [
        subprocess.Popen([sys.executable, "-c", HELD], stdout=subprocess.PIPE, text=True, env=environment)
        for _ in range(2)
    ]
    killed, alive = (Path(p.stdout.readline().strip()) for p in running)
    (killed / "drive.csv").write_text("secret")
    (alive / "drive.csv").write_text("in use")
    (tmp_path / f"{PREFIX}file").write_text("not ours")
    (tmp_path / f"{PREFIX}link").symlink_to(alive)
    (tmp_path / "else").mkdir()
    running[0].send_signal(signal.SIGKILL)
    running[0].wait()
    mine = Uploads()
    sweep()
    left = {p.name for p in tmp_path.iterdir()}
    for p in running:
        p.kill()
        p.communicate()
    assert left == {alive.name, mine.folder.name, f"{PREFIX}file", f"{PREFIX}link", "else"}
    assert (alive / "drive.csv").exists()
    mine.close()


def test_the_program_sweeps_when_it_starts(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr("signal.signal", lambda *_: None)
    (tmp_path / f"{PREFIX}old").mkdir()
    assert main(["workbench", "--bitrate", "0"]) == 2  # it goes no further
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def foreign(tmp_path):
    """A folder of uploads with a config whose files lie elsewhere on this machine."""
    here, elsewhere = tmp_path / "uploads", tmp_path / "elsewhere"
    here.mkdir()
    elsewhere.mkdir()
    (elsewhere / "secret.dbc").write_text("a-word-of-mine:1\n")
    return here, elsewhere


def test_an_uploaded_config_opens_uploads_only(foreign):
    """`dbc = ["/etc/shadow"]` told its first line in an error."""
    here, elsewhere = foreign
    text = '[bus]\nchannel = "vcan0"\n{dbc}\n[[string]]\nname = "one"\nmodel = "{model}"\n'
    config = here / "gateway.toml"
    for dbc, model in (
        (f'dbc = ["{elsewhere}/secret.dbc"]', "m.toml"),
        ('dbc = ["../elsewhere/secret.dbc"]', "m.toml"),
        ("", f"{elsewhere}/secret.dbc"),
    ):
        config.write_text(text.format(dbc=dbc, model=model))
        with pytest.raises(ConfigError, match="no file") as told:
            load_config(config, uploaded=True)
        assert "a-word-of-mine" not in str(told.value)
        assert str(elsewhere) not in str(told.value)


def test_an_uploaded_config_finds_what_was_uploaded_beside_it(tmp_path):
    config = write(tmp_path)
    plain = load_config(config)
    text = config.read_text()
    assert "vehicle.dbc" in text
    moved = text.replace('"vehicle.dbc"', '"../dbc/vehicle.dbc"').replace(
        '"string_1.toml"', "'C:\\models\\string_1.toml'"
    )
    config.write_text(moved + '[mqtt]\nhost = "localhost"\nusername = "x"\npassword_file = "/etc/shadow"\n')
    found = load_config(config, uploaded=True)
    assert found.plan == plain.plan
    assert found.files == plain.files
    assert found.config.mqtt is None


def test_from_afar_a_config_tells_nothing_of_the_files_here(foreign):
    """From the page to the process that reads, and its one line back."""
    elsewhere = foreign[1]
    site = Site(local=False)
    desk = Desk("afar")
    try:
        for name, text in (
            ("drive.log", "(1700000000.000000) can0 123#11\n"),
            ("string.toml", EXAMPLE),
            ("gateway.toml", MAPPED.replace("vehicle.dbc", f"{elsewhere}/secret.dbc")),
        ):
            desk.uploads.receive(io.BytesIO(text.encode()), len(text), name)
        wanted = {"tables": ["drive.log"], "model": "string.toml", "config": "gateway.toml"}
        desk.open(wanted_files(site, desk, wanted))
        told = done(desk)["error"]
        assert "gateway.toml: bus.dbc[1]: no file 'secret.dbc'" in told
        assert "a-word-of-mine" not in told
        for name in (f"{elsewhere}/secret.dbc", "/etc/hostname", "../drive.log"):
            with pytest.raises(UsageError, match="upload it"):
                wanted_files(site, desk, {**wanted, "config": name})
    finally:
        desk.close()


@pytest.mark.slow
def test_the_name_of_a_string_is_no_path(foreign, tmp_path, monkeypatch):
    """`"string": "/home/me/secret"` told what that file says; it is refused before anything is estimated."""
    (foreign[1] / "secret.toml").write_text("password = 'a-word-of-mine'\n")
    worked = Path(__file__).resolve().parents[2] / "deploy" / "worked"
    folder = tmp_path / "desk"
    folder.mkdir()
    files = {"tables": [str(worked / "drive.log.gz")], "dbc": [str(worked / "vehicle.dbc")], "model": "", "config": ""}
    names = (f"{foreign[1]}/secret", f"../{foreign[1].name}/secret", "gateway", "string_1/../string_1", "string_2")
    with monkeypatch.context() as patched:
        patched.setattr(form, "settle", None)
        for name in names:
            with pytest.raises(UsageError, match="open: the log has no string '") as told:
                with_config({**files, "string": name}, folder)
            assert "a-word-of-mine" not in str(told.value)
    found, _ = with_config({**files, "string": "string_1"}, folder)
    assert Path(found["model"]) == folder / "string_1.toml"
