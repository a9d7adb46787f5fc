"""Configs, models and DBC files spoilt in the way that a text is: lines, numbers, names; not bytes alone."""

import random
import re
from pathlib import Path

from tests.config.files import DBC, MAPPED, OWN, write
from tests.config.hostile import ATTRIBUTES, DATA_ID, LOOP
from tests.config.model_texts import EXAMPLE
from tests.fuzz.mutate import apply, random_edits

FILES = ("gateway.toml", "string_1.toml", "vehicle.dbc")
PROTECTED = 'BA_ "E2EProfile" BO_ 256 1;\nBA_ "E2EDataID" BO_ 256 77;\nBA_ "GenMsgCycleTime" BO_ 256 100;\n'
VALUES = 'VAL_ 256 Soc 254 "error" 255 "SNA" ;\nCM_ SG_ 256 Soc "charge";\nSIG_VALTYPE_ 256 Voltage : 0;\n'
EFFECTS = """
[effect.resistance_temperature]
B = { value = 500, unit = "K", sd = 2000 }
"""
SEEDS: dict[str, tuple[str, ...]] = {
    FILES[0]: (MAPPED, OWN, MAPPED + '[mqtt]\nhost = "localhost"\n[alerts]\ncore_max_C = 60.0\n'),
    FILES[1]: (EXAMPLE, EXAMPLE.replace("effects = []", 'effects = ["resistance_temperature"]') + EFFECTS),
    FILES[2]: (DBC, DBC + ATTRIBUTES + DATA_ID + PROTECTED, DBC + LOOP, DBC + VALUES),
}
NUMBERS = (
    *(
        "0",
        "-1",
        "1e400",
        "-1e308",
        "1e-320",
        "0x" + "F" * 30,
        "9" * 5000,
        "99999",
        "4294967296",
        "18446744073709551616",
    ),
    *("1.5", "nan", "inf", "65", "-0.0", "2", "1785", "true", "07:32:00", "1979-05-27"),
)
TEXTS = ('""', '"\\u0000"', '"x"', '"' + "y" * 5000 + '"', '"../../etc/passwd"', '"/dev/zero"', '"é\\u202e"', '"."')
SHAPES = ("[]", "{}", "[[[[1]]]]", "[" * 3000 + "]" * 3000, "{ a = { b = { c = 1 } } }", "[1, 'a', 2.0]")
NUMBER = re.compile(r"-?\d+(\.\d+)?")
TEXT = re.compile(r'"[^"\n]*"')
WORD = re.compile(r"[A-Za-z_]\w*")


def spoilt(rng: random.Random) -> tuple[str, bytes]:
    """One of the three files, and what stands in it."""
    name = rng.choice(FILES)
    text = rng.choice(SEEDS[name])
    if rng.random() < 0.3:
        return name, apply(text.encode(), random_edits(rng))
    for _ in range(1 + int(rng.expovariate(1.0))):
        text = _edited(rng, text)
    return name, text.encode()


def _edited(rng: random.Random, text: str) -> str:
    how = rng.randrange(8)
    if how == 0:
        return _replaced(rng, text, NUMBER, rng.choice(NUMBERS))
    if how == 1:
        return _replaced(rng, text, TEXT, rng.choice(TEXTS))
    if how == 2:
        return _replaced(rng, text, TEXT if rng.random() < 0.5 else NUMBER, rng.choice(SHAPES))
    if how == 3:  # a name for another of the same file
        return _replaced(rng, text, WORD, rng.choice(WORD.findall(text) or ["x"]))
    lines = text.splitlines(keepends=True) or [""]
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    if how == 4:
        del lines[i]
    elif how == 5:
        lines.insert(j, lines[i])
    elif how == 6:
        lines[i], lines[j] = lines[j], lines[i]
    else:
        lines.insert(i, f"{'.'.join('k' * rng.choice((1, 5, 50, 2000)))} = {rng.choice(NUMBERS + SHAPES)}\n")
    return "".join(lines)


def _replaced(rng: random.Random, text: str, what: re.Pattern[str], by: str) -> str:
    places = list(what.finditer(text))
    if not places:
        return text + by
    found = rng.choice(places)
    return text[: found.start()] + by + text[found.end() :]


def lay(folder: Path, name: str, content: bytes) -> Path:
    """Write the sound three with one of them spoilt; returns the path of the config."""
    path = write(folder, MAPPED)
    (folder / name).write_bytes(content)
    return path
