"""Model files: what is written reads back exactly, and every fault is one line that names key and remedy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.config.model_file import format_model, parse_model, read_model, write_model
from bms_gateway.errors import ConfigError
from bms_gateway.thermal import CELL_SYMBOLS, CONDITIONS, KINDS, Prior, StringModel, StringParameters

EXAMPLE = """\
cells = 5
sensors = [1, 3, 5]              # measured surfaces, 1-based
condition = "full"               # full | natural | no-conduction | single
effects = []                     # e.g. ["resistance_temperature"], one [effect.NAME] table each

[cell]
capacity_Ah = 8.0                # for SOC by counting where no SOC is given

[parameters]                     # value with unit and either rel_sd (prior) or fixed = true; per cell: values = [..]
C_c  = { value = 268.0, unit = "J/K", rel_sd = 0.05 }
C_s  = { value = 18.8, unit = "J/K", rel_sd = 0.05 }
R_e  = { value = 3.5, unit = "mOhm", rel_sd = 0.6 }
R_c  = { value = 1.266, unit = "K/W", rel_sd = 0.6 }
R_u  = { value = 0.79, unit = "K/W", rel_sd = 0.6 }
R_cc = { value = 4.0, unit = "K/W", rel_sd = 0.4 }     # strings only
C_f  = { value = 11.33, unit = "W/K", rel_sd = 0.05 }  # strings only; at nominal flow
coolant_flow = { value = 0.0095, unit = "m3/s" }       # the nominal flow

[tolerances]                     # what is not a missing effect; defaults shown
cell_R_e = 0.02
cell_R_u = 0.02
cell_R_c = 0.03
surface_offset_K = 0.05
inlet_offset_K = 0.05
"""


def same(a, b):
    """Equality of models; their arrays have no truth value of their own."""
    for name in StringModel.__dataclass_fields__:
        if name == "priors":
            continue
        assert getattr(a, name) == getattr(b, name), name
    assert a.priors.keys() == b.priors.keys()
    for symbol, prior in a.priors.items():
        other = b.priors[symbol]
        assert np.ndim(prior.value) == np.ndim(other.value)
        assert np.array_equal(prior.value, other.value), symbol
        assert prior.rel_sd == other.rel_sd


@st.composite
def models(draw):
    cells = draw(st.integers(1, 6))
    condition = draw(st.sampled_from(CONDITIONS))
    coupled = {
        "R_cc": cells > 1 and condition in ("full", "natural"),
        "C_f": cells > 1 and condition in ("full", "no-conduction"),
    }
    priors = {}
    for symbol, kind in KINDS.items():
        if not coupled.get(symbol, True):
            continue
        inside = st.floats(kind.lower, kind.upper)
        per_cell = symbol in CELL_SYMBOLS and draw(st.booleans())
        value = np.array(draw(st.lists(inside, min_size=cells, max_size=cells))) if per_cell else draw(inside)
        priors[symbol] = Prior(value, draw(st.just(0.0) | st.floats(1e-4, 3.0)))
    return StringModel(
        cells=cells,
        sensors=tuple(sorted(draw(st.sets(st.integers(1, cells))))),
        condition=condition,
        priors=priors,
        coolant="ntu",
        capacity_Ah=draw(st.none() | st.floats(0.1, 1000.0)),
        flow=draw(st.none() | st.floats(1e-6, 1.0)),
        tolerances={
            name: draw(st.floats(0.0, 1.0))
            for name in ("cell_R_e", "cell_R_u", "cell_R_c", "surface_offset_K", "inlet_offset_K")
        },
    )


@settings(deadline=None, max_examples=100)
@given(models())
def test_what_is_written_reads_back_bit_for_bit(model):
    same(parse_model(format_model(model)), model)


def test_the_example_means_what_it_says():
    model = parse_model(EXAMPLE)
    assert (model.cells, model.sensors, model.condition, model.coolant) == (5, (1, 3, 5), "full", "bulk")
    assert model.capacity_Ah == 8.0
    assert model.flow == 0.0095
    p = model.nominal
    expected = StringParameters.of(5, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79, R_cc=4.0, C_f=11.33)
    for name in (*CELL_SYMBOLS, "R_cc", "C_f"):
        assert np.allclose(getattr(p, name), getattr(expected, name), rtol=1e-12), name
    assert model.priors["R_e"].rel_sd == 0.6


def test_units_people_write_mean_the_same():
    forms = [
        '3.5, unit = "mOhm"',
        '3.5, unit = "mΩ"',
        '0.0035, unit = "Ohm"',
        '0.0035, unit = "Ω"',
        '3500, unit = "uOhm"',
    ]
    values = [parse_model(EXAMPLE.replace('3.5, unit = "mOhm"', form)).priors["R_e"].value for form in forms]
    assert np.allclose(values, 0.0035, rtol=1e-12)


def test_tolerances_and_cell_may_be_left_out():
    text = EXAMPLE[: EXAMPLE.index("[tolerances]")].replace("[cell]\ncapacity_Ah = 8.0 ", "")
    model = parse_model(text)
    assert model.capacity_Ah is None
    assert model.tolerances["cell_R_c"] == 0.03


def test_coupling_without_effect_is_left_aside_so_that_only_the_condition_needs_to_change():
    model = parse_model(EXAMPLE.replace('"full"', '"single"'))
    assert set(model.priors) == set(CELL_SYMBOLS)


FAULTS = [
    ("cells = 5", "cels = 5", "cels: unknown key; did you mean 'cells'?"),
    ("cells = 5", "cells = 0", "cells: 0"),
    ("cells = 5", 'cells = "5"', "cells: '5': input should be a valid integer"),
    ("[1, 3, 5]", "[1, 9]", "sensors: cell 9 does not exist; valid: 1 to 5"),
    ("[1, 3, 5]", "[1, 1]", "sensors: cell 1 is named twice"),
    ('"full"', '"ful"', "condition: 'ful' is not known; did you mean 'full'?"),
    ("effects = []", 'effects = ["entropic_heat"]', "effects are not available in this version"),
    ("[tolerances]", "[effect.entropic_heat]\n[tolerances]", "effect.entropic_heat"),
    ("[tolerances]", "[tolerence]", "tolerence: unknown key; did you mean 'tolerances'?"),
    ("cell_R_u = 0.02", "cell_R_u = -0.02", "tolerances.cell_R_u: -0.02"),
    ("R_cc = {", "R_xc = {", "parameters.R_xc: unknown key; did you mean 'R_c"),
    ("R_cc = {", "# R_cc = {", "parameters.R_cc: missing"),
    ("C_f  = {", "# C_f  = {", "parameters.C_f: missing"),
    ("R_u  = {", "# R_u  = {", "parameters.R_u: missing"),
    ('3.5, unit = "mOhm"', '3.5, unit = "Ohm"', "parameters.R_e: 3.5 Ohm is not plausible; valid: 1e-05 to 1 Ohm"),
    ('3.5, unit = "mOhm"', '3.5, unit = "mOm"', "parameters.R_e: unit 'mOm' does not fit R_e; did you mean 'mOhm'?"),
    ('3.5, unit = "mOhm"', "3.5", "parameters.R_e.unit: missing"),
    ("value = 3.5", "value = nan", "parameters.R_e.value: nan: input should be a finite number"),
    ("value = 3.5", 'value = "3.5"', "parameters.R_e.value: '3.5': input should be a valid number"),
    ("value = 3.5, ", "", "parameters.R_e: needs either value or values"),
    ("value = 3.5", "values = [3.5, 3.6]", "parameters.R_e: 2 values for 5 cells"),
    ("value = 4.0", "values = [4.0, 4.0, 4.0, 4.0, 4.0]", "parameters.R_cc: is one number for the whole string"),
    ("rel_sd = 0.4", "fixed = false", "parameters.R_cc: needs either rel_sd"),
    ("rel_sd = 0.4", "fixed = true, rel_sd = 0.4", "parameters.R_cc: needs either rel_sd"),
    ("rel_sd = 0.4", "rel_sd = 40.0", "parameters.R_cc.rel_sd: 40.0"),
    ("rel_sd = 0.4", "rel_sd = 0.0", "parameters.R_cc.rel_sd: 0.0"),
    ('"m3/s"', '"gpm"', "parameters.coolant_flow: unit 'gpm' does not fit coolant_flow; valid: "),
    ("value = 11.33", "value = 0.9", 'use coolant = "ntu" or a larger C_f'),
    ("capacity_Ah = 8.0", "capacity_Ah = 0", "cell.capacity_Ah: 0"),
    ("[cell]", "[cell", "not valid TOML"),
    ("[cell]", "cell = 3\n[other]", "other: unknown key"),
]


@pytest.mark.parametrize(("old", "new", "says"), FAULTS)
def test_every_fault_is_one_line_with_file_key_and_remedy(tmp_path, old, new, says):
    assert old in EXAMPLE
    file = tmp_path / "string.toml"
    file.write_text(EXAMPLE.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        read_model(file)
    line = str(caught.value)
    assert line.startswith(f"{file}: ")
    assert says in line
    assert "\n" not in line


def test_a_missing_file_names_the_nearest(tmp_path):
    write_model(parse_model(EXAMPLE), tmp_path / "string_1.toml")
    with pytest.raises(ConfigError, match=r"did you mean 'string_1\.toml'"):
        read_model(tmp_path / "string1.toml")


def test_what_is_no_text_is_said(tmp_path):
    (tmp_path / "a.toml").write_bytes(b"cells = 5\xff\xfe")
    with pytest.raises(ConfigError, match="not UTF-8 text"):
        read_model(tmp_path / "a.toml")


def test_a_failed_write_leaves_the_old_file(tmp_path):
    with pytest.raises(ConfigError, match="cannot be written"):
        write_model(parse_model(EXAMPLE), tmp_path / "absent" / "a.toml")
