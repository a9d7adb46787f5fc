"""The house itself: files that a person can read at a sitting, no empty rooms, nothing beside the agreed top level."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "bms_gateway"
LONGEST = 500  # lines; about 300 is the aim
MOST_PARAMETERS = 6
MOST_ATTRIBUTES = 20
DENSER = {
    # one parameter or attribute for each symbol of the equations
    "thermal/parameters.py StringParameters.of": 9,
    "thermal/point.py Point": 29,
    # to be taken apart along what changes together
    "health/heat/balances.py Unknown.of": 7,
    "health/heat/filter.py HeatFilter": 22,
    "health/heat/proven.py may_be_heat": 7,
}
"""Parameters of functions and attributes of classes above the limits: they may fall, and nothing may join them."""
PRIVATE = {
    # a step of a recursion, held against the same step written out
    "observe/test_exact.py": 14,
    "observe/test_gap.py": 1,
    "observe/test_effects.py": 2,
    "diagnosis/test_lacking.py": 1,
    "health/test_fault_onsets.py": 4,
    # one object with another, member by member
    "engine/test_backlog.py": 5,
    # a signal that no process can send to itself in a test; a queue with no other face
    "service/test_signals.py": 3,
    "engine/test_never_learnt.py": 1,
    "engine/test_taken_up.py": 1,
    "engine/test_time_rules.py": 1,
    # what a library keeps to itself
    "bus/test_foreign_rules.py": 1,
    "service/test_child_rules.py": 1,
    "service/test_mqtt_rules.py": 4,
    "support/by_file.py": 1,
    "test_workers.py": 1,
    # a socket that refuses, put in the place of a real one
    "bus/test_vcan.py": 2,
    "workbench/test_desk.py": 2,
    "workbench/test_labels.py": 1,
}
"""Private members of others that the tests touch, by file: they may become fewer, and no file may join them."""
NAMED_TUPLE = {"_replace", "_fields", "_asdict"}
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


def test_helpers_of_several_test_modules_stand_in_modules_of_their_own() -> None:
    found = [
        f"{file.name}: {line}"
        for file in (ROOT / "tests").rglob("*.py")
        for line in file.read_text(encoding="utf-8").splitlines()
        if re.match(r"from tests\.(\w+\.)*test_\w+ import", line)
    ]
    assert found == []


def test_tests_go_through_the_public_face() -> None:
    tests = ROOT / "tests"
    counts = {
        str(f.relative_to(tests)): sum(1 for _ in _private(ast.parse(f.read_text(encoding="utf-8"))))
        for f in tests.rglob("*.py")
    }
    assert {name: n for name, n in counts.items() if n > PRIVATE.get(name, 0)} == {}


def test_private_members_are_counted_as_a_reader_would() -> None:
    text = """
from a._b import c, _d, __version__
import os
class A:
    def f(self, other):
        self._x = other._x + cls._y
        os._exit(other._replace(y=1).__dict__)
        return other._z._w()
"""
    assert sorted(_private(ast.parse(text))) == ["_b", "_d", "_w", "_x", "_z"]


def _private(tree: ast.AST) -> Iterator[str]:
    """Private names that a module imports, or reads of anything but `self` and `cls`."""
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Attribute):
            owner = node.value.id if isinstance(node.value, ast.Name) else ""
            if owner not in ("self", "cls") and (owner, node.attr) != ("os", "_exit"):
                names = [node.attr]
        elif isinstance(node, ast.ImportFrom):
            names = [*(node.module or "").split("."), *(a.name for a in node.names)]
        elif isinstance(node, ast.Import):
            names = [part for a in node.names for part in a.name.split(".")]
        yield from (n for n in names if n[:1] == "_" and n[:2] != "__" and n not in NAMED_TUPLE)


def test_what_libraries_do_well_is_left_to_them() -> None:
    """Config files are checked by pydantic, logs and DBC files read by python-can and cantools: none of it is ours."""
    for library, file in (("pydantic", "config/schema.py"), ("cantools", "frames/dbc.py"), ("can", "bus/pythoncan.py")):
        text = (PACKAGE / file).read_text(encoding="utf-8")
        assert f"import {library}" in text or f"from {library}" in text, f"{file} does without {library}"


def test_functions_and_classes_stay_small_enough_to_keep_in_mind() -> None:
    counts = {}
    for file in sorted(PACKAGE.rglob("*.py")):
        for name, most, count in _sizes(ast.parse(file.read_text(encoding="utf-8"))):
            name = f"{file.relative_to(PACKAGE)} {name}"
            if count > DENSER.get(name, most):
                counts[name] = count
    assert counts == {}


def test_the_counts_are_those_of_a_reader() -> None:
    text = """
class A:
    a: int
    def __init__(self, x, *, y=1, **more):
        self.b, self._c = x, y
    def f(self):
        self._c += 1
        self.d: int = 2
def g(a, b, /, *c): ...
"""
    assert list(_sizes(ast.parse(text))) == [
        ("A", MOST_ATTRIBUTES, 4),
        ("A.__init__", MOST_PARAMETERS, 3),
        ("A.f", MOST_PARAMETERS, 0),
        ("g", MOST_PARAMETERS, 3),
    ]


def _sizes(tree: ast.AST, inside: str = "") -> Iterator[tuple[str, int, int]]:
    """Name, limit and count of each function and class of a module, in the order of its text."""
    for node in ast.iter_child_nodes(tree):
        name = f"{inside}{getattr(node, 'name', '')}"
        if isinstance(node, ast.ClassDef):
            yield name, MOST_ATTRIBUTES, len(_attributes(node))
            yield from _sizes(node, f"{name}.")
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            a = node.args
            given = [*a.posonlyargs, *a.args, *a.kwonlyargs, *filter(None, (a.vararg, a.kwarg))]
            yield name, MOST_PARAMETERS, sum(x.arg not in ("self", "cls") for x in given)
            yield from _sizes(node, f"{name}.")
        else:
            yield from _sizes(node, inside)


def _attributes(body: ast.ClassDef) -> set[str]:
    """Names that a class declares, and that its methods give to `self`."""
    declared = {x.target.id for x in body.body if isinstance(x, ast.AnnAssign) and isinstance(x.target, ast.Name)}
    given = {
        x.attr
        for x in ast.walk(body)
        if isinstance(x, ast.Attribute)
        and isinstance(x.ctx, ast.Store)
        and isinstance(x.value, ast.Name)
        and x.value.id == "self"
    }
    return declared | given
