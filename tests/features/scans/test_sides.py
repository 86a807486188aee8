"""Cells with mirror images beyond their sides, against eight copies made by hand."""

import numpy as np
import pytest

import sppm_pipeline as sppm
from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.flow.numerics.conduction import conductivity
from sppm_pipeline.features.flow.numerics.mirrored import HeldConductor, mirrored_conductivity
from sppm_pipeline.features.scans.image_field import ImageField
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.services.elastic import loaded
from tests.features.scans.test_statistics import spheres

pytestmark = pytest.mark.filterwarnings("ignore::sppm_pipeline.SppmWarning")  # twelve voxels resolve little

SOLVE = {"solver_tolerance": 1e-9, "precision": "double"}


@pytest.fixture(scope="module")
def cut():
    """A cut of a blob that does not repeat, whose solid and void both lead through."""
    return np.ascontiguousarray(spheres(24, 5, 0.55, seed=4)[2:14, 3:15, 5:17])


def by_hand(solid):
    for axis in range(3):
        solid = np.concatenate((solid, np.flip(solid, axis)), axis)
    return Voxels.from_array(solid, periodic=True)


def test_mirrored_images_are_eight_copies(cut):
    image = Voxels.from_array(cut)
    for stage, number in ((sppm.homogenize.voxel, "stiffness"), (sppm.homogenize.conductivity, "k")):
        mirrored = getattr(stage(sides="mirror", **SOLVE)(image), number)
        copies = getattr(stage(**SOLVE)(by_hand(cut)), number)
        assert np.abs(mirrored - copies).max() < 1e-6 * np.abs(copies).max()
        assert np.diag(mirrored)[0] > 0


def test_stiffness_with_mirror_images_is_solved_on_an_eighth(cut, monkeypatch):
    """Two materials, voxels of unequal edges, an odd number of them, single precision, and a cycle that breaks down."""
    phases = (cut[:11, :, :10] + (np.indices((11, 12, 10)).sum(axis=0) % 7 == 0)).astype(np.uint8)
    copies = by_hand(phases).values
    stage = sppm.homogenize.voxel(sides="mirror", young=[1.0, 3.0], poisson=[0.3, 0.4])
    sizes = []
    solve = loaded.solve

    def watched(hierarchy, b, *args, **options):
        found = solve(hierarchy, b, *args, **options)
        sizes.append(len(b))
        return found._replace(definite=not hierarchy.twice)  # as if every second visit made the cycle indefinite

    scan = Voxels(phases, (1.0, 1.3, 0.8), True, (False,) * 3)
    whole = Voxels(copies, (1.0, 1.3, 0.8), True, (True,) * 3)
    expected = sppm.homogenize.voxel(young=[1.0, 3.0], poisson=[0.3, 0.4])(whole).stiffness
    assert stage(scan).stiffness == pytest.approx(expected, abs=3e-4 * expected.max())
    monkeypatch.setattr(loaded, "solve", watched)
    assert stage(scan).stiffness == pytest.approx(expected, abs=3e-4 * expected.max())
    assert set(sizes) == {3 * 12 * 13 * 11}
    heated = sppm.homogenize.voxel(sides="mirror", young=[1.0, 3.0], poisson=[0.3, 0.4], expansion=[1e-5, 1e-5])
    assert heated(scan).expansion[:3] == pytest.approx([1e-5] * 3, rel=1e-3)


def as_fields(cut):
    """A cut as a field that does not repeat, and its eight copies as one that does."""
    values = np.where(cut, np.float32(-1), np.float32(1))
    field = ImageField.through(np.asfortranarray(values), (1 / 12,) * 3, physical=False, periodic=False)
    whole = ImageField.through(
        np.where(by_hand(cut).values > 0, np.float32(-1), np.float32(1)).copy(order="F"), (1 / 12,) * 3,
        physical=False, periodic=True,
    )  # fmt: skip
    assert whole.cells == (1, 1, 1)
    return field, whole


def test_fields_of_scans_are_homogenized_with_their_mirror_images(cut):
    field, whole = as_fields(cut)
    options = {"fractions": "binary", "grids": 1, **SOLVE}
    found = sppm.homogenize.conductivity(sides="mixed", resolution=16, **options)(field)
    assert found.k == pytest.approx(sppm.homogenize.conductivity(resolution=32, **options)(whole).k, rel=1e-6, abs=1e-9)
    with pytest.raises(DesignError, match="`sides: mirror`"):
        sppm.homogenize.conductivity(resolution=16)(field)


def same_flow(mirrored, copies):
    for name in ("porosity", "pocket_share", "thermal_tortuosity", "wraps"):
        assert getattr(mirrored, name) == pytest.approx(getattr(copies, name), rel=2e-3), name
    for name in ("viscous_tortuosity", "hydraulic_tortuosity"):
        for here, there in zip(getattr(mirrored, name), getattr(copies, name), strict=True):
            assert here == (None if there is None else pytest.approx(there, rel=1e-4)), name


def test_flow_in_fields_of_scans_is_that_between_mirrors(cut, monkeypatch):
    """Walls between the points, and no sample of the images but of the voxels next to a side."""
    field, whole = as_fields(~cut)
    sizes = []

    sample = ImageField.sample_layers

    def watched(self, grid, start, stop, threads=1):
        sizes.append(grid.shape[0])
        return sample(self, grid, start, stop, threads)

    monkeypatch.setattr(ImageField, "sample_layers", watched)
    options = {"solver_tolerance": 1e-8, "grids": 1}
    mirrored = sppm.homogenize.permeability(sides="mirror", resolution=16, **options)(field)
    assert max(sizes) == 2 * 16  # of halves of voxels, by which porosities are measured
    copies = sppm.homogenize.permeability(resolution=32, **options)(whole)
    assert mirrored.k == pytest.approx(4 * copies.k, rel=1e-5, abs=1e-6 * copies.k.max())
    assert mirrored.thermal == pytest.approx(4 * copies.thermal, rel=1e-4)
    assert mirrored.surface == pytest.approx(copies.surface / 2, rel=1e-5)
    assert mirrored.grid == (16, 16, 16)
    same_flow(mirrored, copies)


def test_flow_between_mirrors_is_that_of_eight_copies(cut):
    """Unequal edges, an odd number of voxels, a pocket, and an axis that nothing flows along."""
    void = ~cut[:11, :, :10]
    void[:, :2, :] = False
    void[4, 0, 4] = True
    spacing = (0.1, 0.13, 0.08)
    options = {"solver_tolerance": 1e-7}
    for share in (False, True):
        solid = 1 - void.astype(np.float32) * np.float32(0.9) if share else (~void).astype(np.uint8)
        hand = solid
        for axis in range(3):
            hand = np.concatenate((hand, np.flip(hand, axis)), axis)
        mirrored = sppm.homogenize.permeability(sides="mirror", **options)(Voxels(solid, spacing, True, (False,) * 3))
        copies = sppm.homogenize.permeability(**options)(Voxels(hand, spacing, True, (True,) * 3))
        assert mirrored.m2 == pytest.approx(copies.m2, rel=1e-6, abs=1e-6 * copies.m2.max())
        assert np.count_nonzero(np.diag(mirrored.m2)) == 2
        assert mirrored.pocket_share > 0
        same_flow(mirrored, copies)
        if share:
            assert mirrored.surface == pytest.approx(copies.surface / 2, rel=1e-6)
        throats = [[w for w in one.warnings if "throats" in w] for one in (mirrored, copies)]
        assert throats[0] == throats[1]
        assert bool(throats[0]) != share
        assert mirrored.slices[0].shape == (12, 11)
        assert np.nanmax(mirrored.slices[0]) > 1


def test_conduction_between_mirrors_breaks_down_and_goes_on(cut, monkeypatch):
    """Two conductors in voxels of unequal edges, and a cycle that is not positive definite."""
    image = Voxels((cut[:11, :, :10] + 1).astype(np.uint8), (1.0, 1.3, 0.8), True, (False,) * 3)
    copies = Voxels(by_hand(image.values).values, image.spacing, True, (True,) * 3)
    stage = sppm.homogenize.conductivity(sides="mirror", bulk=[1.0, 30.0])
    expected = sppm.homogenize.conductivity(bulk=[1.0, 30.0])(copies).k
    sizes, solve = [], loaded.solve

    def watched(hierarchy, b, *args, **options):
        sizes.append(len(b))
        return solve(hierarchy, b, *args, **options)._replace(definite=not hierarchy.twice)

    monkeypatch.setattr(loaded, "solve", watched)
    assert stage(image).k == pytest.approx(expected, abs=3e-4 * expected.max())
    assert set(sizes) == {12 * 13 * 11}
    nothing = sppm.homogenize.conductivity(sides="mirror")(Voxels.from_array(np.zeros((4, 4, 4), np.uint8)))
    assert not nothing.k.any()


def test_linear_potentials_at_all_sides_bound_mirrors_and_periods_from_above():
    """Mirrors neither bound a periodic value nor lie below it: they hold more at two sides, and less at the others."""
    ratios = []
    for seed in range(10):
        k = spheres(12, 3, 0.5, seed=seed).astype(np.float64) + 0.02
        periodic = np.diag(conductivity(k, tolerance=1e-8, precision=np.float64).conductivity)
        mirrored = np.diag(mirrored_conductivity(k, tolerance=1e-8, precision=np.float64).conductivity)
        for axis in range(3):
            body = HeldConductor(k, (1.0,) * 3, axis, np.dtype(np.float64), everywhere=True)
            line = np.arange(13.0).reshape([-1 if d == 2 - axis else 1 for d in range(3)])
            linear = np.broadcast_to(line, body.fixed.shape)
            u = body.solve(np.zeros_like(linear), linear, linear, residual=1e-9).displacement
            bound = float((u * body.forces(u)).sum()) / k.size
            assert 1 / np.mean(1 / k) < mirrored[axis] < bound * (1 + 1e-6)
            assert periodic[axis] < bound * (1 + 1e-6) < k.mean()
        ratios += (mirrored / periodic).tolist()
    assert min(ratios) < 1 < max(ratios)


def test_what_touches_no_side_carries_nothing():
    """Nor does what nothing pulls at: the guess of a solver is no answer."""
    image = np.zeros((8, 8, 8), bool)
    image[3:5, 3:5, 3:5] = True
    for stage, number in ((sppm.homogenize.voxel, "stiffness"), (sppm.homogenize.conductivity, "k")):
        assert not getattr(stage(sides="mirror")(Voxels.from_array(image)), number).any()


def test_symmetric_cells_do_not_care_whether_they_repeat_or_are_mirrored():
    half = spheres(12, 3, 0.5, seed=7)[3:9, 3:9, 3:9]
    cell = by_hand(half).values
    for stage, number in ((sppm.homogenize.voxel, "stiffness"), (sppm.homogenize.conductivity, "k")):
        repeated = getattr(stage(**SOLVE)(Voxels.from_array(cell, periodic=True)), number)
        mixed = getattr(stage(sides="mixed", **SOLVE)(Voxels.from_array(cell)), number)
        assert mixed == pytest.approx(repeated, rel=1e-6, abs=1e-7)
        assert repeated.any()
