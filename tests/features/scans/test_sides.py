"""Cells with mirror images beyond their sides, against eight copies made by hand."""

import numpy as np
import pytest

import sppm_pipeline as sppm
from sppm_pipeline.errors import DesignError
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

    def watched(hierarchy, b, *args):
        found = solve(hierarchy, b, *args)
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


def test_fields_of_scans_are_homogenized_with_their_mirror_images(cut):
    values = np.where(cut, np.float32(-1), np.float32(1))
    field = ImageField.through(np.asfortranarray(values), (1 / 12,) * 3, physical=False, periodic=False)
    copies = by_hand(cut)
    whole = ImageField.through(
        np.where(copies.values > 0, np.float32(-1), np.float32(1)).copy(order="F"), (1 / 12,) * 3,
        physical=False, periodic=True,
    )  # fmt: skip
    assert whole.cells == (1, 1, 1)
    options = {"fractions": "binary", "grids": 1, **SOLVE}
    found = sppm.homogenize.conductivity(sides="mirror", resolution=16, **options)(field)
    assert found.k == pytest.approx(sppm.homogenize.conductivity(resolution=32, **options)(whole).k, rel=1e-6, abs=1e-9)
    with pytest.raises(DesignError, match="`sides: mirror`"):
        sppm.homogenize.conductivity(resolution=16)(field)


def test_flow_between_mirrors_is_that_of_eight_copies(cut):
    void = Voxels.from_array(~cut, spacing=0.1)
    hand = by_hand(~cut)
    options = {"solver_tolerance": 1e-6}
    mirrored = sppm.homogenize.permeability(sides="mirror", **options)(void)
    copies = sppm.homogenize.permeability(**options)(Voxels(hand.values, (0.1,) * 3, True, (True,) * 3))
    assert mirrored.m2 == pytest.approx(copies.m2, rel=1e-6, abs=1e-6 * copies.m2.max())
    assert mirrored.darcy_mean > 0
