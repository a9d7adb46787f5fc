"""Configs that are none, misspell a key, or contradict themselves or their model."""

from tests.cli.bad_inputs.case import Case

CHECK = "check gateway.toml"


def _case(name: str, old: str, new: str, *blame: str, words: str = CHECK) -> Case:
    return Case(f"config: {name}", words, blame, {"gateway.toml": (old, new)})


_FIRST = '1 = "Temps.T1"'

CONFIGS: tuple[Case, ...] = (
    Case("config: missing", "check gatway.toml", ("gatway.toml", "gateway.toml")),
    Case("config: empty", CHECK, ("gateway.toml", "empty"), {"gateway.toml": ""}),
    Case("config: prose", CHECK, ("gateway.toml", "line 1"), {"gateway.toml": "this is no TOML\n"}),
    Case("config: JSON", CHECK, ("gateway.toml", "line 1"), {"gateway.toml": '{"bus": {}}\n'}),
    Case("config: UTF-16", CHECK, ("gateway.toml", "utf-8"), {"gateway.toml": "[bus]\n".encode("utf-16")}),
    Case("config: a model", "check string_1.toml", ("string_1.toml",)),
    Case("config: a folder", "check .", ("directory",)),
    _case("an open quote", 'channel = "vcan0"', 'channel = "vcan0', "gateway.toml", "line 3"),
    _case("a key twice", 'channel = "vcan0"', 'channel = "vcan0"\nchannel = "can0"', "line 4"),
    _case("a section misspelt", "[identify]", "[identfy]", "identfy", "identify"),
    _case("a key misspelt", "channel =", "chanel =", "chanel", "channel"),
    _case("a key of the string misspelt", "model =", "modell =", "modell", "model"),
    _case("a quantity misspelt", "coolant_inlet =", "coolant_inlett =", "coolant_inlett", "coolant_inlet"),
    _case("no current", 'current = { signal = "Pack.Current", scale = -1.0 }\n', "", "current"),
    _case("no inlet", 'coolant_inlet = "Pack.InletF"\n', "", "coolant_inlet"),
    _case("a sensor without a signal", _FIRST + "\n", "", "surface", "1"),
    _case("a surface of no sensor", _FIRST, _FIRST + '\n2 = "Temps.T2"', "cell 2", "sensors"),
    _case("a cell beyond the string", _FIRST, _FIRST + '\n9 = "Temps.T2"', "surface.9"),
    _case("cell 0", _FIRST, _FIRST + '\n0 = "Temps.T2"', "surface.0"),
    _case("a cell that is a word", _FIRST, _FIRST + '\nfirst = "Temps.T2"', "surface.first"),
    _case("a signal misspelt", "Temps.T1", "Temps.T11", "surface.1", "'T11'", "'T1'"),
    _case("a signal without its message", "Temps.T1", "T1", "T1", "Temps.T1"),
    _case("a signal of an unknown message", "Temps.T1", "Tempers.T1", "Tempers", "'Temps'"),
    _case("the same signal for two cells", "Temps.T5", "Temps.T1", "Temps.T1"),
    _case("scale of zero", "scale = -1.0", "scale = 0", "current", "scale"),
    _case("scale that is a word", "scale = -1.0", 'scale = "minus"', "current", "scale"),
    _case("a range upside down", "scale = -1.0", "minimum = 5, maximum = -5", "minimum 5", "maximum -5"),
    _case("a byte order of no kind", "scale = -1.0", 'byte_order = "intel"', "byte_order", "little_endian"),
    _case("signal and constant", "scale = -1.0", "constant = 3.0", "current", "exactly one"),
    _case("a constant colder than cold", '"Pack.InletF"', "{ constant_C = -300.0 }", "coolant_inlet", "-300"),
    _case("max_of beyond the string", _FIRST, 'max = { max_of = "1-99", signal = "Temps.T1" }', "max_of"),
    _case("max_of of prose", _FIRST, 'max = { max_of = "all", signal = "Temps.T1" }', "max_of"),
    _case("a method of no kind", 'method = "window"', 'method = "windows"', "windows", "window"),
    _case(
        "a model that is missing", 'model = "string_1.toml"', 'model = "strng_1.toml"', "strng_1.toml", "string_1.toml"
    ),
    _case("a model that is the config", 'model = "string_1.toml"', 'model = "gateway.toml"', "gateway.toml"),
    _case("a DBC that is a number", 'dbc = ["vehicle.dbc"]', "dbc = 5", "dbc"),
    _case("a DBC that is missing", 'dbc = ["vehicle.dbc"]', 'dbc = ["vehicel.dbc"]', "vehicel.dbc", "vehicle.dbc"),
    _case("transmit that is a word", "transmit = true", 'transmit = "yes"', "transmit"),
    _case("an interface of no kind", 'interface = "socketcan"', 'interface = "soketcan"', "soketcan", "socketcan"),
    _case("a name with blanks", 'name = "string_1"', 'name = "string 1"', "name"),
    _case("a channel of no kernel", '"vcan0"', '"a-channel-with-a-long-name"', "channel"),
)
