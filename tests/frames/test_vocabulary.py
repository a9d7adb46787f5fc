"""The one table of inputs: whatever else names an input agrees with it."""

import runpy
from dataclasses import fields
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from bms_gateway.config.dbc_files import own_dbc_text, read_dbc
from bms_gateway.config.schema import Signals, Source
from bms_gateway.config.units import signal_conversion
from bms_gateway.diagnosis.record_inputs import Columns
from bms_gateway.errors import ConfigError
from bms_gateway.frames import own_dbc
from bms_gateway.frames.database import Database
from bms_gateway.frames.own_dbc import OWN_DBC, input_messages, own_signal
from bms_gateway.frames.vocabulary import CELL, INPUTS, OPTIONAL, SLOW, WHOLE, Input, Quantity
from bms_gateway.report.columns import quantity_of
from bms_gateway.report.table import known

ROOT = Path(__file__).resolve().parents[2]


def test_the_names_of_the_type_are_those_of_the_table() -> None:
    assert get_args(Quantity) == tuple(INPUTS) == (*WHOLE, *CELL)
    assert set(SLOW) == set(WHOLE) - {"current", "voltage"}
    assert set(OPTIONAL) == set(INPUTS) - {"current", "coolant_inlet", "surface"}
    assert len({i.column for i in INPUTS.values()}) == len(INPUTS)


@pytest.mark.parametrize("name", INPUTS)
def test_measurements_and_tables_have_a_place_for_every_input(name: Quantity) -> None:
    this = INPUTS[name]
    assert this.field in {f.name for f in fields(Columns)}
    assert known(this.column.format(7))
    assert quantity_of(this.column.format(7)) == this.kind
    row = np.array([0.25, 0.5])
    given = {"current_A": row, "coolant_inlet_C": row, "surface_C": {}, this.field: {3: row} if this.of_cells else row}
    made = Columns(time_s=np.arange(2.0), **given)
    assert made.of(name, 3 if this.of_cells else None).tolist() == [0.25, 0.5]
    assert [(q, c) for q, c, _ in made.given() if q == name] == [(name, 3 if this.of_cells else None)]


@pytest.mark.parametrize("name", INPUTS)
def test_a_config_may_name_every_input(name: Quantity) -> None:
    needed = {"current": "M.I", "coolant_inlet": {"constant_C": 20.0}}
    made = Signals.model_validate(needed | {name: {"3": "M.S"} if INPUTS[name].of_cells else "M.S"})
    key = f"{name}.3" if INPUTS[name].of_cells else name
    assert dict(made.sources())[key] == Source(signal="M.S")


@pytest.mark.parametrize("name", [name for name, i in INPUTS.items() if i.own is not None])
def test_the_own_dbc_carries_every_input_in_its_unit(name: Quantity) -> None:
    database = Database.load({OWN_DBC: own_dbc_text()}, read_dbc)
    info = database.resolve(own_signal(8, name, 18 if INPUTS[name].of_cells else None))
    assert signal_conversion(name, info.unit) == (1.0, 0.0)
    assert info.message in input_messages(8)


def test_an_input_that_the_own_dbc_does_not_carry_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    ambient = Input(kind="temperature", unit="°C", plausible=(-60.0, 90.0), column="ambient_C")
    monkeypatch.setattr(own_dbc, "INPUTS", {**INPUTS, "ambient": ambient})
    with pytest.raises(ConfigError, match=r"^bms_gateway\.dbc has no signal for ambient; name a signal of your own"):
        own_signal(1, "ambient")
    parts = ("electrical", "coolant", "surface", "cell_voltage")
    assert input_messages(1) == tuple(f"string_1_{part}" for part in parts)


def test_the_table_of_inputs_in_the_document_is_that_of_the_code() -> None:
    made = runpy.run_path(str(ROOT / "dbc" / "tabulate.py"))["inputs"]()
    assert (ROOT / "dbc" / "README.md").read_text(encoding="utf-8") == made, "run: python dbc/tabulate.py"
    assert all(f"| `{name}`" in made for name in INPUTS)


@pytest.mark.parametrize("name", INPUTS)
def test_a_constant_that_stands_in_is_one_that_a_guard_would_not_wonder_at(name: Quantity) -> None:
    low, high = INPUTS[name].plausible
    assert low < high
    if (constant := INPUTS[name].constant) is not None:
        assert constant[0] < constant[1]
        assert max(low, constant[0]) < min(high, constant[1])
