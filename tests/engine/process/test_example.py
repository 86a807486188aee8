"""The example of the documentation does what it says."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from sppm_pipeline.errors import PluginError
from sppm_pipeline.testing.plain_context import PlainContext

PAGE = Path(__file__).resolve().parents[3] / "docs" / "howto" / "run-native-code-safely.md"


def test_the_example_of_the_page(tmp_path, temporary, monkeypatch):
    child, caller = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "my_plugin").mkdir()
    (tmp_path / "my_plugin" / "__init__.py").touch()
    (tmp_path / "my_plugin" / "child.py").write_text(child, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    page = {}
    exec(caller, page)
    corners = np.stack(np.meshgrid(*[[0.0, 2.0]] * 3), -1).reshape(-1, 3)
    faces, volume = page["hull_of"](corners, PlainContext())
    assert faces.shape == (12, 3)
    assert volume == pytest.approx(8)
    assert "my_plugin" not in sys.modules
    with pytest.raises(PluginError, match=r"^scipy \S+ raised QhullError") as caught:
        page["hull_of"](corners * [1, 1, 0], PlainContext())
    assert "in step 'build the hull'" in caught.value.message
    assert caught.value.hint == "remove points that coincide"
