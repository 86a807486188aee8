"""Charts of curves of compression, and frames of crushed bodies."""

import csv
import dataclasses
import io

import meshio
import numpy as np
import pytest
from PIL import Image
from sppm_crushing.compression import CompressionCurve, CrushedBody
from sppm_crushing.stages.write_curves import WriteCurves
from sppm_crushing.stages.write_frames import WriteFrames

from sppm_pipeline import Table, write
from sppm_pipeline.errors import DesignError, WiringError
from sppm_pipeline.testing.plain_context import PlainContext

STRAIN = np.arange(601) / 1000
STRESS = np.interp(STRAIN, [0, 0.03, 0.05, 0.1, 0.25, 0.5, 0.6], [0, 3.0, 2.5, 2.0, 2.0, 2.2, 4.0])
TEST = CompressionCurve(STRAIN, STRESS, "MPa", "measured", "foam$")
STRONGER = CompressionCurve(STRAIN[:501], 1.2 * STRESS[:501], "MPa", "measured", "foam$")
CORNERS = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)])
BLOCK = np.array([CORNERS, CORNERS + np.array((0, 0, 1))])
NODES, NUMBERS = np.unique(BLOCK.reshape(-1, 3), axis=0, return_inverse=True)
BODY = CrushedBody(
    STRAIN, STRESS / 1000, "GPa", "simulated", "block", grid=(1, 1, 2), spacing=1.0, voxels=[[0, 0, 0], [0, 0, 1]],
    phases=[1, 2], elements=NUMBERS.reshape(2, 8), frame_strains=[0, 0.3, 0.6],
    frame_nodes=[NODES, NODES * (1, 1, 0.7), NODES * (1, 1, 0.4)], frame_alpha=[[0, 0], [0, 0.25], [0, 0.5]],
)  # fmt: skip


def table_of(directory):
    rows = list(csv.reader(io.StringIO((directory / "curves.csv").read_text(encoding="utf-8"))))
    return rows[0], [[float(cell) if cell else None for cell in row] for row in rows[1:]]


def test_the_table_holds_mean_and_spread_of_a_batch_and_the_simulation_beside_it(tmp_path):
    context = PlainContext(directory=tmp_path)
    WriteCurves(measures=True, title="$E$").run(context, (TEST, BODY, STRONGER))
    assert context.reported["lines"] == ["foam$, mean of 2 tests ± s", "block, simulation"]
    head, rows = table_of(tmp_path)
    assert head[0] == "strain"
    assert head[2] == "foam$, mean of 2 tests ± s: standard deviation (MPa)"
    assert head[5] == "block, simulation: stress (MPa)"
    at = rows[300]
    assert at[0] == 0.3
    assert at[1] == pytest.approx(1.1 * STRESS[300], rel=1e-5)
    assert at[2] == pytest.approx(0.2 * STRESS[300] / 2**0.5, rel=1e-5)
    assert at[5] == pytest.approx(STRESS[300], rel=1e-5)  # the simulation was in GPa
    assert at[6] == pytest.approx(0.5125 + 0.05 * (2 + STRESS[300]) / 2, rel=1e-4)
    assert at[7] == pytest.approx(at[6] / at[5], rel=1e-4)
    assert rows[550][1] is None  # the shorter specimen has ended
    assert rows[550][5] is not None


def test_the_chart_is_the_same_on_every_run(tmp_path):
    files = []
    for run in "ab":
        context = PlainContext(directory=tmp_path / run)
        WriteCurves(path="a.png", table=None, measures=True).run(context, (TEST, BODY))
        files.append((tmp_path / run / "a.png").read_bytes())
        assert not (tmp_path / run / "curves.csv").exists()
    assert files[0] == files[1]
    plain = PlainContext(directory=tmp_path / "c")
    WriteCurves(path="a.png", table=None).run(plain, (TEST, BODY))
    assert (tmp_path / "c" / "a.png").read_bytes() != files[0]


def test_relative_stresses_are_not_drawn_beside_others():
    relative = CompressionCurve(STRAIN, STRESS, "relative", "simulated", "block")
    with pytest.raises(DesignError, match="the stresses of 'block' are relative"):
        WriteCurves().run(PlainContext(), (TEST, relative))
    with pytest.raises(DesignError, match="foam can't be drawn"):
        WriteCurves().run(PlainContext(), (CompressionCurve([0, 1e-4], [0, 1], "MPa", "measured", "foam"),))


def test_as_functions_several_curves_are_given(tmp_path):
    made = write.curves(TEST, BODY, table=None, output=tmp_path)
    assert [path.name for path in made] == ["curves.png"]
    made = write.curves(curves=[TEST, STRONGER], output=tmp_path, path="b.svg")
    assert [path.name for path in made] == ["b.svg", "curves.csv"]
    with pytest.raises(WiringError, match="one or more of CompressionCurve"):
        write.curves(path="a.png")(output=tmp_path)
    with pytest.raises(WiringError, match="can't take Table"):
        write.curves(TEST, Table({"a": (1,)}), output=tmp_path)


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    folder = tmp_path_factory.mktemp("frames")
    context = PlainContext(directory=folder)
    WriteFrames(path="crushed", meshes=True, image_size=(60, 80), pause=0.25).run(context, BODY)
    return folder / "crushed", context


def test_strip_and_animation(frames):
    folder, context = frames
    assert context.reported["frames"] == 3
    assert context.reported["plastic_strain_scale"] == pytest.approx(0.495)
    assert [call[0] for call in context.progress_calls] == [1, 2, 3]
    with Image.open(folder / "animation.png") as moving:
        assert moving.n_frames == 3
        moving.seek(2)
        assert moving.info["duration"] == 250
        last = np.asarray(moving.convert("RGB"), int)
        moving.seek(0)
        first = np.asarray(moving.convert("RGB"), int)
    assert (first != last).any()
    with Image.open(folder / "strip.png") as strip:
        assert strip.width > 3 * 60


def test_meshes_are_read_by_others(frames):
    folder, _ = frames
    assert sorted(path.name for path in folder.glob("*.vtu")) == [f"frame_00{i}.vtu" for i in range(3)]
    mesh = meshio.read(folder / "frame_002.vtu")
    assert mesh.points == pytest.approx(NODES * (1, 1, 0.4))
    (block,) = mesh.cells
    assert block.type == "hexahedron"
    around = mesh.points[block.data[0]]  # VTK goes around the lower face, then around the upper one
    assert around[:4, 2].max() < around[4:, 2].min()
    assert np.linalg.norm(np.diff(around[[0, 1, 2, 3, 0]], axis=0), axis=1) == pytest.approx(1)
    assert np.cross(around[1] - around[0], around[3] - around[0])[2] == pytest.approx(1)
    assert mesh.cell_data["plastic_strain"][0].tolist() == [0, 0.5]
    assert mesh.cell_data["phase"][0].tolist() == [1, 2]


def test_colors_can_be_those_of_phases(tmp_path):
    for color in ("phase", "none"):
        context = PlainContext(directory=tmp_path)
        WriteFrames(path=color, color=color, image_size=(40, 60), animation=False).run(context, BODY)
        assert context.reported["plastic_strain_scale"] == 0
        assert not context.warnings
    pictures = [np.asarray(Image.open(tmp_path / color / "strip.png"), int) for color in ("phase", "none")]
    assert pictures[0].shape == pictures[1].shape
    assert (pictures[0].max(axis=2) - pictures[0].min(axis=2)).max() > 80  # colors, not grays
    assert (pictures[1].max(axis=2) - pictures[1].min(axis=2)).max() < 60


def test_an_elastic_body_has_no_scale(tmp_path):
    elastic = dataclasses.replace(BODY, frame_alpha=np.zeros((3, 2)))
    context = PlainContext(directory=tmp_path)
    WriteFrames(image_size=(40, 40), animation=False).run(context, elastic)
    assert context.reported["plastic_strain_scale"] == 0
    assert "nothing has yielded" in str(context.warnings)
    assert [path.name for path in (tmp_path / "frames").iterdir()] == ["strip.png"]
