"""Every relative link of README and docs leads somewhere, and every anchor is a heading."""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import unquote


def anchors(document: Path) -> set[str]:
    """Anchors of a document's headings, as GitHub makes them."""
    text = re.sub(r"^```.*?^```", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    found: set[str] = set()
    for heading in re.findall(r"^#{1,6} +(.+?) *#*$", text, re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "")
        slug = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        number, unique = 0, slug
        while unique in found:
            number += 1
            unique = f"{slug}-{number}"
        found.add(unique)
    return found


def test_link_leads_somewhere(link: tuple[Path, str], root: Path) -> None:
    document, target = link
    if re.match(r"[a-z][a-z0-9+.-]*:", target):
        return  # the web is not asked
    path, _, anchor = target.partition("#")
    place = (document.parent / unquote(path)).resolve() if path else document
    assert place.is_relative_to(root), "the link leaves the repository"
    assert place.exists(), f"{place.relative_to(root)} does not exist"
    if anchor and place.suffix == ".md":
        assert anchor in anchors(place), f"{place.name} has no heading for #{anchor}"


def test_anchors_follow_the_headings(tmp_path: Path) -> None:
    document = tmp_path / "page.md"
    document.write_text("# Two words\n\n```\n# no heading\n```\n## `sppm run`\n## Radii or ω and μ\n## Two words\n")
    assert anchors(document) == {"two-words", "sppm-run", "radii-or-ω-and-μ", "two-words-1"}
