"""The public face: every name is there, loaded late, and known to type checkers."""

import ast
import functools
import importlib
import inspect
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

import sppm_pipeline as sppm
from sppm_pipeline import errors, hookspecs

FACES = {"sppm_pipeline": sppm} | {
    name: importlib.import_module(name)
    for name in (f"sppm_pipeline.{face}" for face in ("nouns", "numerics", "pictures", "formats"))
}


def in_a_fresh_process(code):
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


@pytest.mark.parametrize("face", FACES.values(), ids=FACES)
def test_every_public_name_is_there_and_listed(face):
    assert sorted(set(face.__all__)) == face.__all__
    for name in face.__all__:
        assert getattr(face, name) is not None
    assert set(face.__all__) <= set(dir(face))


def test_the_face_is_small_and_says_where_other_names_are():
    assert len(sppm.__all__) <= 80
    with pytest.raises(AttributeError, match=r"it is sppm_pipeline\.numerics\.jit"):
        sppm.jit  # noqa: B018
    with pytest.raises(AttributeError, match="did you mean 'Sampler'"):
        sppm.Smapler  # noqa: B018
    assert sppm.nouns is FACES["sppm_pipeline.nouns"]
    with pytest.raises(AttributeError, match="no attribute 'dart_throwing'"):
        sppm.dart_throwing  # noqa: B018


PUBLIC = (*map(vars, FACES.values()), vars(errors))
OWN = {
    "Part.cut_zyx",  # what ends so is for the kernels of the program
    *(f"{field}.patches" for field in ("Microstructure", "PeriodicTile", "Tiling")),
    "EncodedLayers.__init__",  # stores and notebooks are given these, and make none
    "Run.__init__",
    "SurfaceMesh.outer_surface",  # where shells overlap; plugins are given the mesh
}
"""What is public in name, but called by the program alone."""


def signatures():
    """Fields, methods and functions of the public face, and its hooks."""
    for name, thing in {
        n: inspect.unwrap(getattr(owner, n)) for owner in FACES.values() for n in owner.__all__
    }.items():
        yield name, thing
        for member in dir(thing) if isinstance(thing, type) else ():
            if member == "__init__" or not member.startswith("_"):
                found = inspect.getattr_static(thing, member)
                yield (
                    f"{name}.{member}",
                    next(
                        (inner for way in ("__func__", "fget", "func") if (inner := getattr(found, way, None))), found
                    ),
                )
    yield from ((name, hook) for name, hook in vars(hookspecs).items() if name.startswith("sppm_"))


@functools.cache
def imports_of(module):
    """Where the names of a module come from, those for type checkers alone included."""
    nodes = ast.walk(ast.parse(inspect.getsource(sys.modules[module])))
    return {name.name: node.module for node in nodes if isinstance(node, ast.ImportFrom) for name in node.names}


def named(thing):
    """Classes of this project, and names for types that hold such, in the annotations of a class or function."""
    notes = vars(thing).get("__annotations__", {}) if isinstance(thing, type) else thing.__annotations__
    for field, note in notes.items():
        text = getattr(note, "__forward_arg__", note)  # what a named tuple keeps
        if field.startswith("_") or not isinstance(text, str):
            continue
        for word in {node.id for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Name)}:
            value = getattr(sys.modules[thing.__module__], word, None)
            if value is None and (module := imports_of(thing.__module__).get(word)):
                value = getattr(importlib.import_module(module), word)
            if any(part.__module__.startswith("sppm_pipeline") for part in classes_in(value)):
                yield word, value


def classes_in(value):
    parts = get_args(value)
    return [one for part in parts for one in classes_in(part)] if parts else [value] * isinstance(value, type)


def test_whatever_a_public_signature_names_is_public():
    seen, missing = set(), {}
    for place, thing in signatures():
        if place in OWN or not getattr(thing, "__module__", "").startswith("sppm_pipeline"):
            continue
        if not isinstance(thing, type) and not inspect.isfunction(thing):
            continue
        for word, value in named(thing):
            seen.add(word)
            if not any(value is public for face in PUBLIC for public in face.values()):
                missing.setdefault(word, []).append(place)
    assert missing == {}
    assert {"Cloud", "EncodedLayers", "Law", "RecipeSize", "StageEvent", "VoxelCell"} <= seen


@pytest.mark.parametrize("face", FACES.values(), ids=FACES)
def test_type_checkers_see_the_same_names_in_the_same_places(face):
    """The stub says where each name is, and that is what a user gets."""
    tree = ast.parse(Path(face.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    places = {
        alias.asname: (node.module, alias.name)
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module != "sppm_pipeline"
        for alias in node.names
    }
    renamed = {node.targets[0].id: node.value.id for node in tree.body if isinstance(node, ast.Assign)}
    names = {name for name in places if name not in renamed.values()} | renamed.keys()
    assert names == set(face.__all__)
    for name in names:
        module, there = places[renamed.get(name, name)]
        found = importlib.import_module(module)
        assert getattr(found, there) is getattr(face, name)
    assert (Path(sppm.__file__).parent / "py.typed").is_file()


def test_the_import_loads_nothing_else():
    code = "import sys; before = set(sys.modules); import sppm_pipeline; print(*set(sys.modules) - before)"
    assert set(in_a_fresh_process(code).split()) - {"__future__"} == {"sppm_pipeline"}


def test_the_import_takes_less_than_five_milliseconds():
    code = (
        "import sppm_pipeline, importlib, time\n"
        "def took():\n"
        "    start = time.process_time(); importlib.reload(sppm_pipeline); return time.process_time() - start\n"
        "print(min(took() for _ in range(20)))"
    )
    assert float(in_a_fresh_process(code)) < 0.005


def test_data_load_no_engine_and_no_compiler():
    code = (
        "import sys, sppm_pipeline as s; s.SurfaceMesh; "
        "print('sppm_pipeline.engine' in sys.modules, 'numba' in sys.modules)"
    )
    assert in_a_fresh_process(code).split() == ["False", "False"]
