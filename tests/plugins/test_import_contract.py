"""Plugins, examples, documents and notebooks import the public face and nothing below it."""

import json
import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

FACES = ("sppm_pipeline", *(f"sppm_pipeline.{face}" for face in ("errors", "formats", "nouns", "numerics", "pictures")))

PRIVATE = {
    "plugins/sppm-structures/examples/draw_published_curves.py",  # draws with the charts of the program itself
    "docs/generate_paper.py",  # runs the command line without a process for each row
    "docs/generate_reference.py",  # writes the reference from the engine's own description of stages
}
"""Scripts of this repository that are part of its workshop and no example for others."""

_FENCE = re.compile(r"^ *```python[^\n]*\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
_IMPORT = re.compile(r"^\s*(?:from|import)\s+sppm_pipeline[.\w]*.*$", re.MULTILINE)


def python_files():
    """Code for or by others, without its tests, which may look inside."""
    for folder in ("plugins", "examples", "docs"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT).parts
            if not {"build", "tests"} & set(parts) and path.relative_to(ROOT).as_posix() not in PRIVATE:
                yield path


def text_of(path):
    """The code of a module, of the Python blocks of a page, or of the cells of a notebook."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    return "\n".join(_FENCE.findall(text)) if path.suffix == ".md" else text


def internal_imports(text):
    """What is imported from below the public face, or is not in it."""
    found = []
    for line in _IMPORT.findall(text):
        words = line.split()
        module = words[1]
        if module not in FACES and not f"{module}.".startswith("sppm_pipeline.testing."):
            found.append(line.strip())
        elif words[0] == "from" and module in FACES and "(" not in line:
            names = (part.split()[0] for part in line.partition(" import ")[2].split(","))
            found += [name for name in names if not hasattr(import_module(module), name)]
    return found


@pytest.mark.parametrize("path", [*python_files()], ids=lambda path: path.relative_to(ROOT).as_posix())
def test_modules_import_the_public_face_only(path):
    assert internal_imports(text_of(path)) == []


def test_numerics_of_plugins_know_nothing_of_pipelines_and_files():
    """As `lint-imports` holds it inside the package."""
    files = [*(ROOT / "plugins").glob("*/*/numerics/*.py")]
    found = {
        (path.name, name)
        for path in files
        for name in re.findall(r"^\s*(?:from|import)\s+(\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert len(files) > 5
    assert not [pair for pair in found if pair[1] in {"pluggy", "ruamel", "logging", "argparse", "pathlib"}]


@pytest.mark.parametrize(
    "path",
    [*sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "docs").rglob("*.ipynb")), ROOT / "README.md"],
    ids=lambda path: path.relative_to(ROOT).as_posix(),
)
def test_pages_import_the_public_face_only(path):
    assert internal_imports(text_of(path)) == []


def test_a_breach_would_be_noticed():
    assert internal_imports("from sppm_pipeline.method.nouns.mesh import SurfaceMesh\n")
    assert internal_imports("    import sppm_pipeline.engine\n")
    assert internal_imports("from sppm_pipeline import nothing_of_this_name\n")
    assert not internal_imports(
        "import sppm_pipeline as sppm\nfrom sppm_pipeline.testing.contracts import StageContract\n"
    )
