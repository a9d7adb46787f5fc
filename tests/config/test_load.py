"""Configs become plans, and a config that is wrong says where in one line, with exit status 2."""

from pathlib import Path

import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import load_config, own_dbc_text
from bms_gateway.config.model_file import read_model
from bms_gateway.errors import ConfigError
from bms_gateway.thermal import Disturbance
from tests.config.bench_cell import write_bench_cell
from tests.config.files import MAPPED, OWN, write
from tests.config.model_texts import EXAMPLE
from tests.config.race_car import THERMISTORS, write_race_car

ROOT = Path(__file__).resolve().parents[2]


def channels(plan, string=0):
    return {(c.quantity, c.cell): c for c in plan.strings[string].channels}


def test_without_signals_our_own_messages_of_the_strings_number_are_used(tmp_path):
    two = OWN + '[[string]]\nname = "string_2"\nmodel = "string_1.toml"\n'
    plan = load_config(write(tmp_path, two)).plan
    found = channels(plan, 1)
    assert found["current", None].signal == "string_2_electrical.current"
    assert found["coolant_inlet", None].signal == "string_2_coolant.coolant_inlet"
    assert [k for q, k in found if q == "surface"] == [1, 3, 5]
    assert found["surface", 3].signal == "string_2_surface.surface_03"
    assert [k for q, k in found if q == "cell_voltage"] == [1, 2, 3, 4, 5]
    assert {(c.scale, c.offset) for c in found.values()} == {(1.0, 0.0)}


def test_units_of_the_dbc_become_si_and_the_users_scale_comes_on_top(tmp_path):
    found = channels(load_config(write(tmp_path)).plan)
    current, inlet = found["current", None], found["coolant_inlet", None]
    assert current.scale * 5000.0 + current.offset == pytest.approx(-5.0)  # mA, sign flipped
    assert inlet.scale * 212.0 + inlet.offset == pytest.approx(100.0)  # °F
    assert found["voltage", None].scale == pytest.approx(1e-3)
    assert found["soc", None].scale == pytest.approx(1e-2)
    assert found["coolant_flow", None].scale * 60_000 == pytest.approx(1.0)
    assert (found["surface", 1].scale, found["surface", 1].offset) == (1.0, 0.0)
    assert found["surface", 3].offset == 0.5
    assert found["surface", 5].offset == pytest.approx(-273.15)  # K


def test_settings_reach_the_plan(tmp_path):
    text = OWN + "[observer]\nheat_cell_W = 0.3\n[engine]\nsilent_after_s = 5.0\n[identify]\nmethod = 'rls'\n"
    loaded = load_config(write(tmp_path, text.replace('"vcan0"', '"vcan0"\ntransmit = false')))
    assert loaded.plan.disturbance == Disturbance(heat_cell=0.3)
    assert loaded.plan.silent_after_ns == 5_000_000_000
    assert loaded.plan.strings[0].identify == "rls"
    assert loaded.plan.transmit is False


def test_each_string_may_be_identified_by_its_own_method(tmp_path):
    own = OWN.replace('name = "string_1"', 'name = "string_1"\nidentify = "off"', 1)
    assert own != OWN
    assert load_config(write(tmp_path, own + "[identify]\nmethod = 'rls'\n")).plan.strings[0].identify == "off"
    with pytest.raises(ConfigError, match=r"string\[1\].identify: 'of' is not known; did you mean 'off'"):
        load_config(write(tmp_path, own.replace('"off"', '"of"')))


def test_the_state_goes_where_the_config_or_systemd_says(tmp_path, monkeypatch):
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    assert load_config(write(tmp_path)).store == tmp_path / "state"
    assert load_config(write(tmp_path, OWN)).store is None
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/bms-gateway:/var/lib/other")
    assert load_config(write(tmp_path, OWN)).store == Path("/var/lib/bms-gateway")


def test_the_shipped_example_is_sound(capsys):
    assert main(["check", str(ROOT / "deploy" / "example" / "gateway.toml")]) == 0
    assert "string_5" in capsys.readouterr().out
    assert own_dbc_text().startswith("VERSION")


def test_a_dbc_in_the_encoding_of_windows_loads(tmp_path):
    file = write(tmp_path)
    dbc = tmp_path / "vehicle.dbc"
    dbc.write_bytes(dbc.read_text(encoding="utf-8").replace('"C"', '"°C"').encode("cp1252"))
    assert channels(load_config(file).plan)["surface", 1].scale == 1.0


def test_the_race_car_maps_141_thermistors_of_its_own_dbc(tmp_path):
    plan = load_config(write_race_car(tmp_path)).plan
    surfaces = [c.signal for s in plan.strings for c in s.channels if c.quantity == "surface"]
    assert len(plan.strings) == 8
    assert surfaces[0] == "BMU_ChannelTemp.TempChannel01"
    assert surfaces[-1] == "BMU_ChannelTemp.TempChannel141"
    assert len(set(surfaces)) == len(surfaces) == THERMISTORS
    assert {channels(plan, i)["current", None].signal for i in range(8)} == {"BMU_stateBusHV.CurrentBusHV"}
    assert {channels(plan, i)["coolant_inlet", None].constant for i in range(8)} == {22.0}


@pytest.mark.parametrize("priors", ["wide", "authors"])
@pytest.mark.parametrize("voltage", [False, True])
def test_the_bench_cell_loads(tmp_path, priors, voltage):
    plan = load_config(write_bench_cell(tmp_path, priors=priors, voltage=voltage)).plan
    assert (("voltage", None) in channels(plan)) == voltage


SIGNALS = "\n[string.signals]\ncurrent = 'Pack.Current'\ncoolant_inlet = 'Pack.InletF'\n"
FAULTS = [
    (MAPPED.replace("[bus]", "[buss]"), "buss: unknown key; did you mean 'bus'?"),
    (MAPPED.replace("channel", "chanel"), "bus.chanel: unknown key; did you mean 'channel'?"),
    (MAPPED.replace("transmit = true", 'transmit = "yes"'), "bus.transmit: 'yes'"),
    (
        MAPPED.replace("[identify]", "receive_buffer = 1\n[identify]").replace("[[string]]", "[[string]]"),
        "receive_buffer",
    ),
    (MAPPED.replace('"window"', '"windows"'), "identify.method: 'windows' is not known; did you mean 'window'?"),
    (MAPPED.replace("vehicle.dbc", "vehicel.dbc"), "bus.dbc[1]: no file"),
    (MAPPED.replace("vehicle.dbc", "vehicel.dbc"), "did you mean 'vehicle.dbc'?"),
    (MAPPED.replace('"string_1.toml"', '"string1.toml"'), "string[1].model: no file"),
    (MAPPED.replace('"string_1.toml"', '"string1.toml"'), "did you mean 'string_1.toml'?"),
    (MAPPED.replace('name = "string_1"', 'name = "a,b"'), "string[1].name: 'a,b'"),
    (MAPPED.replace('name = "string_1"\n', ""), "string[1].name: missing"),
    (MAPPED + OWN[OWN.index("[[") :], "two strings are called 'string_1'"),
    ("[bus]\n", "string: missing"),
    (
        MAPPED.replace('"socketcan"', '"sockecan"'),
        "bus.interface: no CAN interface is called 'sockecan'; did you mean 'socketcan'?",
    ),
    ("[bus]\nchannel = \n", "not valid TOML: Invalid value (at line 2"),
    (MAPPED.replace("Pack.Current", "Pack.Curent"), "string[1].signals.current: message 'Pack' has no signal 'Curent'"),
    (MAPPED.replace("Pack.Current", "Pack.Curent"), "did you mean 'Current'?"),
    (
        MAPPED.replace("Temps.T1", "Temp.T1"),
        "string[1].signals.surface.1: no message 'Temp' in the DBC; did you mean 'Temps'",
    ),
    (MAPPED.replace("Temps.T1", "T1"), "'T1' is not of the form Message.Signal; did you mean 'Temps.T1'?"),
    (MAPPED.replace("soc =", "sock ="), "string[1].signals.sock: unknown key; did you mean 'soc'?"),
    (MAPPED.replace("offset = 0.5", "ofset = 0.5"), "signals.surface.3.ofset: unknown key; did you mean 'offset'?"),
    (MAPPED.replace("5 = ", "6 = "), "surface.6: no such cell; valid: 1 to 5"),
    (MAPPED.replace("5 = ", "five = "), "surface.five: no such cell"),
    (MAPPED.replace("5 = ", "4 = "), "surface: cell 4: not among the model's sensors [1, 3, 5]"),
    (MAPPED.replace('5 = "Temps.T5"\n', ""), "surface: no signal for cell 5, a sensor of the model"),
    (MAPPED.replace("Temps.T5", "Temps.T1"), "surface.5: signal 'Temps.T1' is cell 1's already"),
    (
        MAPPED.replace('"Pack.InletF"', "{ constant_C = 500.0 }"),
        "coolant_inlet: 500 is not plausible; valid: -60 to 150",
    ),
    (MAPPED.replace('"Pack.InletF"', "{ constant_C = 22.0, scale = 2.0 }"), "a constant has neither scale nor offset"),
    (MAPPED.replace('"Pack.InletF"', "{ }"), "signals.coolant_inlet: needs exactly one of signal"),
    (MAPPED.replace('"Pack.Soc"', "{ constant_C = 0.5 }"), "signals.soc: constant_C is for temperatures"),
    (MAPPED.replace('"Temps.T1"', "{ constant = 20.0 }"), "surface.1: must be a signal of the bus"),
    (MAPPED.replace("scale = -1.0", "scale = 0.0"), "scale = 0"),
    (MAPPED.replace("scale = -1.0", "scale = 0.001"), "in mA, which is converted without a scale"),
    (MAPPED.replace('current = { signal = "Pack.Current", scale = -1.0 }\n', ""), "string[1].signals.current: missing"),
    (MAPPED.replace("[identify]", "[observer]\nheat_cel_W = 1.0\n[identify]"), "did you mean 'heat_cell_W'?"),
    (OWN.replace("[[string]]", "[string]"), "string: write [[string]], in double brackets"),
    ("string = []\n", "string: needs at least one [[string]]"),
    (
        MAPPED.replace('name = "string_1"', 'name = "Zelle ß"'),
        "valid are letters A-Z and a-z, digits, '_', '-' and '.'",
    ),
    (MAPPED.replace('name = "string_1"', 'name = ""'), "string[1].name: must not be empty"),
    (MAPPED.replace('"vcan0"', '""'), "bus.channel: must not be empty"),
    (
        MAPPED.replace('"vcan0"', '"a_name_too_long_0"'),
        "channel: 'a_name_too_long_0': a SocketCAN interface has at most",
    ),
    (MAPPED.replace('"vcan0"', '"vcan 0"'), "channel: 'vcan 0': a SocketCAN interface has no blank"),
    (MAPPED.replace('"string_1.toml"', '""'), "string[1].model: must not be empty"),
    (MAPPED.replace('"vehicle.dbc"', '""'), "bus.dbc[1]: must not be empty"),
    (MAPPED.replace('"state"', '""'), "store.path: must not be empty"),
    (MAPPED.replace('"string_1.toml"', '"."'), "is a directory; expected a file"),
    (MAPPED.replace('"vehicle.dbc"', '"."'), "bus.dbc[1]: "),
    (MAPPED.replace('"string_1.toml"', '"/dev/null"'), "string[1].model: '/dev/null' is no plain file"),
    (MAPPED.replace('"string_1.toml"', '"string_1.tml"'), "did you mean 'string_1.toml'?"),
    (
        MAPPED.replace('"Temps.T1"', '"Pack.Current"'),
        "string[1].signals.surface.1: 'Pack.Current': unit 'mA' does not fit a temperature",
    ),
    (MAPPED.replace('"Temps.T1"', '{ signal = "Pack.Voltage", scale = 2.0 }'), "unit 'mV' does not fit a temperature"),
    (MAPPED.replace('"Pack.Current"', '"Temps.T1"'), "signals.current: 'Temps.T1': unit 'C' does not fit a current"),
    (MAPPED.replace('"Pack.InletF"', '"Pack.Soc"'), "unit '%' does not fit a temperature"),
    (MAPPED.replace('"Pack.Soc"', '"Pack.Voltage"'), "unit 'mV' does not fit an SOC"),
    (MAPPED.replace("[identify]", "[engine]\nsilent_after_s = 0.1\n[identify]"), "engine.silent_after_s: 0.1"),
]


@pytest.mark.parametrize(("text", "says"), FAULTS)
def test_every_fault_of_a_config_is_one_line_and_exit_status_2(tmp_path, capsys, text, says):
    file = write(tmp_path, text)
    assert main(["check", str(file)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"bms-gateway: error: {file}: ")
    assert err.count("\n") == 1
    assert says in err


def test_a_fault_in_a_model_names_the_model_file(tmp_path, capsys):
    file = write(tmp_path, model=EXAMPLE.replace("R_u  =", "R_uu ="))
    assert main(["check", str(file)]) == 2
    assert f"error: {tmp_path / 'string_1.toml'}: parameters.R_uu: unknown key" in capsys.readouterr().err


def test_flow_on_the_bus_needs_the_nominal_flow(tmp_path):
    file = write(tmp_path, model=EXAMPLE.replace("coolant_flow", "# coolant_flow"))
    with pytest.raises(ConfigError, match=r"signals\.coolant_flow: the model file needs parameters\.coolant_flow"):
        load_config(file)


def test_a_broken_dbc_names_file_and_line(tmp_path, capsys):
    file = write(tmp_path)
    dbc = tmp_path / "vehicle.dbc"
    dbc.write_text(dbc.read_text().replace("BU_: VEHICLE", "BU_: VEHICLE\nBO_ x"))
    assert main(["check", str(file)]) == 2
    assert f"{dbc}: line " in capsys.readouterr().err


def many(count, signals=""):
    return OWN[: OWN.index("[[")] + "".join(
        f'[[string]]\nname = "s{i}"\nmodel = "string_1.toml"\n{signals}' for i in range(count)
    )


def test_our_dbc_sets_limits_only_where_it_is_used(tmp_path):
    with pytest.raises(ConfigError, match=r"string\[9\]: our DBC has 8 strings"):
        load_config(write(tmp_path, many(9)))
    mapped = MAPPED[MAPPED.index("[string.signals]") : MAPPED.index("[identify]")]
    text = many(9, mapped).replace('"vcan0"', '"vcan0"\ndbc = ["vehicle.dbc"]')
    with pytest.raises(ConfigError, match="9 strings: our DBC has 8"):
        load_config(write(tmp_path, text))
    listen = load_config(write(tmp_path, text.replace('"vcan0"', '"vcan0"\ntransmit = false')))
    assert len(listen.plan.strings) == 9
    long = EXAMPLE.replace("cells = 5", "cells = 19")
    with pytest.raises(ConfigError, match="19 cells: our DBC has 18 per string"):
        load_config(write(tmp_path, OWN, long))
    assert load_config(write(tmp_path, text.replace('"vcan0"', '"vcan0"\ntransmit = false'), long)).plan.strings


def test_a_string_that_is_not_observable_gives_exit_status_1(tmp_path, capsys):
    file = write(tmp_path, OWN, EXAMPLE.replace('"full"', '"single"').replace("[1, 3, 5]", "[1, 3]"))
    assert main(["check", str(file), "--json", str(tmp_path / "out.json")]) == 1
    assert "not observable: string_1" in capsys.readouterr().out
    import json

    found = json.loads((tmp_path / "out.json").read_text())
    assert found["ok"] is False
    assert (found["strings"][0]["exact_rank"], found["strings"][0]["states"]) == (4, 10)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("gateway.tml", "no such file; did you mean 'gateway.toml'?"),
        ("gatway.toml", "did you mean 'gateway.toml'?"),
        ("zzz.toml", "no such file; valid: gateway.toml, string_1.toml"),
        ("absent/gateway.toml", "no such folder"),
        (".", "is a directory"),
        ("/dev/null", "/dev/null: is empty"),
    ],
)
def test_a_config_that_is_not_there_names_the_nearest_file(tmp_path, capsys, name, says):
    write(tmp_path)
    assert main(["check", str(tmp_path / name)]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1


def test_files_as_windows_saves_them_load(tmp_path):
    file = write(tmp_path)
    for path in (file, tmp_path / "string_1.toml", tmp_path / "vehicle.dbc"):
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert channels(load_config(file).plan)["surface", 3].offset == 0.5


@pytest.mark.parametrize(
    ("unit", "scale"), [("", 1.0), ("gids", 1.0), ("temperature:C", 1.0), ("deg C", 1.0), ("degF", 5 / 9)]
)
def test_a_unit_that_says_nothing_passes(tmp_path, unit, scale):
    file = write(tmp_path)
    dbc = tmp_path / "vehicle.dbc"
    dbc.write_text(dbc.read_text().replace('"C"', f'"{unit}"'))
    assert channels(load_config(file).plan)["surface", 1].scale == pytest.approx(scale)


def test_check_mentions_a_state_that_cannot_be_kept(tmp_path, capsys):
    file = write(tmp_path)
    assert main(["check", str(file)]) == 0
    assert capsys.readouterr().err == ""
    (tmp_path / "state").write_text("")
    assert main(["check", str(file)]) == 2
    assert f"store.path: {tmp_path / 'state'} is no directory" in capsys.readouterr().err


def test_a_model_file_and_a_config_in_each_others_place_are_told_what_they_are(tmp_path):
    config = write(tmp_path)
    model = tmp_path / "string_1.toml"
    with pytest.raises(ConfigError, match=r"gateway\.toml: is a gateway config; a model file is needed"):
        read_model(config)
    with pytest.raises(ConfigError, match=r"string_1\.toml: is the model file of a string; a gateway config is needed"):
        load_config(model)
