"""Mutation testing, for example

    python -m tests.benchmarks.mutation bms_gateway/bus/pace.py --tests tests/bus/test_rules.py

Changes one operator, constant, condition or statement of a module at a time and runs those of the tests given that
reach the changed line; a mutant that they let pass has survived. Survivors that no test can kill stand with the reason
in `equivalent_mutants`; an entry there that no longer fits its module is told. `--limit` takes so many mutants, spread
evenly over the module; `--again` those that survived in what an earlier run printed.

The checkout is copied aside first, and never touched. One process loads the libraries and the rooms below the module's
own, which cannot import it, and forks for each mutant; the mutant itself is compiled in the child, so that nothing is
written. Annotations, decorators and texts are not mutated.

`--written` is for modules that the tests run in processes of their own: each mutant is written into the copy too, and
all tests are run on it, since nobody counts the lines that such processes reach.
"""

import argparse
import ast
import contextlib
import gc
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks.equivalent_mutants import EQUIVALENT

ROOT = Path(__file__).resolve().parents[2]
HANG_S = 60
"""On top of ten times what the tests take on the sound module: a mutant that takes longer hangs, which is noticed."""
SWAPS: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt,),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt,),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.FloorDiv,),
    ast.Pow: (ast.Mult,),
    ast.LShift: (ast.RShift,),
    ast.RShift: (ast.LShift,),
    ast.BitXor: (ast.BitAnd,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
}


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change: the number of the node in `parents`' order, which of its mutations, and what that is in words."""

    node: int
    which: int
    line: int
    last_line: int
    scope: str
    change: str

    @property
    def name(self) -> str:
        return f"{self.scope}: {self.change}"


def nodes(tree: ast.AST, scope: str = "") -> Iterator[tuple[ast.AST, str]]:
    """All nodes that may be mutated, in the order of the text, with the name of the function or class around."""
    for field, value in ast.iter_fields(tree):
        if field in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield child, scope
                named = isinstance(child, ast.FunctionDef | ast.ClassDef)
                yield from nodes(child, f"{scope}.{child.name}".lstrip(".") if named else scope)


def mutations(node: ast.AST) -> list[ast.AST]:
    """What may stand in a node's place."""
    found: list[ast.AST] = []
    if isinstance(node, ast.Compare):
        for i, op in enumerate(node.ops):
            found += [
                _with(node, ops=[*node.ops[:i], other(), *node.ops[i + 1 :]]) for other in SWAPS.get(type(op), ())
            ]
    elif isinstance(node, ast.BinOp | ast.AugAssign | ast.BoolOp):
        found += [_with(node, op=other()) for other in SWAPS.get(type(node.op), ())]
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.Invert | ast.USub):
        found.append(deepcopy(node.operand))
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        found.append(ast.Constant(not node.value))
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        found.append(ast.Constant(node.value + 1))
    elif isinstance(node, ast.If | ast.IfExp | ast.While):
        found.append(_with(node, test=ast.UnaryOp(ast.Not(), node.test)))
    elif isinstance(node, ast.Break | ast.Continue):
        found.append(ast.Continue() if isinstance(node, ast.Break) else ast.Break())
    return [*found, ast.Pass()] if _may_go(node) else found


def _with(node: ast.AST, **fields: object) -> ast.AST:
    changed = deepcopy(node)
    for name, value in fields.items():
        setattr(changed, name, deepcopy(value))
    return changed


def _may_go(node: ast.AST) -> bool:
    """Whether it is a statement without which the rest can still run."""
    if isinstance(node, ast.Assign):
        return all(isinstance(t, ast.Attribute | ast.Subscript) for t in node.targets)
    return isinstance(node, ast.AugAssign | ast.Raise) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    )


def shown(node: ast.AST) -> str:
    return ast.unparse(ast.fix_missing_locations(deepcopy(node))).splitlines()[0][:110]


def mutants(source: str) -> list[Mutant]:
    """Every mutant of a module; those with the same words are told apart by a number."""
    found, seen = [], dict[str, int]()
    for number, (node, scope) in enumerate(nodes(ast.parse(source))):
        for which, other in enumerate(mutations(node)):
            change = f"{shown(node)}  ->  {shown(other)}"
            seen[f"{scope}: {change}"] = nth = seen.get(f"{scope}: {change}", 0) + 1
            line = getattr(node, "lineno", 0)
            last = line if isinstance(node, ast.If | ast.While) else (getattr(node, "end_lineno", None) or line)
            found.append(Mutant(number, which, line, last, scope, change + (f"  #{nth}" if nth > 1 else "")))
    return found


def changed(source: str, mutant: Mutant) -> ast.Module:
    """The module with one change."""
    tree = ast.parse(source)
    node = next(n for i, (n, _) in enumerate(nodes(tree)) if i == mutant.node)
    other = ast.copy_location(mutations(node)[mutant.which], node)

    class Swap(ast.NodeTransformer):
        def visit(self, seen: ast.AST) -> ast.AST:
            return other if seen is node else self.generic_visit(seen)

    return ast.fix_missing_locations(Swap().visit(tree))


class Changed(importlib.abc.MetaPathFinder, importlib.machinery.SourceFileLoader):
    """Import one module from a changed tree."""

    def __init__(self, name: str, path: str, tree: ast.Module) -> None:
        super().__init__(name, path)
        self._tree = tree

    def find_spec(self, name, path, target=None):
        return importlib.util.spec_from_file_location(name, self.path, loader=self) if name == self.name else None

    def get_code(self, fullname):
        return compile(self._tree, self.path, "exec")


PYTEST = ["-x", "-q", "-pno:cacheprovider", "--hypothesis-seed=0", "-m", "not slow and not vcan and not systemd"]
BRIEF = [
    "--assert=plain",
    *(f"-pno:{p}" for p in ("cov", "unraisableexception", "threadexception", "junitxml")),
]
"""For the children: what makes failures readable or reports them is left out, two thirds of a start; but the marks of
xdist are those of `conftest`."""


class Durations:
    """A plugin of pytest that keeps what each test took."""

    def __init__(self) -> None:
        self.of: dict[str, float] = {}

    def pytest_runtest_logreport(self, report) -> None:
        self.of[report.nodeid] = self.of.get(report.nodeid, 0.0) + report.duration


def sound_run(modules: list[str], tests: list[str]) -> tuple[dict[str, dict[int, list[str]]], dict[str, float]]:
    """Tests that reach each line of each module, and what each test takes; ends the program where one fails."""
    import pytest
    from coverage import CoverageData

    durations = Durations()
    # by folder: to find a module by its name coverage would import its package, and numpy cannot be imported twice
    where = [f"--cov={folder}" for folder in sorted({str(Path(m).parent) for m in modules})]
    with tempfile.TemporaryDirectory() as folder:
        os.environ["COVERAGE_FILE"] = f"{folder}/reached"
        if pytest.main([*PYTEST, *where, "--cov-context=test", "--cov-report=", *tests], [durations]):
            sys.exit("the tests fail on the sound modules")
        data = CoverageData(f"{folder}/reached")
        data.read()
        reached = {}
        for module in modules:
            by_line = data.contexts_by_lineno(str(Path(module).resolve()))
            reached[module] = {n: _tests_of(found, durations.of) for n, found in by_line.items()}
    return reached, durations.of


def _tests_of(contexts: list[str], known: Iterable[str]) -> list[str]:
    """Tests that may notice a change: those that reached the line, and all of a file whose shared setup did."""
    found = {c.split("|")[0] for c in contexts} - {""}
    files = tuple({c.split("::")[0] + "::" for c in contexts if c.endswith("|setup")})
    return sorted(found | ({test for test in known if test.startswith(files)} if files else set()))


@contextlib.contextmanager
def written(module: str, tree: ast.Module, number: int) -> Iterator[None]:
    """Have a mutant in the place of the module, as new as no other one: what was compiled of them is not taken."""
    path = Path(module)
    before = path.read_text()
    path.write_text(ast.unparse(tree))
    os.utime(path, (number, number))
    try:
        yield
    finally:
        path.write_text(before)


def survives(module: str, tree: ast.Module, tests: list[str], patience_s: float) -> bool:
    """Run tests on a changed module in a child; a child that hangs or breaks has noticed the change."""
    child = os.fork()
    if child == 0:
        code = 1
        with contextlib.suppress(BaseException):
            os.setpgrp()  # not a session: that would not be as nice as we are
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1)
            os.dup2(quiet, 2)
            import hypothesis
            import pytest

            # what earlier mutants failed with is no merit of the tests; nor need a failure be made small
            phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
            hypothesis.settings.register_profile("mutants", database=None, phases=phases)
            hypothesis.settings.load_profile("mutants")
            name = module.removesuffix(".py").replace("/", ".")
            sys.meta_path.insert(0, Changed(name, str(Path(module).resolve()), tree))
            code = int(pytest.main([*PYTEST, *BRIEF, *tests]))
        os._exit(code)
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status) == 0
        time.sleep(0.005)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False


def rooms_below(modules: list[str]) -> list[str]:
    """Names of all modules in rooms that may import none of these, by the layers that `lint-imports` holds."""
    contracts = tomllib.loads(Path("pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = [{room.strip() for room in layer.split("|")} for layer in contracts[0]["layers"]]
    own = {Path(m).parts[1].removesuffix(".py") for m in modules}
    lowest = max(i for i, rooms in enumerate(layers) if rooms & own)
    rooms = set().union(*layers[lowest + 1 :])
    files = (path.relative_to("bms_gateway").with_suffix("") for path in Path("bms_gateway").rglob("*.py"))
    return sorted(".".join(("bms_gateway", *f.parts)).removesuffix(".__init__") for f in files if f.parts[0] in rooms)


def judge(
    module: str,
    limit: int | None,
    again: str | None,
    reached: dict[int, list[str]],
    took: dict[str, float],
    write: bool,
) -> tuple[int, int, int]:
    """Mutants killed, equivalent, and tried in all."""
    source = Path(module).read_text()
    every = mutants(source)
    chosen = every if limit is None else every[:: max(1, len(every) // limit)]
    if again is not None:
        told = set(re.findall(rf"^  (?:survived|never run)  {re.escape(module)}:\d+ (.*)$", again, re.M))
        chosen = [m for m in every if m.name in told]
    known = EQUIVALENT.get(module, {})
    for name in sorted(set(known) - {m.name for m in every}):
        print(f"  no such mutant any more: {module} {name}", flush=True)
    begun, dead, equivalent, tried = time.monotonic(), 0, 0, 0
    all_tests = sorted(took, key=lambda test: took[test])
    if not survives(module, ast.parse(source), all_tests, HANG_S + 10 * sum(took.values())):
        sys.exit(f"{module}: a child fails on the sound module")
    for mutant in chosen:
        if mutant.name in known:
            equivalent += 1
            continue
        lines = range(mutant.line, mutant.last_line + 1)
        # what is done at import is reached before any test
        tests = sorted({t for n in lines for t in reached.get(n, [])}, key=lambda test: took[test])
        if write or (not tests and any(n in reached for n in lines)):
            tests = all_tests
        patience_s = HANG_S + 10 * sum(took[t] for t in tests)
        tree = changed(source, mutant)
        with written(module, tree, 10**9 + tried) if write else contextlib.nullcontext():
            noticed = bool(tests) and not survives(module, tree, tests, patience_s)
        tried += 1
        if noticed:
            dead += 1
        else:
            print(f"  {'survived' if tests else 'never run'}  {module}:{mutant.line} {mutant.name}", flush=True)
    print(
        f"{module}: {dead} of {len(chosen)} killed ({100 * dead / len(chosen):.1f} %), {equivalent} equivalent, "
        f"{len(chosen) - dead - equivalent} survived; {len(every)} possible; {time.monotonic() - begun:.0f} s",
        flush=True,
    )
    return dead, equivalent, len(chosen)


def work(modules: list[str], tests: list[str], limit: int | None, again: str | None, write: bool) -> int:
    """Try the mutants of the modules, in the copy."""
    receiving, sending = os.pipe()
    if os.fork() == 0:  # so that nothing of the package is loaded in the process that forks later
        os.close(receiving)
        told = json.dumps(sound_run(modules, tests))
        with os.fdopen(sending, "w") as out:
            out.write(told)
        os._exit(0)
    os.close(sending)
    with os.fdopen(receiving) as answer:
        told = answer.read()
    os.wait()
    if not told:
        return 1
    reached, took = json.loads(told)
    import can  # noqa: F401
    import cantools  # noqa: F401
    import hypothesis  # noqa: F401
    import numpy  # noqa: F401
    import pytest  # noqa: F401
    import scipy.linalg
    import scipy.optimize
    import scipy.stats  # noqa: F401

    for name in rooms_below(modules):
        importlib.import_module(name)
    if loaded := {m.removesuffix(".py").replace("/", ".") for m in modules} & set(sys.modules):
        sys.exit(f"loaded by rooms below: {', '.join(sorted(loaded))}")
    gc.freeze()  # no collection goes through all that in a child
    dead = equivalent = tried = 0
    for module in modules:
        lines = {int(n): found for n, found in reached[module].items()}
        d, e, t = judge(module, limit, again, lines, took, write)
        dead, equivalent, tried = dead + d, equivalent + e, tried + t
    print(f"{dead} of {tried} mutants killed ({100 * dead / tried:.1f} %), {equivalent} equivalent", flush=True)
    return 0 if dead + equivalent >= 0.9 * tried else 1


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("modules", nargs="+")
    parser.add_argument("--tests", nargs="+", required=True)
    parser.add_argument("--limit", type=int)
    parser.add_argument("--again", type=Path)
    parser.add_argument("--written", action="store_true")
    asked = parser.parse_args()
    if "MUTATION_COPY" in os.environ:
        again = None if asked.again is None else Path(os.environ["MUTATION_COPY"], asked.again).read_text()
        return work(asked.modules, asked.tests, asked.limit, again, asked.written)
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name) / "src"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", "__pycache__", ".*_cache", ".venv"))
        data = os.environ.get("BMS_GATEWAY_DATA", str(ROOT.parent / "shared" / "data"))
        environment = os.environ | {
            "PYTHONPATH": str(copy),
            "PYTHONSAFEPATH": "1",
            "MUTATION_COPY": str(Path.cwd()),
            "BMS_GATEWAY_DATA": data,
            "OPENBLAS_NUM_THREADS": "1",
            "TMPDIR": name,
        }
        command = [sys.executable, "-m", "tests.benchmarks.mutation", *sys.argv[1:]]
        return subprocess.run(command, cwd=copy, env=environment).returncode


if __name__ == "__main__":
    sys.exit(main())
