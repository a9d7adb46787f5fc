"""Reports of many cells are small enough to be mailed, and hide nothing for it."""

import pytest

from bms_gateway.cli.main import main
from tests.report.html_page import Page
from tests.truth.hidden import Scenario, make_logs

pytest.importorskip("plotly")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "cells", "seconds", "points"),
    [("compare", 12, 3600, 400), ("diagnose", 12, 3600, 400), ("add entropic_heat", 12, 3600, 400),
     ("compare", 60, 1500, 300), ("compare", 60, 3600, 300)],
)  # fmt: skip
def test_a_report_of_many_cells_takes_less_than_two_megabytes(tmp_path, command, cells, seconds, points):
    places = tuple(range(1, cells + 1))
    hidden = {"entropic_heat": ("strong", None)}
    (log,) = make_logs([Scenario(hidden, cells=cells, sensors=places, seconds=seconds, seed=21, noise=0.05)])
    log.write_csv(tmp_path / "log.csv")
    (tmp_path / "pack.toml").write_text(log.model)
    page, table = tmp_path / "log.html", str(tmp_path / "log.csv")
    data = ["--data", table, "--out", str(tmp_path / "out.toml")] if command.startswith("add") else [table]
    assert main([*command.split(), *data, "--model", str(tmp_path / "pack.toml"), "--html", str(page)]) == 0
    print(command, cells, page.stat().st_size)
    assert page.stat().st_size < 2_000_000
    text = page.read_text(encoding="utf-8")
    figures = Page(text).figures(text)
    assert {f"overlay-1-{k}" for k in places} <= set(figures)
    drawn = [t for k in places for t in figures[f"overlay-1-{k}"]["data"][:3]]
    assert all(len(t["x"]) > points for t in drawn)  # not by drawing less
    assert {round(y, 2) for t in drawn for y in t["y"]} == {y for t in drawn for y in t["y"]}  # of a noise of 0.05 K
