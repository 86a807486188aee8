"""``field.voronoi_foam``: open and closed foams along the edges and faces of Voronoi cells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import (
    ConfigError,
    Context,
    InputError,
    Length,
    Palette,
    PoreSet,
    ScalarField,
    Size,
    SurfaceMesh,
    frozen,
    option,
)
from sppm_pipeline.nouns import CellIndex, CellwiseField, PartFieldMaker
from sppm_structures.seeds import MAX_SEEDS, HashedSeeds, blue_noise, images_near
from sppm_structures.sizes import field_size, near_struts, of_struts

MAX_SHARED = np.sqrt(3.0) / 2
"""No point of a periodic cell is further than this from a seed, cell sizes."""


@dataclass(frozen=True, eq=False, kw_only=True)
class VoronoiFoam(CellwiseField):
    """Distance from the surface of an "open" or "closed" foam.

    Seeds are drawn by their place (`hashed`), or those of the periodic cell (`given`, (n, 3)). In cell sizes: `half`,
    the radius of the struts or half the thickness of the walls, and `blend`, over which joints of struts are rounded.
    """

    form: str
    hashed: HashedSeeds | None
    given: NDArray[np.float64]
    half: float
    blend: float = 0.0

    @property
    def furthest(self) -> float:
        """No point is further than this from the nearest seed, cell sizes."""
        return min(self.hashed.furthest, MAX_SHARED if self.periodic else np.inf) if self.hashed else MAX_SHARED

    def seeds_near(self, cell: CellIndex, margin: float) -> tuple[NDArray[np.float64], int]:
        """Seeds in a cell, first, and those nearer to it than `margin`; relative to its low corner."""
        if self.hashed is not None:
            return self.hashed.near(cell, margin, self.periodic)
        return images_near(self.given, margin)

    def edges_of(self, cell: CellIndex) -> NDArray[np.float64]:
        """Voronoi edges of a cell's seeds, (m, 6), relative to its low corner; each edge belongs to one cell."""
        from sppm_structures.voronoi_kernels import voronoi_edges

        most = 2 * self.furthest
        seeds, own = self.seeds_near(cell, most)
        return voronoi_edges(seeds, own, min(most, 2.0 * max(own, 1) ** (-1 / 3)), most)

    def prepare(self, cell: CellIndex) -> Any:
        from sppm_structures.strut_kernels import REACH, table_of_struts
        from sppm_structures.voronoi_kernels import wall_table

        if self.form == "closed":
            # a wall is nearer than the furthest seed, and who bounds it nearer than three times as much
            return wall_table(self.seeds_near(cell, 3 * self.furthest + 0.25)[0])
        # a point p is a mean of the corners v of its Voronoi cell, with seed s, and the same mean of |v - p|^2 is that
        # of |v - s|^2 less |p - s|^2; so one of them, where edges end, is nearer than the furthest corner of all cells
        margin = self.furthest + REACH * self.blend
        ring = range(-int(np.ceil(margin)), int(np.ceil(margin)) + 1)
        parts = []
        for shift in product(ring, repeat=3):
            other = (0, 0, 0) if self.periodic else (cell[0] + shift[0], cell[1] + shift[1], cell[2] + shift[2])
            edges = self.kept.get(("edges", other), partial(self.edges_of, other)) + np.tile(shift, 2)
            low, high = np.minimum(edges[:, :3], edges[:, 3:]), np.maximum(edges[:, :3], edges[:, 3:])
            parts.append(edges[((low <= 1 + margin) & (high >= -margin)).all(axis=1)])
        struts = np.concatenate(parts)
        return table_of_struts(np.column_stack([struts, np.zeros((len(struts), 2))]), self.blend)

    def evaluate(
        self, prepared: Any, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        from sppm_structures.strut_kernels import evaluate_struts
        from sppm_structures.voronoi_kernels import evaluate_walls

        closed = self.form == "closed"
        values = evaluate_walls(prepared, x, y, z) if closed else evaluate_struts(prepared, self.blend, x, y, z)
        values -= np.float32(self.half)
        return values

    def cut_at(self, value: float) -> VoronoiFoam:
        return replace(self, half=self.half + value)

    def summary(self) -> dict[str, Any]:
        """Form, number of Voronoi cells and what tuning changes."""
        name, size = ("thickness", 2 * self.half) if self.form == "closed" else ("radius", self.half)
        summary: dict[str, Any] = {"form": self.form, name: size}
        if self.edge is not None:
            summary[f"{name}_mm"] = size * self.edge
        if self.periodic:
            summary["seeds"] = self.seeds_near((0, 0, 0), 0.0)[1]
        else:
            summary["cells"] = list(self.cells)
        return summary


@dataclass(frozen=True, kw_only=True)
class Voronoi(PartFieldMaker):
    """A foam of Voronoi cells: round struts along their edges, or walls at their faces.

    Evaluated where it is sampled, after Martinez, Dumas and Lefebvre 2016, "Procedural Voronoi foams for additive
    manufacturing": one seed is drawn in each of `seeds`^3 places of a cell by a hash of the place, so that a part of
    any size takes no memory and no time beyond that of its samples. With ``layout: part`` nothing repeats.

    Both distances are exact. A wall is a bisector plane, at ``(|p-b|^2 - |p-a|^2) / (2 |b-a|)``. Struts follow the
    edges of the Voronoi diagram, which are found for the seeds of one cell at a time. ``tune.porosity`` changes the
    radius, or the thickness. The pores of a closed foam are closed: resin and powder stay inside.
    """

    name: ClassVar[str] = "field.voronoi_foam"
    is_random: ClassVar[bool] = True

    form: str = option(
        "open", help="form of the solid; struts along the edges, or walls at the faces", choices=("open", "closed")
    )
    radius: Length | None = option(None, help="radius of the struts; 0.03 if omitted", unit="cell size", above=0)
    thickness: Length | None = option(None, help="thickness of the walls; 0.03 if omitted", unit="cell size", above=0)
    blend: Length = option(Length(0.01), help="length over which joints are rounded", unit="cell size", minimum=0)
    seeds: int = option(4, help="seeds along an edge of the cell, if no pores are given", minimum=1, maximum=16)
    seeding: str = option(
        "jittered",
        help="seeds drawn each in a place of its own, or by dart throwing",
        choices=("jittered", "darts"),
        formerly="pattern",
    )
    jitter: float = option(
        0.8, help="random displacement of the points; as a fraction of a seed's place", minimum=0, maximum=1
    )
    fine: float = option(
        0.0, help="share of the places that are cut into eight, each with a seed", minimum=0, maximum=1
    )
    layout: str = option(
        "cell", help="one cell that repeats, or all cells of a part, none like another", choices=("cell", "part")
    )

    def check_options(self) -> None:
        if self.form == "open" and self.thickness is not None:
            raise ConfigError("the struts of an open foam have a `radius`, no thickness")
        if self.form == "closed" and self.radius is not None:
            raise ConfigError("the walls of a closed foam have a `thickness`, no radius")
        if self.cells is not None and self.layout == "cell":
            raise ConfigError("`cells` are laid with `layout: part`", hint="or repeat one cell with `tile.periodic`")
        if self.seeding == "darts" and self.layout == "part":
            raise ConfigError("darts are thrown into a cell that repeats; seeds of a whole part are `jittered`")
        if self.seeding == "darts" and self.fine:
            raise ConfigError("`fine` cuts the places of jittered seeds")

    def estimate(self, palette: Palette, pores: Size | None, cover: Size | None) -> Size:
        edge = self.edge_mm
        if edge is None and pores is not None:
            edge = pores.cell.edge_mm
        # where places are cut into eight, each has a seed
        seeds = self.seeds**3 * (1 + 7 * self.fine) if pores is None else pores.cell.pores
        if self.form == "closed":
            # random Voronoi cells have faces of 2.91 n^(1/3) (Okabe et al., "Spatial Tessellations", ch. 5)
            thickness, area = self.in_cells(self.thickness or Length(0.03), edge), 2.91 * seeds ** (1 / 3)
            void = np.exp(-thickness * area)
            solid, surface, work = 1 - void, 2 * area * void, 145.0
            drawn, kept = seeds / 6, 34.0
        else:
            # and edges of 5.83 n^(2/3), of which joints hide a quarter; nanoseconds of a sample as measured
            length, radius = 5.83 * seeds ** (2 / 3), self.in_cells(self.radius or Length(0.03), edge)
            solid, surface = of_struts(length, radius)
            surface *= 0.75
            work = 100 + 170 * near_struts(length, radius + 4 * self.in_cells(self.blend, edge))
            # tables of cells with 27 to 216 seeds take 0.9 to 3.4 MB
            drawn, kept = seeds, 35 + seeds
        cells = self.cells if self.layout == "part" else None
        cover = cover if self.layout == "part" else None
        return field_size(edge, float(solid), float(surface), work, cells, cover, drawn, kept)

    def run(self, context: Context, pores: PoreSet | None, cover: SurfaceMesh | None) -> ScalarField:
        """Choose the seeds; the field is evaluated where it is sampled."""
        edge = self.edge_mm
        if edge is None and pores is not None and pores.cell.physical:
            edge = pores.cell.edge
        region, origin = self.region(cover, edge) if self.layout == "part" else (None, (0.0, 0.0, 0.0))
        size = self.radius if self.form == "open" else self.thickness
        half = self.in_cells(size or Length(0.03), edge) / (1 if self.form == "open" else 2)
        blend = self.in_cells(self.blend, edge) if self.form == "open" else 0.0
        if not (half < 0.5 and blend < 0.1):
            raise ConfigError(
                f"half thickness {half:g} must be less than 0.5, blend {blend:g} less than 0.1 cell sizes"
            )
        given, hashed = np.empty((0, 3)), None
        if pores is not None:
            if region is not None:
                raise ConfigError("seeds that are given fill one cell", hint="leave out `layout: part`, or the pores")
            given = _seeds_of(pores)
        elif self.seeding == "darts":
            given = blue_noise(context.rng(), self.seeds**3)
        else:
            hashed = HashedSeeds(int(context.rng().integers(2**62)), self.seeds, self.jitter, self.fine)
        return VoronoiFoam(
            form=self.form,
            hashed=hashed,
            given=frozen(given),
            half=half,
            blend=blend,
            edge=edge,
            region=region,
            origin=origin,
        )


def _seeds_of(pores: PoreSet) -> NDArray[np.float64]:
    """The pores of a single cell, folded into it, each once."""
    if pores.interiors > 1 or max(pores.colors) > 1:
        raise InputError("a foam needs the pores of one cell, not of a tile set")
    centers = pores.centers - np.floor(pores.centers)
    centers[centers >= 1.0] = 0.0
    _, first = np.unique(np.round(centers * 1e7) % 10**7, axis=0, return_index=True)
    centers = frozen(centers[np.sort(first)])
    if not 1 <= len(centers) <= MAX_SEEDS:
        raise InputError(f"a foam needs 1 to {MAX_SEEDS} different pores, got {len(centers)}")
    return centers
