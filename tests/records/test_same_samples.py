"""`fit` learns from exactly the samples that `analyze` believes: the engine reads a log for both."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log
from bms_gateway.cli.main import main
from bms_gateway.config import load_config
from bms_gateway.config.model_file import read_model
from bms_gateway.engine import Decoded, Engine
from bms_gateway.engine.driver import drive
from bms_gateway.records import read
from tests.acceptance.race_logs import LOGS
from tests.cli.measured_tables import MODEL, encoded, table
from tests.config.files import OWN, write
from tests.config.race_car import write_race_car
from tests.data import need

Sample = tuple[float, str, int | None, float]
STUCK_A, BEGINS_S, LASTS_S = 23.0, 200, 700


@cache
def believed(log: Path, config: Path) -> dict[str, set[Sample]]:
    """Samples of each string that an engine as `analyze` builds it lets pass, and that a record has a place for."""
    loaded = load_config(config)
    engine = Engine(loaded.plan, loaded.database)
    engine.recording = True
    places: dict[int, list[tuple[str, str, int | None]]] = {}
    for string, wire in zip(loaded.plan.strings, engine.wires, strict=True):
        for quantity, i in wire.whole.items():
            places.setdefault(i, []).append((string.name, quantity, None))
        for k, i in enumerate(wire.surface, 1):
            places.setdefault(int(i), []).append((string.name, "surface", k))
    found: dict[str, dict[tuple[float, str, int | None], float]] = {s.name: {} for s in loaded.plan.strings}
    for event in drive(engine, read_log(log)):
        if isinstance(event, Decoded):
            for t, i, v in zip(event.sample_ns.tolist(), event.input.tolist(), event.value.tolist(), strict=True):
                for name, quantity, k in places.get(i, ()):
                    found[name][round(t * 1e-9, 6), quantity, k] = v  # of several with one stamp the last one counts
    return {name: {(*key, v) for key, v in samples.items()} for name, samples in found.items()}


def used(log: Path, config: Path, model, name: str, monkeypatch) -> set[Sample]:
    """What a record is made of."""
    found: set[Sample] = set()
    make = read.make_record

    def noted(given, *more, **how):
        columns = {("current", None): given.current_A, ("coolant_inlet", None): given.coolant_inlet_C}
        columns |= {("voltage", None): given.voltage_V, ("soc", None): given.soc}
        columns |= {("coolant_flow", None): given.coolant_flow_m3_s}
        columns |= {("surface", k): x for k, x in given.surface_C.items()}
        for place, values in columns.items():
            if values is not None:
                found.update(
                    (round(t, 6), *place, v)
                    for t, v in zip(given.time_s.tolist(), values.tolist(), strict=True)
                    if v == v
                )
        return make(given, *more, **how)

    monkeypatch.setattr(read, "make_record", noted)
    read.read_measurements([log], model=model, config=config, string=name)
    return found


@pytest.fixture(scope="module")
def stuck(tmp_path_factory) -> tuple[Path, Path]:
    """A log of such a string, and its config."""
    folder = tmp_path_factory.mktemp("stuck")
    config = write(folder, OWN + '[identify]\nmethod = "off"\n')  # what is believed is not asked of it
    return encoded(folder, with_a_stuck_current(folder), config), config


def with_a_stuck_current(folder: Path) -> Path:
    """A string whose current sensor stands still for some minutes while the voltage goes on."""
    file = table(folder, seconds=BEGINS_S + LASTS_S + 100)
    head, *lines = file.read_text().splitlines()
    names = head.split(",")
    at, t = names.index("current_A"), names.index("time_s")
    rows = [line.split(",") for line in lines]
    for row in rows:
        if BEGINS_S <= float(row[t]) < BEGINS_S + LASTS_S:
            row[at] = f"{STUCK_A:.5f}"
    file.write_text("\n".join([head, *(",".join(row) for row in rows)]) + "\n")
    return file


@pytest.mark.slow
def test_a_current_that_stands_still_is_refused_offline_as_it_is_live(stuck, tmp_path, monkeypatch):
    """It was used 900 of 900 times."""
    log, config = stuck
    mine = used(log, config, MODEL, "string_1", monkeypatch)
    taken = [s for s in mine if s[1] == "current" and s[3] == STUCK_A]
    assert len(taken) < 0.2 * 10 * LASTS_S  # ten frames a second
    assert mine == believed(log, config)["string_1"]
    assert main(["analyze", str(log), "--config", str(config), "--out", str(tmp_path / "out")]) == 0
    rejected = json.loads((tmp_path / "out" / "summary.json").read_text())["rejected"]
    assert rejected["stuck"] >= 10 * LASTS_S - len(taken) - 20


def test_it_is_told(stuck):
    log, config = stuck
    (record,) = read.read_measurements([log], model=MODEL, config=config)
    (note,) = (n for n in record.notes if "current" in n and "not used" in n)
    assert "the voltage moves while it stands at one value" in note


@pytest.fixture(scope="module")
def race_car(tmp_path_factory) -> Path:
    return write_race_car(tmp_path_factory.mktemp("race_car"))


@pytest.mark.parametrize("name", LOGS)
@pytest.mark.parametrize("module", ["module_2", "module_8"])
@pytest.mark.plain_cases(1)
def test_what_analyze_believes_of_a_race_car_is_what_fit_uses(name, module, race_car, monkeypatch):
    cells = 18 if module == "module_2" else 15
    model = read_model(race_car.parent / f"module_{cells}.toml")
    log = need("can", f"{name}.log.gz")
    both = used(log, race_car, model, module, monkeypatch), believed(log, race_car)[module]
    both = tuple({s for s in x if s[1] != "coolant_inlet"} for x in both)  # a constant, of which nothing is heard
    assert both[0] == both[1]
    assert len(both[0]) > 200


def test_a_whole_reader_takes_in_what_no_estimator_uses(tmp_path):
    """Voltages of cells in a string of which they are not identified, as the table gives them."""
    loaded = load_config(write(tmp_path, OWN))
    engine, whole = Engine(loaded.plan, loaded.database), Engine(loaded.plan, loaded.database, whole=True)
    assert (whole.wires[0].cell_voltage >= 0).all()
    assert len(whole.can_ids) >= len(engine.can_ids)
    assert np.array_equal(whole.wires[0].surface >= 0, engine.wires[0].surface >= 0)
