"""``crush.voxel``: from a field or an image to a curve, a deformed body, and words about both."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from sppm_crushing.compression import CrushedBody
from sppm_crushing.crusher import is_quiet
from sppm_crushing.numerics.march import March
from sppm_crushing.stages.crush_voxel import CrushVoxel
from sppm_crushing.stages.measure_compression import measured
from sppm_crushing.stages.write_curves import WriteCurves

from sppm_pipeline.engine.plan.checking import is_declared
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext

QUICK = {"strain": 0.1, "rate": 0.03}


def image(values, spacing=1.0, physical=False):
    return Voxels(np.asarray(values, np.uint8), (spacing,) * 3, physical, (False,) * 3)


def ells():
    """A block that differs along each axis: 4 x 5 x 6 voxels with a corner cut off."""
    values = np.ones((4, 5, 6), np.uint8)
    values[2:, 3:, :] = 0
    return values


def crushed(source, context=None, **options):
    body = CrushVoxel(**{**QUICK, **options}).run(context or PlainContext(), source)
    body.check()
    return body


class TestContract(StageContract):
    def stages(self):
        return [CrushVoxel(strain=0.05, rate=0.05, yield_stress=0.03)]

    def inputs(self):
        return {"source": image(ells())}


@pytest.mark.parametrize(("axis", "turn"), [("x", (1, 2, 0)), ("y", (2, 0, 1))])
def test_axes_are_the_same_block_turned(axis, turn):
    along_z = crushed(image(ells().transpose(turn)), frames=(0.05,))
    along = crushed(image(ells()), axis=axis, frames=(0.05,))
    assert along.stress == pytest.approx(along_z.stress, rel=1e-12)
    assert along.frame_strains == pytest.approx([0, 0.05, 0.1], abs=2e-3)
    n = "xyz".index(axis)
    heights = np.ptp(along.frame_nodes[..., n], axis=1)
    assert heights == pytest.approx(along.grid[n] * (1 - along.frame_strains), rel=1e-5)


def test_strains_of_the_frames_are_declared_columns():
    body = crushed(image(ells()), frames=(0.03, 0.05))
    assert len(body.summary()["frames"]) > 2
    assert is_declared("frames.3", frozenset(CrushedBody.reported))


def test_the_body_lies_where_its_image_lies():
    values = ells()
    values[0, 0, 0] = 2
    body = crushed(image(values, 0.5, True), axis="y", young=(1.0, 0.5), solid_density=2.0)
    assert body.spacing == 0.5
    assert body.grid == (4, 5, 6)
    assert body.height == 2.5
    assert body.area == 4 * 6 * 0.25
    assert body.density == pytest.approx(2 * 0.8)
    assert np.array_equal(values[tuple(body.voxels.T)], body.phases)
    corners = body.frame_nodes[0][body.elements]
    for column in range(8):
        up = [column & 1, column >> 1 & 1, column >> 2 & 1]
        assert corners[:, column] == pytest.approx(0.5 * (body.voxels + up))


def test_units_are_those_of_the_modulus():
    relative = crushed(image(ells()), yield_stress=0.02)
    mpa = crushed(image(ells()), young=1400.0, yield_stress=((0.0, 28.0),), stress_unit="MPa")
    assert mpa.unit == "MPa"
    assert mpa.stress == pytest.approx(1400 * relative.stress, rel=1e-9)
    assert mpa.energies["external"] == pytest.approx(1400 * relative.energies["external"], rel=1e-9)
    shares = {"elastic", "hourglass", "plastic", "contact", "friction", "kinetic", "damping", "plates", "mass"}
    total = sum(mpa.numbers[name] for name in shares) + mpa.numbers["unbalanced"]
    given = relative.energies["kinetic"][0] / relative.energies["external"][-1]
    assert total == pytest.approx(1 + given, abs=0.02)
    assert mpa.plates.mean(1) == pytest.approx(mpa.stress)


def test_energy_is_the_area_below_the_curve():
    body = crushed(image(ells()), yield_stress=0.02, rate=0.01)
    area = np.concatenate([[0], np.cumsum(np.diff(body.strain) * (body.stress[1:] + body.stress[:-1]) / 2)])
    assert body.energies["external"][-1] == pytest.approx(area[-1], rel=0.02)


@dataclass(frozen=True, eq=False)
class Slanted(ScalarField):
    """Half of a cell, cut by a plane."""

    @property
    def cells(self):
        return (1, 1, 1)

    @property
    def periodic(self):
        return False

    def sample_layers(self, grid, start, stop, threads=1):
        grid = grid.layers(start, stop)
        x, y, z = (grid.axis(axis) - 0.5 for axis in range(3))
        return (x[:, None, None] + 0.3 * y[:, None] + 0.2 * z).astype(np.float32)


def test_a_field_keeps_its_density():
    body = crushed(Slanted(), resolution=7, strain=0.01, rate=0.05)
    assert body.numbers["relative_density"] == pytest.approx(0.5, abs=1 / 7**3)


def test_rate_is_halved_until_nothing_changes():
    context = PlainContext()
    body = crushed(image(np.ones((3, 3, 3))), context, rate="auto", strain=0.2, yield_stress=0.05)
    assert body.numbers["rate"] in (0.01, 0.005, 0.0025)
    slower = crushed(image(np.ones((3, 3, 3))), rate=body.numbers["rate"] / 2, strain=0.2, yield_stress=0.05)
    assert body.numbers["plateau"] is None  # it would end at 40 %
    late = body.strain > 0.1
    assert body.stress[late].mean() == pytest.approx(slower.stress[slower.strain > 0.1].mean(), rel=0.03)


def test_a_slender_strut_is_crushed_slowly_enough_to_bow():
    width, length = 4, 48
    column = np.zeros((width + 4, width, length))
    for z in range(length):
        bow = round((1 - np.cos(2 * np.pi * (z + 0.5) / length)) / 2)
        column[bow : bow + width, :, z] = 1
    euler = 4 * np.pi**2 * (width**2 / 12) / length**2 * width / (width + 4)
    options = {"strain": 0.06, "least_strain": 0.01, "plates": "stick", "poisson": 0.3}
    # no column bears more than Euler's load; at this rate inertia carries the rest
    assert crushed(image(column), rate=0.01, **options).stress.max() > 1.03 * euler
    body = crushed(image(column), rate=None, **options)
    assert body.numbers["rate"] <= 0.0025
    assert body.stress.max() < 0.72 * euler


def test_a_quiet_dense_block_is_crushed_once():
    quiet = crushed(image(np.ones((3, 3, 3))), rate=None, strain=0.3, yield_stress=0.05)
    assert quiet.numbers["rate"] == (0.01 if is_quiet(quiet.numbers) else 0.005)


def test_what_is_doubtful_is_said():
    floating = np.zeros((4, 4, 8), np.uint8)
    floating[:, :, 2:4] = floating[:, :, 5:6] = 1
    context = PlainContext()
    crushed(image(floating), context)
    said = " ".join(context.warnings)
    assert "begins 2 voxels above the lower and ends 2 below the upper" in said
    assert "no load path between the plates" in said
    context = PlainContext()
    loose = np.ones((6, 4, 4), np.uint8)
    loose[1] = loose[0, :, 0] = 0
    crushed(image(loose), context, rate=0.05, yield_stress=((0.0, 0.05), (1.0, 0.01)))
    said = " ".join(context.warnings)
    assert "0.16 of the solid is not connected to the load path" in said
    assert "the solid softens" in said
    assert "of the work is in motion" in said


@pytest.fixture
def brittle(monkeypatch):
    """All marches get unstable at a strain of 7 %."""

    def rescale(self, whole=March._rescale):
        if self.strain > 0.07:
            self._mass *= 0.05
        whole(self)

    monkeypatch.setattr(March, "_rescale", rescale)


def test_a_block_that_comes_apart_keeps_its_curve(brittle):
    block, context = image(ells()), PlainContext()
    body = crushed(block, context, least_strain=0.06, frames=(0.05, 0.09))
    assert 0.06 <= body.strain[-1] <= 0.08
    assert "a voxel turned inside out" in body.ended or "without bound" in body.ended
    assert f"the simulation stopped: {body.ended} beyond a strain of 0.07" in " ".join(context.warnings)
    assert body.frame_strains == pytest.approx([0, 0.05, 0.06], abs=2e-3)  # the last state that is kept
    assert body.numbers["plateau"] is None
    assert body.stress.max() < 2 * body.stress[body.strain < 0.06].max()
    remarks = {one.name: one for one in measured(body, (0.2, 0.4), 0.5)}
    for name in ("plateau_stress", "energy_25", "stress_10", "densification_strain"):
        assert remarks[name].value is None
        assert remarks[name].remark.startswith("not reached")
        assert remarks[name].remark.endswith(f"where {body.ended}")
    assert WriteCurves(path="c.png")._line([body], "relative").label.endswith(f" %, where {body.ended}")
    with pytest.raises(DesignError, match=r"simulation stopped: .* after \d+ of \d+ steps"):
        crushed(block, least_strain=0.09)
    with pytest.raises(DesignError, match="simulation stopped"):
        crushed(block)  # the least strain is that at the end


def test_the_end_and_the_frames_do_not_change_the_march():
    block = image(ells())
    long, short = crushed(block, strain=0.2, frames=()), crushed(block, strain=0.13, frames=(0.031, 0.07))
    n = len(short.strain) - 2
    assert short.strain[-1] == 0.13
    assert np.array_equal(long.stress[:n], short.stress[:n])


def test_refusals():
    with pytest.raises(DesignError, match="empty"):
        crushed(image(np.zeros((3, 3, 3))))
    with pytest.raises(DesignError, match="only cubes"):
        crushed(Voxels(np.ones((3, 3, 3), np.uint8), (1.0, 1.0, 1.2), True, (False,) * 3))
    with pytest.raises(DesignError, match="phases up to 2"):
        crushed(image(2 * np.ones((3, 3, 3))))
    for wrong, words in [
        ({"young": (1.0, 2.0), "poisson": (0.3, 0.3, 0.3)}, "`poisson` 3"),
        ({"yield_stress": ((0.1, 0.1),)}, "start at 0"),
        ({"yield_stress": ((0.0, 0.1), (0.0, 0.2))}, "rise"),
        ({"yield_stress": 29.0}, "same unit"),
        ({"young": (1.0, 2.0), "yield_stress": (((0.0, 0.1),),) * 3}, "3 tables"),
    ]:
        with pytest.raises(ConfigError, match=words):
            CrushVoxel(**wrong).check_options()
    several = CrushVoxel(young=(1.0, 2.0), yield_stress=(((0.0, 0.1),), ()))
    several.check_options()
    assert several._tables() == (((0.0, 0.1),), ())
    assert replace(several, yield_stress=0.05)._tables() == (((0.0, 0.05),),) * 2


class Interrupted(PlainContext):
    """A run that somebody ends; what it remembers is there for the next."""

    def __init__(self, memory, at=2.0, threads=1):
        super().__init__(threads=threads)
        self.memory, self.at = memory, at

    def progress(self, done, total, what=""):
        if done / total > self.at:
            raise KeyboardInterrupt

    def remember(self, key, state):
        self.memory.pop(key, None)
        if state is not None:
            self.memory[key] = state

    def recall(self, key):
        return self.memory.get(key)


def test_an_interrupted_run_goes_on_to_the_same_bytes():
    block = image(np.random.default_rng(8).random((5, 5, 6)) < 0.75)
    options = {"strain": 0.3, "yield_stress": 0.03, "frames": (0.05, 0.11, 0.2)}
    whole = crushed(block, **options)
    memory = {}
    for at in (0.4, 0.8):
        with pytest.raises(KeyboardInterrupt):
            crushed(block, Interrupted(memory, at), **options)
        assert len(memory) == 1
    ended = crushed(block, Interrupted(dict(memory)), **{**options, "strain": 0.24})  # where it was
    assert np.array_equal(ended.stress[:-2], whole.stress[: len(ended.stress) - 2])
    assert ended.frame_strains == pytest.approx([0, 0.05, 0.11, 0.2, 0.24], abs=2e-3)
    crushed(block, Interrupted(memory), **{**options, "yield_stress": 0.04})  # another material begins anew
    context = Interrupted(memory, threads=2)
    then = crushed(block, context, **options)
    assert not memory
    assert np.array_equal(then.stress, whole.stress)
    assert np.array_equal(then.frame_nodes, whole.frame_nodes)
    assert np.array_equal(then.frame_alpha, whole.frame_alpha)
    assert np.array_equal(then.frame_strains, whole.frame_strains)


def test_a_rate_at_which_the_block_comes_apart_is_not_the_last_that_is_tried(monkeypatch):
    at_a_rate, tried = CrushVoxel._crushed, []

    def apart_at_first(self, context, image, spacing, physical, rate):
        tried.append(rate)
        if rate > limit:
            raise DesignError("the simulation stopped")
        return at_a_rate(self, context, image, spacing, physical, rate)

    monkeypatch.setattr(CrushVoxel, "_crushed", apart_at_first)
    solid, limit = image(np.ones((2, 2, 2))), 0.01
    body = crushed(solid, rate="auto", strain=0.1, yield_stress=0.05)
    assert body.numbers["rate"] == tried[-1] < tried[1] <= limit < tried[0]
    limit = 0.0
    with pytest.raises(DesignError, match="simulation stopped"):
        crushed(solid, rate="auto", strain=0.1, yield_stress=0.05)
