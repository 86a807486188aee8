"""``homogenize.tet``: from the field to the report."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from sppm_tetrahedra.stages.homogenize_tet import HomogenizeTet
from sppm_tetrahedra.stages.mesh_isosurface_stuffing import IsosurfaceStuffing
from sppm_tetrahedra.volume_mesh import VolumeMesh

import sppm_pipeline as sppm
from sppm_pipeline.errors import ConfigError, DesignError, InputError
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.testing.plain_context import PlainContext


@dataclass(frozen=True, eq=False)
class SchwarzP(ScalarField):
    @property
    def cells(self):
        return (1, 1, 1)

    @property
    def periodic(self):
        return True

    def sample_layers(self, grid, start, stop, threads=1):
        grid = grid.layers(start, stop)
        x, y, z = (np.cos(2 * np.pi * grid.axis(axis)) for axis in range(3))
        return (x[:, None, None] + y[:, None] + z).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Shards(SchwarzP):
    """A ball in each cell."""

    def sample_layers(self, grid, start, stop, threads=1):
        grid = grid.layers(start, stop)
        x, y, z = ((grid.axis(axis) - 0.5) ** 2 for axis in range(3))
        return (np.sqrt(x[:, None, None] + y[:, None] + z) - 0.3).astype(np.float32)


def meshed(resolution, order=1, field=None):
    return IsosurfaceStuffing(resolution=resolution, order=order).run(PlainContext(), field or SchwarzP())


def homogenized(mesh, **options):
    context = PlainContext()
    return HomogenizeTet(**options).run(context, mesh), context


def test_schwarz_p_approaches_the_limit_from_above():
    """C11 of the network at half density is .3283 by quadratic elements elsewhere; straight ones are stiffer."""
    coarse, fine = (homogenized(meshed(n))[0] for n in (6, 12))
    assert coarse.stiffness[0, 0] > fine.stiffness[0, 0] > 0.325
    quadratic, context = homogenized(meshed(8, 2))
    quadratic.check()
    c = quadratic.stiffness
    assert c[0, 0] == pytest.approx(0.3283, rel=0.02)
    assert c[0, 0] == pytest.approx(c[1, 1], rel=1e-6)
    assert c[0, 1] == pytest.approx(c[1, 2], rel=1e-6)
    assert context.reported["joined"] == "nodes"
    assert quadratic.porosity == pytest.approx(0.5, abs=0.02)
    assert quadratic.summary()["bounds"]["within_voigt_and_reuss"]


def test_the_mortar_agrees_with_matching_nodes():
    mesh = meshed(10)
    matched, (mortar, context), collocated = (
        homogenized(mesh)[0],
        homogenized(mesh, faces="mortar"),
        homogenized(mesh, faces="collocation")[0],
    )
    assert context.reported["joined"] == "mortar"
    assert mortar.stiffness == pytest.approx(matched.stiffness, abs=2e-5)
    assert collocated.stiffness == pytest.approx(matched.stiffness, abs=2e-5)


def test_faces_that_do_not_match_take_the_mortar_by_themselves():
    mesh = meshed(10)
    nodes = mesh.nodes.copy()
    high = nodes[:, 0] > 1 - 1e-9
    inner = high & (np.abs(nodes[:, 1] - 0.5) < 0.2) & (np.abs(nodes[:, 2] - 0.5) < 0.2)
    nodes[inner, 1] += 0.01 * np.sin(10 * nodes[inner, 2])
    moved, context = homogenized(replace(mesh, nodes=nodes, matched=False))
    assert context.reported["joined"] == "mortar"
    assert moved.stiffness == pytest.approx(homogenized(mesh)[0].stiffness, rel=0.02, abs=2e-4)


def test_materials_of_the_mesh_have_constants_of_their_own():
    mesh = meshed(6)
    two = replace(mesh, materials=1 + (mesh.nodes[mesh.cells[:, 0], 2] > 0.5).astype(np.uint8))
    one = homogenized(two)[0]
    assert one.stiffness == pytest.approx(homogenized(mesh)[0].stiffness, abs=1e-9)
    soft = homogenized(two, young=(1.0, 0.1), poisson=(0.3, 0.2), stress_unit="GPa")[0]
    assert soft.stiffness[2, 2] < 0.7 * one.stiffness[2, 2]
    assert len(soft.phases) == 3
    assert soft.summary()["unit"] == "GPa"
    with pytest.raises(ConfigError, match="2 materials"):
        homogenized(two, young=(1.0,))


def test_what_can_not_be_homogenized():
    mesh = meshed(6)
    with pytest.raises(InputError, match="no periodic cell"):
        homogenized(replace(mesh, box=None, matched=False))
    with pytest.raises(InputError, match="inside out"):
        homogenized(replace(mesh, cells=mesh.cells[:, [1, 0, 2, 3]]))
    with pytest.raises(InputError, match="no cells"):
        homogenized(VolumeMesh(mesh.nodes, np.empty((0, 4), np.int32), box=mesh.box))
    with pytest.raises(DesignError, match="did not converge"):
        homogenized(mesh, iterations=1)


@pytest.mark.parametrize("order", [1, 2])
def test_shards_that_carry_no_load_are_told(order):
    one = meshed(6, order, Shards())
    with pytest.raises(DesignError, match="carries no load: its solid does not run through the cell") as told:
        homogenized(one)
    assert "less porous" in told.value.hint
    with pytest.raises(DesignError, match="does not run through"):
        homogenized(one, young=2e11, faces="mortar")
    half = one.nodes * (0.5, 1, 1)
    cells = np.vstack([one.cells, one.cells + len(half)])
    two = replace(one, nodes=np.vstack([half, half + np.array([0.5, 0, 0])]), cells=cells)
    with pytest.raises(DesignError, match="in 2 loose parts, does not run through"):
        homogenized(two)


def test_what_carries_load_along_one_axis_only_is_homogenized():
    """A rod is pulled along its axis: Young's modulus times its share, as a bar has it, and nothing else."""

    class Rod(SchwarzP):
        def sample_layers(self, grid, start, stop, threads=1):
            grid = grid.layers(start, stop)
            x, y, z = (grid.axis(axis) - 0.5 for axis in range(3))
            return (np.hypot(x[:, None, None], y[:, None]) - 0.3 + 0 * z).astype(np.float32)

    found = homogenized(meshed(6, 1, Rod()))[0]
    found.check()
    assert found.stiffness[2, 2] == pytest.approx(1 - found.porosity, rel=1e-4)
    assert np.abs(np.delete(found.stiffness, 2, 0)).max() < 1e-6


def test_straight_tetrahedra_that_lock_are_told():
    mesh = meshed(6)
    soft, quiet = homogenized(mesh, poisson=0.49)
    stiff, told = homogenized(mesh, poisson=0.499)
    assert not quiet.warnings
    assert any("tetrahedra lock" in text for text in told.warnings)
    assert stiff.stiffness[0, 0] > 1.5 * soft.stiffness[0, 0]


def test_a_mesh_without_the_box_of_its_cell_is_refused_before_the_run(tmp_path):
    (tmp_path / "a.vtu").write_text("")
    read = sppm.step.read.volume_mesh(path=str(tmp_path / "a.vtu"))
    with pytest.raises(sppm.ConfigError, match=r"'read.volume_mesh' makes has no periodic box") as caught:
        sppm.Pipeline([read, sppm.step.homogenize.tet()]).check()
    assert "`cell` to `mesh.tetwild`" in str(caught.value.hint)
    sppm.Pipeline(
        [sppm.step.read.volume_mesh(path=str(tmp_path / "a.vtu"), periodic=True), sppm.step.homogenize.tet()]
    ).check()
