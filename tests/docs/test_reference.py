"""The generated reference is that of the code; if it is stale, run ``python docs/generate_reference.py``."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from tests.built_in import PLACES
from tests.docs.conftest import script


@pytest.fixture(scope="module")
def generator() -> ModuleType:
    return script("generate_reference")


@pytest.fixture(scope="module")
def pages(generator: ModuleType) -> dict[str, str]:
    return generator.pages()


def test_pages_are_up_to_date(generator: ModuleType, pages: dict[str, str]) -> None:
    assert generator.stale(generator.FOLDER, pages) == [], "run python docs/generate_reference.py"


def test_every_stage_has_a_page_named_like_its_file(pages: dict[str, str], root: Path) -> None:
    for name, place in PLACES.items():
        page = pages[f"{name.replace('.', '/')}.md"]
        module, _, _ = place.partition(":")
        assert module.rpartition(".")[2] == name.replace(".", "_")
        source = page.partition("Source: [`")[2].partition("`")[0]
        assert source.endswith(f"{module.replace('.', '/')}.py")
        assert (root / source).is_file()


def test_a_change_makes_a_page_stale(generator: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "sample").mkdir()
    (tmp_path / "sample" / "a.md").write_text("old")
    (tmp_path / "gone.md").write_text("of a stage that was removed")
    (tmp_path / "yaml.md").write_text("by hand")
    wanted = {"sample/a.md": "new", "sample/b.md": "not there yet"}
    assert generator.stale(tmp_path, wanted) == ["gone.md", "sample/a.md", "sample/b.md"]
    assert generator.stale(tmp_path, {"sample/a.md": "old", "gone.md": "of a stage that was removed"}) == []


def test_pages_state_required_options_bounds_and_choices(pages: dict[str, str]) -> None:
    porosity = pages["tune/porosity.md"]
    assert "| `target` | a number |  | > 0, &lt; 1 | **required** |" in porosity
    assert "`level`, `gap` | `level` |" in porosity


def test_pages_of_data_state_shapes_units_order_and_who_makes_them(pages: dict[str, str]) -> None:
    assert "| `centers` | (n, 3) float64, cell sizes |" in pages["data/PoreSet.md"]
    assert "Made by: [`sample.dart_throwing`]" in pages["data/PoreSet.md"]
    voxels = pages["data/Voxels.md"]
    assert "x is contiguous in memory" in voxels
    assert "| **`from_array(array, spacing=, periodic=, axes=)`** |" in voxels
    assert '| `axes` | {"xyz", "zyx"} |' in voxels
    tiling = pages["data/Tiling.md"]
    assert "has all that is said there" in tiling
    assert "[`slice.field`]" in tiling.partition("Taken by")[2]  # as any field
    assert "[`check.tiling`]" in tiling.partition("Taken by")[2]
    assert "[`field.gaussian`]" in pages["data/ScalarField.md"].partition("Taken by")[0]


def test_every_data_type_says_what_it_holds(pages: dict[str, str]) -> None:
    types = [name for name in pages if name.startswith("data/")]
    assert len(types) > 20
    words = ("## Attributes", "## Methods", "It is a [")
    assert [name for name in types if not any(word in pages[name] for word in words)] == []
    assert [name for name in types if f"]({name})" not in pages["README.md"]] == []


def test_cells_of_tables_hold_any_text(generator: ModuleType) -> None:
    assert generator.table(("a",), [("x|y <b> `<c>`\nz",)]) == ["| a |", "|---|", "| x\\|y &lt;b> `<c>` z |"]
