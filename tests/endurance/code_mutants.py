"""Small changes of the code, one at a time, and whether a test notices: mutation testing.

    python tests/endurance/code_mutants.py [MOST] [SEED] [MODULE...]

Each module of `TARGETS` is changed in at most MOST ways (40), drawn by SEED (0) from all that `Mutator` knows; MODULE
is a part of a name, such as ``voigt``; all if omitted. A child of this process imports the changed module in place of
the real one and runs the tests that stand beside it here. Survivors are listed, with the score; equivalent changes are
among them. Modules with compiled kernels are refused: what is kept of those does not know of changes in memory.

mutmut and cosmic-ray start an interpreter for each mutant, which takes longer than most of these tests.
"""

from __future__ import annotations

import ast
import contextlib
import importlib
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib.machinery import SourceFileLoader
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 60.0
"""Seconds after which a mutant counts as noticed: it hangs."""

TARGETS = {
    "nouns/length": ("tests/nouns/test_length.py",),
    "services/elastic/bounds": ("tests/services/elastic/test_bounds.py",),
    "services/elastic/convergence": ("tests/services/elastic/test_convergence.py",),
    "services/elastic/directional": ("tests/services/elastic/test_directional.py",),
    "services/elastic/isotropy": ("tests/services/elastic/test_isotropy.py",),
    "services/elastic/voigt": ("tests/services/elastic/test_voigt.py",),
    "services/boolean_model": ("tests/services/test_boolean_model.py",),
    "services/grid": ("tests/services/test_grid.py",),
    "services/target_search": ("tests/services/test_target_search.py",),
}
"""Modules, and the tests that should notice a change of theirs."""

COMPARISONS = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
OPERATIONS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Div, ast.Mod: ast.Mult,
    ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
NAMES = {"min": "max", "max": "min", "any": "all", "all": "any", "floor": "ceil", "ceil": "floor"}


def changed(node: ast.AST) -> Iterator[ast.AST]:
    """What stands in the place of a node in a mutant."""
    match node:
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value)):
            yield ast.Constant(value + 1)
        case ast.Constant(value=float(value)):
            yield ast.Constant(1.1 * value if value else 1.0)
        case ast.Compare(ops=[op]) if type(op) in COMPARISONS:
            yield ast.Compare(node.left, [COMPARISONS[type(op)]()], node.comparators)
        case ast.BinOp(op=ast.MatMult()):
            yield ast.BinOp(node.right, node.op, node.left)
        case ast.BinOp() if type(node.op) in OPERATIONS:
            yield ast.BinOp(node.left, OPERATIONS[type(node.op)](), node.right)
        case ast.AugAssign() if type(node.op) in OPERATIONS:
            yield ast.AugAssign(node.target, OPERATIONS[type(node.op)](), node.value)
        case ast.BoolOp():
            yield ast.BoolOp(ast.And() if isinstance(node.op, ast.Or) else ast.Or(), node.values)
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            yield node.operand
        case ast.IfExp():
            yield ast.IfExp(node.test, node.orelse, node.body)
        case ast.If() | ast.While():
            yield type(node)(ast.UnaryOp(ast.Not(), node.test), node.body, node.orelse)
        case ast.Subscript(slice=ast.Tuple(elts=[first, second])) if ast.dump(first) != ast.dump(second):
            yield ast.Subscript(node.value, ast.Tuple([second, first], ast.Load()), node.ctx)
        case ast.Name(id=name) if name in NAMES:
            yield ast.Name(NAMES[name], node.ctx)
        case ast.Attribute(attr=name) if name in NAMES:
            yield ast.Attribute(node.value, NAMES[name], node.ctx)
        case ast.Expr(value=ast.Call()):
            yield ast.Pass()


class Mutator(ast.NodeTransformer):
    """Changes the node of one number, in the order of the tree; messages and annotations are left alone."""

    def __init__(self, number: int = -1) -> None:
        self.number, self.count = number, 0
        self.found = ""

    def visit(self, node: ast.AST) -> ast.AST:
        for new in changed(node):
            if self.count == self.number:
                self.count += 1
                place, shown = getattr(node, "lineno", 0), ast.If | ast.While
                old, now = (ast.unparse(one.test if isinstance(one, shown) else one) for one in (node, new))
                self.found = f"{place}: {old}  ->  {now}"
                return ast.copy_location(new, node)
            self.count += 1
        if isinstance(node, ast.Raise | ast.JoinedStr):
            return node
        for field in ("annotation", "returns"):
            kept = getattr(node, field, None)
            if kept is not None:
                setattr(node, field, None if field == "returns" else ast.Name("object", ast.Load()))
                visited = self.generic_visit(node)
                setattr(node, field, kept)
                return visited
        return self.generic_visit(node)


def mutant(source: str, number: int) -> tuple[str, ast.Module, int]:
    """What was changed, the changed module, and how many mutants there are."""
    tree, mutator = ast.parse(source), Mutator(number)
    tree = ast.fix_missing_locations(mutator.visit(tree))
    return mutator.found, tree, mutator.count


def passes(path: Path, tree: ast.Module, tests: tuple[str, ...]) -> bool:
    """Whether all tests pass, in a child of this process, with a module in place of the one in a file."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    code = 1
    with contextlib.suppress(BaseException):
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(int(LIMIT))
        null = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(null, stream)
        original = SourceFileLoader.get_code
        compiled = compile(tree, str(path), "exec")
        SourceFileLoader.get_code = lambda self, name: compiled if self.path == str(path) else original(self, name)
        import pytest

        code = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "--rootdir", str(ROOT), *tests]))
    os._exit(code)


def main(arguments: list[str]) -> int:
    most, seed = (int(a) for a in [*arguments[:2], *["40", "0"][len(arguments[:2]) :]])
    os.chdir(ROOT)
    kernels = Path(tempfile.mkdtemp(prefix="sppm-mutants-"))
    with contextlib.suppress(OSError):  # a copy, so that nothing that a mutant leaves is used by others
        shutil.copytree(Path.home() / ".cache" / "sppm" / "kernels", kernels / "sppm-kernels")
    os.environ["NUMBA_CACHE_DIR"] = str(kernels)
    for library in ("numpy", "scipy.spatial", "scipy.optimize", "scipy.ndimage", "numba", "pytest"):
        importlib.import_module(library)  # once for all children
    killed = total = 0
    try:
        for name, tests in TARGETS.items():
            if arguments[2:] and not any(part in name for part in arguments[2:]):
                continue
            began, path = time.perf_counter(), ROOT / "sppm_pipeline" / f"{name}.py"
            source = path.read_text(encoding="utf-8")
            if "import jit" in source or "import inline_jit" in source:
                raise SystemExit(f"{name} has compiled kernels")
            _, unchanged, count = mutant(source, -1)
            if not passes(path, unchanged, tests):
                raise SystemExit(f"{', '.join(tests)} fail without any change")
            numbers = sorted(random.Random(f"{seed} {name}").sample(range(count), min(most, count)))
            survivors = []
            for number in numbers:
                found, tree, _ = mutant(source, number)
                if passes(path, tree, tests):
                    survivors.append(found)
            killed, total = killed + len(numbers) - len(survivors), total + len(numbers)
            print(f"{name}: {len(numbers) - len(survivors)} of {len(numbers)} noticed ({count} there are), "
                  f"{time.perf_counter() - began:.0f} s", flush=True)  # fmt: skip
            for survivor in survivors:
                print(f"    sppm_pipeline/{name}.py:{survivor}", flush=True)
    finally:
        shutil.rmtree(kernels, ignore_errors=True)
    print(f"{killed} of {total} mutants were noticed")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
