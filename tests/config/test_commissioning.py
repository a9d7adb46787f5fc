"""`[commissioning]` of model files: what is written reads back exactly, and every fault is one line."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.config.model_file import format_model, parse_model
from bms_gateway.errors import ConfigError
from bms_gateway.identify.cell_kept import baseline_of
from bms_gateway.identify.cell_prior import Layout
from bms_gateway.thermal import CONDITIONS, Commissioning, Prior, StringModel

VALUES = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79, "R_cc": 4.0, "C_f": 11.33}


def model(cells=5, condition="full", seed=0, fixed=()) -> StringModel:
    """Cells told apart, with errors that hang together at random."""
    rng = np.random.default_rng(seed)
    each = ("R_e", "R_u", "R_c", "C_c")
    coupled = {"R_cc": condition in ("full", "natural"), "C_f": condition in ("full", "no-conduction")}
    priors = {
        s: Prior(x * np.exp(rng.normal(0, 0.1, cells)) if s in each else x, 0.0 if s in fixed else 0.05)
        for s, x in VALUES.items()
        if coupled.get(s, True)
    }
    m = StringModel(cells, (1, cells), condition, priors, "ntu")
    labels = Layout.of(m).labels
    factors = rng.normal(size=(len(labels), 3 * len(labels)))
    correlation = np.corrcoef(factors)
    np.fill_diagonal(correlation, 1.0)
    electrical = np.where(rng.random(cells) < 0.7, 3e-3 * np.exp(rng.normal(0, 0.1, cells)), np.nan)
    told = Commissioning(labels, np.exp(rng.normal(-4, 1, len(labels))), correlation, electrical)
    return replace(m, commissioning=told)


@settings(deadline=None, max_examples=40)
@given(
    st.integers(2, 7),
    st.sampled_from(CONDITIONS),
    st.integers(0, 10_000),
    st.sets(st.sampled_from(["C_c", "C_s", "R_u"])),
)
def test_what_is_written_reads_back_bit_for_bit(cells, condition, seed, fixed):
    m = model(cells, condition, seed, fixed)
    back = parse_model(format_model(m))
    a, b = m.commissioning, back.commissioning
    assert b.names == a.names
    assert np.array_equal(b.rel_sd, a.rel_sd)
    assert np.array_equal(b.correlation, a.correlation)
    assert np.array_equal(b.electrical, a.electrical, equal_nan=True)
    one, two = baseline_of(m), baseline_of(back)
    assert np.array_equal(one.mean, two.mean)
    assert np.array_equal(one.cov, two.cov)


def test_the_order_of_the_names_does_not_matter():
    m = model()
    c = m.commissioning
    at = np.random.default_rng(3).permutation(len(c.names))
    mixed = Commissioning(tuple(c.names[i] for i in at), c.rel_sd[at], c.correlation[np.ix_(at, at)], c.electrical)
    back = parse_model(format_model(replace(m, commissioning=mixed))).commissioning
    assert back.names == c.names
    assert np.array_equal(back.rel_sd, c.rel_sd)
    assert np.array_equal(back.correlation, c.correlation)


@pytest.mark.parametrize(
    ("was", "becomes", "told"),
    [
        ('"R_e:3"', '"R_e:7"', "commissioning.names: 'R_e:7' is no number of this model; did you mean 'R_e:"),
        ('"R_e:3"', '"R_e:2"', "commissioning.names: 'R_e:2' is there twice"),
        ('names = ["R_e:1", ', "names = [", "commissioning.names: 'R_e:1' is missing; run fit --cells again"),
        ("rel_sd = [", "rel_sd = [0.1, ", "commissioning.rel_sd: 23 names need 23 numbers above 0"),
        ("correlation = [\n", "correlation = [\n  [1.0],\n", "commissioning.correlation: 23 names need 23 rows"),
        ("  [1.0, ", "  [1.2, ", "commissioning.correlation: this is no correlation matrix"),
        ("electrical = { cells = [1", "electrical = { cells = [9", "electrical: cell 9 does not exist; valid: 1 to 5"),
        ('unit = "mOhm" }\ncorrelation', 'unit = "Ohm" }\ncorrelation', "commissioning.electrical: "),
    ],
)
def test_a_fault_is_one_line(was, becomes, told):
    text = format_model(model(seed=5))
    assert was in text
    with pytest.raises(ConfigError, match=r"^pack.toml: ") as e:
        parse_model(text.replace(was, becomes, 1), "pack.toml")
    assert told in str(e.value)
    assert "\n" not in str(e.value)


def test_a_model_from_before_any_data_knows_of_no_commissioning():
    m = model()
    assert replace(m, before=m.priors).unfitted.commissioning is None
