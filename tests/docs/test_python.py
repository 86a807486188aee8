"""What the pages say of Python runs: code of lessons, the six tasks, and an example of every public name."""

from __future__ import annotations

import doctest
import functools
import importlib
import inspect
import re
import typing
import warnings
from pathlib import Path

import numpy as np
import pytest

import sppm_pipeline as sppm
from sppm_pipeline.engine.plan.plugins import REGISTERED

DOCS = Path(__file__).resolve().parents[2] / "docs"
LESSONS = DOCS / "howto" / "beside-other-libraries.md"
TASKS = DOCS / "howto" / "work-in-python.md"
EXAMPLES = DOCS / "reference" / "python-examples.md"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(text):
    return BLOCK.findall(text)


TASKS_TEXT = TASKS.read_text(encoding="utf-8")
START, *PARTS = re.split(r"^## (.+)\n", LESSONS.read_text(encoding="utf-8"), flags=re.MULTILINE)
BESIDE = {
    title.lower().replace("scikit-image", "skimage"): text for title, text in zip(*[iter(PARTS)] * 2, strict=True)
}
"""Lessons by the module of their library."""


@pytest.fixture(autouse=True)
def _as_a_script(tmp_path, monkeypatch):
    """In a folder of its own, with warnings shown and not raised, as libraries of others have theirs."""
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
    REGISTERED.stages.clear()


@functools.cache
def start():
    """What the names stand for that all lessons begin with: none of them changes it."""
    names: dict[str, object] = {}
    for code in blocks(START):
        exec(compile(code, LESSONS.name, "exec"), names)
    return names


@pytest.mark.parametrize("library", BESIDE)
def test_a_lesson_runs_where_its_library_is_installed(library):
    pytest.importorskip(library)
    names = start().copy()
    for code in blocks(BESIDE[library]):
        exec(compile(code, f"{LESSONS.name}: {library}", "exec"), names)


def test_the_libraries_of_the_lessons():
    assert set(BESIDE) == {"porespy", "openpnm", "pyvista", "skimage", "xarray"}
    assert all(blocks(text) for text in (START, *BESIDE.values()))


def test_six_tasks_take_ten_lines():
    imports, code, _ = blocks(TASKS_TEXT)
    lines = [line for line in code.splitlines() if line.strip() and not line.startswith("#")]
    assert len(lines) <= 10
    assert code.count("\n# ") + code.startswith("# ") == 6
    assert max(map(len, lines)) <= 120
    short = code.replace("range(100)", "range(2)").replace("to_pandas()", "to_arrays()")
    assert short.count("range(2)") == short.count("to_arrays()") == 1
    names: dict[str, object] = {}
    exec(compile(imports + short, TASKS.name, "exec"), names)
    assert names["solid"].shape == (64, 64, 64)
    assert names["wider"].finest_radius > sppm.cell("paper", seed=1).finest_radius
    assert names["E"].shape == (3,)
    assert names["k"].shape == (3, 3)
    assert len(names["designs"]["seed"]) == 2
    assert len(sppm.sample.halton(seed=1).centers) == 40


def test_steps_and_runs_are_what_the_page_says():
    code = blocks(TASKS_TEXT)[2]
    names: dict[str, object] = {}
    exec(compile(code, TASKS.name, "exec"), names)
    assert isinstance(names["throw"], sppm.nouns.BoundStage)
    assert names["pores"].per_cell == 40
    assert 1 - names["tuned"].to_numpy(32).mean() == pytest.approx(0.6, abs=0.02)


FACES = ("sppm_pipeline", *(f"sppm_pipeline.{name}" for name in ("nouns", "numerics", "pictures", "formats")))


def public():
    """Whatever can be called, by the name that a user writes; types of arrays are for signatures."""
    for face in FACES:
        module = importlib.import_module(face)
        for name in module.__all__:
            thing = getattr(module, name)
            if callable(thing) and typing.get_origin(thing) is not np.ndarray:
                yield f"{face.replace('sppm_pipeline', 'sppm')}.{name}", thing


def sections():
    """Examples on the page, by the name in their heading."""
    text = EXAMPLES.read_text(encoding="utf-8")
    parts = re.split(r"^### `([\w.]+)`$", text, flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def run_examples(name, text, lineno=0):
    test = doctest.DocTestParser().get_doctest(text, {}, name, name, lineno)
    shown: list[str] = []
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    doctest.DocTestRunner(optionflags=flags).run(test, out=shown.append)
    assert test.examples
    assert not shown, "".join(shown)


IN_DOCSTRINGS = {name: thing for name, thing in public() if ">>>" in (inspect.getdoc(thing) or "")}


@pytest.mark.parametrize("name", IN_DOCSTRINGS)
def test_the_example_in_a_docstring_runs(name):
    run_examples(name, inspect.getdoc(IN_DOCSTRINGS[name]))


METHODS = [sppm.PoreSet.from_array, sppm.ScalarField.to_numpy, sppm.check.__call__]


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.__qualname__)
def test_the_example_of_a_method_runs(method):
    run_examples(method.__qualname__, inspect.getdoc(method))


@pytest.mark.parametrize("name", sections())
def test_the_example_on_the_page_runs(name):
    run_examples(name, sections()[name].replace("```python", "").replace("```", ""))


WITHOUT = {
    *("run_native", "RecipeSize", "show"),
    *(f"nouns.{name}" for name in ("EncodedLayers", "Interiors", "KeptPores", "LayerObserver", "Place", "Printer")),
    *(f"numerics.{name}" for name in ("Hierarchy", "Level", "Measure", "Transfer", "Workspace", "load_cases", "solve")),
    *(f"numerics.{name}" for name in ("finish_row", "gather_row", "scatter_row", "refined")),
}
"""What an example of a few lines can't show: a solver of one's own, native code, what only the program makes."""


def test_every_public_callable_has_an_example():
    names = {name for name, _ in public()}
    assert names - set(IN_DOCSTRINGS) - set(sections()) == {f"sppm.{name}" for name in WITHOUT}
    assert set(sections()) <= names
