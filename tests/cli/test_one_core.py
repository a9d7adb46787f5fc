"""One model and one record have one core band, and one answer to whether it is proven, whoever is asked."""

import json
import re

import numpy as np
import pytest

from bms_gateway.config.model_file import read_model
from bms_gateway.report.core_text import half_width
from bms_gateway.report.step_names import REFITTED
from bms_gateway.workbench.bench import Bench
from bms_gateway.workbench.steps import Frame, doubt_lines
from tests.cli.calls import call, told
from tests.truth.packs import pack as packed

STRONG = 0.55  # mV/K, of the hidden effect


@pytest.fixture(scope="module")
def road(tmp_path_factory):
    """Every command on one model, and on the one that `add` wrote: document, words and page of each."""
    pack = packed(tmp_path_factory.mktemp("one_core"), seconds=1000, sensors=(1, 2, 3))
    folder = pack.folder
    written = folder / "added.toml"
    words = {
        "compare": ("compare", pack.hidden, "--model", pack.model),
        "diagnose": ("diagnose", pack.hidden, "--model", pack.model),
        "add": ("add", "entropic_heat", "--model", pack.model, "--data", pack.hidden, "--out", written),
        "compare added": ("compare", pack.hidden, "--model", written),
        "diagnose added": ("diagnose", pack.hidden, "--model", written),
    }
    found = {}
    for name, command in words.items():
        page, document = folder / f"{name}.html", folder / f"{name}.json"
        status, text, err = call(*command, "--html", page, "--json", document)
        assert status == 0, err
        html = page.read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")
        found[name] = json.loads(document.read_text()), text, html
    files = {"tables": [str(pack.hidden)], "model": str(pack.model)}
    tell = {"tell": lambda *_: None, "show": lambda _: None}
    bench, text = Bench(), pack.model.read_text()
    request = {"files": files, "folder": str(tmp_path_factory.mktemp("uploads")), "words": ["entropic_heat"]}
    request["name"] = REFITTED
    page = {do: bench.answer({**request, "do": do, "text": text}, **tell) for do in ("compare", "add")}
    page["compare added"] = bench.answer({**request, "do": "compare", "text": page["add"]["text"]}, **tell)
    return pack, written, found, page


GROUPS = [
    ("core_before", ("compare", "diagnose"), "before"),
    ("core", ("compare added", "diagnose added"), "after"),
]
both = pytest.mark.parametrize(("key", "others", "side"), GROUPS, ids=["as it is", "with what was added"])


@both
def test_documents_agree_to_the_last_bit(road, key, others, side):
    _, _, found, page = road
    core = found["add"][0][key]
    assert core["sd_K"] > 0.0
    for name in others:
        assert found[name][0]["core"] == core
        variants = found[name][0].get("refitted")
        if variants:
            assert max(variants["core"][0]["sd_K"]) == core["sd_K"]
    compared = page["compare" if side == "before" else "compare added"]
    assert {k: compared["core"][k] for k in core} == core
    half = 1.96 * core["sd_K"]
    cells = compared["variants"]["refitted"]["cells"]
    assert max(c["core_95_K"] for c in cells) == pytest.approx(half, rel=1e-12)
    assert page["add"][side]["core_K"] == pytest.approx(half, rel=1e-12)
    assert max(found["add"][0]["core_95_K"][side]) == pytest.approx(half, rel=1e-12)


@both
def test_words_and_pages_show_the_same_figure(road, key, others, side):
    _, _, found, page = road
    core = found["add"][0][key]
    half = half_width(1.96 * core["sd_K"])
    for name in others:
        _, text, html = found[name]
        assert f"± {half} K" in text
        assert f"± {half} K" in html
        card = re.search(r"<dt>Core, 95 % band</dt><dd[^>]*>(.*?)</dd>", html)
        assert card
        assert f"± {half} K" in card[1]
    _, text, html = found["add"]
    assert re.search(rf"cell \d.*\b{re.escape(half)}\b", text)
    assert half in html
    compared = page["compare" if side == "before" else "compare added"]
    assert f"± {half} K" in compared["core"]["sentence"]


def test_a_model_that_lacks_something_is_not_proven_and_says_why(road):
    _, _, found, _ = road
    core = found["diagnose"][0]["core"]
    assert found["diagnose"][0]["verdict"] == "missing_effect"
    assert core["proven"] is False
    assert any("does not explain the surfaces" in why for why in core["why"])


def test_with_what_it_lacked_it_is(road):
    _, written, found, page = road
    assert found["diagnose added"][0]["verdict"] == "adequate"
    assert found["add"][0]["core"] == {**found["add"][0]["core"], "proven": True, "why": []}
    assert found["add"][1].startswith("Added. ")
    assert read_model(written).doubts == ()
    assert page["add"]["tag"] == "Added"


def test_fit_and_compare_say_the_same(road):
    pack, *_ = road
    out = pack.folder / "fitted.toml"
    first = told("fit", pack.hidden, "--model", pack.model, "--out", out)["core"]
    assert first["proven"] is False
    assert told("compare", pack.hidden, "--model", out)["core"] == first
    model = read_model(out)
    assert list(model.doubts) == first["why"]
    assert model.posterior.model_error_K > 0.0
    assert told("fit", pack.clean, "--model", pack.model, "--out", out)["core"]["proven"] is True
    assert read_model(out).doubts == ()


def test_what_is_added_by_force_is_never_called_added_plainly_nor_known_better(road):
    pack, *_ = road
    out, page = pack.folder / "forced.toml", pack.folder / "forced.html"
    words = ("add", "thermocouple_lag", "--model", pack.model, "--data", pack.clean, "--out", out, "--force")
    status, text, err = call(*words, "--html", page, "--json", pack.folder / "forced.json")
    assert status == 0, err
    assert text.startswith("Added by force, core not proven. ")
    assert "Added by force, core not proven" in page.read_text(encoding="utf-8")
    # what speaks against it is said once
    assert " ".join(text.split()).count("Added by force, though: ") == 1
    assert page.read_text(encoding="utf-8").count("Added by force, though: ") == 1
    d = json.loads((pack.folder / "forced.json").read_text())
    assert d["core"]["proven"] is False
    assert any(why.startswith("Added by force, though: ") for why in d["core"]["why"])
    assert d["core"]["sd_K"] >= d["core_before"]["sd_K"]
    assert all(a >= b for a, b in zip(d["core_95_K"]["after"], d["core_95_K"]["before"], strict=True))
    assert told("compare", pack.clean, "--model", out)["core"] == d["core"]
    # neither another fit nor another record proves what was added against the records
    again = pack.folder / "again.toml"
    assert told("fit", pack.clean, "--model", out, "--out", again)["core"]["proven"] is False
    assert any(why.startswith("Added by force, though: ") for why in read_model(again).doubts)
    # the numbers of a later step are others: the reason is told as of the step at which it was said
    (reason,) = (why for why in read_model(out).doubts if why.startswith("Added by force, though: "))
    earlier = reason.replace(
        "Added by force, though: ", "Added by force in an earlier step, although it was said then: "
    )
    for name, before in (("entropic_heat", out), ("resistance_drift", pack.folder / "entropic_heat.toml")):
        later = pack.folder / f"{name}.toml"
        words = ("add", name, "--model", before, "--data", pack.clean, "--out", later, "--force")
        why = told(*words)["core"]["why"]
        assert why.count(earlier) == 1
        assert reason not in why
        assert list(read_model(later).doubts) == why
        assert "by force" in why[0]


def test_a_page_calls_the_same_numbers_not_identifiable_as_the_terminal(road):
    pack, _, _, _ = road
    out, page = pack.folder / "identified.toml", pack.folder / "identified.html"
    lost = {
        p["name"]
        for p in told("fit", pack.clean, "--model", pack.model, "--out", out)["parameters"]
        if p["status"].startswith("not identifiable")
    }
    call("compare", pack.clean, "--model", pack.model, "--html", page)
    html = page.read_text(encoding="utf-8")
    card = re.search(r"Not identifiable<(.*?)</dl>", html, re.DOTALL)
    assert set(re.findall(r"[a-z] \((\w+)\)", card[1])) == lost != set()


def test_the_band_does_not_hang_on_who_has_worked_something_out_already(road):
    from bms_gateway.diagnosis.calibrate import identify
    from bms_gateway.diagnosis.core_known import known_core
    from bms_gateway.diagnosis.diagnosis import diagnose
    from bms_gateway.records.read import read_measurements

    pack, *_ = road
    model = read_model(pack.model)
    records = read_measurements([pack.clean], model=model, config=None, string=None, columns={})
    plain = known_core(model, records)
    spared = known_core(model, records, identify(model, records), diagnose(model, records).search)
    assert (spared.sd_K, spared.why) == (plain.sd_K, plain.why) == (plain.sd_K, ())


def test_the_coefficient_comes_out_as_a_curve_with_a_band_in_document_words_and_page(road):
    _, _, found, _ = road
    document, text, html = found["diagnose"]
    (curve,) = document["curves"]
    assert (curve["effect"], curve["unit"]) == ("entropic_heat", "mV/K")
    value, sd, soc = (np.array(curve[k]) for k in ("value", "sd", "soc"))
    assert np.allclose(np.diff(soc), 0.05)
    assert (sd > 0.0).all()
    assert np.mean(np.abs(np.abs(value) - STRONG) <= 2.0 * sd) >= 0.8
    assert "dU/dT" in text
    assert "dU/dT over the SOC" in html
    assert found["diagnose added"][0]["curves"] == []


def test_a_model_file_of_a_command_says_on_top_what_that_of_the_page_says(road, tmp_path):
    """It said "core not proven: see [posterior]", and the page everything."""
    pack, *_ = road
    out = tmp_path / "forced.toml"
    words = ("thermocouple_lag", "--model", pack.model, "--data", pack.clean, "--out", out, "--force")
    assert call("add", *words)[0] == 0
    tell = {"tell": lambda *_: None, "show": lambda _: None}
    files = {"tables": [str(pack.clean)], "model": str(pack.model)}
    request = {"files": files, "folder": str(tmp_path), "words": ["thermocouple_lag"], "force": True, "name": "+ x"}
    bench = Bench()
    text = bench.answer({**request, "do": "add", "text": pack.model.read_text()}, **tell)["text"]
    top, _, rest = out.read_text().partition("cells = ")
    assert rest
    assert text.partition("cells = ")[0] == top
    # each doubt that the page tells stands there once
    compared = bench.answer({**request, "do": "compare", "text": text}, **tell)
    told = doubt_lines([Frame(text, "+ x", compared=compared)])
    assert told[0].startswith("Core not proven: ")
    assert len(told) > 1
    assert all(top.count(f"# {line}\n") == 1 for line in told)
    assert top.count("\n") == len(told) + 1
    # and of a fit
    again = tmp_path / "fitted.toml"
    assert call("fit", pack.clean, "--model", out, "--out", again)[0] == 0
    said = again.read_text().partition("cells = ")[0]
    assert said.startswith("# Core not proven: ")
    assert len(re.findall(r"# Added by force, though: ", said)) == 1
