"""Layers are streamed: twenty million voxels fit where their field would not."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def gigavoxel():
    path = Path(__file__).resolve().parents[2] / "endurance" / "gigavoxel.py"
    spec = importlib.util.spec_from_file_location("endurance_gigavoxel", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_twenty_million_voxels_in_little_address_space(gigavoxel, tmp_path):
    small, large = tmp_path / "small", tmp_path / "large"
    small.mkdir()
    large.mkdir()
    first = gigavoxel.slice_cube(small, 6, 20)
    found = gigavoxel.slice_cube(large, 8, 34)
    assert found["voxels"] > 2e7
    assert found["layers"] == 272
    assert found["resident"] < 300e6
    # twelve times the voxels, hardly more memory: what grows is a slab, the patches and a bit a voxel
    assert found["resident"] - first["resident"] < 60e6
