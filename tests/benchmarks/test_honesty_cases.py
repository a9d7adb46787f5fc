"""The cases of the benchmark of honesty: what they hide and show, and how outcomes are counted."""

import csv
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.config.load import load_config
from tests.benchmarks.honesty_case import Outcome
from tests.benchmarks.honesty_measured import SISTERS, measured_cells
from tests.benchmarks.honesty_scores import score
from tests.benchmarks.honesty_simulated import CONTROLS, FLOW, KINDS, Drive, SimulatedDrive, chosen, drives
from tests.benchmarks.honesty_tables import compared, simulated_summary
from tests.truth.hidden import make_log
from tests.truth.sizes import SIZES
from tests.truth.strange import OUTSIDE

SEEN = ("time_s", "current_A", "voltage_V", "coolant_inlet_C", "surface_1_C")


def test_every_effect_is_missing_at_both_sizes_and_no_pack_is_twice():
    some = drives(1)
    assert {d.kind for d in some} == set(KINDS)
    for size in ("medium", "strong"):
        assert {n for d in some if d.kind == f"{size} effect" for n in d.scenario.effects} == set(SIZES)
        assert {n for d in some if d.kind == f"outside, {size}" for n in d.scenario.effects} == set(OUTSIDE)
    assert sum(bool(d.scenario.effects) for d in some) >= 120
    seeds = [d.scenario.seed for d in some] + [d.scenario.seed for d in drives(2)]
    assert len(set(seeds)) == len(seeds)
    for d in some:
        s = d.scenario
        assert (s.seconds, s.noise, s.step) == (3600, 0.05, 0.1)
        assert s.sensors == ((1,) if s.cells == 1 else (1, (s.cells + 1) // 2, s.cells))
        assert (d.kind in (*CONTROLS, FLOW)) == (not s.effects)
        assert (s.flow == "steps" and "flow" not in s.columns) == (d.kind == FLOW)
    together = [d.scenario.effects for d in some if "usual effects" in d.kind]
    assert len(together) == 18
    assert all(len(e) >= 12 and min(size for size, _ in e.values()) > 0 for e in together)


def test_a_part_has_of_every_kind_its_share():
    some = drives(3)
    part = chosen(some, 40, 3)
    assert len(part) == 40
    whole, taken = Counter(d.kind for d in some), Counter(d.kind for d in part)
    assert all(abs(taken[kind] - 40 * n / len(some)) <= 1 and taken[kind] for kind, n in whole.items())
    assert chosen(some, 40, 3) == part
    assert set(map(id, chosen(some, 12, 3))) < set(map(id, part))  # the smaller part is in the larger
    named = chosen(some, None, 3, ["radial", "outside, strong"])
    assert {d.kind for d in named} >= {"outside, strong", "one cell, medium"}
    assert all("radial" in d.label or d.kind == "outside, strong" for d in named)


def test_the_product_sees_no_core_and_the_data_sheets_numbers(tmp_path):
    (drive,) = chosen(drives(1), None, 1, ["nothing n=5 urban"])[:1]
    drive = Drive(drive.kind, replace(drive.scenario, seconds=60, columns=("flow", "soc", "voltage")))
    case = SimulatedDrive(drive, make_log(drive.scenario))
    assert case.core.shape == (60, 5)
    with case.write_table(tmp_path).open(newline="") as f:
        rows = list(csv.DictReader(f))
    assert [k for k in rows[0] if "core" in k] == []
    assert float(rows[30]["voltage_V"]) == pytest.approx(5 * case.log.table["voltage_V"][30], rel=1e-6)
    (string,) = load_config(case.write_config(tmp_path, "default", "off")).plan.strings
    assert {c.quantity for c in string.channels if c.signal is not None} == {
        "current", "voltage", "coolant_inlet", "coolant_flow", "soc", "surface"}  # fmt: skip
    R_c = string.model.priors["R_c"]
    assert (R_c.value, R_c.rel_sd) == (1.266, 0.3)
    assert case.log.pack["R_c"].mean() != pytest.approx(1.266, rel=1e-3)


def test_measured_cells_come_without_and_with_voltage_and_without_their_core(tmp_path):
    found = measured_cells(["insulated_1", "hev2"])
    assert [(c.label, c.has_voltage) for c in found] == [
        ("hev2", False), ("hev2 + V", True), ("insulated_1", False), ("insulated_1 + V", True)]  # fmt: skip
    for c in found:
        with c.write_table(tmp_path).open(newline="") as f:
            rows = list(csv.DictReader(f))
        assert float(rows[-1]["time_s"]) == pytest.approx(c.time_s[-1], abs=1.0)
        assert not any(r[name] for r in rows for name in r if name not in SEEN)
        (string,) = load_config(c.write_config(tmp_path / c.label, "default")).plan.strings
        has = {x.quantity for x in string.channels if x.signal is not None}
        assert ("voltage" in has) == c.has_voltage
    line = found[2].one_liner()
    assert line is not None
    warm = found[2].surface - found[2].ambient
    k = int(np.argmax(warm))
    assert line[k] - found[2].surface[k] > 1.0  # of a warm cell the core is warmer
    assert found[0].name not in SISTERS


def outcome(case, method, error, *, told=0.0, kind="medium effect", sd=1.0):
    """Ten instants of one cell, all off by `error` K, with something told for a share `told` of them."""
    mean, true = np.full((10, 1), 25.0 + error), np.full((10, 1), 25.0)
    s = score(mean, np.full((10, 1), sd), true, (np.arange(10) < 10 * told)[:, None])
    return Outcome(case, kind, "default", method, {"settled": s, "late": s})


def test_wrong_is_confidently_wrong_only_where_nothing_is_told():
    off, told, right = outcome("a", "ours", 3.0), outcome("b", "ours", 3.0, told=0.2), outcome("c", "ours", 1.0)
    assert [o.confidently_wrong() for o in (off, told, right)] == [True, False, False]
    assert [o.honest() for o in (off, told, right)] == [False, False, True]
    assert not outcome("core = surface", "peer", 3.0, sd=0.0).confidently_wrong()  # it claims no band
    failed = Outcome("d", "medium effect", "default", "ours", error="no such file")
    assert not failed.honest()
    refused = Outcome("f", "medium effect", "default", "ours", refused=True)
    lines = simulated_summary([off, told, right, failed, refused, outcome("e", "ours", 0.5, kind=CONTROLS[0])])
    assert any("confidently wrong (< 80 % inside, nothing told) 1 of 3" in line for line in lines)
    assert any("nothing hidden: 100.0 % inside, sd over rms error 2.0 to 2.0" in line for line in lines)
    assert any("1 FAILED  1 not added" in line for line in lines)


def test_two_checkouts_are_compared_case_by_case():
    some = [outcome(c, m, e) for c, m, e in (("a", "ours", 1.0), ("a", "before", 3.0), ("b", "ours", 2.5),
            ("b", "before", 0.5), ("c", "ours", 1.0), ("c", "before", 1.0), ("only", "ours", 9.0))]  # fmt: skip
    head, *moved = compared(some, "ours", "before")
    assert "3 pairs" in head
    assert "better in 1, worse in 1, of the 2 honest before worse in 1, no longer honest 1" in head
    assert [line.split()[1] for line in moved] == ["b:"]
    assert compared(some[:1], "ours", "before") == []
