"""The gallery is that of its configurations; if it is stale, run ``python docs/generate_gallery.py``.

Every page can be reached by links, and the first Python of README.md runs.
"""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from types import ModuleType

import pytest
from PIL import Image

import sppm_pipeline as sppm
from tests.docs.conftest import ROOT, script


@pytest.fixture(scope="module")
def generator() -> ModuleType:
    return script("generate_gallery")


@pytest.fixture(scope="module")
def pages(generator: ModuleType) -> dict[str, str]:
    return generator.pages()


def test_pages_are_up_to_date(generator: ModuleType, pages: dict[str, str]) -> None:
    assert generator.stale(generator.FOLDER, pages) == [], "run python docs/generate_gallery.py"
    assert len(pages) > 16


def test_each_page_shows_the_same_pipeline_in_python(pages: dict[str, str], monkeypatch) -> None:
    monkeypatch.chdir(ROOT / "examples")  # where files lie that an example reads
    for name in sorted(set(pages) - {"README.md"}):
        code = pages[name].partition("```python\n")[2].partition("```")[0]
        made, _, after = code.partition("\n)\n")
        space: dict[str, object] = {}
        exec(f"{made}\n)", space)
        pipeline = space["pipeline"]
        assert isinstance(pipeline, sppm.Pipeline)
        file = ROOT / "examples" / name.replace(".md", ".yaml")
        wanted = [line for line in sppm.Pipeline(str(file)).to_yaml().splitlines() if not line.startswith("folder:")]
        if ".sweep(" in after:
            pipeline = eval(after.partition("run = ")[2].partition(".run()")[0], {"pipeline": pipeline})
            wanted = wanted[: wanted.index("after:")]
        assert pipeline.to_yaml().splitlines() == wanted, name


def test_pictures_are_small(generator: ModuleType, pages: dict[str, str]) -> None:
    files = [generator.FOLDER / name.replace(".md", ".png") for name in pages if name != "README.md"]
    for file in files:
        with Image.open(file) as picture:
            assert picture.size[0] <= generator.LARGEST[0]
    assert max(file.stat().st_size for file in files) <= generator.MOST_BYTES
    assert sum(file.stat().st_size for file in files) <= 2_000_000


def test_a_change_makes_a_page_stale(generator: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "a.md").write_text("old")
    (tmp_path / "a.png").write_bytes(b"")
    (tmp_path / "gone.png").write_bytes(b"")
    assert generator.stale(tmp_path, {"a.md": "new", "b.md": ""}) == ["a.md", "b.md", "b.png", "gone.png"]
    assert generator.stale(tmp_path, {"a.md": "old"}) == ["gone.png"]


def test_every_page_is_reached_by_links(root: Path) -> None:
    """A reader on a Git host has no menu."""
    found, open_ = set(), [root / "docs" / "README.md"]
    while open_:
        page = open_.pop()
        if page not in found and page.suffix == ".md":
            found.add(page)
            targets = re.findall(r"\]\(([^)#\s:]+)", page.read_text(encoding="utf-8"))
            open_ += [path for target in targets if (path := (page.parent / target).resolve()).is_file()]
    pages = set((root / "docs").rglob("*.md")) - {root / "docs" / "index.md"}
    assert sorted(path.name for path in pages - found) == []


def test_the_first_python_of_the_readme_runs(root: Path) -> None:
    code = (root / "README.md").read_text(encoding="utf-8").partition("```python\n")[2].partition("```")[0]
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(code, {})
    assert 0.05 < float(printed.getvalue()) < 0.25  # of the solid; the bound at this porosity is 0.25
