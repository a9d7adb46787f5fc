"""`baseline`: asks for a new one, shows what there is, and refuses in one line."""

import json
from pathlib import Path

import pytest

from bms_gateway.cli import baseline
from bms_gateway.cli.main import main
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Engine
from bms_gateway.store import StateStore
from bms_gateway.store.requests import asked


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "string.toml").write_text(shipped("deploy/example/string.toml").read_text())
    path = tmp_path / "gateway.toml"
    text = '[bus]\ninterface = "socketcan"\nchannel = "vcan0"\n[[string]]\nname = "string_1"\nmodel = "string.toml"\n'
    path.write_text(f'{text}[store]\npath = "{tmp_path / "state"}"\n')
    (tmp_path / "state").mkdir()
    return path


def call(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    status = main(["baseline", *map(str, words)])
    out = capsys.readouterr()
    return status, out.out, out.err


@pytest.mark.parametrize("cell", ["9" * 5000, "²", "-1", "", "0", "13", "x"])
def test_a_cell_that_there_is_not_is_told_in_one_line(config: Path, capsys, cell: str) -> None:
    assert main(["baseline", "--config", str(config), "--reset", f"string_1:{cell}", "--reason", "x"]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "is no cell of string_1" in told


def test_a_reset_is_asked_for_with_its_reason(config: Path, capsys) -> None:
    words = ("--reset", "string_1:2", "--reason", " cell 2  replaced\n", "--config", config)
    status, out, _ = call(capsys, *words)
    assert status == 0
    assert "cell 2 of string_1" in out
    ((_, wish),) = asked(config.parent / "state")
    assert wish is not None
    assert (wish.string, wish.cell, wish.reason) == ("string_1", 2, "cell 2 replaced")
    assert call(capsys, "--reset", "string_1", "--reason", "x", "--config", config)[0] == 0
    assert len(list(asked(config.parent / "state"))) == 2


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "either --show or --reset"),
        (("--show", "--reset", "string_1"), "either --show or --reset"),
        (("--reset", "string_1"), "--reason TEXT"),
        (("--reset", "string_1", "--reason", " "), "--reason TEXT"),
        (("--reset", "sting_1", "--reason", "x"), "did you mean 'string_1'"),
        (("--reset", "string_1:99", "--reason", "x"), "no cell of string_1; valid: 1 to"),
        (("--reset", "string_1:", "--reason", "x"), "no cell of string_1"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(config: Path, capsys, words: tuple[str, ...], told: str) -> None:
    status, out, err = call(capsys, *words, "--config", config)
    assert (status, out) == (2, "")
    assert told in err
    assert err.count("\n") == 1


def test_without_a_place_for_state_there_is_no_baseline(config: Path, capsys) -> None:
    config.write_text(config.read_text().split("[store]")[0] + '[store]\npath = ""\n')
    status, _, err = call(capsys, "--show", "--config", config)
    assert status == 2
    assert err.count("\n") == 1


def test_without_a_path_the_state_of_the_installed_service_is_found(config: Path, capsys, monkeypatch) -> None:
    """`export` looked there, `baseline` did not: the documented command found nothing."""
    config.write_text(config.read_text().split("[store]")[0])
    monkeypatch.setattr(baseline, "STATE_DIRECTORY", config.parent / "nowhere")
    status, _, err = call(capsys, "--show", "--config", config)
    assert (status, err.count("\n")) == (2, 1)
    assert "no service is installed that keeps its state in" in err
    monkeypatch.setattr(baseline, "STATE_DIRECTORY", config.parent / "state")
    assert StateStore(config.parent / "state").save(Engine(*_parts(config)).snapshot(), wall_ns=1) is None
    assert call(capsys, "--show", "--config", config)[0] == 0
    assert call(capsys, "--reset", "string_1", "--reason", "x", "--config", config)[0] == 0
    assert len(list(asked(config.parent / "state"))) == 1


def _parts(config: Path):
    loaded = load_config(config)
    return loaded.plan, loaded.database


def test_a_state_that_cannot_be_read_is_told_and_all_stays_as_it_is(config: Path, capsys) -> None:
    """What is shown was "no baseline yet", and a state that the service had just half written was renamed."""
    folder = config.parent / "state"
    (folder / "state").write_bytes(b"bms-gateway-state 1 0")
    status, out, err = call(capsys, "--show", "--config", config)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "its first line is damaged" in err
    assert [f.name for f in folder.iterdir()] == ["state"]
    assert StateStore(folder).save(Engine(*_parts(config)).snapshot(), wall_ns=1) is None
    (folder / "state").rename(folder / "state.previous")
    (folder / "state").write_bytes(b"")
    status, out, err = call(capsys, "--show", "--config", config)
    assert status == 0
    assert "no baseline yet" in out
    assert "it is empty" in err
    assert {"state", "state.previous"} <= {f.name for f in folder.iterdir()}


def test_what_is_stored_is_shown(config: Path, capsys) -> None:
    assert "no baseline yet" in call(capsys, "--show", "--config", config)[1]
    loaded = load_config(config)
    engine = Engine(loaded.plan, loaded.database)
    h = engine.strings[0].health
    names, n = tuple(loaded.plan.strings[0].model.priors), loaded.plan.strings[0].model.cells
    mean = [float(p.value) for p in loaded.plan.strings[0].model.priors.values()]
    import numpy as np

    for _ in range(3):
        h.offer(names, np.log(mean), 1e-4 * np.eye(len(names)), mean[names.index("R_e")], True)
    h.ageing.update(0.123, 0.01)
    h.fitted(np.zeros(n), np.full(n, 0.01), np.zeros(n))
    h.history.add((1_700_000_000_000_000_000, 3.9e-3, 0.123, 0.01, 0.0))
    engine.reset_baseline("string_1", 1, "cell 1 replaced", time_ns=1_700_000_000_000_000_000)
    assert StateStore(config.parent / "state").save(engine.snapshot(), wall_ns=1) is None
    status, out, _ = call(capsys, "--show", "--config", config)
    assert status == 0
    assert "string_1: baseline R_e" in out
    assert "cell 2: +12.3 ±" in out
    assert "2023-11-14  baseline of cell 1 of R_e reset: cell 1 replaced" in out
    assert "2023-11-14  R_e 3.900 mOhm  +12.3 ± 1.0 %" in out
    told = json.loads(call(capsys, "--show", "--json", "-", "--config", config)[1])["string_1"]
    assert told["growth_pct"] == 12.3
    assert told["history"][0]["R_e_mohm"] == pytest.approx(3.9)
    assert told["cells_growth_pct"]["2"] == pytest.approx(12.3, abs=0.1)
    assert told["cells_growth_pct"]["1"] is None
    assert told["events"][0]["text"].endswith("cell 1 replaced")


@pytest.mark.parametrize(
    "part", ["estimators", "strings", "string_1", "health", "history", "ageing", "trend", "events"]
)
@pytest.mark.parametrize("value", [3, "x", [1], {"x": 1}])
def test_a_state_of_another_form_is_told_in_one_line_and_never_a_traceback(config: Path, capsys, part, value) -> None:
    """Its check sum is right: written by another version, or by whoever owns the directory."""
    state = json.loads(json.dumps(Engine(*_parts(config)).snapshot()))
    holders = {"estimators": state}
    holders["strings"] = state["estimators"]
    holders["string_1"] = holders["strings"]["strings"]
    holders["health"] = holders["string_1"]["string_1"]
    holders |= dict.fromkeys(("history", "ageing", "trend"), holders["health"]["health"])
    holders["events"] = holders["health"]["health"]["history"]
    holders[part][part] = value
    assert StateStore(config.parent / "state").save(state, wall_ns=1) is None
    status, out, err = call(capsys, "--show", "--config", config)
    if status == 0:  # a part without this string says nothing of it
        assert (part, err) in [(p, "") for p in ("estimators", "strings", "string_1", "health")]
        assert "no baseline yet" in out
    else:
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert "stored state does not fit this program" in err or "the stored state is" in err


@pytest.mark.parametrize("time_ns", [10**30, -(10**30), 10**400])
def test_an_event_of_a_time_that_no_calendar_has_is_shown(config: Path, capsys, time_ns: int) -> None:
    engine = Engine(*_parts(config))
    engine.strings[0].health.history.note(time_ns, "baseline of R_e reset: new module")
    assert StateStore(config.parent / "state").save(engine.snapshot(), wall_ns=1) is None
    status, out, _ = call(capsys, "--show", "--config", config)
    assert status == 0
    assert "of no day   baseline of R_e reset: new module" in out


def test_an_event_of_a_state_is_one_line_on_the_terminal(config: Path, capsys) -> None:
    """Whoever owns the state could write to the terminal of root what they liked."""
    engine = Engine(*_parts(config))
    engine.strings[0].health.history.note(1, "\x1b]0;owned\x07\x1b[2J\nstring_1: all is well")
    assert StateStore(config.parent / "state").save(engine.snapshot(), wall_ns=1) is None
    _, out, _ = call(capsys, "--show", "--config", config)
    assert "1970-01-01  ]0;owned [2J string_1: all is well\n" in out
    assert "\x1b" not in out


def test_a_reset_is_shown_from_then_on_and_not_only_once_the_next_baseline_is_there(config: Path, capsys) -> None:
    engine = Engine(*_parts(config))
    engine.reset_baseline("string_1", None, "new module", time_ns=1_700_000_000_000_000_000)
    assert StateStore(config.parent / "state").save(engine.snapshot(), wall_ns=1) is None
    out = call(capsys, "--show", "--config", config)[1]
    assert "string_1: no baseline yet" in out
    assert "2023-11-14  baseline of R_e reset: new module" in out
