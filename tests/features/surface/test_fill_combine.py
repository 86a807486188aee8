"""Plates, handles and holes: set operations with a tool."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError, InputError
from sppm_pipeline.features.surface.stages.fill_combine import Combine
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import box_mesh, cylinder_mesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.mesh.measures import measure_surface, volume
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext

PLATE = SurfaceMesh(*box_mesh((0.0, 0.0, 1.0), (20.0, 10.0, 2.0)), "plate")
PIN = SurfaceMesh(*cylinder_mesh((0.0, 0.0, 0.0), 1.0, 6.0, 64), "pin")


def places(*triples):
    return tuple(tuple(Length(v) for v in triple) for triple in triples)


def combine(operation, mesh=PLATE, tool=PIN, **options):
    made = Combine(operation=operation, **options).run(PlainContext(), mesh, tool)
    made.check()
    return made, measure_surface(made.vertices, made.faces)


def test_four_screw_holes():
    corners = places((-8, -3, 0), (8, -3, 0), (-8, 3, 0), (8, 3, 0))
    made, found = combine("difference", at=corners)
    section = volume(PIN.vertices, PIN.faces) / 6
    assert found.genus == 4
    assert found.volume == pytest.approx(400 - 4 * 2 * section, rel=1e-9)
    assert made.name == "plate"


def test_union_and_intersection_add_up():
    _, both = combine("union", at=places((9.5, 0, 0)))
    _, common = combine("intersection", at=places((9.5, 0, 0)))
    assert both.volume + common.volume == pytest.approx(400 + volume(PIN.vertices, PIN.faces), rel=1e-9)
    assert both.components == common.components == 1


def test_the_tool_is_scaled_then_turned_then_moved():
    made, _ = combine("union", scale=0.5, turn=(0, 90, 0), at=places((11, 0, 1)))
    assert made.upper == pytest.approx([12.5, 5, 2])
    assert made.lower == pytest.approx([-10, -5, 0])


def test_lengths_may_carry_a_unit():
    place = ((Length(1.1, "cm"), Length(0, "mm"), Length(0)),)
    made, _ = combine("union", at=place)
    assert made.upper == pytest.approx([12, 5, 3])


def test_coplanar_faces_are_joined():
    other = SurfaceMesh(*box_mesh((0.0, 0.0, 3.0), (20.0, 10.0, 2.0)), "lid")
    _, found = combine("union", tool=other)
    assert (found.volume, found.components, found.genus) == (pytest.approx(800), 1, 0)


def test_nothing_in_common():
    with pytest.raises(DesignError, match="nothing is left"):
        combine("intersection", at=places((50, 0, 0)))
    with pytest.raises(DesignError, match="nothing is left"):
        combine("difference", tool=SurfaceMesh(*box_mesh((0, 0, 0), (99, 99, 99)), "all"))


@pytest.mark.parametrize("bad", ["mesh", "tool"])
def test_operands_that_are_no_solids(bad):
    broken = SurfaceMesh(PIN.vertices, PIN.faces[1:], "broken")
    with pytest.raises(InputError, match="broken does not bound a solid"):
        combine("union", **{bad: broken})


def test_no_place():
    with pytest.raises(ConfigError, match="place"):
        Combine(operation="union", at=()).check_options()


def test_in_a_configuration(run_yaml, summary):
    record, _ = run_yaml(
        """pipeline:
  - {stage: read.primitive, id: plate, shape: box, size: [20 mm, 10 mm, 2 mm]}
  - {stage: read.primitive, id: hole, shape: cylinder, size: [2 mm, 2 mm, 2 mm], facets: 64}
  - stage: fill.combine
    from: {mesh: plate, tool: hole}
    operation: difference
    at: [[-8 mm, 3, 0], [8, 0.3 cm, 0]]
"""
    )
    round_ = 32 * np.sin(np.pi / 32)
    assert summary(record, "fill.combine")["volume_mm3"] == pytest.approx(400 - 2 * 2 * round_, rel=1e-6)


class TestContract(StageContract):
    def stages(self):
        return [Combine(operation="union"), Combine(operation="difference", turn=(10, 20, 30), scale=0.7)]

    def inputs(self):
        return {"mesh": PLATE, "tool": PIN}


def test_copies_that_overlap_are_united():
    made, found = combine("union", at=places((0, 0, 0), (0, 0, 2), (0.5, 0, 4)))
    assert found.edges.closed
    assert made.upper[2] == pytest.approx(7)
    assert not np.isnan(found.volume)
