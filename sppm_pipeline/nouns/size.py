"""Expected sizes of artifacts, and of the work on them: what estimates are computed from."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from sppm_pipeline.nouns.length import Cell
from sppm_pipeline.nouns.palette import Palette

TRIANGLES = 2.6
"""Triangles of marching cubes per squared voxel edge of a surface of random orientation; measured on the paper's cells.
A face of the box parallel to the grid has two."""

USES_OF_A_PATCH, LASTING_USES, BANK = 4, 30, 256 * 2**20
"""A tiling is sampled by cached patches if each is used as often, and if all take at most so many bytes, three times as
many where the uses last; see `fields.tiling`."""

PAYING_SHARE, PAYING_SHARE_OF_PATCHES = 0.5, 0.8
"""Coarse samples for each fine one up to which interpolating pays, if kernels are summed there, and if patches are:
short rows of kernels cost twice as much a sample as long ones."""


@dataclass(frozen=True, kw_only=True)
class CellDesign:
    """Mean numbers of a cell that samplers and connectors design.

    Attributes
    ----------
    edge : float
        Cell size, mm, or in the unit of length of omega and mu; see `Cell`.
    edge_mm : float or None
        Physical cell size.
    interior_pores, face_pores : float
        Pores of one interior, and of its three independent faces.
    tunnels : float
    interiors : int
    colors : tuple of 3 ints
    radii : (pore, tunnel)
        In cell sizes; 0 before there is a field.
    """

    edge: float = 1.0
    edge_mm: float | None = None
    interior_pores: float = 0.0
    face_pores: float = 0.0
    tunnels: float = 0.0
    interiors: int = 1
    colors: tuple[int, int, int] = (0, 0, 0)
    radii: tuple[float, float] = (0.0, 0.0)

    @property
    def pores(self) -> float:
        """Pores of a cell."""
        return self.interior_pores + self.face_pores

    @property
    def cell(self) -> Cell:
        """The cell, which turns the user's lengths into cell sizes."""
        return Cell(self.edge, self.edge_mm is not None)


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """Expected geometry of a field or mesh. All lengths are in cell sizes, or in mm for a mesh that was read.

    Attributes
    ----------
    edge_mm : float or None
        Physical size of the unit of length.
    box : (x, y, z)
    volume : float
        Of the cells or of the part that the microstructure fills.
    envelope : float
        Area of the box, or of the surface of the part.
    porosity : float
    surface : float
        Area of the pores per volume.
    kernels : float
        Mean number of kernels above the cut-off at a point.
    reach : float
        How far kernels reach beyond their cell.
    patches : float
        Different cells that a tiling is made of.
    coarse : float
        Samples along a cell edge from which those of finer grids are interpolated; infinite if all are summed.
    """

    edge_mm: float | None = None
    box: tuple[float, float, float] = (1.0, 1.0, 1.0)
    volume: float = 1.0
    envelope: float = 6.0
    porosity: float = 0.0
    surface: float = 0.0
    kernels: float = 0.0
    reach: float = 0.0
    patches: float = math.inf
    coarse: float = math.inf

    @property
    def scale(self) -> float:
        """Millimeters of the unit of length; 1 if it has no physical size, as meshes are then written."""
        return self.edge_mm or 1.0

    def in_unit(self, unit: float) -> Geometry:
        """The solid as a body without pores of its own, in another unit of length (mm)."""
        f = self.scale / unit
        x, y, z = self.box
        return Geometry(
            edge_mm=unit,
            box=(f * x, f * y, f * z),
            volume=f**3 * self.volume * (1 - self.porosity),
            envelope=f**2 * self.area,
        )

    @property
    def area(self) -> float:
        """Area of the solid: its pores, and where it ends at the envelope."""
        return self.surface * self.volume + self.envelope * (1 - self.porosity)

    def outline(self, pixel: float, layer: float) -> float:
        """Pixels in the layers of a stack whose neighbor differs.

        Outlines have ``pi / 4`` of the area in a volume as their length (stereology: Underwood, "Quantitative
        Stereology", ch. 2). Where they come closer than a pixel, neighbors differ as often as independent ones.
        """
        inside, pairs = self.volume / (pixel**2 * layer), 2 * self.porosity * (1 - self.porosity)
        crossed = math.pi / 4 * self.area / (pixel * layer)
        # equals `crossed` where outlines are sparse, and never exceeds the share of independent pairs
        return inside * pairs * (1 - math.exp(-crossed / (inside * pairs))) if pairs and inside else crossed

    def triangles(self, resolution: float) -> float:
        """Triangles of marching cubes: pores, and the solid parts of the box or skin that the body ends at."""
        pores = TRIANGLES * self.surface * self.volume
        return (pores + 2 * self.envelope * (1 - self.porosity)) * resolution**2

    def samples(self, resolution: float) -> float:
        """Voxels of the box."""
        return math.prod(self.box) * resolution**3

    def sums(self, samples: float, resolution: float, *, commensurate: bool = True) -> float:
        """Kernels that are evaluated for so many samples: those of patches if they are used often enough."""
        # samples of the coarse grid for each fine one
        share = (self.coarse / resolution) ** 3
        if share <= (PAYING_SHARE_OF_PATCHES if self._patched(self.coarse) else PAYING_SHARE):
            samples, resolution, commensurate = samples * share, self.coarse, True
        return self.kernels * (self.patches * resolution**3 if commensurate and self._patched(resolution) else samples)

    def _patched(self, resolution: float) -> bool:
        """Test whether patches are used often enough, and not too large."""
        # samples of a patch: its cell, and what its kernels reach on both sides
        patch = (resolution * (1 + 2 * self.reach)) ** 3
        room = BANK * (3 if self.volume >= LASTING_USES * self.patches else 1)
        return self.volume >= USES_OF_A_PATCH * self.patches and 4 * self.patches * patch <= room


@dataclass(frozen=True, kw_only=True)
class Size:
    """Counts of what a stage makes or works through, and what later stages derive theirs from.

    The counts are the units of the table of rates (`engine.plan.estimate`). `sums` are evaluated kernels, `resident`
    are values that are held at a time, `outline` are pixels whose neighbor differs, `mid_nodes` those of quadratic
    tetrahedra.
    """

    pores: float = 0.0
    tunnels: float = 0.0
    cells: float = 0.0
    samples: float = 0.0
    sums: float = 0.0
    resident: float = 0.0
    triangles: float = 0.0
    copies: float = 0.0
    tetrahedra: float = 0.0
    nodes: float = 0.0
    mid_nodes: float = 0.0
    voxels: float = 0.0
    pixels: float = 0.0
    layers: float = 0.0
    outline: float = 0.0
    design: CellDesign | None = None
    geometry: Geometry | None = None
    result: Size | None = None
    """Size that later stages see where the counts are work alone, as in a search that makes many candidates."""

    def units(self) -> dict[str, float]:
        """The counts that are not zero."""
        found = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("design", "geometry", "result")}
        return {name: count for name, count in found.items() if count}

    @property
    def cell(self) -> CellDesign:
        """The design of a cell; `LookupError` if it is unknown."""
        if self.design is None:
            raise LookupError("the cell is unknown")
        return self.design

    @property
    def body(self) -> Geometry:
        """The geometry; `LookupError` if it is unknown."""
        if self.geometry is None:
            raise LookupError("the geometry is unknown")
        return self.geometry

    def at_porosity(self, porosity: float | None, **changes: Any) -> Size:
        """A field with a level that gives this porosity, if there is one; `changes` are other counts."""
        found = Size(design=self.design, geometry=self.body, **changes)
        if porosity is None or self.design is None:
            return found if porosity is None else replace(found, geometry=replace(self.body, porosity=porosity))
        from sppm_pipeline.services.boolean_model import expected_structure

        porosity, surface = expected_structure(self.design.pores, self.design.tunnels, *self.design.radii, porosity)
        return replace(found, geometry=replace(self.body, porosity=porosity, surface=surface))

    def in_box(
        self, box: tuple[float, ...], filled: float = math.inf, *, edge_mm: float | None = None, patches: float = 0.0
    ) -> Size:
        """The field in a box of cells, of which `filled` are there."""
        x, y, z = box
        filled = min(filled, x * y * z)
        made = replace(self.body, box=(x, y, z), volume=filled, envelope=2 * (x * y + y * z + z * x))
        made = replace(made, edge_mm=edge_mm or made.edge_mm, patches=patches or made.patches)
        return Size(cells=filled, design=self.design, geometry=made)

    def grid(self, resolution: float, *, at_once: float = math.inf, **changes: Any) -> Size:
        """The work of sampling a field on a grid, `at_once` samples at a time; `changes` are other counts."""
        samples = self.body.samples(resolution)
        return Size(
            samples=samples,
            sums=self.body.sums(samples, resolution),
            resident=min(samples, at_once),
            design=self.design,
            geometry=self.geometry,
            **changes,
        )


def sum_of(sizes: Sequence[Size]) -> Size:
    """All counts together, with the first design and the first geometry that is known."""
    counts: Any = Counter()
    for size in sizes:
        counts.update(size.units())
    design = next((size.design for size in sizes if size.design is not None), None)
    geometry = next((size.geometry for size in sizes if size.geometry is not None), None)
    return replace(Size(design=design, geometry=geometry), **counts)


RecipeSize = Callable[..., Size]
"""``recipe(palette, repeats)``: the size of what a recipe makes; its stages are counted `repeats` times."""

ONE = Palette()
"""The palette of a single cell."""
