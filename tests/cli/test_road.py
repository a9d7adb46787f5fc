"""The road of a user, one command a step: fit, compare, diagnose, add, diagnose again, until nothing is missing."""

import json
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.cli.main import COMMANDS
from bms_gateway.config.model_file import format_model, parse_model, read_model
from tests.cli.calls import call, told
from tests.truth.hidden import Scenario, make_logs
from tests.truth.packs import Pack
from tests.truth.packs import pack as packed

KEYS = [
    "verdict",
    "unknown_remains",
    "selected",
    "ranking",
    "baseline",
    "after",
    "absorbed",
    "next_experiment",
]
"""Of `diagnose --json`, in the order in which they are promised."""
RANKED = ["effect", "cell", "heldout_rmse_K", "evidence", "parameters", "tied_with"]


@pytest.fixture(scope="module")
def pack(tmp_path_factory) -> Pack:
    return packed(tmp_path_factory.mktemp("road"), seconds=2400, sensors=(1, 2, 3))


@pytest.fixture(scope="module")
def diagnosis(pack) -> dict:
    return told("diagnose", pack.hidden, "--model", pack.model)


@pytest.fixture(scope="module")
def added(pack) -> tuple[Path, dict]:
    out = pack.folder / "added.toml"
    page = pack.folder / "added.html"
    words = ("--model", pack.model, "--data", pack.hidden, "--out", out, "--html", page)
    return out, told("add", "entropic_heat", *words)


@pytest.fixture(scope="module")
def fitted(pack) -> tuple[Path, dict]:
    out = pack.folder / "fitted.toml"
    return out, told("fit", pack.clean, "--model", pack.model, "--out", out)


class TestDiagnose:
    def test_names_the_hidden_effect(self, diagnosis):
        assert diagnosis["verdict"] == "missing_effect"
        assert diagnosis["selected"] == [{"effect": "entropic_heat", "cell": None}]
        assert diagnosis["unknown_remains"] is False

    def test_its_document_has_the_promised_keys_first(self, diagnosis):
        assert list(diagnosis)[: len(KEYS)] == KEYS
        assert list(diagnosis["baseline"]) == ["train_rmse_K", "heldout_rmse_K", "noise_floor_K"]
        assert list(diagnosis["after"]) == ["train_rmse_K", "heldout_rmse_K"]
        first = diagnosis["ranking"][0]
        assert list(first)[: len(RANKED)] == RANKED
        assert first["effect"] == "entropic_heat"
        assert all(set(p) == {"value", "sd", "unit"} for p in first["parameters"].values())
        assert all(isinstance(s, str) for s in diagnosis["absorbed"])

    def test_its_ranking_names_each_effect_at_each_place_once(self, diagnosis):
        places = [(r["effect"], r["cell"]) for r in diagnosis["ranking"]]
        assert len(set(places)) == len(places)
        evidence = [r["evidence"] for r in diagnosis["ranking"]]
        assert evidence[0] == max(evidence)

    def test_the_held_out_error_falls_to_the_noise(self, diagnosis):
        floor = diagnosis["baseline"]["noise_floor_K"]
        assert diagnosis["baseline"]["heldout_rmse_K"] > 3 * floor
        assert diagnosis["after"]["heldout_rmse_K"] < 1.15 * floor

    def test_says_the_verdict_first(self, pack):
        status, out, err = call("diagnose", pack.clean, "--model", pack.model)
        assert status == 0
        assert err == ""
        assert out.startswith("The model explains these readings")
        assert "held-out" in out

    def test_a_record_that_is_too_short_is_told_as_compare_tells_it_and_the_verdict_is_written(self, pack):
        """It once ended with status 0, where compare ended with 2."""
        head, *lines = pack.clean.read_text().splitlines()
        short = pack.folder / "short.csv"
        short.write_text("\n".join([head, *lines[:100]]))
        status, out, err = call("diagnose", short, "--model", pack.model, "--json", "-")
        assert status == call("compare", short, "--model", pack.model)[0] == 2
        assert err.splitlines()[-1].endswith("short.csv: The record lasts 99 s; 300 s are the least.")
        d = json.loads(out)
        assert d["verdict"] == "insufficient_data"
        assert list(d)[: len(KEYS)] == KEYS
        assert d["selected"] == d["ranking"] == []
        assert "300 s are the least" in d["sentence"]


class TestAdd:
    def test_the_error_falls_where_nothing_was_fitted(self, added):
        _, d = added
        assert d["added"]
        assert d["refused"] is None
        assert d["after"]["heldout_rmse_K"] < 1.15 * d["noise_floor_K"] < d["before"]["heldout_rmse_K"]
        for s in d["sensors"]:
            assert s["after"]["heldout_rmse_K"] < 1.2 * s["noise_floor_K"] < s["before"]["heldout_rmse_K"]
        assert all(a < b for a, b in zip(d["core_95_K"]["after"], d["core_95_K"]["before"], strict=True))

    def test_its_page_says_the_same(self, pack, added):
        pytest.importorskip("plotly")
        text = (pack.folder / "added.html").read_text()
        d = added[1]
        error = f"from {d['before']['heldout_rmse_K']:.3f} to {d['after']['heldout_rmse_K']:.3f} K"
        assert f"With reversible (entropic) heat (entropic_heat) the held-out error falls {error}" in text
        assert text.count('class="plot"') == 6  # three surfaces, their map, the drive, the hottest core
        assert 'id="map-1"' in text

    def test_its_model_lacks_nothing_any_more(self, pack, added):
        d = told("diagnose", pack.hidden, "--model", added[0])
        assert d["verdict"] == "adequate"
        assert d["baseline"]["heldout_rmse_K"] < 1.15 * d["baseline"]["noise_floor_K"]

    def test_its_model_keeps_what_was_known_before(self, pack, added):
        nominal, model = read_model(pack.model), read_model(added[0])
        assert [e.name for e in model.effects] == ["entropic_heat"]
        assert dict(model.unfitted.priors) == dict(nominal.priors)
        assert model.priors["R_e"].rel_sd < 0.2 < nominal.priors["R_e"].rel_sd
        assert format_model(parse_model(format_model(model))) == format_model(model)

    @pytest.mark.slow
    def test_what_the_records_speak_against_is_refused_with_the_reason(self, pack):
        out = pack.folder / "refused.toml"
        words = ("add", "resistance_drift", "--model", pack.model, "--data", pack.hidden, "--out", out)
        page = pack.folder / "refused.html"
        status, text, err = call(*words, "--html", page)
        assert status == 1
        assert not out.exists()
        assert text == ""
        assert "Not added" in page.read_text()
        assert len(err.strip().splitlines()) == 1
        assert "not added: resistance_drift" in err
        assert "held-out" in err or "instead" in err

    def test_force_adds_it_and_says_so_in_the_file(self, pack):
        out, js = pack.folder / "forced.toml", pack.folder / "forced.json"
        status, text, _ = call(
            *("add", "thermocouple_lag", "--model", pack.model, "--data", pack.clean, "--out", out),
            *("--force", "--json", js),
        )
        assert status == 0
        assert "Added by force" in text
        assert "by force" in out.read_text().splitlines()[1]
        assert [e.name for e in read_model(out).effects] == ["thermocouple_lag"]
        d = json.loads(js.read_text())
        assert d["forced"]
        assert d["refused"]

    @pytest.mark.parametrize(
        ("words", "status", "message"),
        [
            (["entropic_haet"], 2, "'entropic_haet' is not in the catalogue; did you mean 'entropic_heat'?"),
            (["entropic_heat:2"], 2, "entropic_heat sits on no cell; write entropic_heat"),
            (["cell_cooling:9"], 2, "no place for cell_cooling; valid: 1, 2, 3"),
            (["cell_cooling", "--cell", "9"], 2, "no place for cell_cooling; valid: 1, 2, 3"),
            (["voltage_heat"], 2, "voltage_heat needs the column voltage_V"),
            (["flow_dependent_cooling"], 2, "flow_dependent_cooling cannot show here: it needs a flow that changes"),
            (["entropic_heat", "entropic_heat"], 2, "entropic_heat is there twice"),
            (["cell_cooling", "end_plate", "--cell", "1"], 2, "--cell goes with one EFFECT"),
        ],
    )
    def test_a_slip_is_one_line(self, pack, words, status, message):
        out = pack.folder / "slip.toml"
        got, text, err = call("add", *words, "--model", pack.model, "--data", pack.clean, "--out", out)
        assert (got, text) == (status, "")
        assert message in err
        assert len(err.strip().splitlines()) == 1
        assert not out.exists()

    def test_what_is_in_the_model_already_cannot_be_added(self, pack, added):
        out = pack.folder / "twice.toml"
        status, _, err = call("add", "entropic_heat", "--model", added[0], "--data", pack.hidden, "--out", out)
        assert status == 2
        assert "entropic_heat is in the model already" in err


class TestFit:
    def test_finds_the_parameters_within_its_sd(self, pack, fitted):
        found = {p["name"]: p for p in fitted[1]["parameters"]}
        factor = {"R_e": 1e3}
        for name in ("C_c", "C_s", "R_e", "R_c", "R_u", "C_f"):
            true = float(np.mean(pack.truth[name])) * factor.get(name, 1.0)
            assert abs(found[name]["after"]["value"] - true) < 3 * found[name]["after"]["sd"], name
            assert found[name]["after"]["sd"] < found[name]["before"]["sd"]

    def test_its_error_is_the_noise(self, fitted):
        d = fitted[1]
        assert d["heldout_rmse_K"] < 1.15 * d["noise_floor_K"]
        assert {s["cell"] for s in d["sensors"]} == {1, 2, 3}

    def test_its_model_compares_as_well(self, pack, fitted):
        before = told("compare", pack.clean, "--model", pack.model)
        after = told("compare", pack.clean, "--model", fitted[0])
        floor = after["filed"]["noise_floor_K"]
        assert before["filed"]["heldout_rmse_K"] > 2 * floor
        assert after["filed"]["heldout_rmse_K"] < 1.3 * floor
        # the filed model was fitted with offsets of sensors besides; the refitted one starts from the same prior
        assert after["refitted"]["heldout_rmse_K"] == pytest.approx(before["refitted"]["heldout_rmse_K"], rel=1e-3)

    def test_a_second_fit_to_the_same_data_learns_nothing_new(self, pack, fitted):
        again = pack.folder / "again.toml"
        told("fit", pack.clean, "--model", fitted[0], "--out", again)
        first, second = read_model(fitted[0]), read_model(again)
        assert dict(second.unfitted.priors) == dict(first.unfitted.priors)
        for name, prior in first.priors.items():
            assert second.priors[name].rel_sd == pytest.approx(prior.rel_sd, rel=0.01)

    def test_tables_share_the_physics_and_not_the_cooling(self, pack):
        out = pack.folder / "both.toml"
        d = told("fit", pack.clean, pack.hidden, "--model", pack.model, "--out", out)
        cooling = [p for p in d["parameters"] if p["name"] == "R_u"]
        assert [Path(p["table"]).name for p in cooling] == ["clean.csv", "hidden.csv"]
        mean = np.exp(np.mean(np.log([p["after"]["value"] for p in cooling])))
        assert np.mean(np.log(read_model(out).priors["R_u"].value)) == pytest.approx(np.log(mean), abs=0.02)

    def test_calibration_needs_a_core(self, pack):
        out = pack.folder / "calibrated.toml"
        status, _, err = call("fit", pack.clean, "--model", pack.model, "--out", out, "--calibrate")
        assert status == 2
        assert "--calibrate needs a thermocouple in a core: no column core_1_C" in err

    def test_a_calibration_tells_of_the_cell_what_later_fits_know(self, pack):
        log = make_logs([Scenario(seed=21, seconds=1800, cells=1, sensors=(1,), noise=0.05)])[0]
        rows = pack.folder / "cell.csv"
        log.write_csv(rows)
        head, *lines = rows.read_text().splitlines()
        lines = [f"{line},{core:.3f}" for line, core in zip(lines, log.core[:, 0], strict=True)]
        rows.write_text("\n".join([f"{head},core_1_C", *lines]))
        model, out = pack.folder / "cell.toml", pack.folder / "cell_b.toml"
        model.write_text(log.model)
        d = told("fit", rows, "--model", model, "--out", out, "--calibrate")
        assert d["calibrated"]
        assert {s["kind"] for s in d["sensors"]} == {"surface", "core"}
        known = read_model(out).unfitted.priors
        assert known["R_c"].rel_sd < 0.1
        assert float(known["R_c"].value) == pytest.approx(float(log.pack["R_c"][0]), rel=0.1)
        assert known["R_u"].rel_sd == read_model(model).priors["R_u"].rel_sd

    def test_data_without_heat_are_refused(self, pack):
        head, *lines = pack.clean.read_text().splitlines()
        at = head.split(",").index("current_A")
        still = [",".join("0.0" if i == at else x for i, x in enumerate(line.split(","))) for line in lines]
        (pack.folder / "still.csv").write_text("\n".join([head, *still]))
        out = pack.folder / "still.toml"
        status, _, err = call("fit", pack.folder / "still.csv", "--model", pack.model, "--out", out)
        assert status == 2
        assert "No current flows" in err
        assert not out.exists()


class TestCompare:
    def test_says_where_and_in_which_regime_the_model_fails(self, pack):
        d = told("compare", pack.hidden, "--model", pack.model)
        assert set(d) >= {"tables", "filed", "refitted"}
        sensors = d["refitted"]["sensors"]
        assert [s["cell"] for s in sensors] == [1, 2, 3]
        assert all(s["z"] > 6 for s in sensors)
        assert d["refitted"]["findings"]
        left = d["closest"]["explained_by"]  # by wrong numbers a model may be off all along; not by what it lacks
        assert max(left, key=left.get) != "always"

    def test_a_page_needs_an_extra_and_says_so_before_the_work(self, pack, monkeypatch):
        monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
        given = ("--model", pack.model, "--html", pack.folder / "x.html")
        for words in (
            ("compare", pack.clean),
            ("diagnose", pack.clean),
            ("add", "entropic_heat", "--data", pack.clean, "--out", pack.folder / "x.toml"),
        ):
            status, _, err = call(*words, *given)
            assert status == 2
            assert "pip install 'bms-gateway[report]'" in err

    def test_an_output_is_never_an_input(self, pack):
        for command in ("compare", "diagnose", "fit"):
            more = ("--out", pack.folder / "x.toml") if command == "fit" else ()
            status, _, err = call(command, pack.clean, "--model", pack.model, *more, "--json", pack.clean)
            assert status == 2
            assert "this file is read by the command" in err


@pytest.mark.parametrize("name", ["fit", "compare", "diagnose", "add"])
def test_help_has_an_example(name):
    assert name in COMMANDS
    status, out, _ = call(name, "--help")
    assert status == 0
    assert f"bms-gateway {name} " in out.partition("example:")[2]
