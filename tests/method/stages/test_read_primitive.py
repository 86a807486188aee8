"""Bodies without a file."""

import math

import numpy as np
import pytest

from sppm_pipeline.method.stages.read_primitive import SHAPES, ReadPrimitive
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.mesh.measures import measure_surface
from sppm_pipeline.testing.plain_context import PlainContext

SIZE = (Length(20), Length(1.2, "cm"), Length(8, "mm"))
VOLUMES = {"box": 1920, "ball": math.pi / 6 * 1920, "cylinder": math.pi / 4 * 1920}


@pytest.mark.parametrize("facets", [8, 9, 100])
@pytest.mark.parametrize("shape", SHAPES)
def test_closed_bodies_that_just_fill_their_box(shape, facets):
    body = ReadPrimitive(shape=shape, size=SIZE, facets=facets).run(PlainContext())
    body.check()
    found = measure_surface(body.vertices, body.faces)
    assert found.edges.closed
    assert found.volume > 0
    assert found.genus == (1 if shape.startswith("torus") else 0)
    assert np.allclose(body.lower, [-10, -6, 0])
    assert np.allclose(body.upper, [10, 6, 8])
    if shape in VOLUMES and facets == 100:
        assert found.volume == pytest.approx(VOLUMES[shape], rel=0.01)
