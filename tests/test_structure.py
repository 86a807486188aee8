"""The shape of the package: no long files, few tiny ones, no circles, and a sentence on what each folder is for."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import networkx as nx

import sppm_pipeline
from tests.conftest import LONG

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "sppm_pipeline"
MAXIMUM_LINES = 450
SMALL, MAXIMUM_SMALL = 60, 25


def modules() -> dict[str, int]:
    """Lines of each module by its path."""
    return {
        path.relative_to(ROOT).as_posix(): len(path.read_text(encoding="utf-8").splitlines()) for path in python_files()
    }


def python_files() -> list[Path]:
    """Modules of the package."""
    return [*PACKAGE.rglob("*.py")]


def test_no_file_is_long():
    assert {file: lines for file, lines in modules().items() if lines > MAXIMUM_LINES} == {}


def test_the_tests_that_take_long_are_there():
    assert [file for file in LONG if not (ROOT / file).is_file()] == []


def test_few_files_are_tiny():
    # an `__init__` that only says what its package is for is no module of its own, and a stage is as short as it can be
    small = sorted(
        file
        for file, lines in modules().items()
        if lines < SMALL and not file.endswith("/__init__.py") and "/stages/" not in file
    )
    assert len(small) <= MAXIMUM_SMALL, small


def test_packages_say_what_they_are_for():
    for folder in {path.parent for path in python_files()}:
        tree = ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))
        assert ast.get_docstring(tree), folder


def names_in(folder: Path) -> set[str]:
    """Modules and packages in a folder, and what these define at their top."""
    found = set()
    for path in folder.iterdir():
        if path.is_dir() or path.suffix == ".py":
            found.add(path.stem)
        if path.suffix == ".py":
            tree = ast.parse(path.read_text(encoding="utf-8"))
            found |= {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    return found


def test_packages_name_only_what_is_there():
    """What a package's docstring puts between backticks is something in it, or below this package."""
    public = sppm_pipeline.__all__
    missing = {}
    for folder in {path.parent for path in python_files()}:
        text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))) or ""
        for name in re.findall(r"(?<!`)`([A-Za-z_][\w.]*)`(?!`)", text):
            *packages, last = name.removeprefix("sppm_pipeline.").split(".")
            inside = (PACKAGE if name.startswith("sppm_pipeline.") else folder).joinpath(*packages)
            known = names_in(inside) if inside.is_dir() else names_in(inside.parent) if packages else set()
            if last not in known and name not in public and not (packages and inside.with_suffix(".py").is_file()):
                missing.setdefault(folder.relative_to(ROOT).as_posix(), []).append(name)
    assert missing == {}


def imports_at_run_time(path: Path) -> set[str]:
    """What a file imports, at its top or inside functions, but not for type checkers alone."""

    def found(node: ast.AST) -> Iterator[str]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.ImportFrom) and child.module and not child.level:
                yield child.module
                yield from (f"{child.module}.{alias.name}" for alias in child.names)
            elif isinstance(child, ast.Import):
                yield from (alias.name for alias in child.names)
            yield from found(child)

    return set(found(ast.parse(path.read_text(encoding="utf-8"))))


def test_no_file_needs_a_file_that_needs_it():
    def name(path: Path) -> str:
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)

    files = {name(path): path for path in python_files()}
    needs = nx.DiGraph()
    for place, path in files.items():
        for other in imports_at_run_time(path):
            below = other.removeprefix("sppm_pipeline.")
            if other.startswith("sppm_pipeline.") and below in files and below != place:
                needs.add_edge(place, below)
    assert [sorted(circle) for circle in nx.strongly_connected_components(needs) if len(circle) > 1] == []


FROM_A_FACE = re.compile(r"from sppm_pipeline(\.(nouns|numerics|pictures|formats))?\s+import\b")


def test_the_faces_are_no_back_door_to_features():
    """What a file takes from a face lies where the file may import from: features are named there for plugins."""
    places = {}
    for face in ("__init__.pyi", "nouns/__init__.pyi", "numerics.pyi", "pictures.pyi", "formats.pyi"):
        module = "sppm_pipeline." + face.removesuffix(".pyi").removesuffix("__init__").replace("/", ".")
        for node in ast.parse((PACKAGE / face).read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom):
                names = {(module.rstrip("."), alias.asname.removeprefix("_")) for alias in node.names}
                places |= dict.fromkeys(names, node.module.removeprefix("sppm_pipeline."))
    wrong = []
    for path in python_files():
        ring, *rest = path.relative_to(PACKAGE).parts
        if not rest or ring == "testing":
            continue
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if FROM_A_FACE.search(text) else ():
            if isinstance(node, ast.ImportFrom):
                for alias in node.names:
                    other = places.get((node.module, alias.name), "").split(".")
                    if other[0] == "features" and (ring != "features" or other[1] != rest[0]):
                        wrong.append((path.relative_to(ROOT).as_posix(), alias.name))
    assert wrong == []


PROOF = ("flow",)
"""Features that show that the faces hold all that a feature needs."""


def test_a_feature_imports_the_faces_alone():
    faces = {
        "sppm_pipeline",
        *(f"sppm_pipeline.{face}" for face in ("nouns", "numerics", "pictures", "formats", "errors")),
    }
    taken = {
        (feature, node.module)
        for feature in PROOF
        for path in (PACKAGE / "features" / feature).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("sppm_pipeline")
    }
    own = {pair for pair in taken if pair[1].startswith(f"sppm_pipeline.features.{pair[0]}")}
    assert {module for _, module in taken - own} <= faces


def test_kernels_that_may_contract_take_no_powers():
    """Numba compiles a power once in a process, with the flags of its first caller: bytes would depend on it."""
    found = [
        f"{path.name}:{node.lineno}"
        for text, path in ((path.read_text(encoding="utf-8"), path) for path in python_files())
        if "inline_jit" in text or "fused_jit" in text
        for function in ast.walk(ast.parse(text))
        if isinstance(function, ast.FunctionDef)
        and any(getattr(kind, "id", "") in ("inline_jit", "fused_jit") for kind in function.decorator_list)
        for node in ast.walk(function)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow)
    ]
    assert found == []
