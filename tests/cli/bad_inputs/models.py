"""Models that are none, lack a parameter, or have one that no cell has; and cells that nobody makes."""

from tests.cli.bad_inputs.case import Case

CHECK = "check gateway.toml"


def _case(name: str, old: str, new: str, *blame: str) -> Case:
    return Case(f"model: {name}", CHECK, blame, {"string_1.toml": (old, new)})


_C_C = 'C_c  = { value = 268.0, unit = "J/K", rel_sd = 0.05 }'

MODELS: tuple[Case, ...] = (
    Case("model: empty", CHECK, ("string_1.toml",), {"string_1.toml": ""}),
    Case("model: prose", CHECK, ("string_1.toml", "line 1"), {"string_1.toml": "no model\n"}),
    Case("model: missing", CHECK, ("string_1.toml",), {"string_1.toml": None}),
    _case("no cells", "cells = 5", "cells = 0", "string_1.toml", "cells"),
    _case("half a cell", "cells = 5", "cells = 5.5", "cells"),
    _case("a million cells", "cells = 5", "cells = 1000000", "cells"),
    _case("a sensor beyond the string", "sensors = [1, 3, 5]", "sensors = [1, 3, 9]", "sensors", "9"),
    _case("a sensor twice", "sensors = [1, 3, 5]", "sensors = [1, 3, 3]", "sensors"),
    _case("a condition of no kind", 'condition = "full"', 'condition = "ful"', "condition", "full"),
    _case("a parameter missing", _C_C + "\n", "", "C_c"),
    _case("a parameter misspelt", "C_c  =", "C_cc  =", "C_cc"),
    _case("a unit of another quantity", '268.0, unit = "J/K"', '268.0, unit = "K/W"', "C_c", "K/W"),
    _case("a unit of no kind", '268.0, unit = "J/K"', '268.0, unit = "Joule"', "C_c", "Joule"),
    _case("no unit", 'value = 268.0, unit = "J/K", rel_sd', "value = 268.0, rel_sd", "C_c", "unit"),
    _case("a negative heat capacity", "value = 268.0", "value = -268.0", "C_c"),
    _case("a heat capacity in kJ", "value = 268.0", "value = 268000000.0", "C_c"),
    _case("a value that is a word", "value = 268.0", 'value = "268"', "C_c", "value"),
    _case("a value that is no number", "value = 268.0", "value = nan", "C_c"),
    _case("sd below zero", "rel_sd = 0.05 }\nC_s", "rel_sd = -0.05 }\nC_s", "C_c", "rel_sd"),
    _case("sd and fixed", "rel_sd = 0.05 }\nC_s", "rel_sd = 0.05, fixed = true }\nC_s", "C_c", "fixed"),
    _case("an effect of no kind", "effects = []", 'effects = ["entropic"]', "entropic", "entropic_heat"),
    Case(
        "model: an effect without its table",
        CHECK,
        ("string_1.toml", "effect"),
        {"string_1.toml": ("effects = []", 'effects = ["resistance_temperature"]')},
    ),
    Case("model: a log", "compare bench.csv --model drive.log", ("drive.log",)),
    Case("model: a config", "compare bench.csv --model gateway.toml", ("gateway.toml",)),
    Case("model: an effect that is none", "effects entropic", ("entropic", "entropic_heat")),
    Case("model: a cell nobody makes", "cells samsung_99x", ("samsung_99x",)),
    Case("model: a cell misspelt", "cells lg_m51", ("lg_m51", "lg_m50")),
    Case("model: a cell of no mass", "cells 21700,0g", ("0g",)),
    Case("model: a place for no sensor", "place --cells 5 --sensors 0", ("--sensors",)),
    Case("model: observability of no cells", "observability --cells 0", ("--cells",)),
)
