"""A DBC that has lost its multiplexing: signals that share bits; and abbreviated temperatures of boards."""

import re

import numpy as np
import pytest

from bms_gateway.cli.main import main
from bms_gateway.setup.signal_words import AMBIENT, OTHER_THINGS, has, words
from tests.setup.proposals import proposed
from tests.setup.vehicles import SECONDS, drive, german, plain, write


def test_init_goes_on_with_its_own_dbc_where_signals_share_bits(tmp_path, capsys) -> None:
    vehicle = german()
    log, dbc = write(vehicle, tmp_path)
    text = dbc.read_text()
    assert re.search(r"HVB_Zelltemp_0\d m\d", text)
    dbc.write_text(re.sub(r"(HVB_Zelltemp_\d\d) m\d+", r"\1", text).replace("Mux M :", "Mux :"))
    out = tmp_path / "v"
    assert main(["init", str(log), "--dbc", str(dbc), "--yes", "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert "shares bits with" in said.err
    assert main(["check", str(out / "gateway.toml")]) == 0
    written = (out / "vehicle.dbc").read_text()
    assert written.count(" SG_ HVB_Zelltemp_0") == 2  # of eight, two at a time


BOARDS = [
    "T_PCB",
    "TmpBrd",
    "MosT",
    "T_Tarjeta",
    "Temp_Carte",
    "Temp_Bd",
    "T_FET",
    "TempKarte",
    "T_Platine",
    "HeatsinkTemp",
]


@pytest.mark.parametrize("name", BOARDS)
def test_an_abbreviated_board_is_no_cell(name: str, tmp_path) -> None:
    assert has(words(name), OTHER_THINGS)
    d = drive(8)
    found = proposed(plain({name: 33.0 + 6.0 * (1 - np.exp(-d.t / 600))}, unit="degC"), tmp_path)
    assert not list(found.of("surface"))


@pytest.mark.parametrize("name", ["TempAmb", "T_Umg"])
def test_an_abbreviated_ambient_is_no_cell(name: str) -> None:
    assert has(words(name), AMBIENT)


def test_greatest_and_least_by_one_letter_come_before_a_card(tmp_path) -> None:
    d = drive(8)
    card = 33.0 + 6.0 * (1 - np.exp(-d.t / 600))
    values = {"TC": card, "TxC": np.round(d.surface.max(axis=1)), "TnC": np.round(d.surface.min(axis=1))}
    assert len(card) == 10 * SECONDS
    found = {p.statistic: p.series.info.name for p in proposed(plain(values, unit="degC"), tmp_path).of("surface")}
    assert found == {"max": "TxC", "min": "TnC"}
