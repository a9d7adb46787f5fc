"""Mutation testing, for example

    python -m tests.benchmarks.mutation bms_gateway/bus/pace.py -- tests/bus/test_rules.py [--limit N]

Changes one operator, constant or condition of a module at a time and runs the tests given; a mutant that they let pass
has survived. The package is copied aside first, so the checkout is never touched. `--limit` takes so many mutants,
spread evenly over the module.
"""

import ast
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
HANG_S = 300
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
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
}


def places(tree: ast.Module) -> Iterator[tuple[int, int]]:
    """Number of each node in `ast.walk`, and number of its mutation."""
    for number, node in enumerate(ast.walk(tree)):
        yield from ((number, k) for k in range(len(mutations(node))))


def mutations(node: ast.AST) -> list[ast.AST]:
    """What may stand in a node's place."""
    found: list[ast.AST] = []
    if isinstance(node, ast.Compare):
        for i, op in enumerate(node.ops):
            for other in SWAPS.get(type(op), ()):
                changed = deepcopy(node)
                changed.ops[i] = other()  # type: ignore[assignment]
                found.append(changed)
    elif isinstance(node, ast.BinOp | ast.AugAssign | ast.BoolOp):
        for other in SWAPS.get(type(node.op), ()):
            changed = deepcopy(node)
            changed.op = other()  # type: ignore[assignment]
            found.append(changed)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.Invert | ast.USub):
        found.append(deepcopy(node.operand))
    elif isinstance(node, ast.Constant) and not isinstance(node.value, str | bytes) and node.value is not None:
        if node.value is Ellipsis:
            return []
        value = not node.value if isinstance(node.value, bool) else node.value + 1
        found.append(ast.Constant(value))
    elif isinstance(node, ast.If | ast.IfExp | ast.While):
        changed = deepcopy(node)
        changed.test = ast.UnaryOp(ast.Not(), changed.test)
        found.append(changed)
    return found


def mutant(source: str, number: int, which: int) -> tuple[str, str]:
    """Text of a module with one change, and what was changed."""
    tree = ast.parse(source)
    node = next(n for i, n in enumerate(ast.walk(tree)) if i == number)
    other = ast.copy_location(mutations(node)[which], node)

    class Swap(ast.NodeTransformer):
        def visit(self, seen: ast.AST) -> ast.AST:
            return other if seen is node else self.generic_visit(seen)

    before = ast.unparse(node).splitlines()[0][:70]
    changed = ast.fix_missing_locations(Swap().visit(tree))
    return ast.unparse(
        changed
    ), f"line {getattr(node, 'lineno', 0)}: {before}  ->  {ast.unparse(other).splitlines()[0][:70]}"


def main() -> int:
    words = sys.argv[1:]
    limit = int(words[words.index("--limit") + 1]) if "--limit" in words else None
    if limit is not None:
        at = words.index("--limit")
        del words[at : at + 2]
    cut = words.index("--")
    modules, tests = words[:cut], words[cut + 1 :]
    killed = total = 0
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name) / "src"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", "__pycache__", ".*_cache", ".venv"))
        environment = os.environ | {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1", "PYTHONSAFEPATH": "1"}
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--hypothesis-seed=0", *tests]
        environment["BMS_GATEWAY_DATA"] = os.environ.get("BMS_GATEWAY_DATA", str(ROOT.parent / "shared" / "data"))
        sound = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True)
        if sound.returncode:
            print(sound.stdout[-2_000:])
            return 1
        for module in modules:
            path, source = copy / module, (ROOT / module).read_text()
            tree = ast.parse(source)
            every = list(places(tree))
            chosen = every if limit is None else every[:: max(1, len(every) // limit)]
            begun, survivors = time.monotonic(), []
            for number, which in chosen:
                text, what = mutant(source, number, which)
                path.write_text(text)
                try:
                    done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, timeout=HANG_S)
                    dead = done.returncode != 0
                except subprocess.TimeoutExpired:
                    dead = True
                if not dead:
                    survivors.append(what)
                    print(f"  survived  {module} {what}", flush=True)
            path.write_text(source)
            dead_here = len(chosen) - len(survivors)
            killed, total = killed + dead_here, total + len(chosen)
            print(
                f"{module}: {dead_here} of {len(chosen)} killed ({100 * dead_here / len(chosen):.0f} %), "
                f"{time.monotonic() - begun:.0f} s; {len(every)} possible",
                flush=True,
            )
    print(f"{killed} of {total} mutants killed ({100 * killed / total:.1f} %)")
    return 0 if killed >= 0.9 * total else 1


if __name__ == "__main__":
    sys.exit(main())
