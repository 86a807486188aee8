"""The shape of the package: no long files, few tiny ones, and a sentence on what each folder is for."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "sppm_pipeline"
TEMPLATES = PACKAGE / "cli" / "templates"
"""Data of `sppm new`: files of other distributions."""
MAXIMUM_LINES = 450
SMALL, MAXIMUM_SMALL = 60, 40


def modules() -> dict[str, int]:
    """Lines of each module by its path."""
    return {
        path.relative_to(ROOT).as_posix(): len(path.read_text(encoding="utf-8").splitlines()) for path in python_files()
    }


def python_files() -> list[Path]:
    """Modules of the package."""
    return [path for path in PACKAGE.rglob("*.py") if not path.is_relative_to(TEMPLATES)]


def test_no_file_is_long():
    assert {file: lines for file, lines in modules().items() if lines > MAXIMUM_LINES} == {}


def test_few_files_are_tiny():
    # an `__init__` that only says what its package is for is no module of its own
    small = sorted(f for f, lines in modules().items() if lines < SMALL and not f.endswith("/__init__.py"))
    assert len(small) <= MAXIMUM_SMALL, small


def test_packages_say_what_they_are_for():
    for folder in {path.parent for path in python_files()}:
        tree = ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))
        assert ast.get_docstring(tree), folder
