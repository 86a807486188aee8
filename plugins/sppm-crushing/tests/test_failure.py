"""Failure: work of a crack, release of voxels, rubble, the balance of energy, and what is refused."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from sppm_crushing.numerics import element
from sppm_crushing.numerics.body import body_of
from sppm_crushing.numerics.failing_march import FailingMarch
from sppm_crushing.numerics.march import Load
from sppm_crushing.numerics.material import RELEASED, Material, constants, failing
from sppm_crushing.stages.crush_voxel import CrushVoxel

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.nouns.size import Geometry, Size
from sppm_pipeline.testing.plain_context import PlainContext

RESIN = Material(1.0, 0.35, ((0.0, 0.02),))
SOFT = RESIN._replace(fracture=1e-3)


def image(values, spacing=1.0, physical=False):
    return Voxels(np.asarray(values, np.uint8), (spacing,) * 3, physical, (False,) * 3)


def run(values, materials, load, threads=1):
    march = FailingMarch(body_of(values), materials, load, threads)
    march.to(1)
    march.close()
    return march


class Voxel:
    """One voxel whose sides are free, stretched along z."""

    def __init__(self, material):
        self.body = body_of(np.ones((1, 1, 1), np.uint8))
        self.table, self.failing = constants((material,)), failing((material,))
        self.state = np.zeros((1, element.STATE, element.LANES))
        self.state[:, :3] = self.state[:, 8:] = 1
        self.side = 1.0
        self.cracks = np.zeros((1 if material.cracks else 0, 4, element.LANES))

    def _forces(self, side, stretch):
        state, cracks, sums = self.state.copy(), self.cracks.copy(), np.zeros((1, element.SUMS))
        x = np.ascontiguousarray(self.body.nodes * np.array([side, side, stretch]))
        f = np.zeros_like(x)
        element.forces(
            x, self.body.blocked(self.body.corners, -1), np.zeros(1, np.int32), np.array([0, 1]), 0, 1, self.table,
            state, np.full((1, element.LANES), -1, np.int32), np.zeros(0, np.uint8), np.zeros((0, 8, 3)),
            np.zeros(element.ROWS * element.LANES), f, sums, self.failing, cracks,
        )  # fmt: skip
        high = self.body.nodes == 1
        return f[high[:, 0], 0].sum(), -f[high[:, 2], 2].sum(), state, cracks, sums

    def stress(self, stretch):
        """Nominal stress, when the sides have found theirs."""
        side = brentq(lambda side: self._forces(side, stretch)[0], 0.99 * self.side, 1.01 * self.side, xtol=1e-12)
        self.side = side
        _, stress, self.state, self.cracks, sums = self._forces(side, stretch)
        return stress, sums


@pytest.mark.parametrize(("how", "way"), [("j2", -1), ("j2", 1), ("rankine", 1)])
@pytest.mark.parametrize("n", [4, 8, 16, 32])
def test_a_bar_takes_the_same_work_however_many_voxels_it_has(how, way, n):
    """Of n voxels one is weak and fails; the others unload, so that the work is that of the crack."""
    energy = 2e-4  # per area, in Young's moduli times the length of the bar
    if how == "rankine":
        material = Material(1.0, 0.35, (), energy * n, 0.02)
    else:
        material = RESIN._replace(fracture=energy * n)
    assert material.fracture >= material.least_fracture
    voxel, stretches, stresses, dissipated = Voxel(material), [1.0], [0.0], 0.0
    end = 1.05 * material.failure_strain + 0.03 if how == "j2" else 6 * energy * n / 0.02 + 0.03
    for log in np.linspace(0, end, 500 if how == "j2" else 2000)[1:]:
        stretch = math.exp(way * log)
        stress, sums = voxel.stress(stretch)
        stretches.append(stretch)
        stresses.append(stress)
        dissipated += sums[0, 2]
        if how == "j2":
            released = voxel.state[0, 6, 0] >= material.failure_strain
        else:
            first, largest, damage, _ = voxel.cracks[0, :, 0]
            released = damage > 0 and (1 - damage) * largest <= RELEASED * first
        if released:
            break
    assert released
    work = np.trapezoid(stresses, stretches) / n  # nominal stress over the voxel's edge
    assert max(np.abs(stresses)) == pytest.approx(0.02, rel=0.05)
    assert work == pytest.approx(energy, rel=0.02)
    assert (dissipated + sums[0, 0]) / n == pytest.approx(energy, rel=0.02)  # what is stored goes with the release


def test_softening_encloses_the_work_to_failure():
    hard = Material(2.0, 0.3, ((0.0, 0.02), (0.1, 0.03)), 5e-3)
    strain, stress = np.array(hard.curve).T
    later = strain >= 0.1
    assert np.trapezoid(stress[later], strain[later]) == pytest.approx(5e-3)
    assert stress[-1] == pytest.approx(RELEASED * 0.03)
    assert strain[-1] == hard.failure_strain
    assert hard.curve[0] == (0.0, 0.02)
    # the steepest part falls as fast as the modulus where the voxel is as large as it may be
    largest = hard._replace(fracture=hard.least_fracture)
    strain, stress = np.array(largest.curve).T
    assert np.diff(stress).min() < 0
    assert (np.diff(stress) / np.diff(strain)).min() == pytest.approx(-2.0)


def test_what_cannot_fail_has_the_bytes_of_a_plastic_solid(cell, plastic):
    found = [run(cell, (one,), Load(0.05, 0.02)) for one in (plastic, plastic._replace(fracture=math.inf))]
    # a fracture energy beyond reach softens by nothing that matters
    found.append(run(cell, (plastic._replace(yield_stress=((0.0, 0.02),), fracture=1e9),), Load(0.05, 0.02)))
    assert np.array_equal(found[0].x, found[1].x)
    assert np.array_equal(found[0].history().top, found[1].history().top)
    flat = run(cell, (plastic._replace(yield_stress=((0.0, 0.02),)),), Load(0.05, 0.02))
    assert found[2].history().top == pytest.approx(flat.history().top, rel=1e-6)


@pytest.mark.parametrize("rubble", [False, True])
@pytest.mark.parametrize("how", ["j2", "both"])
def test_energy_is_balanced_while_voxels_fail(cell, crushed, how, rubble):
    material = SOFT if how == "j2" else SOFT._replace(strength=0.012)
    march = run(cell, (material,), Load(0.25, 0.005, rubble=rubble))
    shares = march.shares()
    assert march.released.sum() > 30
    assert abs(shares["unbalanced"]) < 5e-3
    assert shares["failed"] < 0.1
    history, plastic = march.history(), crushed.history()
    late = history.strain > 0.1
    assert history.top[late].mean() < 0.6 * np.interp(history.strain[late], plastic.strain, plastic.top).mean()
    assert march.fragments() > 1


def test_threads_and_interruptions_leave_no_trace_of_rubble(cell):
    load = Load(0.1, 0.02, rubble=True)
    material = SOFT._replace(strength=0.012)

    def marched(threads):
        march = FailingMarch(body_of(cell), (material,), load, threads)
        march.to(0.07)
        return march, march.kept()

    (first, kept), (other, _) = marched(2), marched(3)
    first.close()
    assert first.released.sum() > 30
    then = FailingMarch(body_of(cell), (material,), load)
    then.resume({name: value.copy() for name, value in kept.items()})
    for march in (then, other):
        march.to(0.1)
        march.close()
    assert then.released.sum() > first.released.sum()
    assert np.array_equal(then.released, other.released)
    assert np.array_equal(then.x, other.x)
    assert np.array_equal(then.history().energies["failed"], other.history().energies["failed"])


def test_what_a_crack_has_parted_meets_again():
    """A weak layer fails; the blocks on both sides then touch, and bear what one block bears."""
    values = np.ones((9, 5, 5), np.uint8)
    values[4] = 2
    weak = Material(1.0, 0.35, ((0.0, 0.005),), 1.1e-4)
    march = run(values, (Material(1.0, 0.35), weak), Load(0.3, 0.01))
    assert march.released.sum() == 25
    assert march.fragments() == 2
    history = march.history()
    # the layer is held by what is beside it, so that it bears more than its yield stress
    strain, stress = history.strain, history.top / 25
    assert stress[strain < 0.05].max() > 0.02
    assert stress[(strain > 0.055) & (strain < 0.07)].max() < 0.005  # nothing touches yet
    assert stress[strain > 0.25].min() > 0.1
    assert abs(march.shares()["unbalanced"]) < 5e-3


def test_a_disk_between_plates_splits_along_its_diameter():
    """The Brazilian test: tension across the loaded diameter is 2 / pi of the load over diameter and thickness."""
    n = 24
    z, _, x = np.indices((n, 2, n)) + 0.5
    values = (np.hypot(x - n / 2, z - n / 2) < n / 2).astype(np.uint8)
    brittle = Material(1.0, 0.2, (), 3e-5 * n, 0.01)
    march = FailingMarch(body_of(values), (brittle,), Load(0.06, 0.002, -1.0))
    while not march.released.any():
        march.to(march.strain + 1e-3)
    middle = np.abs(march.body.voxels[march.released][:, 0] + 0.5 - n / 2)
    assert middle.max() < 3
    march.to(march.strain + 0.003)
    history = march.history()
    assert history.top.max() / (2 * n) == pytest.approx(np.pi / 2 * 0.01, rel=0.15)
    assert history.top[-1] < 0.5 * history.top.max()


GIVEN = {"young": 1404.0, "poisson": 0.45, "yield_stress": 29.0, "stress_unit": "MPa", "failure": "j2"}


def test_voxels_in_which_stress_would_snap_back_are_refused():
    stage = CrushVoxel(resolution=8, fracture_energy=0.6, **GIVEN)
    geometry = Geometry(edge_mm=15.0, box=(1, 1, 1), volume=1, envelope=6, porosity=0.7, surface=5)
    with pytest.raises(ConfigError, match=r"voxels of 1\.875 mm .* the largest that are allowed have 1\.138 mm") as no:
        stage.crushing(Size(geometry=geometry))
    assert "`resolution: 14`" in no.value.hint
    CrushVoxel(resolution=14, fracture_energy=0.6, **GIVEN).crushing(Size(geometry=geometry))
    block = np.ones((3, 3, 3))
    with pytest.raises(ConfigError, match="snap back"):
        stage.run(PlainContext(), image(block, 1.2, True))
    with pytest.raises(ConfigError, match="snap back"):
        CrushVoxel(fracture_energy=0.6, **GIVEN | {"failure": "rankine"}).run(PlainContext(), image(block, 0.7, True))


def test_a_block_that_fails_knows_what_is_left(cell):
    body = CrushVoxel(
        strain=0.2, rate=0.02, frames=(0.1,), fracture_energy=0.7, solid_density=1.2, **GIVEN
    ).run(PlainContext(), image(cell.T, 0.8, True))  # fmt: skip
    body.check()
    assert body.frame_released.shape == body.frame_alpha.shape
    assert not body.frame_released[0].any()
    assert (body.frame_released[1] <= body.frame_released[2]).all()
    assert body.numbers["released"] == pytest.approx(body.frame_released[-1].mean(), abs=1e-6)
    assert body.numbers["fragments"] >= 1
    assert body.energies["failed"][-1] == pytest.approx(
        body.numbers["failed"] * body.energies["external"][-1], rel=0.05
    )
    known = CrushVoxel(strain=0.05, rate=0.05, yield_stress=0.03).run(PlainContext(), image(np.ones((3, 3, 3))))
    assert known.frame_released.shape == (0, 0)
    assert "failed" not in known.energies


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"failure": "j2"}, "needs a `fracture_energy`"),
        ({"fracture_energy": 1.0}, "`fracture_energy` is of no use with `failure: none`"),
        ({"failure": "j2", "fracture_energy": 1.0}, "needs a `yield_stress`"),
        ({"failure": "rankine", "fracture_energy": 1.0}, "of a solid that does not yield it must be given"),
        ({"failure": "rankine", "fracture_energy": 1.0, "tensile_strength": 1.0}, "beside Young's"),
        ({"failure": "j2", "fracture_energy": 1.0, "yield_stress": 0.1, "tensile_strength": 0.1}, "no use"),
        ({"failure": "j2", "fracture_energy": (1.0, 2.0), "yield_stress": 0.1}, "`fracture_energy` has 2 values"),
        ({"failure": "both", "fracture_energy": 1.0, "yield_stress": ((0.0, 0.1), (0.1, 0.05))}, "falls"),
    ],
)
def test_refusals(wrong, words):
    with pytest.raises(ConfigError, match=words):
        CrushVoxel(**wrong).check_options()
