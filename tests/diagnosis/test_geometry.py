"""What format and mass say against the numbers of a model and of a fit."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.cli.main import main
from bms_gateway.config.model_file import parse_model
from bms_gateway.diagnosis.calibrate import AGAINST_FORMAT, changes, identify
from bms_gateway.diagnosis.checks import check_record
from bms_gateway.diagnosis.core_known import known_core
from bms_gateway.diagnosis.geometry import facts_of, odd_declared, odd_fitted
from bms_gateway.diagnosis.hypotheses import judged
from bms_gateway.records.read import read_measurements
from bms_gateway.thermal import Prior, StringModel
from tests.truth.hidden import Scenario, make_log

POUCH = "pouch 290x216x7.1mm 787g"


def pouch(R_c, C=790.0, words=POUCH, sd=0.1):
    values = {"C_c": 0.93 * C, "C_s": 0.07 * C, "R_e": 2e-3, "R_c": R_c, "R_u": 1.0}
    return StringModel(
        1, (1,), "single", {k: Prior(v, sd) for k, v in values.items()}, capacity_Ah=33.0, cell_format=words
    )


def test_a_flat_cell_has_no_room_for_half_a_kelvin_per_watt():
    (odd,) = odd_declared(pouch(0.49))
    assert odd.excluded
    assert odd.name == "R_c"
    # t/(10 k A) by hand: 7.1 mm over 10 x 0.6 W/m/K x 626.4 cm2
    assert odd.expected == pytest.approx(7.1e-3 / (10 * 0.6 * 0.29 * 0.216), rel=1e-9)
    assert "R_c = 0.49 K/W is not possible" in odd.says
    assert "26 times" in odd.says


@pytest.mark.parametrize("R_c", [0.01, 0.02, 0.05])
def test_what_the_format_allows_is_not_told(R_c):
    assert odd_declared(pouch(R_c)) == ()


def test_a_heat_capacity_against_the_mass_is_told():
    (odd,) = odd_declared(pouch(0.02, C=400.0, sd=0.05))
    assert odd.name == "C_c + C_s"
    assert odd.excluded
    assert odd_declared(pouch(0.02, C=700.0)) == ()


def test_a_number_that_is_hardly_known_contradicts_nothing():
    assert odd_declared(pouch(0.49, sd=3.0)) == ()


def test_without_a_format_nothing_is_said():
    assert odd_declared(pouch(0.49, words=None)) == ()
    assert facts_of(pouch(0.49, words=None)) is None


@pytest.fixture(scope="module")
def tall(tmp_path_factory):
    """Record of a cell whose R_c is that of a thick roll, and its model; the format is put in by each test."""
    log = make_log(Scenario(cells=1, sensors=(1,), seed=71, seconds=2400, noise=0.03))
    path = tmp_path_factory.mktemp("odd") / "log.csv"
    log.write_csv(path)
    return path, log


def named(log, words):
    return parse_model(log.model.replace("[cell]\n", f'[cell]\nformat = "{words}"\n'))


def test_a_fit_that_a_format_excludes_is_not_believed(tall):
    path, log = tall
    thin = named(log, "pouch 200x120x7mm")  # far too thin for its R_c, and about of the right mass
    assert float(np.asarray(log.pack["R_c"]).mean()) > 0.5
    records = read_measurements([path], model=thin)
    found = identify(thin, records)
    (odd,) = [o for o in odd_fitted(found.fit) if o.name == "R_c"]
    assert odd.excluded
    status = {c.name: c.status for c in changes(found.fit)}
    assert status["R_c"] == AGAINST_FORMAT
    assert AGAINST_FORMAT not in (status["R_e"], status["R_u"])
    core = known_core(thin, records)
    assert not core.proven
    assert any("R_c" in why and "not possible" in why for why in core.why)


def test_a_fit_within_its_format_is_as_without_one(tall):
    path, log = tall
    round_ = named(log, "32157 285g LFP forced")
    records = read_measurements([path], model=round_)
    bare = replace(round_, cell_format=None)
    assert odd_fitted(identify(round_, records).fit) == ()
    with_format, without = (known_core(m, records) for m in (round_, bare))
    assert (with_format.why, with_format.sd_K) == (without.why, without.sd_K)


def test_a_hypothesis_that_leaves_the_format_is_refused_where_the_model_as_it_is_does_not(tall):
    from bms_gateway.diagnosis.model_error import Bench, ModelError, averaged, fit
    from bms_gateway.diagnosis.prepare import measured
    from bms_gateway.identify.map_fit import FitEffort
    from bms_gateway.identify.problem import Problem

    path, log = tall
    thin, round_ = (named(log, w) for w in ("pouch 200x120x7mm", "32157 285g LFP forced"))
    (record,) = read_measurements([path], model=thin)
    error = ModelError()

    def hypothesis(model, base=None):
        bench = Bench([averaged(measured(record, model), error)], error)
        problem = Problem(model, bench.records, bench.beliefs)
        return judged((), fit(bench, problem, problem.begin, FitEffort(iterations=12)), (), base)

    within, against = hypothesis(round_), hypothesis(thin)
    assert "R_c" in hypothesis(thin, within).refused
    assert hypothesis(thin, against).refused == ""
    assert hypothesis(round_, within).refused == ""


def test_the_model_file_s_own_contradiction_is_the_first_thing_said(tall, tmp_path, capsys):
    path, log = tall
    text = log.model.replace("[cell]\n", f'[cell]\nformat = "{POUCH}"\n').replace("rel_sd = 0.6", "rel_sd = 0.1")
    model = tmp_path / "model.toml"
    model.write_text(text, encoding="utf-8")
    (record,) = read_measurements([path], model=parse_model(text))
    kinds = [f.kind for f in check_record(record, parse_model(text))]
    assert "cell_format" in kinds
    assert main(["compare", str(path), "--model", str(model)]) == 0
    assert "Model file: R_c" in capsys.readouterr().out
