"""The surface of a field, sampled and marched through slab by slab."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.surface.mesh_stream import MeshPiece, MeshStream, RimPoints, count_mesh
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.mesh import ExpectedSize
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.arrays import F32, F64, I32, I64, U8
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.threads import computed_ahead

if TYPE_CHECKING:
    from sppm_pipeline.method.part.crossings import Crossings

SLAB_SAMPLES = 2**20
"""Samples taken at a time; a slab holds at least two planes."""

KEPT_SAMPLES = 2**25
"""Grids up to this many samples are kept between the pass that finds islands and the one that marches."""

MIN_VOXELS, MAX_VOXELS = 4, 2048
"""Voxels along a cell edge."""

PLANES_BACK = 4
"""Planes of samples that are kept when a slab is done."""

PIECE_SAMPLES = 2**16
"""Samples marched through at a time; what is known of the vertices of some pieces is kept, and stays in the cache."""

Mesh = tuple[F64, I32]
Item = TypeVar("Item")


def voxels_along_edge(field: ScalarField, resolution: int | None, voxel: Length | None) -> int:
    """Voxels along an edge of the cell: as given, or as many as keep them within `voxel`; 32 if neither is given.

    DesignError if `voxel` is given for a cell without a physical size, or leads to fewer or more voxels than are
    allowed.
    """
    if voxel is None:
        return resolution or 32
    # an edge that is a whole number of voxels up to rounding gets that number
    n = math.ceil(field.physical_edge() / voxel.mm() - 1e-9)
    if not MIN_VOXELS <= n <= MAX_VOXELS:
        raise DesignError(
            f"voxels of {voxel} make {n} along an edge of the cell, {field.edge_mm:g} mm; "
            f"allowed are {MIN_VOXELS} to {MAX_VOXELS}",
            hint="choose another `voxel`, or give `resolution` instead",
        )
    return n


def expected_voxels(edge_mm: float | None, resolution: int | None, voxel: Length | None) -> int:
    """Result of `voxels_along_edge` for a field with this cell size."""
    if voxel is None or not edge_mm:
        return resolution or 32
    return math.ceil(edge_mm / voxel.mm() - 1e-9)


def on_torus(field: ScalarField) -> bool:
    """Test whether a field is a single periodic cell, which continues across opposite faces."""
    return field.periodic and field.cells == (1, 1, 1) and not isinstance(field, Part)


class SampledSlab(NamedTuple):
    """Consecutive planes of samples."""

    start: int  # number of the first plane
    values: F32  # (planes, ny, nx), negative in the solid
    # of a part: the fields of the microstructure, of the domain, and of the skin if there is one
    apart: tuple[F32, ...] | None
    crossings: Crossings  # of a part's domain with edges that begin in these planes


class _FlatPiece(NamedTuple):
    """A piece whose vertices are not yet moved, and the surroundings of its rims."""

    piece: MeshPiece
    points: F64  # (k, 3), those on rims of this piece and all before
    losers: I32  # (k,), vertices beside rims with volumes that are lost there
    lost: F64  # (k,), these volumes, voxels


@dataclass(frozen=True)
class SampledSlabs:
    """All samples of a grid, to be read once."""

    slabs: Iterator[SampledSlab]
    findings: dict[str, Any] = field(default_factory=dict)  # what was removed
    expected: tuple[int, int] = (0, 0)  # about how many vertices and triangles; zeros if that is not known
    # predicts counts and box of the mesh; None if they cannot be known
    predict: Callable[[], ExpectedSize] | None = None

    def __iter__(self) -> Iterator[SampledSlab]:
        return self.slabs


@dataclass(frozen=True, eq=False)
class FieldSurface:
    """The boundary of the solid of a field; memory is that of a slab, and of up to `KEPT_SAMPLES` samples.

    With `islands` to be removed, solid that is not connected, across faces of voxels around the nodes, to the largest
    component is left out; on the grid of a single periodic cell components are found on the torus, so that opposite
    faces stay equal. `caps` close the surface where the solid meets the border of the grid. A part that is `cut` ends
    at the surface of its domain. Otherwise it ends at least a voxel outside of it, without regard to shape, and is
    there to be cut by the mesh of the domain; `islands` are then to be kept.
    """

    source: ScalarField
    grid: Grid  # nodes, cell sizes
    islands: str = "auto"  # auto, remove or keep
    caps: bool = True
    cut: bool = True

    @property
    def _cut_part(self) -> Part | None:
        """The part that is cut at the surface of its domain; a border of its own makes it a field like others."""
        return self.source if isinstance(self.source, Part) and self.source.border is None else None

    def mesh(
        self, threads: int = 1, progress: Callable[[float, float], None] | None = None
    ) -> tuple[F64, I32, dict[str, Any]]:
        """Vertices (n, 3) float64 in cell sizes, faces (m, 3) int32, and what was removed; same for all `threads`."""
        return self.mesh_with_kinds(threads, progress)[:3]

    def mesh_with_kinds(
        self, threads: int = 1, progress: Callable[[float, float], None] | None = None
    ) -> tuple[F64, I32, dict[str, Any], U8]:
        """`mesh`, and of a part what each face lies on, (m,) uint8: FIELD, DOMAIN or SKIN; else without elements."""
        from sppm_pipeline.services.mesh.marching_cubes import joined_mesh

        stream = self.stream(threads, progress)
        kinds = [np.empty(0, np.uint8)]

        def meshes() -> Iterator[Mesh]:
            for piece in stream:
                kinds.append(piece.kinds)
                yield piece.vertices, piece.faces

        vertices, faces = joined_mesh(meshes(), lambda: stream.expected)
        if len(stream.points):
            from sppm_pipeline.features.surface.numerics.rim_points import number_points

            number_points(faces, len(vertices))
            count = len(vertices)
            vertices.resize((count + len(stream.points), 3), refcheck=False)
            vertices[count:] = stream.points
        return vertices, faces, stream.findings, np.concatenate(kinds)

    def stream(self, threads: int = 1, progress: Callable[[float, float], None] | None = None) -> MeshStream:
        """The mesh in pieces; memory is that of some slabs, and of the points on rims.

        With more than one thread, triangles are made of a piece, vertices of the pieces before are moved, and the
        consumer works on those that are done, all at the same time.
        """
        slabs, rims = self.slabs(max(1, threads - 2)), RimPoints()  # the others are at work on what is sampled
        flat = computed_ahead(self._flat_pieces(slabs, rims, progress), threads)
        return MeshStream(computed_ahead(self._bulged_pieces(flat, rims, threads > 1), threads), rims, slabs)

    def _bulged_pieces(self, flat: Iterator[_FlatPiece], rims: RimPoints, ahead: bool) -> Iterator[MeshPiece]:
        """The mesh piece by piece; vertices and faces follow upon those of the pieces before."""
        from sppm_pipeline.features.surface.numerics.bulging import Bulging

        bulging = Bulging(self.grid)
        waiting: deque[MeshPiece] = deque()  # a face comes when its vertices are there

        def moved(vertices: Iterator[F64]) -> Iterator[MeshPiece]:
            for done in vertices:  # which goes when the next one comes
                if waiting:
                    yield waiting.popleft()._replace(vertices=done.copy() if ahead else done)

        for piece, points, losers, lost in flat:
            if len(piece.vertices) or len(piece.faces):
                waiting.append(piece)
                yield from moved(bulging.push(*piece, points, losers, lost))
        yield from moved(bulging.finish(rims.points))

    def _flat_pieces(
        self, slabs: SampledSlabs, rims: RimPoints, progress: Callable[[float, float], None] | None
    ) -> Iterator[_FlatPiece]:
        """The pieces with their vertices on the surface."""
        from sppm_pipeline.features.surface.numerics.placing import Placed, Samples, place_vertices
        from sppm_pipeline.features.surface.numerics.rims import split_rims
        from sppm_pipeline.method.part.crossings import NO_CROSSINGS
        from sppm_pipeline.services.mesh.closing import capped_marching_cubes_slabs
        from sppm_pipeline.services.mesh.marching_cubes import marching_cubes_slabs

        origin, spacing, (nx, ny, nz) = self.grid
        part = self._cut_part
        nothing = np.empty((0, 0, 0), np.float32)
        planes: list[tuple[F32, ...]] = []
        crossings = NO_CROSSINGS
        start = 0

        def values() -> Iterator[F32]:
            # a piece ends a plane before its planes do, and what is done to it looks two planes back
            nonlocal start, crossings
            for sampled in _with_progress(slabs, nz, progress):
                slab = self._smooth(sampled)
                fields = (slab.values,) if slab.apart is None else slab.apart
                back = tuple(field[-PLANES_BACK:] for field in planes[0]) if planes else tuple(f[:0] for f in fields)
                fields = tuple(np.concatenate(pair) for pair in zip(back, fields, strict=True))
                start = slab.start - len(back[0])
                crossings = _from_plane(crossings, start, self.grid, slab.crossings)
                step = max(1, PIECE_SAMPLES // (nx * ny))
                for first in range(0, len(slab.values), step):
                    piece = slab.values[first : first + step]
                    planes[:] = [tuple(field[: len(back[0]) + first + len(piece)] for field in fields)]
                    yield piece

        def held_back() -> Iterator[F32]:
            # as for caps, the last plane waits for the slab that follows
            held = np.empty((0, ny, nx), np.float32)
            for slab in values():
                whole = np.concatenate([held, slab])
                held = whole[-1:].copy()
                if len(whole) > 1:
                    yield whole[:-1]
            yield held

        before: Placed | None = None
        first = 0
        caps = self.caps and part is None
        no_kinds, no_vertices, no_volumes = np.empty(0, np.uint8), np.empty(0, np.int32), np.empty(0)
        extract, waiting = (capped_marching_cubes_slabs, values()) if caps else (marching_cubes_slabs, held_back())
        for vertices, faces in extract(waiting, 0.0, origin, spacing):
            field, domain, skin = (*planes[0], nothing, nothing)[:3]
            samples = Samples(self.grid, start, field, domain, skin, crossings)
            placed = place_vertices(vertices, samples)
            if part is None or not self.cut:
                yield _FlatPiece(MeshPiece(vertices, faces, no_kinds), rims.points, no_vertices, no_volumes)
                continue
            # faces of this piece have corners in the piece before
            joined = placed
            if before is not None:
                joined = Placed(
                    np.concatenate([before.vertices, placed.vertices]), np.concatenate([before.edge, placed.edge]),
                    np.concatenate([before.on, placed.on]), np.concatenate([before.triangle, placed.triangle]),
                )  # fmt: skip
            split = split_rims(faces, first, joined, samples)
            piece = MeshPiece(vertices, rims.numbered(split), split.on)
            yield _FlatPiece(piece, rims.points, split.losers, split.lost)
            if len(vertices):
                first += len(joined.vertices) - len(vertices)
                before = placed

    def slabs(self, threads: int = 1) -> SampledSlabs:
        """The samples, without islands if they are to be removed, which takes a pass of its own."""
        if self.islands == "keep":
            return SampledSlabs(computed_ahead(self._sampled(threads), threads))
        from sppm_pipeline.method.connectivity.components import components_of_runs
        from sppm_pipeline.method.connectivity.islands import negate_runs
        from sppm_pipeline.method.connectivity.removal import check_removal
        from sppm_pipeline.method.connectivity.runs import find_runs, stack_runs

        # on the torus the last node of an axis is the first one
        torus = on_torus(self.source)
        nx, ny, nz = (n - torus for n in self.grid.shape)
        # a part is sampled as up to three fields, which are kept apart
        keep = nx * ny * nz * (3 if isinstance(self.source, Part) else 1) <= KEPT_SAMPLES
        kept: deque[SampledSlab] = deque()
        runs = []
        for slab in computed_ahead(self._sampled(threads), threads):
            if slab.start < nz:
                solid = slab.values[: nz - slab.start, :ny, :nx] < 0
                runs.append(find_runs(np.ascontiguousarray(solid).view(np.uint8)))
            if keep:
                kept.append(slab)
        found = components_of_runs(stack_runs(runs), (torus,) * 3)
        total, largest = int(found.sizes.sum()), int(found.sizes[:1].sum())
        removed = (total - largest) / max(1, total)
        check_removal(removed, self.islands, finer="finer voxels")
        # the two ends of a run are vertices, and the surface crosses the edges of the other two directions as often;
        # reserved memory costs nothing until it is used
        vertices = int(1.05 * 6 * found.runs.n_runs)
        stays, solid_runs = found.of_run == 0, found.runs
        rows, bounds = solid_runs.rows, solid_runs.bounds
        del found

        def predict() -> ExpectedSize:
            return self._predicted(*count_mesh(solid_runs, stays, self.caps, threads))

        def cleaned() -> Iterator[SampledSlab]:
            for slab in _emptied(kept) if keep else computed_ahead(self._sampled(threads), threads):
                if largest < total:
                    negate_runs(rows, bounds, stays, (nz, ny, nx), slab.start, slab.values)
                yield slab

        # the rims of a part have more points, and on the torus solid at the border is counted once
        certain = None if torus or isinstance(self.source, Part) else predict
        return SampledSlabs(cleaned(), {"removed_share": removed}, (vertices, 2 * vertices), certain)

    def _predicted(self, vertices: int, faces: int, low: I64, high: I64) -> ExpectedSize:
        """Of a mesh whose solid nodes lie in this box: it ends within a voxel, or where it is capped."""
        origin, spacing, last = np.array(self.grid.origin), np.array(self.grid.spacing), np.array(self.grid.shape) - 1
        least = origin + np.array([low, high]) * spacing
        beyond = np.array([low - 1, high + 1])
        if self.caps:
            beyond = np.clip(beyond, 0, last)
        return ExpectedSize(vertices, faces, least, origin + beyond * spacing)

    def _sampled(self, threads: int) -> Iterator[SampledSlab]:
        nx, ny, nz = self.grid.shape
        step = max(2, SLAB_SAMPLES // (nx * ny))
        for start in range(0, nz, step):
            yield self._planes(start, min(start + step, nz), threads)

    def _planes(self, start: int, stop: int, threads: int) -> SampledSlab:
        from sppm_pipeline.method.part.crossings import NO_CROSSINGS

        part = self._cut_part
        if part is None:
            values = self.source.sample_zyx(self.grid, start, stop, threads)
            # they are changed on the way; sums of kernels are new arrays, those of other fields may be kept by them
            values = values if self.source.sum_level is not None else values.copy()
            return SampledSlab(start, values, None, NO_CROSSINGS)
        if self.cut:
            inner, skin, outer, crossings = part.cut_zyx(self.grid, threads, start, stop)
        else:
            inner, skin, outer = part.fields_zyx(self.grid, threads, start, stop)
            crossings = NO_CROSSINGS
            # All nodes a voxel or more outside are void, by so little that the surface lies at them: a point of the
            # domain is nearer than that to some corner of its cube of nodes, so the surface never passes through the
            # domain.
            outside = outer >= (1 - 1e-4) * self.grid.spacing[0]
            outer = np.where(outside, np.float32(1e-30), np.float32(-1e30))
        united = inner if skin is None else np.minimum(inner, skin)
        fields = (inner, outer) if skin is None else (inner, outer, skin)
        return SampledSlab(start, np.maximum(united, outer), fields, crossings)

    def _smooth(self, slab: SampledSlab) -> SampledSlab:
        """Logarithms in place of sums of kernels, as less happens between their samples; in place."""
        from sppm_pipeline.method.kernels.profiles import log_of_sums

        level = self.source.inner_level if isinstance(self.source, Part) else self.source.sum_level
        if level is not None:
            log_of_sums(slab.values if slab.apart is None else slab.apart[0], level)
        return slab

    def expected_triangles(self, threads: int = 1, layers: int = 24) -> int:
        """About how many triangles the surface will have, from some layers of cubes spread over the grid."""
        from sppm_pipeline.services.mesh.sign_words import pack_signs, slab_counts

        nx, ny, nz = self.grid.shape
        looked = sorted({round((i + 0.5) * (nz - 1) / layers - 0.5) for i in range(layers)})
        vertices = 0
        for start in looked:
            values = self._planes(start, start + 2, threads).values
            words = np.empty((2, ny, -(-nx // 64)), np.uint64)
            pack_signs(values, np.float32(0), words)
            vertices += slab_counts(words, nx, False)[0]
        return int(2 * vertices * (nz - 1) / len(looked))  # a closed surface has two triangles for each vertex


def _emptied(items: deque[Item]) -> Iterator[Item]:
    while items:
        yield items.popleft()


def _from_plane(old: Crossings, start: int, grid: Grid, new: Crossings) -> Crossings:
    """The crossings of edges that begin at plane `start` or above, and those of the planes that follow."""
    first = int(np.searchsorted(old.edge, 3 * start * grid.shape[0] * grid.shape[1]))
    edge, share = np.concatenate([old.edge[first:], new.edge]), np.concatenate([old.share[first:], new.share])
    return new._replace(edge=edge, share=share, triangle=np.concatenate([old.triangle[first:], new.triangle]))


def _with_progress(
    slabs: Iterable[SampledSlab], planes: int, progress: Callable[[float, float], None] | None
) -> Iterator[SampledSlab]:
    for slab in slabs:
        yield slab
        if progress is not None:
            progress(slab.start + len(slab.values), planes)
