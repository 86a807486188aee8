"""``sppm fix``: former names become the current ones in place, and the plan stays the same."""

from __future__ import annotations

import pytest

import sppm_pipeline as sppm
from sppm_pipeline.engine.cli.main import main

OLD = """\
# a file of long ago
sppm: 1
recipes:
  cell:
    - {stage: sample.dart_throwing, total: 40}   # pores
    - {stage: connect.mbdst, neighbours: 9}
    - {stage: field.gaussian, pore_radius: 0.11, tunnel_radius: 0.03}
pipeline:
  - {stage: tune.porosity, recipe: cell, target: 0.5, "samples": 2}
  - stage: extract.marching_cubes
    spacing: 0.05 mm   # fine
  - stage: write.stl  # the part
  - write.ply
  - {stage: 'write.stl', path: b.stl}
  - {stage: write.obj, id: last, path: c.obj}
"""
NEW = """\
# a file of long ago
sppm: 1
recipes:
  cell:
    - {stage: sample.dart_throwing, total: 40}   # pores
    - {stage: connect.mbdst, neighbors: 9}
    - {stage: field.gaussian, pore_radius: 0.11, tunnel_radius: 0.03}
pipeline:
  - {stage: tune.porosity, recipe: cell, target: 0.5, "trials": 2}
  - stage: extract.marching_cubes
    voxel: 0.05 mm   # fine
  - stage: write.mesh  # the part
    id: write.stl
    path: mesh.stl
  - {stage: write.mesh, id: write.ply, path: mesh.ply}
  - {stage: 'write.mesh', 'id': write.stl#2, path: b.stl}
  - {stage: write.mesh, id: last, path: c.obj}
"""


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_former_names_are_rewritten_and_all_else_stays(tmp_path, capsys, end):
    path = tmp_path / "old.yaml"
    path.write_bytes(OLD.replace("\n", end).encode())
    assert main(["fix", str(path), "--dry-run"]) == 0
    assert "+    - {stage: connect.mbdst, neighbors: 9}" in capsys.readouterr().out
    assert path.read_bytes().decode() == OLD.replace("\n", end)
    assert main(["fix", str(path)]) == 0
    assert path.read_text() == NEW
    capsys.readouterr()
    assert main(["check", str(path)]) == 0
    assert "is now" not in capsys.readouterr().err
    assert main(["fix", str(path)]) == 0
    assert "no former names" in capsys.readouterr().out
    assert path.read_text() == NEW


def test_names_of_plugins_and_words_that_can_not_be_replaced(tmp_path, capsys):
    plugin = tmp_path / "grow.py"
    plugin.write_text(
        "from dataclasses import dataclass\nfrom typing import ClassVar\nimport sppm_pipeline as sppm\n\n"
        "@dataclass(frozen=True, kw_only=True)\nclass Grow(sppm.Sampler):\n    '''Pores.'''\n\n"
        "    name: ClassVar[str] = 'sample.grow'\n    n: int = sppm.option(3, help='pores', formerly='number')\n\n"
        "    def throw(self, rng, box):\n        return rng.random((self.n, 3))\n\n"
        "@sppm.hookimpl\ndef sppm_stages():\n    return {'sample.grow': Grow}\n\n"
        "@sppm.hookimpl\ndef sppm_stage_aliases():\n    return {'sample.old': 'sample.grow'}\n"
    )
    path = tmp_path / "job.yaml"
    path.write_text("sppm: 1\npipeline: [{stage: sample.old, number: 4}]\n")
    assert main(["fix", str(path), "--plugin", str(plugin)]) == 0
    assert path.read_text() == "sppm: 1\npipeline: [{stage: sample.grow, id: sample.old, n: 4}]\n"
    path.write_text('sppm: 1\npipeline: [{stage: "sample\\u002eold", n: 4}]\n')
    assert main(["fix", str(path), "--plugin", str(plugin)]) == 2
    assert "written in another way" in capsys.readouterr().err


def test_a_plugin_for_another_interface_is_refused_by_name(tmp_path, capsys):
    plugin = tmp_path / "later.py"
    plugin.write_text(f"SPPM_API_VERSION = {sppm.API + 1}\n")
    (tmp_path / "job.yaml").write_text("sppm: 1\npipeline: [{stage: sample.dart_throwing, total: 9}]\n")
    assert main(["check", str(tmp_path / "job.yaml"), "--plugin", str(plugin)]) == 4
    said = capsys.readouterr().err
    assert "later.py was written for version 2 of the interface, this program has version 1" in said
