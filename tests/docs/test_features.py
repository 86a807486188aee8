"""Each feature of the package has a page, which names its folders and links to each of its stages."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.built_in import PLACES
from tests.docs.conftest import ROOT

FEATURES = sorted(path.parent.name for path in (ROOT / "sppm_pipeline" / "features").glob("*/__init__.py"))


@pytest.mark.parametrize("feature", FEATURES)
def test_the_page_of_a_feature_links_its_stages(feature: str) -> None:
    text = (ROOT / "docs" / "features" / f"{feature}.md").read_text(encoding="utf-8")
    own = [name for name, place in PLACES.items() if place.startswith(f"sppm_pipeline.features.{feature}.")]
    assert own, "a feature without stages"
    assert [name for name in own if f"[`{name}`](../reference/{name.replace('.', '/')}.md)" not in text] == []
    for folder in (f"sppm_pipeline/features/{feature}/", f"tests/features/{feature}/"):
        assert f"`{folder}`" in text
        assert (ROOT / folder).is_dir()


def test_every_feature_is_in_the_index() -> None:
    pages = {path.stem for path in Path(ROOT, "docs", "features").glob("*.md")} - {"README"}
    assert pages == set(FEATURES)
    index = (ROOT / "docs" / "features" / "README.md").read_text(encoding="utf-8")
    assert [name for name in FEATURES if f"]({name}.md)" not in index] == []
