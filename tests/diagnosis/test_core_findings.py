"""What is said of the cores below a comparison does not contradict what is said of them in its head."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.diagnosis.compare import compare
from bms_gateway.diagnosis.core_known import known_core
from bms_gateway.diagnosis.findings import core_sentences
from bms_gateway.report.comparison_text import comparison_document, comparison_text
from bms_gateway.report.show import number
from tests.diagnosis.hidden_record import record_of
from tests.truth.hidden import Scenario, make_log

AGAINST = "or more"
FOR = "nothing speaks against it"


@pytest.fixture(scope="module")
def thinned():
    """A right model and every fifth second of its current, which leaves an error at the surface; and the true core."""
    log = make_log(Scenario(cells=1, sensors=(1,), seconds=2400, noise=0.05, seed=7, cycle="urban"))
    thin = replace(log, table={k: x[::5] for k, x in log.table.items()}, core=log.core[::5], surface=log.surface[::5])
    record, model = record_of(thin)
    core = known_core(model, [record])
    return log, record, model, core, compare(model, [record], core)


def test_an_error_that_the_band_holds_speaks_against_no_core(thinned):
    log, _, _, core, found = thinned
    assert core.proven
    assert any(s.disagrees for s in found.refitted.sensors)
    (band,) = found.refitted.cores
    assert (band.remainder_K > 0.0).all()  # the error at the surface is in the band …
    off = np.interp(band.time_s, log.table["time_s"] - log.table["time_s"][0], log.core[:, 0]) - band.T_c[:, 0]
    assert np.mean(np.abs(off) <= 1.96 * band.total_K[:, 0]) > 0.95  # … which holds the true core
    text = comparison_text(found, [], [])
    refitted = text[text.index("The same model, refitted") :]
    assert FOR in refitted
    assert AGAINST not in refitted
    assert "The bands of the cores hold the error that the model leaves at the surfaces: the core of cell 1" in refitted


@pytest.mark.parametrize("name", ["filed", "refitted"])
@pytest.mark.parametrize("agrees", [False, True])
@pytest.mark.parametrize("half_K", [0.4, 4.0])
def test_a_core_that_is_not_proven_may_be_further_off_in_every_case(thinned, half_K, agrees, name):
    *_, found = thinned
    sensors = found.refitted.sensors
    if agrees:
        sensors = [replace(s, structured_K=0.0, z=0.0, held=replace(s.held, rmse_K=s.held.floor_K)) for s in sensors]
    bands = [
        replace(b, sd_K=np.full_like(b.sd_K, half_K / 1.96), remainder_K=0.0 * b.remainder_K, share=0.0)
        for b in found.refitted.cores
    ]
    (said,) = core_sentences(bands, sensors, name, proven=False)
    assert AGAINST in said
    assert f"{half_K:.2f} K" in said  # with the digits of the head
    (said,) = core_sentences(bands, sensors, "refitted", proven=True)
    assert AGAINST not in said


def test_head_and_list_of_a_core_that_is_not_proven_say_the_same(thinned):
    _, record, model, core, _ = thinned
    found = compare(model, [record], replace(core, why=("A reason.",)))
    assert AGAINST in found.refitted.findings[-1]
    assert FOR not in comparison_text(found, [], [])


def test_a_core_that_is_not_known_has_no_number_on_the_terminal_as_on_the_page(thinned):
    # Bug: 48.4 ± 41.4 °C stood there as a result, where the page said "not known".
    *_, found = thinned
    limit = 1.96 * 12.0  # the gateway sends no core that is known to no better than 12 K
    for half_K, known in ((0.99 * limit, True), (1.01 * limit, False)):
        bands = [
            replace(b, sd_K=np.full_like(b.sd_K, half_K / 1.96), remainder_K=0.0 * b.remainder_K, share=0.0)
            for b in found.refitted.cores
        ]
        cored = replace(found, filed=replace(found.filed, cores=bands), refitted=replace(found.refitted, cores=bands))
        tables = comparison_text(cored, [], []).split("± 95 % K")[1:]
        rows = [next(x for x in t.splitlines() if x.strip().startswith("cell 1 ")) for t in tables]
        assert len(rows) == 2  # from its file, and refitted
        assert all(("not known" in x) is not known for x in rows)
        assert all((number(bands[0].T_c.max()) in x) is known for x in rows)
        (core,) = comparison_document(cored, [], [])["filed"]["core"]
        assert core["max_C"] == pytest.approx([bands[0].T_c.max()], abs=0.01)  # the document keeps its fields
