"""Contours of two parameters: they are those of the fit's posterior, on axes that do not move with what is ticked."""

import numpy as np
import pytest

from bms_gateway.config.model_file import read_model
from bms_gateway.diagnosis.compare import compare
from bms_gateway.diagnosis.core_band import posterior
from bms_gateway.records.read import read_measurements
from bms_gateway.report.html_correlation import correlations
from bms_gateway.workbench.contours import known
from tests.support.page_steps import ADDED, FIT_S, seen_added, seen_compared
from tests.truth.packs import pack as make_pack
from tests.workbench.browser import faults
from tests.workbench.conftest import served

WITHIN = {0.95: 2.4477, 0.68: 1.5096}
"""Share of two Gaussian numbers, and the radius in sd that holds it: 1 − exp(−r²/2)."""


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack"))


@pytest.fixture(scope="module")
def fit(pack):
    model = read_model(pack.model)
    return compare(model, read_measurements([pack.hidden], model=model)).refitted.fit


def test_radii_hold_their_share():
    assert {share: 1.0 - np.exp(-(r**2) / 2) for share, r in WITHIN.items()} == pytest.approx(
        {s: s for s in WITHIN}, abs=1e-3
    )


def test_numbers_and_covariance_are_those_of_the_fit(fit):
    found = known(fit)
    names, r = correlations(fit)
    assert [n["name"] for n in found["numbers"]] == names
    of = np.array(found["covariance"])
    sd = np.sqrt(np.diag(of))
    np.testing.assert_allclose(of / np.outer(sd, sd), r, atol=1e-5)
    for n in found["numbers"]:
        i = next(k for k, c in enumerate(fit.problem.coordinates) if c.name == n["key"])
        assert n["log"]
        nominal = np.mean(fit.problem.model.priors[n["key"]].value)
        in_si = 1e-3 if n["unit"] == "mΩ" else 1.0
        assert in_si * n["scale"] * np.exp(n["at"]) == pytest.approx(nominal * np.exp(fit.theta[i]), rel=1e-6)
        assert n["before"][1] == pytest.approx(fit.problem.model.priors[n["key"]].rel_sd)
        assert of[names.index(n["name"]), names.index(n["name"])] == pytest.approx(posterior(fit)[i, i], rel=1e-6)


CURVES = (
    "return document.querySelector('#plot-pair').data"
    ".map(d => ({name: d.name, mode: d.mode, x: [...d.x], y: [...d.y]}))"
)


@pytest.mark.slow
def test_contours_in_the_page(window, pack, axe):
    with served(pack.folder, *pack.words) as url:
        page = window(url)
        seen_compared(page)
        page.idle(FIT_S)
        page.click("#tab-compare")
        page.click("#pairs summary")
        page.wait("return document.querySelector('#plot-pair').dataset.pair")
        pair = page.run("return document.querySelector('#plot-pair').dataset.pair").split(",")
        desk = page.run("return JSON.parse(sessionStorage.workbench).desk")
        state = page.run("return fetch(`/api/state?desk=${arguments[0]}`).then(r => r.json())", desk)
        told = state["steps"][1]["variant"]["known"]
        keys, of = [n["key"] for n in told["numbers"]], np.array(told["covariance"])
        r = np.abs(of / np.sqrt(np.outer(np.diag(of), np.diag(of)))) - np.eye(len(of))
        i, j = (keys.index(k) for k in pair)
        assert r[i, j] == pytest.approx(r.max())  # the two that are hardest to tell apart come first
        assert f"{r.max():.2f}" in page.text("#pair-told")
        curves = page.run(CURVES)
        assert [(c["name"], c["mode"]) for c in curves] == [
            ("known before", "lines"), ("refitted", "lines"), ("refitted", "lines"), ("refitted", "markers"),
        ]  # fmt: skip
        at = np.array([told["numbers"][k]["at"] for k in (i, j)])
        scale = np.array([told["numbers"][k]["scale"] for k in (i, j)])
        inverse = np.linalg.inv(of[np.ix_((i, j), (i, j))])
        for c, radius in zip(curves[1:3], WITHIN.values(), strict=True):
            z = np.log(np.stack([c["x"], c["y"]], axis=1) / scale) - at
            np.testing.assert_allclose(np.sqrt(np.einsum("ki,ij,kj->k", z, inverse, z)), radius, rtol=1e-3)
        assert faults(page, axe) == []

        # another pair, by keyboard's way; who is chosen twice changes places
        other = next(k for k in keys if k not in pair)
        choose = (
            "const s = document.querySelector(arguments[0]);"
            "s.value = arguments[1]; s.dispatchEvent(new Event('change'));"
        )
        page.run(choose, "#pair-x", other)
        page.wait("return document.querySelector('#plot-pair').dataset.pair === arguments[0]", f"{other},{pair[1]}")
        page.run(choose, "#pair-y", other)
        page.wait("return document.querySelector('#plot-pair').dataset.pair === arguments[0]", f"{pair[1]},{other}")
        assert page.run("return document.querySelector('#pair-x').value") == pair[1]

        # what an addition does to them, on axes that do not move
        seen_added(page)
        page.wait(
            "return document.querySelector('#plot-pair').data.some(d => d.name === arguments[0])",
            ADDED,
            patience_s=FIT_S,
        )
        ranges = "return ['xaxis', 'yaxis'].map(a => document.querySelector('#plot-pair').layout[a].range.join())"
        axes = page.run(ranges)
        page.click("#step-1")
        page.wait("return !document.querySelector('#plot-pair').data.some(d => d.name === 'refitted')")
        assert page.run(ranges) == axes
        for width in (390, 1024, 1920):
            page.cdp("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
            page.wait("return document.documentElement.scrollWidth <= innerWidth", patience_s=20)
        page.reload()  # the two stay chosen
        page.idle(FIT_S)
        page.click("#tab-compare")
        page.click("#pairs summary")
        page.wait("return document.querySelector('#plot-pair').dataset.pair === arguments[0]", f"{pair[1]},{other}")
        assert page.complaints() == []
