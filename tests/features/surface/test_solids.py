"""manifold3d in a child: the same bytes as in place, and its crashes and its patience contained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError, InputError, NativeCrash, ResourceError
from sppm_pipeline.features.surface import solids
from sppm_pipeline.features.surface.solids import (
    ManifoldLimits,
    boolean,
    manifold_combine,
    manifold_extract,
    run_level_set,
)
from sppm_pipeline.features.surface.stages.extract_manifold_sdf import ManifoldSdf
from sppm_pipeline.features.surface.stages.fill_boolean import BooleanFill
from sppm_pipeline.features.surface.stages.fill_combine import Combine
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.services.mesh.measures import volume
from sppm_pipeline.testing.plain_context import PlainContext

BALL, BOX = ball_mesh((0.1, 0.2, 0.3), 1.0, 3), box_mesh((0.0, 0.0, 0.0), (1.5, 1.4, 1.3))
NAMES = ("the ball", "the box")
LIMITS = ManifoldLimits(60.0)


def same(one, other) -> bool:
    return all(a.dtype == b.dtype and a.tobytes() == b.tobytes() for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("operation", ["union", "difference", "intersection"])
def test_booleans_are_those_made_in_place(operation):
    made = manifold_combine(BALL, BOX, operation, NAMES, LIMITS)
    assert same(made.mesh, boolean(BALL, BOX, operation, NAMES))
    assert made.tool_volume == volume(*BOX)


def test_copies_are_united_one_after_the_other():
    places = [np.array(place) for place in ([0.0, 0.0, 0.0], [0.7, 0.1, 0.0], [-0.9, 0.3, 0.2])]
    told = []
    limits = ManifoldLimits(60.0, 2**30, lambda *step: told.append(step))
    made = manifold_combine(BALL, BOX, "difference", NAMES, limits, places=places)
    tools = (BOX[0] + places[0], BOX[1])
    for place in places[1:]:
        tools = boolean(tools, (BOX[0] + place, BOX[1]), "union", NAMES)
    assert same(made.mesh, boolean(BALL, tools, "difference", NAMES))
    assert made.tool_volume == volume(*tools)
    assert [done for done, _, _ in told] == [1, 2]


@pytest.mark.parametrize("tolerance", [None, 1e-3])
def test_extraction_is_that_made_in_place(tolerance):
    x = np.linspace(-1, 1, 17, dtype=np.float32)
    samples = (x[:, None, None] ** 2 + x[None, :, None] ** 2 + x[None, None, :] ** 2 - 0.7).astype(np.float32)
    made, status = manifold_extract(samples, (-1.0, -1.0, -1.0), 0.25, tolerance, LIMITS)
    there, said = run_level_set(samples, (-1.0, -1.0, -1.0), 0.25, tolerance)
    assert len(made[1]) > 500
    assert same(made, there)
    assert status == said == "NoError"


def test_refusals_are_those_made_in_place():
    far = (BOX[0] + 10, BOX[1])
    for case, kind in (((BALL, far), DesignError), ((BALL, (BOX[0], BOX[1][1:])), InputError)):
        with pytest.raises(kind) as child:
            manifold_combine(*case, "intersection", NAMES, LIMITS)
        with pytest.raises(kind) as here:
            boolean(*case, "intersection", NAMES)
        assert (child.value.message, child.value.hint) == (here.value.message, here.value.hint)


@pytest.fixture
def calls(wang_tiling, cell, ball):
    """The three stages, each as a function of options."""
    box = SurfaceMesh(*BOX, "box")
    return [
        lambda **options: BooleanFill(resolution=8, **options).run(PlainContext(), wang_tiling, ball),
        lambda **options: Combine(operation="union", **options).run(PlainContext(), SurfaceMesh(*BALL, "ball"), box),
        lambda **options: ManifoldSdf(resolution=8, **options).run(PlainContext(), cell),
    ]


def test_a_crash_of_the_library_names_it(calls, monkeypatch):
    from importlib.metadata import version

    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "engine" / "process" / "functions")
    monkeypatch.setattr(solids, "COMBINE", "evil_functions:segfault")
    monkeypatch.setattr(solids, "EXTRACT", "evil_functions:segfault")
    for call in calls:
        with pytest.raises(NativeCrash, match=rf"^manifold3d {version('manifold3d')} died by SIGSEGV") as error:
            call()
        assert error.value.exit_code == 6


def test_a_library_that_does_not_end_is_a_lack_of_time(calls, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "engine" / "process" / "functions")
    monkeypatch.setattr(solids, "COMBINE", "evil_functions:loop")
    monkeypatch.setattr(solids, "EXTRACT", "evil_functions:loop")
    for call in calls:
        with pytest.raises(ResourceError, match=r"manifold3d .* used up its 0\.5 s") as error:
            call(time_limit=0.5)
        assert error.value.exit_code == 5
        assert "`time_limit`" in error.value.hint
