"""Promises of fields, slicers, writers and homogenizers beyond any stage; see `sppm_pipeline.testing.contracts`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.method.slicing.slice_stack import SliceStack
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.testing.plain_context import PlainContext
from sppm_pipeline.testing.stage_contract import StageContract


class SlicerContract(StageContract):
    """Expectations of writers of layers on a stage that makes a stack of them."""

    def test_layers_come_from_the_bottom_without_a_gap(self) -> None:
        """As many and as large as the stack says; bytes that don't depend on threads, in between only if it is gray."""
        for stage in self.stages():
            stack, _ = self._run(stage)
            assert isinstance(stack, SliceStack)
            nx, ny, nz = stack.shape
            found: list[NDArray[np.uint8]] = []
            for start, slab in stack.slabs():
                assert start == sum(len(one) for one in found), f"a slab starts at layer {start}"
                assert slab.shape[1:] == (ny, nx), "layers are (ny, nx), rows along x"
                assert slab.dtype == np.uint8
                found.append(slab.copy())
            layers = np.concatenate(found)
            assert len(layers) == nz
            assert np.array_equal(stack.to_numpy(threads=3), layers)
            assert stack.gray or np.isin(layers, (0, 255)).all()

    def test_pixels_have_a_pitch_along_x_and_one_along_y(self) -> None:
        """A pair, also where both are equal, and a layer height."""
        for stage in self.stages():
            stack, _ = self._run(stage)
            assert isinstance(stack.pixel_mm, tuple), "the pitch of square pixels is a pair, too"
            assert len(stack.pixel_mm) == 2
            assert min(*stack.pixel_mm, stack.layer_mm) > 0


class FieldContract(StageContract):
    """Expectations of meshing, slicing and homogenization on a field."""

    def _fields(self) -> Iterator[ScalarField]:
        for stage in self.stages():
            field, _ = self._run(stage)
            assert isinstance(field, ScalarField)
            yield field

    def test_has_solid_and_void(self) -> None:
        """Negative in the solid, positive in the void, with either of them."""
        for field in self._fields():
            values = field.sample(12)
            assert values.min() < 0 < values.max()
            assert np.array_equal(field.solid(12), values < 0)

    def test_a_sample_depends_on_its_place_alone(self) -> None:
        """Not on the layers that are asked for, nor on other points, nor on threads."""
        for field in self._fields():
            grid = Grid((0.05, 0.03, 0.07), (0.1, 0.15, 0.11), (9, 6, 7))
            whole = field.sample(grid)
            assert whole.shape == (9, 6, 7)
            assert whole.dtype == np.float32
            parts = [field.sample_layers(grid, start, stop, threads=3) for start, stop in ((0, 2), (2, 3), (3, 7))]
            assert np.array_equal(np.concatenate(parts, axis=2), whole)
            # the same points as part of another grid: sums may be rounded otherwise
            inner = Grid((0.25, 0.33, 0.18), (0.1, 0.15, 0.11), (4, 3, 2))
            assert np.allclose(field.sample(inner), whole[2:6, 2:5, 1:3], atol=1e-6 * np.abs(whole).max())

    def test_repeats_if_it_says_so(self) -> None:
        """The next cell of a periodic field is the same."""
        for field in self._fields():
            if field.periodic:
                grid = Grid((0.1, 0.2, 0.3), (0.17, 0.13, 0.11), (4, 5, 6))
                nx, ny, nz = field.cells
                # by whole boxes, in either direction
                moved = Grid((0.1 + nx, 0.2 - ny, 0.3 + 2 * nz), grid.spacing, grid.shape)
                values = field.sample(grid)
                assert np.allclose(field.sample(moved), values, atol=1e-5 * np.abs(values).max())


class WriterContract(StageContract):
    """Expectations of users on a stage that writes."""

    def test_writes_where_it_is_told(self) -> None:
        """The file or folder of the option `path`, with something in it; others beside it begin with its name."""
        for stage in self.stages():
            made, context = self._run(stage)
            assert made is None, "a writer makes nothing"
            target = context.directory / str(getattr(stage, "path")).rstrip("/")  # noqa: B009 - no stage has to have it
            assert target.exists()
            files = [target] if target.is_file() else [file for file in target.rglob("*") if file.is_file()]
            assert files
            assert all(file.stat().st_size for file in files)
            others = {file for file in context.directory.rglob("*") if file.is_file()} - set(files)
            assert all(file.parent == target.parent and file.name.startswith(target.stem) for file in others)


class HomogenizerContract(StageContract):
    """Properties of an effective stiffness, whatever the method; the port of the stage takes images."""

    port = "source"

    def inputs(self) -> Mapping[str, Any]:
        """An image with different stiffness along its axes: a solid slab, and a bar through the rest."""
        solid = np.zeros((6, 6, 6), bool)
        solid[:, :, :3] = solid[2:4, :, :] = solid[:, 3:, 4:5] = True
        return {self.port: Voxels.from_array(solid, periodic=True)}

    def test_a_stiffness_between_the_bounds(self) -> None:
        """Symmetric, without negative energies, between Voigt and Reuss."""
        for stage in self.stages():
            report, _ = self._run(stage)
            assert report.stiffness.shape == (6, 6)
            report.check()
            assert report.bounds.within

    def test_axes_may_be_renamed(self) -> None:
        """The stiffness of the turned image is the stiffness with its axes turned."""
        source = self.inputs()[self.port]
        turned = Voxels.from_array(np.array(source.values).transpose(1, 2, 0) > 0, periodic=True)
        normal = [1, 2, 0]
        order = [*normal, *(3 + i for i in normal)]  # yz, xz, xy are numbered by the axis that they lack
        for stage in self.stages():
            first = stage.run(PlainContext(5), **{self.port: source})
            second = stage.run(PlainContext(5), **{self.port: turned})
            scale = np.abs(first.stiffness).max()
            assert np.allclose(second.stiffness, first.stiffness[np.ix_(order, order)], atol=2e-3 * scale)
