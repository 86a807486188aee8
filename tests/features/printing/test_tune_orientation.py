"""``tune.orientation``: the turn that it tells does to the part what was scored."""

import csv
import json

import numpy as np
import pytest
from PIL import Image

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.printing.stages.tune_orientation import COSTS, TuneOrientation
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.primitive_meshes import box_mesh
from sppm_pipeline.services.mesh.rotation import rotated, rotation
from sppm_pipeline.testing.plain_context import PlainContext

TURNED = (20.0, -35.0, 50.0)


def tuned(part, **options):
    context = PlainContext()
    stage = TuneOrientation(**options)
    stage.check_options()
    assert stage.run(context, part) is part
    return context


@pytest.fixture
def tower(wang_tiling):
    """A box that stands on a small side, with a skin."""
    return Part(wang_tiling, SurfaceMesh(*box_mesh((8.0, 6.0, 6.0), (3.0, 5.0, 9.0)), name="tower"), 0.5)


def test_the_flattest_way_is_found_and_told(tower):
    context = tuned(tower, directions=6, cost_weights=(0, 0, 1, 0))
    found = context.reported
    assert found["height_mm"] == pytest.approx(3.0, abs=2 * found["voxel_mm"])
    turned = rotated(tower.domain.vertices, rotation(tuple(found["turn"])))
    assert np.ptp(turned[:, 2]) == pytest.approx(3.0)
    assert found["score"] < found["score_as_is"] == 1.0
    assert found["orientations"] == 6
    steep = tuned(tower, directions=6, cost_weights=(1, 0, 0, 0), overhang_angle=80.0).reported
    assert steep["supports_mm2"] < tuned(tower, directions=6, cost_weights=(1, 0, 0, 0)).reported["supports_mm2"]


def test_files_of_a_part_that_was_turned_before(tower):
    context = tuned(tower, turned=TURNED)
    folder = context.directory / "orientation"
    told = json.loads((folder / "orientations.json").read_text())
    rows = told["orientations"]
    assert len(rows) == 26
    assert [row["score"] for row in rows] == sorted(row["score"] for row in rows)
    assert rows[0] | {"orientations": 26} == {name: context.reported[name] for name in (*rows[0], "orientations")}
    assert rows[0]["pareto"]
    assert not all(row["pareto"] for row in rows)
    for row in rows:
        up = rotation(tuple(row["turn"])) @ rotation(TURNED).T @ row["up"]
        assert np.allclose(up, (0, 0, 1), atol=1e-5)
    largest = {name: max(row[name] for row in rows) or 1 for name in COSTS}
    for row in rows:
        terms = [w * row[name] / largest[name] for w, name in zip((1, 1, 0.5, 0.3), COSTS, strict=True)]
        assert row["score"] == pytest.approx(sum(terms), rel=1e-4)
    table = list(csv.DictReader((folder / "orientations.csv").read_text().splitlines()))
    assert [float(row["supports_mm2"]) for row in table] == [row["supports_mm2"] for row in rows]
    sheet = np.asarray(Image.open(folder / "orientations.png").convert("L"))
    assert len(np.unique(sheet)) > 20
    assert sheet.shape[0] > 5 * 320 * 0.75  # five rows


@pytest.mark.parametrize("options", [{"directions": 7}, {"cost_weights": (0, 0, 0, 0)}])
def test_options_that_can_not_be(options):
    with pytest.raises(ConfigError, match=next(iter(options))):
        TuneOrientation(**options).check_options()
