"""Real logs with the DBC files of their makers, against tables of what each signal is, made by hand."""

import json
import re

import pytest

from bms_gateway.cli.main import main
from tests.data import need

ROLES = {
    "uwfe": {
        "current": r"BMU_stateBusHV\.CurrentBusHV|IVT_Result_I\.IVT_I",
        "voltage": r"BMU_stateBusHV\.VoltageBusHV|BMU_AmsVBatt\.AMS_PackVoltage|IVT_Result_U1\.IVT_U1",
        "soc": r"BMU_batteryStatusHV\.StateBatteryChargeHV",
        "surface": r"BMU_ChannelTemp\.TempChannel\d+",
        "cell_voltage": r"BMU_CellVoltage\.VoltageCell\d+",
    },
    "leaf": {
        "current": r"x1DB\.LB_Current",
        "voltage": r"x1DB\.LB_Total_Voltage",
        "soc": r"x55B\.LB_SOC",
        "surface": r"x5BC\.LB_Average_Battery_Temperature|x5C0\..*",
        "coolant_inlet": r"x54C\.OutsideAmbientTemperature",
    },
}
LOGS = [
    ("uwfe", "uwfe_july7_run12", "uwfe_2024CAR_original", {"surface": 100, "cell_voltage": 120}),
    ("uwfe", "uwfe_pitt_autocross_02", "uwfe_2024CAR_fixed", {"surface": 100, "cell_voltage": 120}),
    ("uwfe", "uwfe_autocross_2025-04-30_run10", "uwfe_2024CAR_fixed", {"surface": 90}),
    ("leaf", "leaf_ze0_24kwh", "leaf_EV-can_ZE0", {}),
    ("leaf", "leaf_ze1_62kwh_eco_drive", "leaf_EV-can_ZE1", {}),
]


@pytest.mark.parametrize(("vehicle", "log", "dbc", "least"), LOGS, ids=[log for _, log, _, _ in LOGS])
@pytest.mark.slow
def test_signals_of_real_vehicles(vehicle: str, log: str, dbc: str, least: dict, tmp_path, capsys) -> None:
    said = tmp_path / "init.json"
    words = [str(need("can", f"{log}.log.gz")), "--dbc", str(need("dbc", f"{dbc}.dbc")), "--out", str(tmp_path / "v")]
    assert main(["init", *words, "--yes", "--json", str(said)]) == 0
    found = json.loads(said.read_text())["signals"]
    right = [s for s in found if re.fullmatch(ROLES[vehicle].get(s["role"], "none"), s["signal"])]
    wrong = [s for s in found if s not in right]
    print(f"{log}: {len(right)} of {len(found)} right, wrong: {[(s['role'], s['signal']) for s in wrong]}")
    assert len(right) >= 0.9 * len(found)
    assert not [s for s in wrong if s["sure"]]
    for role in ("current", "voltage", "soc", "surface"):
        assert any(s["role"] == role for s in right), role
    for role, count in least.items():
        assert sum(s["role"] == role for s in right) >= count
    config = str(tmp_path / "v" / "gateway.toml")
    assert main(["check", config]) == 0
    used = tmp_path / "check.json"
    main(["check", config, "--log", words[0], "--json", str(used)])
    _refused_are_told(json.loads(used.read_text())["signals"], capsys.readouterr().out)
    assert main(["analyze", words[0], "--config", config, "--out", str(tmp_path / "r")]) == 0
    text = (tmp_path / "r" / "estimates.csv").read_text()
    cores = [float(line.split(",")[3] or "nan") for line in text.splitlines()[1:]]
    # two minutes at up to 150 A, and R_c of a cell that nobody named: a band wider than 12 K is not stated
    stated = [c for c in cores if c == c]
    assert len(stated) > 0.33 * len(cores)
    assert all(-40 < c < 100 for c in stated)


def _refused_are_told(signals: dict, text: str) -> None:
    """Each signal of which samples are refused is in the table with the reason, or among those that it counts."""
    rows = [line for line in text.splitlines() if re.match(r"string_\d+\.\w+", line)]
    refused = {name: s for name, s in signals.items() if s["refused"]}
    for name, s in refused.items():
        assert s["used"] + sum(s["refused"].values()) == s["seen"], name
        row = next((line for line in rows if f" {name} " in line), None)
        if row is None:
            assert "more" in text
            continue
        for reason, count in s["refused"].items():
            assert f"{reason} {count}" in row
    shown = sum(any(f" {name} " in line for line in rows) for name in refused)
    assert shown >= min(len(refused), 30)


def test_the_sign_of_the_leaf_and_its_bits(tmp_path) -> None:
    """Its current is a two's complement, negative while it drives; one DBC says unsigned, the other too narrow."""
    said = tmp_path / "init.json"
    words = [str(need("can", "leaf_ze1_62kwh_eco_drive.log.gz")), "--dbc", str(need("dbc", "leaf_EV-can_ZE1.dbc"))]
    assert main(["init", *words, "--out", str(tmp_path / "v"), "--json", str(said)]) == 0
    current = next(s for s in json.loads(said.read_text())["signals"] if s["role"] == "current")
    assert current["scale"] == -1.0
    assert current["observed"] == [pytest.approx(-61.5), pytest.approx(430.0)]
    assert current["overrides"]["minimum"] <= -430.0
    zero = tmp_path / "zero.json"
    words = [str(need("can", "leaf_ze0_24kwh.log.gz")), "--dbc", str(need("dbc", "leaf_EV-can_ZE0.dbc"))]
    assert main(["init", *words, "--out", str(tmp_path / "w"), "--json", str(zero)]) == 0
    current = next(s for s in json.loads(zero.read_text())["signals"] if s["role"] == "current")
    assert current["overrides"] == {"signed": True}
    assert -5.0 < current["observed"][0] < current["observed"][1] < 5.0  # it stands


def test_a_log_without_a_battery_is_told(tmp_path, capsys) -> None:
    log = need("conformance", "python-can", "issue_1256.asc")
    assert main(["init", str(log), "--out", str(tmp_path / "v"), "--yes"]) in (1, 2)
    assert "Traceback" not in capsys.readouterr().err
    assert not (tmp_path / "v" / "gateway.toml").exists()


def test_a_voltage_that_reads_bytes_of_two_measurements_speaks_against_no_current(tmp_path, capsys) -> None:
    """A seventh of its samples read 0 to 38 V in place of 500; the others follow the current by one resistance."""
    said, log = tmp_path / "init.json", str(need("can", "uwfe_autocross_2025-04-30_run10.log.gz"))
    words = [log, "--dbc", str(need("dbc", "uwfe_2024CAR_fixed.dbc")), "--out", str(tmp_path / "v"), "--yes"]
    assert main(["init", *words, "--json", str(said)]) == 0
    current = next(s for s in json.loads(said.read_text())["signals"] if s["role"] == "current")
    assert "the pack's voltage changes without it" not in " ".join(current["why"])
    used = tmp_path / "check.json"
    main(["check", str(tmp_path / "v" / "gateway.toml"), "--log", log, "--json", str(used)])
    signal = json.loads(used.read_text())["signals"][current["signal"]]
    assert signal["used"] > 0.95 * signal["seen"]
    assert "changes without it" not in capsys.readouterr().out
