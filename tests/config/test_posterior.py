"""`[posterior]` of model files: it reads back exactly, and numbers changed by hand are one line."""

import re
from dataclasses import replace

import pytest

from bms_gateway.config.model_file import format_model, parse_model
from bms_gateway.errors import ConfigError
from bms_gateway.thermal import AddedEffect, Posterior, Prior, StringModel

WHY = ('The model does not explain the surfaces: "0.2 K".', "R_c ends 3.4 sd from what was known of it.")


def model(why=WHY, **more) -> StringModel:
    values = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79}
    priors = {s: Prior(x, 0.0 if s == "C_s" else 0.1) for s, x in values.items()}
    effect = AddedEffect("resistance_temperature", None, {"B": 2500.0}, {"B": 300.0})
    m = StringModel(1, (1,), "single", priors, effects=(effect,), before=priors)
    return replace(m, posterior=Posterior(*m.free_numbers, 0.07, 0.35, False, why, **more))


def test_what_is_written_reads_back_bit_for_bit():
    m = model()
    back = parse_model(format_model(m))
    assert back.posterior == m.posterior
    assert back.doubts == WHY
    assert back.core_doubt == 0.35
    assert format_model(back) == format_model(m)
    assert "core_proven = false" in format_model(m)


def test_a_proven_core_says_so_and_has_no_doubts():
    text = format_model(model(()))
    assert "core_proven = true" in text
    assert parse_model(text).doubts == ()


def test_a_fit_starts_from_what_was_before_and_leaves_the_posterior_behind():
    assert model().unfitted.posterior is None


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('R_c = { value = 1.266, unit = "K/W", rel_sd = 0.1 }', 'R_c = { value = 1.3, unit = "K/W", rel_sd = 0.1 }',
         "R_c was 1.266 when it was fitted"),
        ('R_c = { value = 1.266, unit = "K/W", rel_sd = 0.1 }', 'R_c = { value = 1.266, unit = "K/W", rel_sd = 0.01 }',
         "R_c's sd was 0.1 when it was fitted"),
        ('R_c = { value = 1.266, unit = "K/W", rel_sd = 0.1 }', 'R_c = { value = 1.266, unit = "K/W", fixed = true }',
         "'R_c' is no free number of this model any more"),
        ("value = 2500.0", "value = 2600.0", "resistance_temperature.B was 2500 when it was fitted"),
        ("core_proven = false", "core_proven = true", "posterior.core_proven: true, yet not_proven says"),
        ("core_doubt = 0.35", "core_doubt = -0.35", "posterior.core_doubt"),
        ("sd = [0.1, ", "sd = [", "posterior.sd: 5 names need 5 numbers"),
    ],
)  # fmt: skip
def test_what_was_changed_by_hand_is_one_line(old, new, says):
    text = format_model(model())
    head, table = text.split("[before]")[0], text.split("[before]")[1]
    assert old in head
    with pytest.raises(ConfigError) as e:
        parse_model(head.replace(old, new, 1) + "[before]" + table)
    assert says in str(e.value)
    assert "\n" not in str(e.value)


def test_doubts_cannot_be_emptied():
    text = re.sub(r"not_proven = \[.*?\]\n", "", format_model(model()), flags=re.DOTALL)
    with pytest.raises(ConfigError, match="not_proven: empty, yet core_proven is false"):
        parse_model(text)
