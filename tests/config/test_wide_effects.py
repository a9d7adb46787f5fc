"""A string model whose effects are as little known as a file may say: its check tells bands, and no warning."""

import warnings

import pytest

from bms_gateway.thermal.effects import Effect, catalogue
from tests.cli.calls import call
from tests.config.files import OWN, write

CELLS = """\
cells = 5
sensors = [1, 3, 5]
condition = "full"
effects = ["{name}"]
[cell]
capacity_Ah = 8.0
[parameters]
C_c = {{ value = 268.0, unit = "J/K", rel_sd = 0.05 }}
C_s = {{ value = 18.8, unit = "J/K", rel_sd = 0.05 }}
R_e = {{ value = 3.5, unit = "mOhm", rel_sd = 0.6 }}
R_c = {{ value = 1.266, unit = "K/W", rel_sd = 0.6 }}
R_u = {{ value = 0.79, unit = "K/W", rel_sd = 0.6 }}
R_cc = {{ value = 4.0, unit = "K/W", rel_sd = 0.4 }}
C_f = {{ value = 11.33, unit = "W/K", rel_sd = 0.05 }}
coolant_flow = {{ value = 0.0095, unit = "m3/s" }}
"""


def model(effect: Effect, factor: float) -> str:
    """A model with the effect, the sd of each number `factor` times the distance of its bounds."""
    numbers = []
    for p in effect.parameters:
        span = max(p.upper - p.lower, p.sd) / p.to_si
        known = f"rel_sd = {factor / 100.0}" if p.log else f"sd = {factor * span!r}"
        numbers.append(f'{p.name} = {{ value = {p.probe / p.to_si!r}, unit = "{p.unit}", {known} }}')
    cell = [] if effect.place == "string" else ["cell = 1"]
    return "\n".join([CELLS.format(name=effect.name), f"[effect.{effect.name}]", *cell, *numbers, ""])


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_an_effect_of_which_nothing_is_known_is_checked(tmp_path, name):
    path = write(tmp_path, OWN)
    (tmp_path / "string_1.toml").write_text(model(catalogue()[name], 999.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        status, out, err = call("check", path)
    assert (status, "Traceback" in out + err) == (0, False), err
