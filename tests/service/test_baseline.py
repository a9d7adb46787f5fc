"""Requests for a new baseline: carried out once, refused in words, and not lost at a cut of power."""

import asyncio
import errno
import json
import logging
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from bms_gateway.cli.main import main
from bms_gateway.errors import StateError
from bms_gateway.service import baseline, live
from bms_gateway.service.baseline import KEPT_S, BaselineRequests
from bms_gateway.store.requests import Acknowledgement, BaselineReset, ask, asked
from tests.config.bench_cell import write_bench_cell
from tests.engine.engines import engine
from tests.support.live_service import PATIENCE_S

WISH = BaselineReset("string_1", None, "new module", 1_700_000_000_000_000_000)


def texts(e) -> list[str]:
    return [event.text for event in iter(e.next_output, None)]


def test_a_wish_is_carried_out_once_and_removed_when_it_has_been_saved(tmp_path: Path) -> None:
    e = engine()
    path = ask(tmp_path, WISH)
    requests = BaselineRequests(tmp_path, lambda: e)
    for now in (0.0, 2.0, KEPT_S - 1.0):
        requests.look(9_000.0 + now)
        assert path.exists()
    assert texts(e) == ["baseline of R_e reset: new module: made anew by the next drives"]
    requests.look(9_000.0 + KEPT_S)
    assert not path.exists()
    assert list(asked(tmp_path)) == []


def test_a_wish_is_kept_for_three_saves() -> None:
    """One save may fail, and one may have begun before the wish was carried out."""
    assert KEPT_S == 3 * live.SAVE_S


def test_the_service_looks_for_wishes_every_two_seconds(tmp_path, monkeypatch) -> None:
    pauses = []

    async def sleep(seconds: float) -> None:
        pauses.append(seconds)
        if len(pauses) == 3:
            raise asyncio.CancelledError

    monkeypatch.setattr(baseline.asyncio, "sleep", sleep)
    with pytest.raises(asyncio.CancelledError):
        asyncio.run(BaselineRequests(tmp_path, engine).run())
    assert pauses == [2.0] * 3


def test_beside_the_gateway_wishes_are_carried_out_and_removed_round_after_round(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(baseline, "PERIOD_S", 0.01)
    monkeypatch.setattr(baseline, "KEPT_S", 0.05)
    e, removed = engine(), []

    async def main() -> None:
        looking = asyncio.ensure_future(BaselineRequests(tmp_path, lambda: e).run())
        for time_ns in (1, 2):
            path = ask(tmp_path, replace(WISH, time_ns=time_ns))
            async with asyncio.timeout(PATIENCE_S):
                while path.exists():
                    await asyncio.sleep(0.01)
            removed.append(path)
        looking.cancel()
        await asyncio.wait([looking])

    asyncio.run(main())
    assert len(set(removed)) == 2
    assert texts(e) == ["baseline of R_e reset: new module: made anew by the next drives"] * 2


def test_a_wish_that_a_person_has_removed_meanwhile_is_over_without_a_word(tmp_path, monkeypatch, caplog) -> None:
    path = ask(tmp_path, WISH)
    found = list(asked(tmp_path))
    monkeypatch.setattr(baseline, "asked", lambda _: found)
    requests = BaselineRequests(tmp_path, engine)
    requests.look(0.0)
    path.unlink()
    with caplog.at_level(logging.WARNING):
        requests.look(KEPT_S)
    assert [r.getMessage() for r in caplog.records if r.name == baseline.__name__] == []


def test_a_disk_that_hangs_holds_up_no_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers, ticks, ended = threading.Event(), [], threading.Event()

    def hangs(_: Path) -> list:
        answers.wait(PATIENCE_S)
        ended.set()
        return []

    monkeypatch.setattr(baseline, "asked", hangs)

    async def main() -> None:
        looking = asyncio.ensure_future(BaselineRequests(tmp_path, engine).run())
        for _ in range(5):
            await asyncio.sleep(0.01)
            ticks.append(not ended.is_set())
        looking.cancel()
        await asyncio.wait([looking], timeout=PATIENCE_S)
        assert looking.cancelled()

    asyncio.run(main())
    assert ticks == [True] * 5
    assert not ended.is_set()
    answers.set()


def test_a_wish_found_again_after_a_restart_is_not_carried_out_twice(tmp_path: Path) -> None:
    one, two = engine(), engine()
    ask(tmp_path, WISH)
    BaselineRequests(tmp_path, lambda: one).look(0.0)
    two.restore(json.loads(json.dumps(one.snapshot(), allow_nan=False)))
    texts(two)
    BaselineRequests(tmp_path, lambda: two).look(0.0)
    assert texts(two) == []
    assert [text for _, text in two.strings[0].health.history.events] == ["baseline of R_e reset: new module"]


@pytest.mark.parametrize(
    "content", ["", "[1]", "{}", '{"string": 1, "cell": null, "reason": "x", "time_ns": 1}', "\xff", "[" * 20_000]
)
def test_what_is_no_wish_is_told_and_removed(tmp_path: Path, caplog: pytest.LogCaptureFixture, content: str) -> None:
    path = tmp_path / "baseline.1.request"
    path.write_text(content, encoding="latin-1")
    requests = BaselineRequests(tmp_path, engine)
    with caplog.at_level(logging.WARNING):
        requests.look(0.0)
        requests.look(KEPT_S)
    assert [r.getMessage() for r in caplog.records] == ["baseline.1.request: not a request; it is removed"]
    assert not path.exists()


@pytest.mark.parametrize(("string", "cell", "told"), [("sting_1", None, "did you mean"), ("string_1", 5, "1 to 4")])
def test_a_wish_for_what_does_not_exist_is_refused(tmp_path, caplog, string, cell, told) -> None:
    ask(tmp_path, BaselineReset(string, cell, "x", 1))
    BaselineRequests(tmp_path, engine).look(0.0)
    assert told in caplog.text


def test_a_wish_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    with pytest.raises(StateError, match="cannot be written"):
        ask(tmp_path / "missing", WISH)


def test_a_file_that_cannot_be_removed_is_told_and_tried_again(tmp_path, caplog) -> None:
    path = tmp_path / "baseline.1.request"
    path.mkdir()
    requests = BaselineRequests(tmp_path, engine)
    for now in (0.0, KEPT_S, KEPT_S + 2.0):
        requests.look(now)
    assert caplog.text.count("cannot be removed") == 2


@pytest.mark.parametrize("call", ["open", "is_file", "glob"])
def test_a_wish_that_cannot_be_read_now_is_told_kept_and_carried_out_later(tmp_path, monkeypatch, caplog, call) -> None:
    """After one failure of the disk it was called no request, and removed."""
    e, path = engine(), ask(tmp_path, WISH)
    requests = BaselineRequests(tmp_path, lambda: e)
    fails = OSError(errno.EIO, "Input/output error")
    with monkeypatch.context() as disk:
        disk.setattr(Path, call, lambda *_, **__: (_ for _ in ()).throw(fails))
        for now in (0.0, 2.0, KEPT_S + 4.0):
            requests.look(now)
    assert caplog.text.count("cannot be read: Input/output error; tried again") == 3
    assert path.exists()
    assert texts(e) == []
    requests.look(KEPT_S + 6.0)
    assert texts(e) == ["baseline of R_e reset: new module: made anew by the next drives"]
    requests.look(2 * KEPT_S + 6.0)
    assert not path.exists()


def test_an_acknowledgement_ends_what_only_a_person_ends_and_is_told(tmp_path: Path) -> None:
    e = engine()
    e.alerting.runaway.latched[1] = True
    e.alerting.limits.lost[0] = True
    path = ask(tmp_path, Acknowledgement(None, "cooled and looked at", 1_700_000_000_000_000_000))
    requests = BaselineRequests(tmp_path, lambda: e)
    requests.look(0.0)
    assert texts(e) == ["cooled and looked at"]
    assert not e.alerting.runaway.latched.any()
    assert not e.alerting.limits.lost.any()
    requests.look(KEPT_S)
    assert not path.exists()


def test_an_acknowledgement_of_one_string_leaves_the_alarms_of_the_others(tmp_path: Path) -> None:
    e = engine()
    e.alerting.runaway.latched[:] = True
    ask(tmp_path, Acknowledgement("string_2", "seen to", 1_700_000_000_000_000_000))
    BaselineRequests(tmp_path, lambda: e).look(0.0)
    assert {c.string for c in e.alerting.runaway.conditions()} == {"string_1"}


def test_the_command_asks_for_it_and_names_what_there_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = write_config(tmp_path)
    (tmp_path / "state").mkdir()
    assert main(["acknowledge", "cell", "--reason", "looked at", "--config", str(config)]) == 0
    ((_, wish),) = asked(tmp_path / "state")
    assert isinstance(wish, Acknowledgement)
    assert (wish.string, wish.reason) == ("cell", "looked at")
    assert main(["acknowledge", "cel", "--reason", "x", "--config", str(config)]) == 2
    assert "did you mean 'cell'" in capsys.readouterr().err


def write_config(folder: Path) -> Path:
    """A string whose state is kept in the folder's `state`."""
    config = write_bench_cell(folder)
    config.write_text(config.read_text() + '[store]\npath = "state"\n')
    return config
