"""Tables of parsed DBC files: they say what cantools says, and are believed only where nothing speaks against it."""

import hashlib
import importlib.metadata
import os
import runpy
import subprocess
import sys

import numpy as np
import pytest

from bms_gateway.config import dbc_files, own_dbc_text
from bms_gateway.config.dbc_files import read_dbc
from bms_gateway.errors import ConfigError
from bms_gateway.frames.dbc import parse
from bms_gateway.frames.own_dbc import OWN_DBC
from tests.frames.payloads import OWN, ROOT, text_of
from tests.frames.same_messages import same

TEXT = (
    'VERSION ""\nBS_:\nBU_: A\nBO_ 291 M: 8 A\n SG_ m M : 0|4@1+ (1,0) [0|0] "" A\n'
    ' SG_ s m1 : 8|16@0- (0.1,-40.3) [-40|80] "°C" A\n SG_ t m2 : 8|32@1- (1,0) [0|0] "V" A\n'
    'CM_ SG_ 291 s "with a \\"quoted\\" word\nin two lines";\nVAL_ 291 s -1 "SNA" 3 "warm" ;\nSIG_VALTYPE_ 291 t : 1;\n'
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("CACHE_DIRECTORY", f"{tmp_path / 'tables'}:/nowhere")
    return tmp_path / "tables"


@pytest.fixture
def parsed(monkeypatch):
    """Names of the files that were parsed."""
    names = []

    def told(name, text):
        names.append(name)
        return parse(name, text)

    monkeypatch.setattr(dbc_files, "parse", told)
    return names


def test_the_table_that_is_shipped_is_of_the_dbc_that_is_shipped() -> None:
    made = runpy.run_path(str(ROOT / "dbc" / "tabulate.py"))["tabulated"]()
    assert (ROOT / "dbc" / "bms_gateway.table").read_text(encoding="ascii") == made, "run: python dbc/tabulate.py"


def test_our_own_dbc_is_never_parsed_as_long_as_its_table_is_of_it(parsed, folder) -> None:
    found = read_dbc(OWN_DBC, own_dbc_text())
    assert parsed == []
    assert same(found, parse(OWN_DBC, text_of(OWN)))
    other = own_dbc_text().replace("[0|255]", "[0|254]", 1)
    assert other != own_dbc_text()
    assert same(read_dbc(OWN_DBC, other), parse(OWN_DBC, other))
    assert parsed == [OWN_DBC]


@pytest.mark.parametrize("content", [None, b"", b"rubbish\n[]\n"])
def test_without_a_sound_table_our_own_dbc_is_parsed(parsed, folder, tmp_path, monkeypatch, content) -> None:
    monkeypatch.setattr(dbc_files, "OWN_TABLE", str(tmp_path / "own.table"))
    if content is not None:
        (tmp_path / "own.table").write_bytes(content)
    assert same(read_dbc(OWN_DBC, TEXT), parse(OWN_DBC, TEXT))
    assert parsed == [OWN_DBC]


def test_a_dbc_is_parsed_once_and_known_by_its_text_alone(parsed, folder) -> None:
    first = read_dbc("a.dbc", TEXT)
    assert same(read_dbc("a.dbc", TEXT), first)
    assert same(read_dbc("b.dbc", TEXT), parse("b.dbc", TEXT))
    assert parsed == ["a.dbc"]
    moved = TEXT.replace("-40.3", "-40.4")
    assert same(read_dbc("a.dbc", moved), parse("a.dbc", moved))
    assert parsed == ["a.dbc", "a.dbc"]
    (file, _) = folder.iterdir()
    assert file.stat().st_mode & 0o777 == 0o600


def test_another_version_parses_anew(parsed, folder, monkeypatch) -> None:
    read_dbc("a.dbc", TEXT)
    monkeypatch.setattr(dbc_files, "__version__", "99.0")
    read_dbc("a.dbc", TEXT)
    monkeypatch.setattr(importlib.metadata, "version", lambda _: "99.0")
    read_dbc("a.dbc", TEXT)
    monkeypatch.setattr(dbc_files, "FORMAT", 99)
    read_dbc("a.dbc", TEXT)
    assert len(parsed) == 4


def test_a_table_of_another_text_under_this_ones_name_is_not_believed(parsed, folder) -> None:
    read_dbc("a.dbc", TEXT)
    (file,) = folder.iterdir()
    read_dbc("a.dbc", other := TEXT.replace("-40.3", "-40.4"))
    (wrong,) = set(folder.iterdir()) - {file}
    file.replace(wrong)
    assert same(read_dbc("a.dbc", other), parse("a.dbc", other))


def test_no_damage_is_believed_and_every_one_is_mended(parsed, folder) -> None:
    truth = read_dbc("a.dbc", TEXT)
    (file,) = folder.iterdir()
    sound = file.read_bytes()
    spots = np.random.default_rng(2).integers(0, len(sound), 60).tolist()
    damaged = [sound[:k] for k in spots] + [sound[:k] + bytes([sound[k] ^ 1]) + sound[k + 1 :] for k in spots]
    head, body = sound.split(b"\n", 1)
    damaged += [b"", b"\xff\xfe\x00", body, head, sound + b"[]\n", sound + sound, sound.replace(b"0.1", b"0.2")]
    for content in damaged:
        file.write_bytes(content)
        assert same(read_dbc("a.dbc", TEXT), truth)
        assert file.read_bytes() == sound
    assert len(parsed) == 1 + len(damaged)


@pytest.mark.parametrize("body", ["", "{}\n1\n", '[]\n["M"]\n', "null\nnull\n", '[[1]]\n["M",1,8,[],null,null,"",1]\n'])
def test_a_table_with_a_right_check_sum_and_nothing_right_in_it_is_parsed_over(parsed, folder, body) -> None:
    truth = read_dbc("a.dbc", TEXT)
    (file,) = folder.iterdir()
    head = file.read_text(encoding="utf-8").split("\n")[0].rsplit(" ", 1)[0]
    file.write_text(f"{head} {hashlib.sha256(body.encode()).hexdigest()}\n{body}", encoding="utf-8")
    assert same(read_dbc("a.dbc", TEXT), truth)
    assert len(parsed) == 2


def test_what_others_may_have_written_is_not_believed(parsed, folder, monkeypatch) -> None:
    read_dbc("a.dbc", TEXT)
    (file,) = folder.iterdir()
    file.chmod(0o660)
    read_dbc("a.dbc", TEXT)
    file.replace(folder / "elsewhere")
    file.symlink_to(folder / "elsewhere")
    read_dbc("a.dbc", TEXT)
    assert len(parsed) == 3
    read_dbc("a.dbc", TEXT)
    assert len(parsed) == 3
    monkeypatch.setattr(os, "geteuid", lambda: file.stat().st_uid + 1)
    read_dbc("a.dbc", TEXT)
    assert len(parsed) == 4


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir, lambda p: p.symlink_to("/dev/zero")])
def test_what_is_no_file_stops_nobody(parsed, folder, make) -> None:
    truth = read_dbc("a.dbc", TEXT)
    (file,) = folder.iterdir()
    file.unlink()
    make(file)
    assert same(read_dbc("a.dbc", TEXT), truth)


@pytest.mark.parametrize("place", ["file/tables", "relative", ""])
def test_where_nothing_can_be_kept_all_is_as_before(parsed, tmp_path, monkeypatch, place) -> None:
    (tmp_path / "file").write_text("a file where a directory should be")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CACHE_DIRECTORY")
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / place) if "/" in place else place)
    for _ in range(2):
        assert same(read_dbc("a.dbc", TEXT), parse("a.dbc", TEXT))
    assert len(parsed) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_user_without_systemd_has_them_in_the_own_cache(parsed, tmp_path, monkeypatch) -> None:
    monkeypatch.delenv("CACHE_DIRECTORY")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    read_dbc("a.dbc", TEXT)
    read_dbc("a.dbc", TEXT)
    assert len(parsed) == 1
    (file,) = (tmp_path / ".cache" / "bms-gateway").iterdir()
    assert file.suffix == ".table"


def test_the_oldest_tables_go(folder) -> None:
    for k in range(dbc_files.KEPT + 3):
        read_dbc("a.dbc", TEXT.replace("-40.3", f"-{k}.25"))
        for file in folder.iterdir():
            os.utime(file, ns=(0, file.stat().st_mtime_ns - 10**9))
    assert len(list(folder.iterdir())) == dbc_files.KEPT
    last = dbc_files.KEPT + 2
    assert any(f"-{last}.25," in f.read_text(encoding="utf-8") for f in folder.iterdir())


def test_a_refused_dbc_is_refused_each_time_with_the_same_words(folder) -> None:
    bad = TEXT.replace("8|16@0-", "8|99@0-")
    with pytest.raises(ConfigError) as first:
        read_dbc("a.dbc", bad)
    with pytest.raises(ConfigError) as second:
        read_dbc("a.dbc", bad)
    assert str(first.value) == str(second.value)
    assert not folder.exists()


def test_a_second_start_with_a_dbc_of_the_user_loads_no_parser(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path))
    path = tmp_path / "user.dbc"
    path.write_text(TEXT, encoding="utf-8")
    code = (
        "import sys; from pathlib import Path; from bms_gateway.config.dbc_files import dbc_text, read_dbc; "
        f"print(read_dbc('u', dbc_text(Path({str(path)!r})))); print('cantools' in sys.modules, 'can' in sys.modules)"
    )
    cold, warm = (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.splitlines()
        for _ in range(2)
    )
    assert cold[0] == warm[0]
    assert (cold[1], warm[1]) == ("True True", "False False")
