"""Numbers of thousands of digits where a person names a cell: Python refuses to read them, and so does each command."""

from pathlib import Path

import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import shipped
from bms_gateway.errors import UsageError
from bms_gateway.workbench.form import with_model

DIGITS = "9" * 5000
NAMES = "time_s,current_A,coolant_inlet_C,surface_1_C,surface_{}_C"


def refused(capsys, *words: object) -> str:
    assert main([str(w) for w in words]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    return told


def laid(folder: Path, head: str) -> tuple[Path, Path]:
    table, model = folder / "a.csv", folder / "string.toml"
    table.write_text("\n".join((head, *(f"{k},30,25,26,26" for k in range(900)))) + "\n")
    model.write_text(shipped("deploy/example/string.toml").read_text())
    return table, model


@pytest.mark.parametrize("head", [NAMES.format(DIGITS), "t/s,I/A,Inlet/°C,Surface 1/°C,Surface " + DIGITS + "/°C"])
def test_a_column_of_a_cell_of_many_digits(tmp_path, capsys, head):
    table, model = laid(tmp_path, head)
    assert main(["compare", str(table), "--model", str(model)]) in (0, 2)  # a column that says nothing, or one line
    assert capsys.readouterr().err.count("\n") <= 1


@pytest.mark.parametrize("effect", [f"cell_resistance:{DIGITS}", "cell_resistance:²"])
def test_an_effect_on_a_cell_of_many_digits(tmp_path, capsys, effect):
    table, model = laid(tmp_path, NAMES.format(12))
    said = refused(capsys, "add", effect, "--data", table, "--model", model, "--out", tmp_path / "b.toml")
    assert "no place for cell_resistance" in said or "valid: 1, 2, 3" in said


@pytest.mark.parametrize("text", ["5" + "0" * 5000, "000001" + "0" * 5000, "²"])
def test_cells_of_many_digits_on_the_page(text, tmp_path):
    with pytest.raises(UsageError, match="must be a number from 1"):
        with_model({"tables": [], "form": {"sensors": "1", "cells": text}}, tmp_path)
