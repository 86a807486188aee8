"""A code block of a tutorial that names a file shows what stands in that file."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = sorted(path for path in (ROOT / "docs" / "tutorial").glob("*.md") if path.stem != "README")
_MARKED = re.compile(r"^```\w+ (?P<file>\S+)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)


def marked(document: Path) -> list[tuple[str, str]]:
    """Named files and what the blocks show of them."""
    return [(m["file"], m["text"]) for m in _MARKED.finditer(document.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("document", TUTORIALS, ids=lambda path: path.stem)
def test_shown_code_is_the_shipped_code(document: Path) -> None:
    shown = marked(document)
    assert shown, "a tutorial shows code that exists"
    for file, text in shown:
        assert text.strip()
        shipped = (ROOT / file).read_text(encoding="utf-8")
        assert f"\n{text}" in f"\n{shipped}", f"{document.name} shows what is not in {file}:\n{text}"


def test_every_lesson_is_there() -> None:
    assert {path.stem for path in TUTORIALS} >= {
        "first-part",
        "one-file-plugin",
        "write-a-field",
        "write-a-sampler",
        "write-a-tile-rule",
        "write-a-writer",
    }


def test_a_change_would_be_noticed(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("text\n\n```python examples/uniform_sampler.py\nx = 1\n```\n\n```python\ny = 2\n```\n")
    assert marked(page) == [("examples/uniform_sampler.py", "x = 1\n")]
