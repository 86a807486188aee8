"""``extract.phases``: order of fields, shells, fillings, refusals, and images that homogenizers take."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.flow.stages.homogenize_conductivity import HomogenizeConductivity
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.stages.extract_phases import ExtractPhases, in_shell
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext


@dataclass(frozen=True, eq=False)
class Ball(ScalarField):
    """Solid within a radius of a corner of the cell, which is 3 mm large."""

    radius: float
    edge_mm: float | None = 3.0
    cells: tuple = (1, 1, 1)
    periodic: bool = field(default=True)

    def sample_layers(self, grid, start, stop, threads=1):
        grid = grid.layers(start, stop)
        x, y, z = (np.abs((grid.axis(axis) + 0.5) % 1 - 0.5) for axis in range(3))
        return (np.sqrt(x[:, None, None] ** 2 + y[:, None] ** 2 + z**2) - self.radius).astype(np.float32)


def labeled(*fields, context=None, **options):
    image = ExtractPhases(**{"resolution": 16, **options}).run(context or PlainContext(), fields)
    image.check()
    return image


class TestContract(StageContract):
    def stages(self):
        return [ExtractPhases(resolution=8), ExtractPhases(resolution=8, coating=Length(0.15), filling=True)]

    def inputs(self):
        return {"fields": (Ball(0.4), Ball(0.5))}


def share(radius):
    return 4 / 3 * np.pi * radius**3


def test_solids_a_shell_and_what_fills_the_void():
    context = PlainContext()
    image = labeled(Ball(0.4), Ball(0.5), context=context, resolution=32, coating=Length(0.1), filling=True)
    assert context.reported["names"] == ["solid 1", "solid 2", "coating", "filling"]
    assert image.physical
    assert image.spacing == (3 / 32,) * 3
    assert image.periodic == (True,) * 3
    found = image.summary()
    assert found["porosity"] == 0
    exact = [share(0.3), share(0.5) - share(0.4), share(0.4) - share(0.3), 1 - share(0.5)]
    assert found["phases"] == pytest.approx(exact, rel=0.02)
    assert image.values[0, 0, 0] == 1
    assert image.values[16, 16, 16] == 4
    # the shell in millimeters; across the sides of the cell, too
    assert (labeled(Ball(0.4), Ball(0.5), resolution=32, coating=Length(0.3, "mm"), filling=True).values
            == image.values).all()  # fmt: skip
    assert (np.roll(image.values, 16, 0) == np.roll(image.values, 16, 0)[::-1]).all()
    # the second one first hides the other
    assert labeled(Ball(0.5), Ball(0.4)).values.max() == 1
    plain = labeled(Ball(0.4))
    assert (plain.values == (Ball(0.4).sample(16) < 0)).all()


def test_a_second_field_may_repeat_more_often_or_have_no_size():
    block = labeled(Ball(0.4, cells=(2, 1, 1)), Ball(0.5, edge_mm=None), resolution=8)
    assert block.shape == (16, 8, 8)
    assert (block.values[:8] == block.values[8:]).all()
    for other, told in (
        (Ball(0.5, edge_mm=2.0), "3 mm large, those of number 2 2 mm"),
        (Ball(0.5, cells=(3, 1, 1)), "number 2 has 3 x 1 x 1 cells"),
        (Ball(0.5, periodic=False, cells=(2, 1, 1)), "does not cover"),
    ):
        with pytest.raises(ConfigError, match=told):
            labeled(Ball(0.4), other)


def test_thin_shells_empty_phases_and_parts(ball, wang_tiling):
    context = PlainContext()
    labeled(Ball(0.4), Ball(0.3), context=context, coating=Length(0.05))
    assert any("`resolution: 35`" in text for text in context.warnings)
    assert "no voxel is left for solid 2" in context.warnings
    with pytest.raises(ConfigError, match="no physical size"):
        labeled(Ball(0.4, edge_mm=None), coating=Length(0.3, "mm"))
    with pytest.raises(DesignError, match="beyond its surface"):
        labeled(Part(wang_tiling, ball), filling=True)
    part = labeled(Part(wang_tiling, ball), resolution=8, coating=Length(0.15))
    assert part.periodic == (False,) * 3
    assert {0, 2} <= set(np.unique(part.values))


def test_more_phases_than_an_image_holds_are_refused():
    ball = Ball(0.4)
    assert labeled(*[ball] * 254, resolution=4, filling=True).values.max() == 255
    with pytest.raises(ConfigError, match="254 fields make 256 phases, and an image holds at most 255"):
        labeled(*[ball] * 254, resolution=4, coating=Length(0.1), filling=True)


def test_a_shell_below_values_that_are_no_numbers():
    values = Ball(0.4).sample(16).T.copy()
    plain = in_shell(values, 1.5, True)
    for odd in (np.nan, np.inf):
        bad = np.where(values > 0.1, np.float32(odd), values)  # none beside the level
        assert np.array_equal(in_shell(bad, 1.5, True), plain)
    bad = np.where(values >= 0, np.float32(np.nan), values)
    found = in_shell(bad, 1.5, True)
    assert not found[values >= 0].any()
    assert 0.8 * plain.sum() < found.sum() < 1.2 * plain.sum()  # the level half way between samples
    assert not in_shell(np.full((4, 4, 4), np.nan, np.float32), 1.0, False).any()


def test_homogenizers_take_the_labels():
    """As the field with a filling, by its centers of voxels."""
    options = {"resolution": 8, "fractions": "binary", "residual": 1e-6}
    image, plain = labeled(Ball(0.45), resolution=8, filling=True), Ball(0.45)
    context = PlainContext()
    direct = HomogenizeVoxel(young=2.0, filling_young=0.5, **options).run(context, plain)
    labels = HomogenizeVoxel(young=(2.0, 0.5), **options).run(context, image)
    assert labels.stiffness == pytest.approx(direct.stiffness, rel=1e-6, abs=1e-9)
    assert labels.bounds.bulk_holds
    both = HomogenizeConductivity(of="both", bulk=2.0, fluid=0.5, **options).run(context, plain)
    labels = HomogenizeConductivity(bulk=(2.0, 0.5), **options).run(context, image)
    assert labels.k == pytest.approx(both.k, rel=1e-6, abs=1e-9)
    with pytest.raises(DesignError, match="phases up to 2"):
        HomogenizeConductivity(**options).run(context, image)
