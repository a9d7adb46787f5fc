"""What the library says is what the commands say, to the last digit."""

import csv
import gzip
import json
import re
import subprocess
import sys
from pathlib import Path

import cantools
import numpy as np
import pytest

import bms_gateway as bms
from bms_gateway.bus.logfile import read_log
from bms_gateway.cli.main import main
from bms_gateway.frames.quality import Quality
from tests.truth.packs import pack as packed

ROOT = Path(__file__).resolve().parents[2]
WORKED = ROOT / "deploy" / "worked"


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    """Files, and the model and the arrays that they hold."""
    pack = packed(tmp_path_factory.mktemp("library"), seconds=900)
    with pack.hidden.open() as f:
        rows = list(csv.DictReader(f))
    t = {name: [float(r[name]) if r[name] else np.nan for r in rows] for name in rows[0]}
    columns = bms.Columns(
        time_s=t["time_s"],
        current_A=t["current_A"],
        coolant_inlet_C=t["coolant_inlet_C"],
        soc=t["soc"],
        coolant_flow_m3_s=t["coolant_flow_m3_s"],
        surface_C={1: t["surface_1_C"], 3: t["surface_3_C"]},
        source=str(pack.hidden),
    )
    model = bms.read_model(pack.model)
    return pack, model, columns, bms.Record.of(columns, model)


def document(folder: Path, *words: object) -> dict:
    out = folder / "document.json"
    assert main([*map(str, words), "--json", str(out)]) in (0, 1)
    return json.loads(out.read_text())


def same(library: dict, command: dict) -> bool:
    return json.loads(json.dumps(library)) == command | ({"model": ""} if "model" in library else {})


def test_fit(pack, tmp_path):
    files, model, _, record = pack
    found = bms.fit(model, record)
    out = tmp_path / "fitted.toml"
    assert same(found.document(), document(tmp_path, "fit", files.hidden, "--model", files.model, "--out", out))
    bms.write_model(found.model, tmp_path / "library.toml")
    written = [re.sub("^#.*\n", "", f.read_text(), flags=re.M) for f in (out, tmp_path / "library.toml")]
    assert written[0] == written[1]
    band = found.cores[0]
    assert band.T_c.shape == band.total_K.shape == (len(band.time_s), 3)


def test_compare(pack, tmp_path, capsys):
    files, model, _, record = pack
    found = bms.compare(model, [record])
    assert same(found.document(), document(tmp_path, "compare", files.hidden, "--model", files.model))
    assert str(found) == capsys.readouterr().out.rstrip("\n")


@pytest.mark.slow
def test_diagnose_and_add(pack, tmp_path, capsys):
    files, model, _, record = pack
    found = bms.diagnose(model, record)
    assert same(found.document(), document(tmp_path, "diagnose", files.hidden, "--model", files.model))
    assert (found.verdict, found.effects) == ("missing_effect", ("entropic_heat",))
    out = tmp_path / "added.toml"
    words = ("entropic_heat", "--model", files.model, "--data", files.hidden, "--out", out)
    added = bms.add(model, record, *found.effects)
    told = document(tmp_path, "add", *words)
    mine = json.loads(json.dumps(added.document()))
    assert mine | {"model": told["model"]} == told
    assert added.refused == ""
    bms.write_model(added.model, tmp_path / "library.toml")
    assert bms.read_model(tmp_path / "library.toml").effects == bms.read_model(out).effects


def test_place(pack, tmp_path):
    files, model, _, _ = pack
    found = bms.place(model, 2, wanted_K=0.1)
    words = ("place", "--model", files.model, "--sensors", "2", "--wanted", "0.1")
    assert same(found.document(), document(tmp_path, *words))
    assert found.reached is (main(list(map(str, words))) == 0)


DBC = """VERSION ""

NS_ :

BS_:

BU_: V

BO_ 256 electrical: 16 V
 SG_ current : 0|64@1- (1,0) [0|0] "A" V
 SG_ voltage : 64|64@1- (1,0) [0|0] "V" V

BO_ 257 coolant_inlet: 8 V
 SG_ coolant_inlet : 0|64@1- (1,0) [0|0] "degC" V

BO_ 258 surface_1: 8 V
 SG_ surface_1 : 0|64@1- (0.1,0) [0|0] "degC" V

SIG_VALTYPE_ 256 current : 2;
SIG_VALTYPE_ 256 voltage : 2;
SIG_VALTYPE_ 257 coolant_inlet : 2;
"""
CONFIG = """
[bus]
dbc = ["vehicle.dbc"]
transmit = false
[[string]]
name = "string"
model = "cell.toml"
[string.signals]
current = "electrical.current"
voltage = "electrical.voltage"
coolant_inlet = "coolant_inlet.coolant_inlet"
[string.signals.surface]
1 = "surface_1.surface_1"
"""
"""A vehicle whose messages are those that the observer makes of the arrays; its thermocouple counts in 0.1 K."""


def test_observer(tmp_path):
    t = np.arange(900.0)
    rng = np.random.default_rng(3)
    amps = np.where(t // 90 % 2 == 0, 18.0, 4.0)
    inlet = 25.0 + np.sin(t / 200.0) + 0.01 * rng.standard_normal(len(t))
    surface = np.round(25.0 + 14.0 * (1.0 - np.exp(-t / 300.0)) + 0.1 * rng.standard_normal(len(t)), 1)
    volts = 3.7 - 0.03 * amps - 1e-4 * t
    names = ("time_s", "current_A", "coolant_inlet_C", "voltage_V", "surface_1_C")
    table = tmp_path / "bench.csv"
    with table.open("w") as f:
        f.write(",".join(names) + "\n")
        columns = (x.tolist() for x in (t, amps, inlet, volts, surface))
        f.writelines(",".join(map(repr, row)) + "\n" for row in zip(*columns, strict=True))
    (tmp_path / "vehicle.dbc").write_text(DBC)
    (tmp_path / "gateway.toml").write_text(CONFIG)
    model = bms.cell_model("21700 5Ah 69g 25mOhm")
    bms.write_model(model, tmp_path / "cell.toml")
    config, log, results = (str(tmp_path / name) for name in ("gateway.toml", "bench.log", "results"))
    assert main(["encode", str(table), "--config", config, "--out", log]) == 0
    assert main(["analyze", log, "--config", config, "--out", results]) == 0

    columns = bms.Columns(time_s=t, current_A=amps, coolant_inlet_C=inlet, voltage_V=volts, surface_C={1: surface})
    observer = bms.Observer(model)
    found = observer.run(columns)
    with Path(results, "estimates.csv").open() as f:
        rows = list(csv.DictReader(f))
    assert len(rows) == len(found.time_s) == len(t) - 1
    told = [
        {
            "time_s": f"{found.time_s[i]:.3f}",
            "core_C": f"{found.core_C[i, 0]:.3f}",
            "core_sd_K": f"{found.core_sd_K[i, 0]:.3f}",
            "surface_C": f"{found.surface_C[i, 0]:.3f}",
            "centre_C": f"{found.centre_C[i, 0]:.3f}",
            "quality": Quality(int(found.quality[i, 0])).name.lower(),
        }
        for i in range(len(rows))
    ]
    assert [{k: r[k] or "nan" for k in told[0]} for r in rows] == told
    last = {}
    with Path(results, "parameters.csv").open() as f:
        last = {r["name"]: r["status"] for r in csv.DictReader(f)}
    assert {p.name: p.status for p in observer.parameters} == last
    assert np.isfinite(found.core_C[-1])
    with pytest.raises(bms.GatewayError, match="does not follow the run before"):
        observer.run(columns)


def test_decode():
    log, dbc = WORKED / "drive.log.gz", WORKED / "vehicle.dbc"
    found = bms.decode(log, dbc)
    by_id = {m.frame_id: m for m in cantools.database.load_file(dbc).messages}
    truth: dict[str, list[tuple[float, float]]] = {}
    for batch in read_log(log):
        for i in range(0, len(batch), 7):
            message = by_id[int(batch.can_id[i])]
            payload = bytes(batch.data[i, : batch.length[i]])
            for name, value in message.decode(payload, decode_choices=False).items():
                truth.setdefault(f"{message.name}.{name}", []).append((batch.time_ns[i] * 1e-9, value))
    assert set(found) == set(truth)
    for path, samples in truth.items():
        mine = dict(zip(found[path].time_s.tolist(), found[path].value.tolist(), strict=True))
        assert all(mine[t] == value for t, value in samples)
    (one,) = [path for path in truth if "urrent" in path]
    only = bms.decode(log, [dbc], [one])
    assert list(only) == [one]
    assert only[one].unit == "A"
    with pytest.raises(bms.GatewayError, match="did you mean"):
        bms.decode(log, dbc, [one[:-1]])


@pytest.mark.slow
def test_the_example_makes_the_error_fall(tmp_path):
    """By the worked table, which the truth's own integrator made."""
    made = packed(tmp_path)
    assert gzip.decompress((WORKED / "bench.csv.gz").read_bytes()) == made.hidden.read_bytes()
    assert (WORKED / "bench.toml").read_text() == made.model.read_text()
    words = [sys.executable, "-m", "bms_gateway.examples"]
    out = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    fitted, added = (float(re.search(rf"{word}: +([0-9.]+) K", out)[1]) for word in ("fitted", "added"))
    assert fitted > 0.3
    assert added < 0.06
    assert "missing_effect entropic_heat" in out


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"current_A": [1.0, 2.0]}, "mine: current_A: 2 values, but time_s has 3"),
        ({"surface_C": {1: [[1.0, 2.0, 3.0]]}}, r"mine: surface_1_C: has the shape \(1, 3\)"),
        ({"soc": ["full", "full", "empty"]}, "mine: soc: not a row of numbers"),
    ],
)
def test_arrays_that_do_not_fit_are_one_line(more, told):
    columns = {"time_s": [0.0, 1.0, 2.0], "current_A": [0.0] * 3, "coolant_inlet_C": [20.0] * 3}
    with pytest.raises(bms.GatewayError, match=told):
        bms.Columns(**{**columns, "surface_C": {1: [20.0] * 3}, **more}, source="mine")


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda m: bms.Observer(m, identify="windows"), "did you mean 'window'"),
        (lambda m: bms.place(m), "how many sensors"),
        (lambda m: bms.place(m, wanted_K=-1.0), "wanted_K -1"),
        (lambda m: bms.place(m, 2), "1 to 1"),
        (lambda m: bms.add(m, []), "name at least one effect"),
        (lambda m: bms.add(m, [], "entropic_heat", "entropic_heat"), "is there twice"),
        (lambda m: bms.read_records(model=m), "at least one table"),
        (lambda m: bms.decode("drive.log", "absent.dbc"), "absent.dbc: no such file"),
        (lambda m: bms.decode("drive.log", "/"), "/: is a directory"),
        (lambda m: bms.decode("drive.log", "/dev/null"), "/dev/null: "),
        (lambda m: bms.cell_model("lg_m50", 2, (3,), "natural"), "cell 3 does not exist"),
        (lambda m: bms.cell_model("lg_m50", 2, (1,), "full"), "coolant_W_K: missing"),
        (lambda m: bms.cell_model("lg_m50", condition="wet"), "condition 'wet': valid: full"),
    ],
)
def test_bad_input_is_one_line(call, told):
    with pytest.raises(bms.GatewayError, match=told) as e:
        call(bms.cell_model("lg_m50"))
    assert "\n" not in str(e.value)
