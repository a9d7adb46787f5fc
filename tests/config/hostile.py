"""Files that once ended the service or kept `check` busy for minutes, each with what is told of it."""

from tests.config.files import DBC, MAPPED
from tests.config.model_texts import EXAMPLE

ATTRIBUTES = """
BA_DEF_ BO_ "E2EProfile" ENUM "None","AUTOSAR_P01_1A";
BA_DEF_ BO_ "GenMsgCycleTime" FLOAT 0 65535;
BA_DEF_DEF_ "E2EProfile" "None";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
"""
DATA_ID = """
BA_DEF_ BO_ "E2EDataID" FLOAT 0 65535;
BA_DEF_DEF_ "E2EDataID" 0;
BA_ "E2EProfile" BO_ 256 1;
"""
LOOP = """
BO_ 513 Loop: 8 VEHICLE
 SG_ A m0M : 0|8@1+ (1,0) [0|2] "" Vector__XXX
 SG_ B m0M : 8|8@1+ (1,0) [0|2] "" Vector__XXX

SG_MUL_VAL_ 513 A B 0-0;
SG_MUL_VAL_ 513 B A 0-0;
"""
SELECTED = """
BO_ 514 Ranges: 8 VEHICLE
 SG_ M M : 0|8@1+ (1,0) [0|2] "" Vector__XXX
 SG_ A m0 : 8|8@1+ (1,0) [0|2] "" Vector__XXX

SG_MUL_VAL_ 514 A M {};
"""


def many_signals(count: int) -> str:
    """A DBC of messages of twenty signals."""
    lines = ['VERSION ""', "BS_:", "BU_: V"]
    for m in range(count // 20):
        lines.append(f"BO_ {(1 << 31) + m} V{m}: 40 V")
        lines += [f' SG_ s{m}_{k} : {16 * k}|16@1+ (0.01,-100) [-100|500] "degC" V' for k in range(20)]
    return "\n".join(lines) + "\n"


def config(more: str) -> tuple[str, str, str]:
    return f"{MAPPED}\n{more}\n", EXAMPLE, DBC


def dbc(more: str) -> tuple[str, str, str]:
    return MAPPED, EXAMPLE, DBC + more


NUL = "\\u0000"
HOSTILE: dict[str, tuple[tuple[str, str, str], str]] = {
    "number of 5,000 digits": (
        config("[engine]\nsilent_after_s = " + "9" * 5000),
        r"a number of 5000 digits \(at line",
    ),
    "hexadecimal number": (
        config("[engine]\nsilent_after_s = 0x" + "F" * 5000),
        "silent_after_s: an integer that does",
    ),
    "no time of day": (config("[engine]\nsilent_after_s = 25:61:00"), "not valid TOML"),
    "nested arrays": (config("x = " + "[" * 3000 + "]" * 3000), "nested over 20 deep"),
    "nested tables": (config(".".join("a" * 300) + " = 1"), r"a\.a: nested over 20 deep"),
    "long key": (config(f"{'k' * 100_000} = 1"), "unknown key"),
    "long value": (config(f'[observer]\nheat_cell_W = "{"v" * 100_000}"'), "observer.heat_cell_W: 'vvv"),
    "store path with NUL": ((MAPPED.replace('"state"', f'"st{NUL}ate"'), EXAMPLE, DBC), "store.path: .* control"),
    "model path with NUL": ((MAPPED.replace("string_1.toml", f"m{NUL}"), EXAMPLE, DBC), "model: .* control"),
    "model path too long": ((MAPPED.replace("string_1.toml", "m" * 5000), EXAMPLE, DBC), "model: .* too long"),
    "cell of many digits": (
        (MAPPED.replace('3 = { signal = "Temps.T3"', "9" * 5000 + ' = { signal = "Temps.T3"'), EXAMPLE, DBC),
        "999: no such cell; valid: 1 to 5",
    ),
    "effect on a cell of many digits": (
        (
            MAPPED,
            EXAMPLE.replace("effects = []", f'effects = ["cell_resistance:{"9" * 5000}"]')
            + f'\n[effect."cell_resistance:{"9" * 5000}"]\n',
            DBC,
        ),
        "999.: no such cell; valid: 1 to 5",
    ),
    "number in the model": ((MAPPED, EXAMPLE.replace("268.0", "2" * 5000), DBC), "string_1.toml: .* 5000 digits"),
    "profile without data ID": (dbc(ATTRIBUTES + 'BA_ "E2EProfile" BO_ 256 1;\n'), "Pack has .* no E2EDataID; add it"),
    "data ID that is no integer": (dbc(ATTRIBUTES + DATA_ID + 'BA_ "E2EDataID" BO_ 256 1.5;\n'), "E2EDataID .*1.5"),
    "multiplexer loop": (dbc(LOOP), "message Loop: multiplexer . is selected by itself"),
    "endless cycle": (dbc(ATTRIBUTES + 'BA_ "GenMsgCycleTime" BO_ 256 1e400;\n'), "Pack: a cycle time of inf ms"),
    "cycle that is a text": (
        dbc(
            ATTRIBUTES.replace('"GenMsgCycleTime" FLOAT 0 65535', '"GenMsgCycleTime" STRING')
            .replace("65535", "9")
            .replace('"GenMsgCycleTime" 0', '"GenMsgCycleTime" ""')
            + 'BA_ "GenMsgCycleTime" BO_ 256 "often";\n'
        ),
        "Pack: the cycle time 'often' is no number",
    ),
    "start value that is a text": (
        dbc(
            'BA_DEF_ SG_ "GenSigStartValue" STRING ;\nBA_DEF_DEF_ "GenSigStartValue" "";\n'
            'BA_ "GenSigStartValue" SG_ 256 Soc "high";\n'
        ),
        "vehicle.dbc: refused as a DBC",
    ),
    "endless scale": ((MAPPED, EXAMPLE, DBC.replace("(10,0)", "(1e400,0)")), "Pack.Current has the scale inf"),
    "long message": ((MAPPED, EXAMPLE, DBC.replace("Pack: 8", "Pack: 99999")), "line 9: message Pack is longer than"),
    "long signal": (
        (MAPPED, EXAMPLE, DBC.replace("48|16@", "48|4294967296@")),
        "line 14: signal InletF lies beyond 14280 bits",
    ),
    "long signal on two lines": (
        (MAPPED, EXAMPLE, DBC.replace(": 48|16@", ":\n 48 | 4294967296@")),
        "line 15: signal InletF lies beyond 14280 bits",
    ),
    "signal far away": (
        (MAPPED, EXAMPLE, DBC.replace("48|16@", "99999999|16@")),
        "line 14: signal InletF lies beyond 14280 bits",
    ),
    "many multiplexer values": (dbc(SELECTED.format("0-4294967296")), "over 1,000,000 multiplexer values"),
    "multiplexer value of many digits": (dbc(SELECTED.format("0-" + "9" * 5000)), "over 1,000,000 multiplexer values"),
    "20,000 labels of no signal": (
        dbc("".join(f'VAL_ 256 No{k} 0 "a" ;\n' for k in range(20_000))),
        r"line 23 \(VAL_ of No0\).* and 19995 more: no message has such a signal",
    ),
    "one character that makes all wide": (
        dbc(f'CM_ "\N{GRINNING FACE}{"x" * (3 << 20)}";\n'),
        r"vehicle.dbc: its 3,1\d\d,\d\d\d characters take 12 MiB of memory, 4 for each because of '.' in line 23",
    ),
    "the same in the config": (
        config("\n# \N{GREEK SMALL LETTER ALPHA}" + "x" * (9 << 20)),
        r"gateway.toml: its 9,4\d\d,\d\d\d characters take 18 MiB of memory, 2 for each because of 'α' in line",
    ),
    "the same in the model": (
        (MAPPED, EXAMPLE + "#" + "x" * (5 << 20) + "\N{GRINNING FACE}", DBC),
        r"string_1.toml: its .* take 20 MiB of memory, 4 for each",
    ),
    "DBC of 9 MiB": (dbc("\n" * (9 << 20)), "vehicle.dbc: longer than 8 MiB"),
    "one comment of a quarter of a million": (
        dbc(f'CM_ "{"x" * 262_145}";\n'),
        "vehicle.dbc: line 23: a text of 262,145 characters; at most 262,144 are read",
    ),
    "8 MiB of semicolons": (dbc(";" * ((8 << 20) - 2000)), "vehicle.dbc: over 2,000,000 words and marks"),
    "a scale of 1e300 in the DBC": (
        (MAPPED, EXAMPLE, DBC.replace("(100,0)", "(1e300,0)")),
        r"signals.voltage: 'Pack.Voltage': with the scale 1e\+300 of .*vehicle.dbc .* valid: 2.3e-05 to 1.5e\+06",
    ),
    "a scale of 1e-300 in the DBC": (
        (MAPPED, EXAMPLE, DBC.replace("(0.1,173.15)", "(1e-300,273.15)")),
        r"signals.surface.5: 'Temps.T5': with the scale 1e-300 of .*vehicle.dbc .* valid: 2.*e-09 to 1.*",
    ),
    "a scale of 1e300 in the config": (
        (MAPPED.replace("scale = -1.0", "scale = -1e300"), EXAMPLE, DBC),
        r"signals.current: 'Pack.Current': with the scale -1e\+300 its bits .* believes -3000 to 3000: .* valid: .* to",
    ),
    "an offset of 1e300 in the config": (
        (MAPPED.replace("offset = 0.5", "offset = 1e300"), EXAMPLE, DBC),
        r"signals.surface.3: 'Temps.T3': .* 1e\+300 to 1e\+300 °C .*: correct scale or offset",
    ),
    "100,000 signals": ((MAPPED, EXAMPLE, many_signals(100_000)), "100000 signals; at most 20000"),
}
"""Config, model and DBC, and what the line says."""
SLOW: dict[str, tuple[tuple[str, str, str], str]] = {
    "200,000 dotted keys": (config(".".join("a" * 200_000) + " = 1"), "gateway.toml: reading it takes over"),
    "200,000 tables": (
        ("\n".join(f"a{i}.b = 1" for i in range(200_000)) + "\n" + MAPPED, EXAMPLE, DBC),
        "gateway.toml: reading it takes over",
    ),
    "450,000 labels": (
        dbc("VAL_ 256 Soc " + " ".join(f'{i} "a{i}"' for i in range(450_000)) + " ;\n"),
        "vehicle.dbc: reading it takes over",
    ),
}
"""What only the bounds end."""
