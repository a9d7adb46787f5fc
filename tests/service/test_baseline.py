"""Requests for a new baseline: carried out once, refused in words, and not lost at a cut of power."""

import json
import logging
from pathlib import Path

import pytest

from bms_gateway.errors import StateError
from bms_gateway.service.baseline import KEPT_S, BaselineRequests
from bms_gateway.store.requests import BaselineReset, ask, asked
from tests.engine.test_engine import engine

WISH = BaselineReset("string_1", None, "new module", 1_700_000_000_000_000_000)


def texts(e) -> list[str]:
    return [event.text for event in iter(e.next_output, None)]


def test_a_wish_is_carried_out_once_and_removed_when_it_has_been_saved(tmp_path: Path) -> None:
    e = engine()
    path = ask(tmp_path, WISH)
    requests = BaselineRequests(tmp_path, lambda: e)
    for now in (0.0, 2.0, KEPT_S - 1.0):
        requests.look(now)
        assert path.exists()
    assert texts(e) == ["baseline of R_e reset: new module: made anew by the next drives"]
    requests.look(KEPT_S)
    assert not path.exists()
    assert list(asked(tmp_path)) == []


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
    assert [r.getMessage() for r in caplog.records] == [
        "baseline.1.request: not a request to reset a baseline; it is removed"
    ]
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
