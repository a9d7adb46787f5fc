"""All given records of real cells through `diagnose`: nothing is named there that cannot be."""

import pytest

from bms_gateway.thermal.effects import catalogue
from tests.benchmarks.bench_measured_records import diagnosed, table
from tests.benchmarks.measured_records import RECORDS
from tests.data import need


@pytest.mark.parametrize("folder", ["bench", "core_surface", "surface_cells"])
def test_no_given_record_is_left_out(folder):
    files = {p.name.partition(".csv")[0] for p in need(folder).iterdir() if ".csv" in p.name}
    assert files - {"a123_26650_hev2_raw_current"} == {r.name for r in RECORDS if r.folder == folder}


LONGEST = {"dmegc_18650_randomwalk_R1", "k2_26650_hppc_20C"}
"""Take minutes each: `python -m tests.benchmarks.bench_measured_records` runs them too."""


def test_what_is_impossible_is_in_the_catalogue():
    assert all(r.impossible <= set(catalogue()) for r in RECORDS)
    assert all(r.impossible for r in RECORDS)


def test_an_impossible_name_is_counted():
    row = {"record": RECORDS[0].name, "verdict": "missing_effect", "named": ["phase_change"], "looks": []}
    row |= {"impossible": ["phase_change"], "held": [0.3, None], "cpu_s": 1.0}
    assert "impossible effects named: 1 in 1 records" in table([row])


@pytest.mark.slow
@pytest.mark.parametrize("record", [r for r in RECORDS if r.name not in LONGEST], ids=lambda r: r.name)
def test_nothing_is_named_that_cannot_be(record):
    row = diagnosed(record)
    assert row["verdict"] != "refused", row["sentence"]
    assert row["impossible"] == [], row["sentence"]
    before, after = row["held"]
    if row["named"] and after >= before:  # a shape by charge, where a block alone holds a part of the charge: told
        told = ("These readings speak for it only where it was fitted.", "holds charge that no other reading covers")
        assert any(t in row["sentence"] for t in told), row["sentence"]
        assert "Fitted to the first 60 %, the error in the last 40 % falls from" in row["sentence"], (
            "nothing was predicted by it"
        )
