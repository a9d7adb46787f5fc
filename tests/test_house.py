"""The house itself: files that a person can read at a sitting, no empty rooms, nothing beside the agreed top level."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "bms_gateway"
LONGEST = 500  # lines; about 300 is the aim
TOP = {"pyproject.toml", "bms_gateway", "dbc", "tests", "deploy", "README.md", "dist", "build"}


def test_no_file_is_longer_than_can_be_read() -> None:
    ours = [p for place in ("bms_gateway", "dbc", "tests") for p in (ROOT / place).rglob("*.py")]
    assert len(ours) > 100
    lengths = {str(p.relative_to(ROOT)): len(p.read_text(encoding="utf-8").splitlines()) for p in ours}
    assert {name: n for name, n in lengths.items() if n > LONGEST} == {}


def test_every_room_has_something_in_it() -> None:
    for room in (p for p in PACKAGE.iterdir() if p.is_dir() and p.name not in ("__pycache__", "shipped")):
        code = [f for f in room.glob("*.py") if f.name != "__init__.py"]
        assert code, f"{room.name} is empty"
        assert (room / "__init__.py").read_text().startswith('"""'), f"{room.name} does not say what it is for"


def test_nothing_lies_beside_the_agreed_top_level_but_what_the_readme_has_one_make() -> None:
    made = set(re.findall(r"--out (\w+)$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE))
    assert made == {"my_vehicle", "results"}
    assert all(f"/{name}/" in (ROOT / ".gitignore").read_text(encoding="utf-8").split() for name in made)
    assert {p.name for p in ROOT.iterdir() if not p.name.startswith(".")} <= TOP | made


def test_what_libraries_do_well_is_left_to_them() -> None:
    """Config files are checked by pydantic, logs and DBC files read by python-can and cantools: none of it is ours."""
    for library, file in (("pydantic", "config/schema.py"), ("cantools", "frames/dbc.py"), ("can", "bus/pythoncan.py")):
        text = (PACKAGE / file).read_text(encoding="utf-8")
        assert f"import {library}" in text or f"from {library}" in text, f"{file} does without {library}"
