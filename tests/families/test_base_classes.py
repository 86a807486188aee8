"""The names of the base classes, which are loaded when they are first used."""

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from sppm_pipeline import families


def declared() -> dict[str, str]:
    """Name -> module, as type checkers see them."""
    tree = ast.parse(Path(families.__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    return {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom) and node.module.startswith("sppm_pipeline")
        for alias in node.names
    }


def test_names_are_those_that_type_checkers_see():
    assert sorted(declared()) == families.__all__ == sorted(families.__all__)
    for name, module in declared().items():
        value = getattr(families, name)
        if name != "options":
            assert value is getattr(import_module(module), name)
            assert module == f"sppm_pipeline.families.{families._PLACE_OF[name]}"


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'Smapler'"):
        _ = families.Smapler


def test_a_family_is_loaded_alone():
    script = (
        "import sys; from sppm_pipeline.families import Sampler, options\n"
        "print(sorted(name.rpartition('.')[2] for name in sys.modules if name.startswith('sppm_pipeline.families.')))"
    )
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert found.strip() == "['cloud', 'interiors', 'options', 'sampler', 'scattered']"
