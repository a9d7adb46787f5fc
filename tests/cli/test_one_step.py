"""One step of the road has one set of numbers and errors: on terminal, page, report, JSON and in the model file.

Models that lack an effect, models with one of two hidden effects, models with all that is hidden, and what was added by
force: in the first two a search comes closer to the readings than the numbers that are believed.
"""

import json
import re
from html import escape

import numpy as np
import pytest

from bms_gateway.config.model_file import parse_model, read_model
from bms_gateway.report.diagnosis_text import with_sd
from bms_gateway.report.show import kelvins
from bms_gateway.report.step_names import FILED, REFITTED, titled, with_added
from bms_gateway.report.words import named_all
from bms_gateway.thermal import KINDS
from bms_gateway.thermal.effects import effect_named
from bms_gateway.workbench.bench import Bench
from tests.cli.calls import call
from tests.truth.hidden import Scenario, make_log

BOTH = ("resistance_temperature", "entropic_heat")
CASES = [
    (BOTH, "resistance_temperature", 1, 31),
    (("entropic_heat",), "entropic_heat", 1, 41),
    (BOTH, "entropic_heat", 3, 32),
    (("ambient_loss", "resistance_temperature"), "ambient_loss", 1, 31),
    (("ambient_loss", "resistance_temperature"), "ambient_loss", 3, 32),
    (("radial_gradient",), "entropic_heat", 1, 31),
    (("polarization",), "polarization", 1, 33),
    (("natural_convection",), "ambient_loss", 3, 34),
]
pytestmark = pytest.mark.slow  # every command several times; `test_one_core` is a plain test of one case
SAME = ("train_rmse_K", "heldout_rmse_K")


class Road:
    """What every way to one addition says."""

    def __init__(self, folder, uploads, hidden, added, cells, seed):
        sensors = (1,) if cells == 1 else (1, 3)
        effects = dict.fromkeys(hidden, ("strong", None))
        columns = ("soc",) if cells == 1 else ("soc", "flow")
        log = make_log(
            Scenario(effects, cells=cells, sensors=sensors, seconds=1000, seed=seed, noise=0.05, columns=columns)
        )
        table, self.model, self.written = folder / "drive.csv", folder / "string.toml", folder / "added.toml"
        log.write_csv(table)
        self.model.write_text(log.model)
        words = {
            "compare": ("compare", table, "--model", self.model),
            "diagnose": ("diagnose", table, "--model", self.model),
            "fit": ("fit", table, "--model", self.model, "--out", folder / "fitted.toml"),
            "add": ("add", added, "--model", self.model, "--data", table, "--out", self.written, "--force"),
            "compare added": ("compare", table, "--model", self.written),
            "diagnose added": ("diagnose", table, "--model", self.written),
        }
        self.json, self.text, self.html = {}, {}, {}
        for name, command in words.items():
            html, document = folder / f"{name}.html", folder / f"{name}.json"
            pages = () if name == "fit" else ("--html", html)
            status, self.text[name], err = call(*command, *pages, "--json", document)
            assert status == 0, err
            self.json[name] = json.loads(document.read_text())
            if name == "fit":
                continue
            text = html.read_text(encoding="utf-8").partition("<script")[0].replace("\N{NO-BREAK SPACE}", " ")
            self.html[name] = re.sub("<[^>]*>", " ", text)
        bench, tell = Bench(), {"tell": lambda *_: None, "show": lambda _: None}
        request = {"files": {"tables": [str(table)], "model": str(self.model)}, "folder": str(uploads)}
        request |= {"words": [added], "force": True, "text": log.model, "name": REFITTED}
        self.page = {do: bench.answer({**request, "do": do}, **tell) for do in ("compare", "add")}
        self.step = with_added(named_all([added]), forced=self.json["add"]["refused"] is not None)
        request |= {"text": self.page["add"]["text"], "name": self.step}
        self.page["compare added"] = bench.answer({**request, "do": "compare"}, **tell)


def roads(cases):
    return [pytest.param(c, id=f"{'+'.join(c[0])}, {c[1]} added, {c[2]} cells, {c[3]}") for c in cases]


@pytest.fixture(scope="module", params=roads(CASES))
def road(request, tmp_path_factory):
    return Road(tmp_path_factory.mktemp("step"), tmp_path_factory.mktemp("uploads"), *request.param)


def errors_of(stair):
    return [stair["trained_K"], stair["held_K"]]


def test_errors_of_a_step_are_the_same_in_every_document_and_on_the_page(road):
    before = [road.json["add"]["before"][k] for k in SAME]
    after = [road.json["add"]["after"][k] for k in SAME]
    assert [road.json["compare"]["refitted"][k] for k in SAME] == before
    assert [road.json["diagnose"]["baseline"][k] for k in SAME] == before
    assert [road.json["compare added"]["refitted"][k] for k in SAME] == after
    assert [road.json["diagnose added"]["baseline"][k] for k in SAME] == after
    assert errors_of(road.page["add"]["before"]) == errors_of(road.page["compare"]["variants"][REFITTED]["stair"])
    assert errors_of(road.page["add"]["before"]) == before
    assert errors_of(road.page["add"]["after"]) == errors_of(road.page["compare added"]["variants"][road.step]["stair"])
    assert errors_of(road.page["add"]["after"]) == after


def test_a_step_has_one_name_on_terminal_page_and_report(road):
    assert all(titled(name) in road.text["compare"] for name in (FILED, REFITTED))
    assert all(escape(titled(name)) in road.html["compare"] for name in (FILED, REFITTED))
    assert f"Before: {REFITTED}. After: {road.step}.\n" in road.text["add"]
    assert all(escape(name) in road.html["add"] for name in (REFITTED, road.step))
    for name in ("diagnose", "diagnose added"):
        chosen = [s["effect"] + (f":{s['cell']}" if s["cell"] else "") for s in road.json[name]["selected"]]
        rows = [line.split("  ")[0] for line in road.text[name].splitlines()]
        assert REFITTED in rows
        assert not chosen or with_added(named_all(chosen)) in rows
        assert not chosen or escape(with_added(named_all(chosen))) in road.html[name]
    assert list(road.page["compare"]["variants"]) == [FILED, REFITTED]
    assert road.page["add"]["step"] == road.step
    assert list(road.page["compare added"]["variants"]) == [road.step]


def test_words_and_reports_show_these_errors(road):
    before, after = ([kelvins(road.json["add"][side][k]) for k in SAME] for side in ("before", "after"))
    row = next(line for line in road.text["add"].splitlines() if re.match(r"(all|surface 1) ", line))
    if "surface 3" not in road.text["add"]:
        assert row.split()[2:6] == [before[0], after[0], before[1], after[1]]
    for one, other in zip(before, after, strict=True):
        assert f"{one} → {other} K" in road.html["add"]
    for name, errors in (
        ("compare", before),
        ("diagnose", before),
        ("compare added", after),
        ("diagnose added", after),
    ):
        for x in errors:
            assert x in road.text[name]
            assert re.search(rf"(→ )?{x} (→ [\d.]+ )?K", road.html[name])


def test_numbers_of_a_step_are_the_same_with_the_same_sd(road):
    numbers = road.json["add"]["parameters"]
    assert road.json["compare added"]["parameters"] == numbers
    shown = [with_sd(x["after"]["value"], x["after"]["sd"]) for x in numbers if x["status"] != "fixed"]
    assert len(shown) >= 6
    plain = re.sub(r"\s+", " ", road.text["add"])
    pages = [road.html["add"], road.html["compare added"], road.page["add"]["parameters"]]
    pages.append(road.page["compare added"]["parameters"])
    for text in shown:
        assert text in plain
        assert all(text.replace("-", "−") in page for page in pages)


def test_the_model_file_holds_these_numbers(road):
    model = read_model(road.written)
    assert repr(parse_model(road.page["add"]["text"])) == repr(model)
    for x in road.json["add"]["parameters"]:
        value, sd = x["after"]["value"], x["after"]["sd"]
        key, _, name = x["name"].rpartition(".")
        if not key:
            kind, prior = KINDS[x["name"]], model.priors[x["name"]]
            assert np.exp(np.mean(np.log(prior.value))) / kind.to_si == pytest.approx(value, rel=2e-5)
            assert prior.rel_sd == pytest.approx(sd / value, rel=1e-3, abs=2e-6)
            continue
        p = effect_named(key.partition(":")[0]).parameter(name)
        effect = next(e for e in model.effects if e.key == key)
        assert effect.values[name] / p.to_si == pytest.approx(value, rel=2e-5, abs=1e-9)
        spread = effect.sd[name] * value if p.log else effect.sd[name] / p.to_si
        assert spread == pytest.approx(sd, rel=1e-3, abs=1e-9)


def test_the_same_file_opened_again_shows_the_same_step(road, tmp_path):
    opened = Bench()
    files = {"tables": [str(road.model.with_name("drive.csv"))], "model": str(road.written)}
    tell = {"tell": lambda *_: None, "show": lambda _: None}
    request = {"files": files, "folder": str(tmp_path), "text": road.page["add"]["text"], "name": REFITTED}
    again = opened.answer({**request, "do": "compare"}, **tell)
    step = road.page["compare added"]
    assert again["variants"][REFITTED]["stair"] == step["variants"][road.step]["stair"]
    assert (again["parameters"], again["core"]) == (step["parameters"], step["core"])
    assert again["variants"][REFITTED]["known"] == step["variants"][road.step]["known"]


def test_traces_of_a_step_leave_the_error_that_is_told(road):
    """The residual that is drawn: its mean square is that of trained and held-out readings together."""
    step = road.page["compare added"]["variants"][road.step]
    low, high = sorted(errors_of(step["stair"]))
    cells = [c for c in step["cells"] if c["error_K"] is not None]
    assert np.sqrt(np.mean([c["error_K"] ** 2 for c in cells])) == pytest.approx(step["stair"]["trained_K"], rel=0.01)
    assert low <= high


@pytest.mark.parametrize(("command", "step"), [("compare", REFITTED), ("compare added", None)])
def test_numbers_that_come_closer_and_are_not_believed_are_named_as_such(road, command, step):
    stated, closest = (road.json[command][k] for k in ("refitted", "closest"))
    told = "Other numbers of the same model follow the surfaces to "
    texts = [road.text[command], road.html[command], road.page[command]["variants"][step or road.step]["closest"]]
    texts += [road.text[command.replace("compare", "diagnose")], road.html[command.replace("compare", "diagnose")]]
    if closest is None:
        assert not any(told in text for text in texts)
        return
    assert closest["train_rmse_K"] < stated["train_rmse_K"]
    assert (closest["core"], closest["core_measured"]) == ([], [])
    assert all(f"{told}{closest['train_rmse_K']:.3g} K" in text for text in texts)


def test_what_the_products_of_numbers_are_known_to_is_the_same(road):
    def products(name):
        return sorted(line.strip() for line in road.text[name].splitlines() if " alone to ± " in line)

    assert products("fit")
    assert products("fit") == products("diagnose")
