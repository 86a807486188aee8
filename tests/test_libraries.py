"""Every stage names the libraries that its result depends on, as found in its source and all that it imports."""

import ast
import functools
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.built_in import STAGES, stage_class

ROOT = Path(__file__).resolve().parents[1]
FOR_ALL = {"numpy", "numba", "llvmlite", "scipy", "PIL"}
NOT_IN_RESULTS = {"pluggy", "ruamel", "psutil", "jinja2", "resource", "IPython", "skimage"}
"""Imports that no number comes from: skimage is the reference of a test contract."""
DISTRIBUTIONS = {"nrrd": "pynrrd"}
NOT_USED = {"write.voxels": {"tifffile", "pynrrd"}}
"""Libraries that a module of a stage uses, but not the stage: files are read by them, and written without."""
FACES = ("sppm_pipeline", "sppm_pipeline.nouns", "sppm_pipeline.numerics", "sppm_pipeline.pictures",
         "sppm_pipeline.formats")  # fmt: skip
STANDARD = __import__("sys").stdlib_module_names


@functools.cache
def tree_of(module: str) -> ast.Module | None:
    distribution = module.partition(".")[0].replace("_", "-")  # of a plugin, if it is not the program
    folder = ROOT if distribution == "sppm-pipeline" else ROOT / "plugins" / distribution
    path = folder.joinpath(*module.split("."))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return ast.parse(file.read_text(encoding="utf-8")) if file.is_file() else None


@functools.cache
def places(face: str) -> dict[str, tuple[str, str]]:
    """Of a face, public name -> (module, name there)."""
    path = ROOT.joinpath(*face.split("."))
    stub = path / "__init__.pyi" if path.is_dir() else path.with_suffix(".pyi")
    found = {}
    for node in ast.parse(stub.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            found |= {alias.asname.removeprefix("_"): (node.module, alias.name) for alias in node.names}
    return found


@functools.cache
def imports(module: str) -> frozenset[str]:
    """Modules that a module imports, lazily or not, and those that it has `library` import; not for type checkers."""
    found: set[str] = set()
    waiting: list[ast.AST] = [tree] if (tree := tree_of(module)) is not None else []
    while waiting:
        node = waiting.pop()
        # methods like `to_networkx` hand artifacts on to other libraries, and no result comes from them
        hands_on = isinstance(node, ast.FunctionDef) and node.name.startswith("to_")
        if not hands_on and not (isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"):
            found |= set(_imported(node))
            waiting += ast.iter_child_nodes(node)
    return frozenset(found)


def _imported(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module:
        for alias in node.names:
            place, name = node.module, alias.name
            if place in FACES and name in places(place):
                place, name = places(place)[name]
            yield f"{place}.{name}" if place.startswith("sppm") and tree_of(f"{place}.{name}") else place
    elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "library":
        named = node.args[0].values[0] if isinstance(node.args[0], ast.JoinedStr) else node.args[0]
        yield str(ast.literal_eval(named))


def libraries_of(module: str) -> set[str]:
    """Distributions that a module and all that it imports use, without those that count for every stage."""
    seen, waiting, found = {module}, [module], set()
    while waiting:
        for name in imports(waiting.pop()):
            if name.startswith("sppm_pipeline.engine"):
                continue
            if name.startswith("sppm_"):
                if name not in seen:
                    seen.add(name)
                    waiting.append(name)
            elif (top := name.partition(".")[0]) not in FOR_ALL | NOT_IN_RESULTS | STANDARD:
                found.add(DISTRIBUTIONS.get(top, top))
    return found


@pytest.mark.parametrize("name", STAGES)
def test_libraries_are_declared(name):
    cls = stage_class(name)
    found = libraries_of(cls.__module__) - NOT_USED.get(name, set())
    assert set(cls.libraries) - {"imagecodecs"} == found  # imagecodecs is imported by tifffile


def test_installing_an_extra_changes_no_keys_but_those_of_stages_that_use_it(monkeypatch):
    from sppm_pipeline.engine.cache import identity

    def keyed(*libraries: str) -> dict[str, str]:
        identity.environment.cache_clear()
        return identity.environment(libraries)

    before = keyed(), keyed("matplotlib")
    original = identity.installed_version
    monkeypatch.setattr(identity, "installed_version", lambda name: "99" if name == "matplotlib" else original(name))
    after = keyed(), keyed("matplotlib")
    identity.environment.cache_clear()
    assert after[0] == before[0]
    assert after[1] != before[1]


def test_only_what_draws_charts_depends_on_matplotlib():
    """Parts once depended on it by `fix.drains` and `tune.orientation`, and were made anew when it was installed."""
    using = {name for name in STAGES if "matplotlib" in stage_class(name).libraries}
    charts = {"write.absorption", "write.bars", "write.chart", "write.curves", "write.statistics"}
    assert using <= charts | {"check.local_porosity", "check.print"}
