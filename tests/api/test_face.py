"""The public face: every name is there, loaded late, and known to type checkers."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import sppm_pipeline as sppm

TREE = ast.parse(Path(sppm.__file__).read_text(encoding="utf-8"))


def in_a_fresh_process(code):
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def test_every_public_name_is_there_and_listed():
    assert len(set(sppm.__all__)) == len(sppm.__all__)
    for name in sppm.__all__:
        assert getattr(sppm, name) is not None
    assert set(sppm.__all__) <= set(dir(sppm))
    with pytest.raises(AttributeError, match="no attribute 'dart_throwing'"):
        sppm.dart_throwing  # noqa: B018


def test_what_a_sampler_is_given_is_public():
    for method in (sppm.Sampler.throw, sppm.Sampler.throw_all):
        words = set(re.findall(r"[A-Z]\w+", " ".join(map(str, method.__annotations__.values()))))
        assert words - {"NDArray", "Generator"} <= set(sppm.__all__)


def test_type_checkers_see_the_same_names_in_the_same_places():
    (block,) = (node for node in TREE.body if isinstance(node, ast.If))
    seen = {
        alias.asname or alias.name: (node.module.removeprefix("sppm_pipeline."), alias.name)
        for node in block.body
        if isinstance(node, ast.ImportFrom) and node.module != "typing"
        for alias in node.names
    }
    assert seen == sppm._PLACE_OF
    assert set(seen) == set(sppm.__all__)
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
