"""Each feature, of the package or of a plugin that is one, has a page, which names its folders and links its stages."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.built_in import DOCUMENTED, PLACES
from tests.docs.conftest import ROOT

FOLDERS = {
    path.parent.name: (f"sppm_pipeline/features/{path.parent.name}/", f"tests/features/{path.parent.name}/")
    for path in (ROOT / "sppm_pipeline" / "features").glob("*/__init__.py")
} | {
    name.removeprefix("sppm-"): (f"plugins/{name}/{name.replace('-', '_')}/", f"plugins/{name}/tests/")
    for name in DOCUMENTED
}
"""Code and tests of each feature."""


@pytest.mark.parametrize("feature", FOLDERS)
def test_the_page_of_a_feature_links_its_stages(feature: str) -> None:
    text = (ROOT / "docs" / "features" / f"{feature}.md").read_text(encoding="utf-8")
    code = FOLDERS[feature][0].removeprefix(f"plugins/sppm-{feature}/").replace("/", ".")
    own = [name for name, place in PLACES.items() if place.startswith(code)]
    assert own, "a feature without stages"
    assert [name for name in own if f"[`{name}`](../reference/{name.replace('.', '/')}.md)" not in text] == []
    for folder in FOLDERS[feature]:
        assert f"`{folder}`" in text
        assert (ROOT / folder).is_dir()


def test_every_feature_is_in_the_index() -> None:
    pages = {path.stem for path in Path(ROOT, "docs", "features").glob("*.md")} - {"README"}
    assert pages == set(FOLDERS)
    index = (ROOT / "docs" / "features" / "README.md").read_text(encoding="utf-8")
    assert [name for name in FOLDERS if f"]({name}.md)" not in index] == []
