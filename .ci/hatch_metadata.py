"""Metadata that depend on where the program is published: its addresses, and README.md with links to them."""

import importlib.util
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface


class AddressHook(MetadataHookInterface):
    """Fills the dynamic fields of pyproject.toml from project.toml."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Called by hatchling."""
        root = Path(self.root)
        spec = importlib.util.spec_from_file_location("release", root / ".ci" / "release.py")
        assert spec is not None
        assert spec.loader is not None
        release = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(release)
        known, version = release.settings(root), metadata["version"]
        text = release.readme((root / "README.md").read_text(encoding="utf-8"), known, version)
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
        metadata["urls"] = release.urls(known, version)
