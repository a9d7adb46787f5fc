"""Model files: what is written reads back exactly, and every fault is one line that names key and remedy."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.config.model_file import format_model, parse_model, read_model, write_model
from bms_gateway.errors import ConfigError
from bms_gateway.thermal import (
    CELL_SYMBOLS,
    CONDITIONS,
    KINDS,
    AddedEffect,
    Prior,
    Share,
    StringModel,
    StringParameters,
)
from bms_gateway.thermal.effects import catalogue
from tests.config.model_texts import EXAMPLE, WITH_EFFECTS


def same(a, b):
    """Equality of models; their arrays have no truth value of their own."""
    for name in StringModel.__dataclass_fields__:
        if name not in ("priors", "before", "correlation"):
            assert getattr(a, name) == getattr(b, name), name
    same_priors(a.priors, b.priors)
    assert (a.before is None) == (b.before is None)
    if a.before is not None:
        same_priors(a.before, b.before)
    assert (a.correlation is None) == (b.correlation is None)
    if a.correlation is not None:
        assert a.correlation[0] == b.correlation[0]
        assert np.array_equal(a.correlation[1], b.correlation[1])


def same_priors(a, b):
    assert a.keys() == b.keys()
    for symbol, prior in a.items():
        other = b[symbol]
        assert np.ndim(prior.value) == np.ndim(other.value)
        assert np.array_equal(prior.value, other.value), symbol
        assert prior.rel_sd == other.rel_sd


@st.composite
def known(draw, cells, condition):
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
    return priors


@st.composite
def added(draw, cells, sensors):
    """Effects at every place, some of them on several cells."""
    found = {}
    for _ in range(draw(st.integers(0, 5))):
        effect = catalogue()[draw(st.sampled_from(sorted(catalogue())))]
        places = {"string": [None], "cell": range(1, cells + 1), "sensor": sensors, "gap": range(1, cells - 1)}
        where = list(places[effect.place])
        if cells < effect.least_cells or not where:
            continue
        values, sd, start = {}, {}, {}
        for p in effect.parameters:
            values[p.name] = draw(st.floats(p.lower, p.upper))
            sd[p.name] = draw(st.just(0.0) | st.floats(1e-6 * p.sd, 10 * p.sd))
            start[p.name] = draw(st.floats(p.lower, p.upper)) if sd[p.name] else values[p.name]
        begin = draw(st.sampled_from([None, start])) if any(sd.values()) else None
        e = AddedEffect(effect.name, draw(st.sampled_from(where)), values, sd, begin)
        found[e.key] = e
    return tuple(found.values())


@st.composite
def models(draw):
    unit = st.floats(0.0, 1.0)
    cells = draw(st.integers(1, 6))
    condition = draw(st.sampled_from(CONDITIONS))
    sensors = tuple(sorted(draw(st.sets(st.integers(1, cells)))))
    priors = draw(known(cells, condition))
    effects = draw(added(cells, sensors))
    names = [*priors, *(f"{e.key}.{p}" for e in effects for p in e.values)]
    chosen = tuple(draw(st.lists(st.sampled_from(names), unique=True, min_size=1)))
    factors = np.random.default_rng(draw(st.integers(0, 99))).normal(size=(len(chosen), 2 * len(chosen)))
    correlation = np.corrcoef(factors) if len(chosen) > 1 else np.ones((1, 1))
    return StringModel(
        cells=cells,
        sensors=sensors,
        condition=condition,
        priors=priors,
        coolant="ntu",
        capacity_Ah=draw(st.none() | st.floats(0.1, 1000.0)),
        centre_share=draw(st.none() | st.builds(Share, unit, unit)),
        core_probe=draw(st.none() | st.builds(Share, unit, unit)),
        flow=draw(st.none() | st.floats(1e-6, 1.0)),
        tolerances={
            name: draw(st.floats(0.0, 1.0))
            for name in ("cell_R_e", "cell_R_u", "cell_R_c", "surface_offset_K", "inlet_offset_K")
        },
        effects=effects,
        before=draw(st.none() | known(cells, condition)),
        correlation=draw(st.none() | st.just((chosen, correlation))),
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


def test_effects_mean_what_they_say():
    model = parse_model(WITH_EFFECTS)
    entropic, cell, transfer = model.effects
    assert (entropic.key, cell.key, transfer.key) == ("entropic_heat", "cell_resistance:4", "charge_transfer")
    assert entropic.values["dUdT"] == pytest.approx(0.55e-3, rel=1e-12)
    assert entropic.sd["dUdT"] == pytest.approx(0.04e-3, rel=1e-12)
    # what is not given does nothing, for certain
    assert entropic.values == {"dUdT": entropic.values["dUdT"], "dUdT_1": 0, "dUdT_2": 0, "dUdT_3": 0, "dUdT_4": 0}
    assert (entropic.sd["dUdT_1"], entropic.sd["dUdT_4"]) == (0.0, 0.0)
    assert (cell.values, cell.sd) == ({"a": 0.15}, {"a": 0.03})
    assert (transfer.values, transfer.sd) == ({"I_0": 12.0, "E": 5000.0}, {"I_0": 0.3, "E": 0.0})
    names, matrix = model.correlation
    assert names == ("R_e", "entropic_heat.dUdT", "cell_resistance:4.a")
    assert matrix.tolist() == [[1.0, -0.4, 0.1], [-0.4, 1.0, 0.0], [0.1, 0.0, 1.0]]
    assert model.before["R_e"].rel_sd == 0.6
    assert model.unfitted.correlation is None


def test_a_fit_that_ended_on_a_bound_reads_back():
    model = parse_model(WITH_EFFECTS)
    above = float(np.nextafter(1e5, np.inf))
    values = {"I_0": above, "E": 15000.0}
    at_bound = replace(model, correlation=None, effects=(replace(model.effects[2], values=values),))
    assert parse_model(format_model(at_bound)).effects[0].values == values


def test_one_effect_on_several_cells_is_named_by_its_cell():
    text = (
        EXAMPLE.replace("effects = []", 'effects = ["cell_resistance:4", "cell_resistance:2"]')
        + """
[effect."cell_resistance:4"]
a = { value = 0.2, sd = 0.1 }
[effect."cell_resistance:2"]
cell = 2
a = { value = 0.1, unit = "1", fixed = true }
"""
    )
    model = parse_model(text)
    assert [e.key for e in model.effects] == ["cell_resistance:4", "cell_resistance:2"]
    written = format_model(model)
    assert '[effect."cell_resistance:4"]' in written
    assert "\ncell = " not in written
    same(parse_model(written), model)
    single = format_model(parse_model(WITH_EFFECTS))
    assert "[effect.cell_resistance]" in single
    assert "\ncell = 4\n" in single


def test_correlation_of_coupling_that_the_condition_has_not_is_left_aside():
    model = parse_model(WITH_EFFECTS.replace('"full"', '"single"').replace('"R_e", "ent', '"R_cc", "ent'))
    assert model.correlation[0] == ("entropic_heat.dUdT", "cell_resistance:4.a")
    assert model.correlation[1].shape == (2, 2)


ENTROPY = "effects: effect 'entropy_heat' is not in the catalogue; did you mean 'entropic_heat'?"
EFFECT_FAULTS = [
    ('"entropic_heat", "cell', '"entropy_heat", "cell', ENTROPY),
    ('"entropic_heat", "cell', '"cell', "effect.entropic_heat: is not in effects"),
    (
        "[effect.entropic_heat]",
        "[effect.entropik_heat]",
        "effect.entropik_heat: is not in effects",
    ),
    (
        '"charge_transfer"]',
        '"charge_transfer", "inlet_ofset"]',
        "effects: effect 'inlet_ofset' is not in the catalogue; did you mean 'inlet_offset'?",
    ),
    (
        '"charge_transfer"]',
        '"charge_transfer", "inlet_offset"]',
        "effects: 'inlet_offset' has no numbers; add [effect.inlet_offset] with "
        'b = { value = 0.3, unit = "K", sd = 1 }',
    ),
    (
        '"charge_transfer"]',
        '"charge_transfer", "cell_cooling:2"]',
        """'cell_cooling:2' has no numbers; add [effect."cell_cooling:2"] with a = { value = 0.12, unit = "1\"""",
    ),
    ('"charge_transfer"]', '"charge_transfer", "entropic_heat"]', "effects: 'entropic_heat' is listed twice"),
    (
        'effects = ["entropic_heat",',
        'effect."cell_resistance:4".a = { value = 0.1, sd = 1 }\neffects = ["cell_resistance:4", "entropic_heat",',
        "effects: 'cell_resistance' is the same as 'cell_resistance:4'",
    ),
    ("dUdT = {", "dUdt = {", "effect.entropic_heat.dUdt: unknown key; did you mean 'dUdT'?"),
    ("dUdT = {", "dUdT_1 = {", "effect.entropic_heat.dUdT: missing; needed: [effect.entropic_heat] with dUdT = {"),
    ("value = 0.55, ", "", "effect.entropic_heat.dUdT.value: missing"),
    ("value = 0.55,", "value = 55,", "effect.entropic_heat.dUdT: 55 mV/K is not plausible; valid: -1.5 to 1.5 mV/K"),
    ('"mV/K", sd', '"mV", sd', "effect.entropic_heat.dUdT: unit 'mV' does not fit dUdT; did you mean 'mV/K'?"),
    (', unit = "mV/K", sd', ", sd", 'effect.entropic_heat.dUdT.unit: missing; write unit = "mV/K"'),
    ("sd = 0.04", "rel_sd = 0.04", "effect.entropic_heat.dUdT.rel_sd: its uncertainty is known in mV/K; use sd"),
    ("rel_sd = 0.3", "sd = 0.3", "effect.charge_transfer.I_0.sd: its uncertainty is known in per cent; use rel_sd"),
    ("sd = 0.04", "fixed = true, sd = 0.04", "effect.entropic_heat.dUdT: needs either sd"),
    (", sd = 0.04", "", "effect.entropic_heat.dUdT: needs either sd"),
    ("sd = 0.04", "sd = 0", "effect.entropic_heat.dUdT.sd: 0"),
    ("sd = 0.04", "sd = 1e308", "effect.entropic_heat.dUdT.sd: far wider than dUdT can be; valid: up to 3e+03 mV/K"),
    (
        "rel_sd = 0.3",
        "rel_sd = 1e308",
        "effect.charge_transfer.I_0.rel_sd: far wider than I_0 can be; valid: up to 161",
    ),
    ("sd = 0.04", "sdd = 0.04", "effect.entropic_heat.dUdT.sdd: unknown key; did you mean 'sd'?"),
    ("dUdT = { value = 0.55", "cell = 2\ndUdT = { value = 0.55", "effect.entropic_heat: entropic_heat sits on no cell"),
    ("cell = 4\n", "", "effect.cell_resistance.cell: missing; cell_resistance sits on one cell; valid: 1 to 5"),
    ("cell = 4\n", "cell = 6\n", "effect.cell_resistance.cell: cell 6 is no place for it; valid: 1 to 5"),
    ("cell = 4\n", 'cell = "4"\n', "effect.cell_resistance.cell: '4': input should be a valid integer"),
    ('"cell_resistance"', '"cell_resistance:x"', "effect.cell_resistance: is not in effects"),
    ("dUdT = { value = 0.55, ", "dUdT = 3 # ", "effect.entropic_heat.dUdT: expected a table, got 3"),
    ('"R_e", "ent', '"R_x", "ent', "correlation.names: 'R_x' is no number of this model; did you mean 'R_"),
    ('"R_e", "ent', '"cell_resistance:4.a", "ent', "correlation.names: 'cell_resistance:4.a' is there twice"),
    ('"R_e", "ent', '"ent', "correlation.matrix: 2 names need 2 rows of 2 numbers"),
    ("[-0.4, 1.0, 0.0]", "[0.4, 1.0, 0.0]", "correlation.matrix: must be symmetric"),
    ("[-0.4, 1.0, 0.0]", "[-0.4, 1.1, 0.0]", "correlation.matrix: must have 1 on its diagonal"),
    (
        "[1.0, -0.4, 0.1],\n  [-0.4,",
        "[1.0, -1.4, 0.1],\n  [-1.4,",
        "correlation.matrix: this is no correlation matrix (it is not positive semidefinite)",
    ),
    ("[before]\nC_c", "[before]\nC_x", "before.C_x: unknown key"),
    ('C_f  = { value = 11.33, unit = "W/K", rel_sd = 0.05 }\n', "", "before.C_f: missing"),
]


@pytest.mark.parametrize(("old", "new", "says"), EFFECT_FAULTS)
def test_every_fault_in_an_effect_is_one_line_with_its_remedy(old, new, says):
    assert old in WITH_EFFECTS
    with pytest.raises(ConfigError) as caught:
        parse_model(WITH_EFFECTS.replace(old, new, 1), "string.toml")
    line = str(caught.value)
    assert line.startswith("string.toml: ")
    assert says in line
    assert "\n" not in line


@pytest.mark.parametrize(
    ("cells", "name", "says"),
    [
        (2, "thermocouple_offset", "cell 2 has no sensor; valid: 1"),
        (2, "coolant_bypass", "effect.coolant_bypass: needs at least 3 cells; this model has 2"),
        (5, "coolant_bypass", "effect.coolant_bypass.cell: cell 4 is no place for it; valid: 1 to 3"),
        (1, "busbar_joule", "effect.busbar_joule: needs at least 2 cells; this model has 1"),
    ],
)
def test_an_effect_sits_where_it_can_be(cells, name, says):
    effect = catalogue()[name]
    p = effect.parameters[0]
    place = "" if effect.place == "string" else f"cell = {max(cells - 1, 2)}\n"
    text = EXAMPLE.replace("cells = 5", f"cells = {cells}").replace("[1, 3, 5]", "[1]")
    text = text.replace("effects = []", f'effects = ["{name}"]')
    text += f'[effect.{name}]\n{place}{p.name} = {{ value = 0.1, unit = "{p.unit}", fixed = true }}\n'
    with pytest.raises(ConfigError, match=says.replace(".", r"\.")):
        parse_model(text)


FAULTS = [
    ("cells = 5", "cels = 5", "cels: unknown key; did you mean 'cells'?"),
    ("cells = 5", "cells = 0", "cells: 0"),
    ("cells = 5", 'cells = "5"', "cells: '5': input should be a valid integer"),
    ("[1, 3, 5]", "[1, 9]", "sensors: cell 9 does not exist; valid: 1 to 5"),
    ("[1, 3, 5]", "[1, 1]", "sensors: cell 1 is named twice"),
    ('"full"', '"ful"', "condition: 'ful' is not known; did you mean 'full'?"),
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
    ("capacity_Ah = 8.0", 'format = "2170"', "cell.format: '2170' is not known; did you mean '21700'"),
    ("capacity_Ah = 8.0", 'format = "pouch 787g"', "cell.format: 'pouch 787g': the size of a pouch cell"),
    ("capacity_Ah = 8.0", "centre_share = { value = 50, sd = 0.2 }", "cell.centre_share.value: 50"),
    ("capacity_Ah = 8.0", "centre_share = { value = 0.5, sd = -0.2 }", "cell.centre_share.sd: -0.2"),
    ("capacity_Ah = 8.0", "centre_share = 0.5", "cell.centre_share"),
    ("capacity_Ah = 8.0", "core_probe = { value = 0.5 }", "cell.core_probe.sd"),
    ("capacity_Ah = 8.0", "core_prob = { value = 0.5, sd = 0.1 }", "core_probe"),
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
