"""What `init` writes and says of the cells, by the resistance that voltage and current give."""

import csv
import math
import re
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import load_config, shipped
from bms_gateway.config.model_file import read_model
from bms_gateway.setup.capacity_shown import capacity_shown
from bms_gateway.setup.proposal import Proposal, Proposed
from bms_gateway.setup.write import lump, unknown_priors
from bms_gateway.thermal import KINDS
from bms_gateway.thermal.cells import cell_of, cell_priors
from tests.setup.vehicles import drive, plain, write
from tests.setup.vehicles_afar import worded


@pytest.mark.parametrize("parallel", [1, 2, 4, 8])
def test_cells_in_parallel_that_are_told_are_believed(parallel: int) -> None:
    """25 mΩ by a step of a second, in parallel: 12 in series."""
    measured = Proposal(series_cells=12, resistance=12 * 0.025 / parallel)
    notes: list[str] = []
    lumped, per_cell = lump(measured, cell_of(f"21700 5Ah 69g 25mOhm {parallel}p"), notes)
    assert notes == []
    assert lumped.parallel == parallel
    assert per_cell == pytest.approx(1.2 * 0.025 / parallel)


def of_a_pack(capacity_Ah: float, *, turned: float = 1.0, swing: float = 0.4) -> list[Proposed]:
    """Current in steps of a minute and an SOC that counts it, of an hour; the DBC's current is in units of 0.1 A."""
    rng = np.random.default_rng(7)
    amps = np.repeat(rng.uniform(0.0, 2.0, 60), 60) * swing * capacity_Ah
    soc = 0.9 - np.concatenate([[0.0], np.cumsum(amps[:-1])]) / 3600.0 / capacity_Ah
    t = np.arange(3600.0)
    sent = SimpleNamespace(t=t, x=10.0 * turned * amps), SimpleNamespace(t=t[::10], x=np.round(100.0 * soc[::10], 1))
    return [Proposed("current", sent[0], factor=0.1 * turned), Proposed("soc", sent[1], factor=0.01)]


@pytest.mark.parametrize("words", ["prismatic 173x125x45 105Ah 2000g 0.95mOhm 1p", "sdi_94ah plate 1p"])
def test_one_cell_in_parallel_that_is_said_stays_one_whatever_the_resistance(words: str) -> None:
    """A resistance of half of the usual one made two cells of it, and cores 3 K too cold."""
    notes: list[str] = []
    lumped, _ = lump(Proposal(series_cells=96, resistance=96 * 0.45e-3), cell_of(words), notes)
    assert lumped.parallel == 1
    assert notes == []


@pytest.mark.parametrize("turned", [1.0, -1.0])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_charge_tells_how_many_cells_are_side_by_side(count: int, turned: float) -> None:
    measured = Proposal(of_a_pack(94.0 * count, turned=turned), series_cells=96, resistance=96 * 0.35e-3)
    assert capacity_shown(measured) == pytest.approx(94.0 * count, rel=0.01)
    notes: list[str] = []
    lumped, _ = lump(measured, cell_of("sdi_94ah plate"), notes)
    assert lumped.parallel == count
    assert [("taken for" in note, f"{count} sdi_94ah" in note) for note in notes] == [(True, True)] * (count > 1)


def test_a_charge_that_is_not_theirs_is_told_and_a_small_one_tells_nothing() -> None:
    """A current of ten times the size was blamed on the cell."""
    notes: list[str] = []
    lump(Proposal(of_a_pack(294.0)), cell_of("21700 4.9Ah 69g 29mOhm 6p"), notes)
    assert len(notes) == 1
    assert "current and SOC give 294 Ah, the cell, 6 in parallel, has 29.4 Ah: the scale" in notes[0]
    assert capacity_shown(Proposal(of_a_pack(50.0, swing=0.05))) is None
    assert capacity_shown(Proposal(of_a_pack(50.0)[:1])) is None
    current, soc = of_a_pack(50.0)
    for seen in (current.series, soc.series):  # half an hour of which nobody recorded the current
        seen.t = np.where(seen.t > 1200.0, seen.t + 1800.0, seen.t)
    assert capacity_shown(Proposal([current, soc])) is None


def test_a_resistance_that_is_not_theirs_is_told() -> None:
    notes: list[str] = []
    lump(Proposal(series_cells=12, resistance=12 * 0.025), cell_of("21700 5Ah 69g 25mOhm 8p"), notes)
    assert len(notes) == 1
    assert "30 mΩ" in notes[0]
    assert "4.1 mΩ" in notes[0]


def test_an_unknown_cell_may_be_a_flat_one_or_round_ones_in_parallel(tmp_path) -> None:
    log, dbc = write(worded(), tmp_path)
    assert main(["init", str(log), "--dbc", str(dbc), "--out", str(tmp_path / "v"), "--yes"]) == 0
    R_c = read_model(tmp_path / "v" / "string_1.toml").priors["R_c"]
    for words in ("prismatic 148x91x27mm 50Ah", "prismatic 173x207x72mm 280Ah", "21700 20p", "4680 4p"):
        possible = cell_priors(cell_of(words), conduction=True)["R_c"].value
        assert abs(R_c.value - possible) <= 2 * R_c.rel_sd * R_c.value, words


def test_an_unknown_cell_may_stand_in_air_or_on_coolant(tmp_path) -> None:
    # Bug: R_u was that of still air. No window of a cooled pack explained its surfaces, and all were left out.
    log, dbc = write(worded(), tmp_path)
    assert main(["init", str(log), "--dbc", str(dbc), "--out", str(tmp_path / "v"), "--yes"]) == 0
    R_u = read_model(tmp_path / "v" / "string_1.toml").priors["R_u"]
    for words in ("21700 20p", "21700 forced 20p", "21700 liquid 20p", "4680 liquid 4p", "prismatic 148x91x27mm 50Ah"):
        possible = cell_priors(cell_of(words), conduction=True)["R_u"].value
        assert abs(math.log(R_u.value / possible)) <= 1.5 * R_u.rel_sd, words


@pytest.mark.parametrize(
    ("inlet", "words", "said"),
    [("CoolantInletTemp", "21700 4p", False), ("CoolantInletTemp", "21700 liquid 4p", True),
     ("CoolantInletTemp", "21700 still 4p", True), ("AmbientAirTemp", "21700 4p", True)],
)  # fmt: skip
def test_a_named_cell_whose_cooling_is_not_said_is_not_taken_for_one_in_still_air(
    inlet, words, said, tmp_path, capsys
) -> None:
    warm = drive(8)
    vehicle = plain({"CellTemp1": warm.surface[:, 0], "CellTemp2": warm.surface[:, 1], inlet: warm.inlet}, unit="degC")
    log, dbc = write(vehicle, tmp_path)
    assert main(["init", str(log), "--dbc", str(dbc), "--cell", words, "--out", str(tmp_path / "v"), "--yes"]) == 0
    assert ("does not say how the cell is cooled" in capsys.readouterr().err) is not said
    R_u = read_model(tmp_path / "v" / "string_1.toml").priors["R_u"]
    stated = cell_priors(cell_of(words), conduction=True)["R_u"]
    if said:
        assert R_u.value == pytest.approx(stated.value, rel=1e-3)
        assert R_u.rel_sd == stated.rel_sd
    else:
        for cooling in ("still", "forced", "plate", "liquid"):
            possible = cell_priors(cell_of(f"21700 {cooling} 4p"), conduction=True)["R_u"].value
            assert abs(math.log(R_u.value / possible)) <= 1.5 * R_u.rel_sd, cooling


@pytest.mark.parametrize("resistance", [None, 0.3e-3, 2e-3, 6e-3, 9e-3, 25e-3])
def test_an_unknown_cell_of_any_resistance_gets_a_sound_model(resistance, tmp_path) -> None:
    """One cell in series, by the step of a second; what is written can be read."""
    measured = Proposal(series_cells=1, resistance=resistance)
    lumped, per_cell = lump(measured, None, [])
    priors = unknown_priors(lumped, per_cell, conduction=True)
    assert all(KINDS[s].lower <= p.value <= KINDS[s].upper and p.rel_sd >= 0.5 for s, p in priors.items())


def test_cores_of_a_cell_that_is_not_named_are_doubtful_from_the_first_moment(tmp_path, capsys) -> None:
    log, dbc = write(worded(), tmp_path)
    for name, words in (("named", ["--cell", "prismatic 148x91x27mm 50Ah"]), ("not_named", [])):
        config = tmp_path / name
        assert main(["init", str(log), "--dbc", str(dbc), "--out", str(config), "--yes", *words]) == 0
        assert main(["check", str(config / "gateway.toml")]) == 0
        out = tmp_path / f"of_{name}"
        assert main(["analyze", str(log), "--config", str(config / "gateway.toml"), "--out", str(out)]) == 0
        rows = csv.DictReader((out / "estimates.csv").read_text().splitlines())
        doubtful = {r["quality"] for r in rows if r["core_C"]}
        assert (doubtful == {"doubtful"}) == (name == "not_named")
    assert "the cell is not known" in capsys.readouterr().out


def test_a_scale_that_is_that_of_the_unit_is_no_second_conversion(tmp_path) -> None:
    """A charge in 0.01 % that the DBC calls % needs the very scale of %."""
    dbc = tmp_path / "a.dbc"
    dbc.write_text(shipped("deploy/worked/vehicle.dbc").read_text().replace('(0.01,0) [0|100] "%"', '(1,0) [0|0] "%"'))
    log = str(shipped("deploy/worked/drive.log.gz"))
    assert main(["init", log, "--dbc", str(dbc), "--out", str(tmp_path / "v"), "--yes"]) == 0
    plan = load_config(tmp_path / "v" / "gateway.toml").plan
    soc = next(c for c in plan.strings[0].channels if c.quantity == "soc")
    assert soc.scale == pytest.approx(1e-4, rel=2e-5)


@pytest.mark.parametrize(
    ("words", "told", "R_u"),
    [("21700 4p", True, 0.1), ("21700 still 4p", False, 0.1), ("21700 liquid 4p", False, 0.02)],
)
def test_cells_in_air_may_be_cooled_unequally_and_still_air_is_told(words, told, R_u, tmp_path, capsys) -> None:
    """With 2 % from cell to cell, a fit of air-cooled cells that differ by 12 % found no number at all."""
    warm = drive(8)
    sensed = {"CellTemp1": warm.surface[:, 0], "CellTemp2": warm.surface[:, 1], "AmbientAirTemp": warm.inlet}
    log, dbc = write(plain(sensed, unit="degC"), tmp_path)
    assert main(["init", str(log), "--dbc", str(dbc), "--cell", words, "--out", str(tmp_path / "v"), "--yes"]) == 0
    assert ("in still air, as no cooling is named; --cell '21700 4p forced'" in capsys.readouterr().err) is told
    model = read_model(tmp_path / "v" / "string_1.toml")
    assert model.tolerances["cell_R_u"] == R_u
    assert model.tolerances["cell_R_e"] == 0.02


@pytest.mark.parametrize("others", [0, 3])
def test_the_gateway_listens_on_the_interface_of_the_log(others, tmp_path) -> None:
    warm = drive(8)
    log, dbc = write(plain({"CellTemp1": warm.surface[:, 0], "AmbientAirTemp": warm.inlet}, unit="degC"), tmp_path)
    lines = re.sub(r"^(\([0-9.]+\)) \S+", r"\1 can2", log.read_text(), flags=re.MULTILINE).splitlines()
    log.write_text("\n".join([*lines[:others], *lines[:others], *lines]).replace("can2", "vcan7", others) + "\n")
    assert main(["init", str(log), "--dbc", str(dbc), "--cell", "21700", "--out", str(tmp_path / "v"), "--yes"]) == 0
    config = (tmp_path / "v" / "gateway.toml").read_text()
    assert tomllib.loads(config)["bus"]["channel"] == "can2"
    assert ("the log has vcan7 too" in config) is bool(others)
