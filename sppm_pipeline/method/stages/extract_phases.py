"""``extract.phases``: fields become an image of several materials."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline import Context, Headline, Length, Palette, Part, ScalarField, Size, Stage, Voxels, option, options
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.fields.scalar_field import RESOLVED_WALL
from sppm_pipeline.method.stages.extract_voxels import ExtractVoxels, image_grid
from sppm_pipeline.services.arrays import F32, F64, U8, Bools
from sppm_pipeline.services.grid import Grid

MAX_PHASES = 255
"""Of an image of 8 bits, in which 0 is void."""

_LAYERS = 16  # whose distances are found at once, to bound memory


@dataclass(frozen=True, kw_only=True)
class ExtractPhases(Stage):
    """Lay fields over each other and label each voxel by its material: solids, a coating, what fills the void.

    The solid of the first field is phase 1, that of the second one as far as the first leaves room phase 2, and so on:
    ``from: [scaffold, second]``. With `coating` the outer layer of the first solid is the next phase, with `filling`
    the rest of the void is the last one. Homogenizers and `crush.voxel` take a material for each phase, `write.voxels`
    and `write.picture` the image.
    """

    name: ClassVar[str] = "extract.phases"
    reported: ClassVar[tuple[str, ...]] = ("names.#6",)

    headline: ClassVar[tuple[Headline, ...]] = (Headline("names"), Headline("phases", "shares"), Headline("porosity"))

    resolution: int = options.resolution(64)
    coating: Length | None = option(
        None, help="thickness of the layer inside the surface of the first solid that is a phase of its own",
        unit="cell size", above=0, maximum=1e5,
    )  # fmt: skip
    filling: bool = option(False, help="what is left of the void is a phase of its own")

    def estimate(self, palette: Palette, fields: tuple[Size, ...]) -> Size:
        images = [ExtractVoxels(resolution=self.resolution).estimate(palette, field) for field in fields]
        return replace(images[0], samples=sum(i.samples for i in images), sums=sum(i.sums for i in images))

    def run(self, context: Context, fields: tuple[ScalarField, ...]) -> Voxels:
        """Sample the fields, the first one on top."""
        first = fields[0]
        names = ["solid" if len(fields) == 1 else f"solid {number}" for number in range(1, len(fields) + 1)]
        names += ["coating"] * (self.coating is not None) + ["filling"] * self.filling
        if len(names) > MAX_PHASES:
            raise ConfigError(
                f"{len(fields)} fields make {len(names)} phases, and an image holds at most {MAX_PHASES}",
                hint="lay fewer fields over each other, or join some by `field.blend` first",
            )
        for number, field in enumerate(fields[1:], 2):
            _check_fits(first, field, number)
        if self.filling and any(isinstance(field, Part) for field in fields):
            raise DesignError(
                "the void of a part reaches beyond its surface; to fill it would leave a block",
                hint="take the cells from before `fill.implicit`, or leave `filling` out",
            )
        grid = image_grid(self.resolution, first.cells)
        labels = np.zeros(grid.shape[::-1], np.uint8)
        for number, field in reversed(list(enumerate(fields, 1))):
            if coarse := field.coarseness(1 / self.resolution):
                context.warn(coarse)
            if number == 1 and self.coating is not None:
                values = field.sample_zyx(grid, 0, grid.shape[2], context.threads)
                labels[values < 0] = 1
                labels[self._in_shell(context, first, values)] = len(fields) + 1
            else:
                self._lay(context, field, grid, np.uint8(number), labels)
            context.progress(len(fields) + 1 - number, len(fields), "fields")
        if self.filling:
            labels[labels == 0] = len(names)
        context.report(names=names)
        shares = np.bincount(labels.ravel(), minlength=len(names) + 1)[1:]
        if missing := [name for name, share in zip(names, shares, strict=True) if not share]:
            context.warn(f"no voxel is left for {', '.join(missing)}")
        edge = first.edge_mm
        return Voxels(labels.T, ((edge or 1.0) / self.resolution,) * 3, edge is not None, (first.periodic,) * 3)

    def _in_shell(self, context: Context, field: ScalarField, values: F32) -> Bools:
        assert self.coating is not None
        thickness = self.coating.in_cells(field.edge_mm)
        if thickness * self.resolution * RESOLVED_WALL < 1:
            context.warn(
                f"the coating is {thickness * self.resolution:.2g} voxels thick and may look broken; "
                f"`resolution: {math.ceil(1 / RESOLVED_WALL / thickness)}` or more shows it"
            )
        return in_shell(values, thickness * self.resolution, field.periodic, context.threads)

    @staticmethod
    def _lay(context: Context, field: ScalarField, grid: Grid, label: np.uint8, labels: U8) -> None:
        """Label the solid of a field, a few layers at a time."""
        for start in range(0, len(labels), 16):
            stop = min(start + 16, len(labels))
            labels[start:stop][field.solid_zyx(grid, start, stop, context.threads) != 0] = label


def _check_fits(first: ScalarField, field: ScalarField, number: int) -> None:
    """Raise `ConfigError` unless a field lies where the first one does, or repeats as that one does."""
    edges = (first.edge_mm, field.edge_mm)
    if None not in edges and edges[0] != edges[1]:
        raise ConfigError(
            f"the cells of the first field are {edges[0]:g} mm large, those of number {number} {edges[1]:g} mm",
            hint="give both the same `edge`, or leave it out in one",
        )
    repeats = field.periodic and not any(n % m for n, m in zip(first.cells, field.cells, strict=True))
    same = field.cells == first.cells and field.periodic == first.periodic and field.origin_mm == first.origin_mm
    if not (repeats or same):
        raise ConfigError(
            f"field number {number} has {' x '.join(map(str, field.cells))} cells and does not cover the "
            f"{' x '.join(map(str, first.cells))} cells of the first one",
            hint="take cells that repeat, or fields over the same part",
        )


def crossings(values: F32, periodic: bool) -> F64:
    """Points where lines between neighboring samples meet the zero level, (n, 3), x, y, z in steps of the grid.

    NaN counts as positive; beside a value that is not finite the level is taken to lie half way between samples. If
    periodic, opposite sides are neighbors.
    """
    found = []
    solid = values < 0
    for axis in range(3):
        meets = solid != np.roll(solid, -1, axis)
        if not periodic:
            np.moveaxis(meets, axis, 0)[-1] = False
        places = np.argwhere(meets)
        beyond = places.copy()
        beyond[:, axis] = (beyond[:, axis] + 1) % values.shape[axis]
        here, there = (values[tuple(at.T)].astype(np.float64) for at in (places, beyond))
        points = places.astype(np.float64)
        with np.errstate(invalid="ignore"):  # NaN and infinity
            share = here / (here - there)
        points[:, axis] += np.where(np.isfinite(here) & np.isfinite(there), share, 0.5)
        found.append(points[:, ::-1])
    return np.concatenate(found)


def in_shell(values: F32, thickness: float, periodic: bool, threads: int = 1) -> Bools:
    """Negative samples within a distance (in steps of the grid) of the zero level, (nz, ny, nx) bool.

    Distances are those to the nearest point where the level meets a line of the grid, a little too long between
    such points: at a distance of d voxels by less than about 1 / (4 d) of a voxel, as half the diagonal of a voxel's
    face is the way to the next one.
    """
    from scipy.spatial import cKDTree

    within = np.zeros(values.shape, bool)
    points = crossings(values, periodic)
    if not len(points):
        return within
    box: Any = np.array(values.shape[::-1]) if periodic else None
    tree = cKDTree(points % box if periodic else points, boxsize=box)
    for start in range(0, len(values), _LAYERS):
        solid = np.argwhere(values[start : start + _LAYERS] < 0)
        solid[:, 0] += start
        distance, _ = tree.query(solid[:, ::-1], distance_upper_bound=thickness * (1 + 1e-6) + 1e-6, workers=threads)
        within[tuple(solid[np.isfinite(distance)].T)] = True
    return within
