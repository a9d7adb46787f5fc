"""The bar moves with the work, never back, and the parameters' correlation is that of the physics."""

from itertools import pairwise

import numpy as np
import pytest

from bms_gateway.config.model_file import read_model
from bms_gateway.diagnosis import adding
from bms_gateway.diagnosis.compare import compare
from bms_gateway.identify.effort import beat, heard
from bms_gateway.records.read import read_measurements
from bms_gateway.report import examine
from bms_gateway.report.html_correlation import correlation_table, correlations
from bms_gateway.thermal import KINDS
from bms_gateway.workbench.bench import Bench
from bms_gateway.workbench.moving import Moving
from tests.support.desk_steps import files
from tests.truth.packs import pack as make_pack

R_E, R_U = "internal electrical resistance (R_e)", f"{KINDS['R_u'].description} (R_u)"


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"))


@pytest.fixture(scope="module")
def measured(pack):
    model = read_model(pack.model)
    return model, read_measurements([pack.clean], model=model)


@pytest.fixture(scope="module")
def compared(measured):
    return compare(*measured)


def test_the_bar_moves_between_steps_and_never_back(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("bms_gateway.workbench.moving.time.monotonic", lambda: now[0])
    told = []
    moving = Moving(lambda share, text: told.append((share, text)))
    moving.step(0.1, "fitting")
    with heard(moving.beat):
        for _ in range(2000):
            now[0] += 0.05
            beat()
    moving.step(0.12, "screening")  # less than what the pieces had moved it to
    moving.step(0.98, "judging")
    for _ in range(2000):
        now[0] += 0.05
        moving.beat()
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert 0.17 < max(share for share, text in told if text.startswith("fitting")) <= 0.2
    assert shares[-1] < 1.0
    assert len([t for _, t in told if t.startswith("fitting")]) == pytest.approx(2000 * 0.05 / 0.25, rel=0.2)
    beat()  # nobody listens any more


def test_the_bar_moves_through_steps_that_its_pieces_have_overtaken(monkeypatch):
    # Bug: after the many short pieces of a screening, the bar of sixty cells stood for half a minute of refits.
    now = [0.0]
    monkeypatch.setattr("bms_gateway.workbench.moving.time.monotonic", lambda: now[0])
    told = []
    moving = Moving(lambda share, text: told.append((share, text)))
    moving.step(0.0688, "screening")
    for _ in range(457):
        moving.beat()
    for k in range(8):
        moving.step(0.0811 + 0.007 * k, f"refitting {k}")
        for _ in range(20):
            now[0] += 0.2
            moving.beat()
    refits = [share for share, text in told if text.startswith("refitting")]
    assert len(refits) == 8 * 11
    assert all(after > before for (before, _), (after, text) in pairwise(told) if "trajector" in text)
    assert refits[-1] > refits[0] + 0.02
    assert refits[-1] < 0.0811 + 0.007 * 7 + 0.1


def test_a_search_that_begins_anew_moves_the_bar_too_and_does_not_fill_it(monkeypatch):
    # Bug: the bar of sixty cells was full for six minutes, because every step began where the pieces had led to.
    now = [0.0]
    monkeypatch.setattr("bms_gateway.workbench.moving.time.monotonic", lambda: now[0])
    told = []
    moving = Moving(lambda share, text: told.append(share))
    for rival in range(4):
        before = told[-1] if told else 0.0
        for k in range(60):
            moving.step(0.1 + 0.005 * k, f"search {rival}")
            for _ in range(400):
                now[0] += 0.05
                moving.beat()
        assert told[-1] > before + 0.02
    assert told == sorted(told)
    assert told[-1] < 0.99
    moving.step(1.0, "done")
    assert told[-1] == 1.0


def test_a_fit_tells_its_pieces(compared):
    count = []
    problem = compared.refitted.fit.problem
    with heard(lambda: count.append(1)):
        problem.predict(compared.refitted.fit.theta)
        problem.columns(compared.refitted.fit.theta, compared.refitted.fit.prediction, problem.coordinates)
    assert len(count) >= 2


def noted(monkeypatch, module, *names):
    """What was told when each of these functions was called last, beside all that was told."""
    told, at = [], {}

    def watched(name, own):
        def called(*words, **more):
            at[name] = told[-1]
            return own(*words, **more)

        return called

    for name in names:
        monkeypatch.setattr(module, name, watched(name, getattr(module, name)))
    return told, at


def test_a_diagnosis_is_not_done_before_all_that_is_told_of_it_is_there(measured, monkeypatch):
    """With sixty cells the bar stood at its end for twenty seconds."""
    told, at = noted(monkeypatch, examine, "card_of", "known_core", "curve_of")
    made = examine.examine(*measured, progress=lambda share, text: told.append((share, text)))
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert told[-1] == (1.0, "done")
    assert 0.5 < at["card_of"][0] < at["known_core"][0] < at["curve_of"][0] < 1.0
    assert len({text for _, text in at.values()}) == len(at)  # each says what is being done

    told, at = noted(monkeypatch, adding, "identify", "known_core", "judged_model")
    wants = adding.asked_for(["entropic_heat"], measured[0])
    known = made.diagnosis
    adding.add_effects(*measured, wants, lambda share, text: told.append((share, text)), lambda *_, progress: known)
    assert told[-1] == (1.0, "done")
    assert all(share < 1.0 for share, _ in at.values())
    assert {"known_core", "judged_model"} <= set(at)


def test_every_share_of_a_comparison_and_an_addition_says_what_is_done(pack, tmp_path):
    """The bar of sixty cells stood below a tenth until the model was there, without a word."""
    bench, trials = Bench(), []
    asked = {"files": files(pack), "folder": str(tmp_path), "text": pack.model.read_text(), "name": "refitted"}

    def shares(do, **more):
        told = []
        bench.answer({"do": do, **asked, **more}, lambda share, text: told.append((share, text)), trials.append)
        assert all(text and text[0] != " " for _, text in told), do
        assert [share for share, _ in told] == sorted(share for share, _ in told)
        return [share for share, _ in told]

    shares("open")
    assert shares("compare")[-1] > 0.7
    shares("diagnose")
    added = shares("add", words=["entropic_heat"])
    assert len(trials) > 2
    assert added[-1] == 1.0
    assert sum(0.15 < share < 0.95 for share in added) > 2


def test_what_only_a_product_tells_is_correlated(compared):
    """At rest the surface tells R_e·R_u: a larger R_e goes with a smaller R_u."""
    names, r = correlations(compared.refitted.fit)
    assert np.allclose(np.diag(r), 1.0)
    assert np.allclose(r, r.T)
    assert r[names.index(R_E), names.index(R_U)] < -0.3
    table = correlation_table(compared.refitted.fit)
    assert table.count("<tr>") == 1 + len(names)
    place = 1 + names.index(R_U)
    assert f">{place} {R_U}</th>" in table
    assert f'aria-label="{R_U}">{place}</th>' in table
