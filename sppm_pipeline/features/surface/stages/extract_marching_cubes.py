"""``extract.marching_cubes``: a triangle mesh of a field."""

from __future__ import annotations

import mmap
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Length, Palette, Part, ScalarField, Size, SurfaceMesh, options
from sppm_pipeline.errors import ConfigError, DesignError, ResourceError
from sppm_pipeline.features.surface.field_surface import (
    KEPT_SAMPLES,
    MAX_VOXELS,
    MIN_VOXELS,
    FieldSurface,
    expected_voxels,
    on_torus,
    voxels_along_edge,
)
from sppm_pipeline.features.surface.mesh_stream import MeshStream, PieceWindow
from sppm_pipeline.features.surface.numerics.meshcheck.bodies import find_shells
from sppm_pipeline.method.connectivity.removal import removal_warning
from sppm_pipeline.method.nouns.mesh import PieceTaker
from sppm_pipeline.method.part.part import islands_for, node_grid
from sppm_pipeline.services.arrays import F32, F64, I32
from sppm_pipeline.services.mesh.measures import add_sums, edge_balance, nothing_found, read_only
from sppm_pipeline.stage import Context, Stage, option

_NO_RIMS = np.empty((0, 3))


class StreamedMeasures:
    """`box_and_volume` and `balanced_edges` of a mesh that comes in pieces, to the bit.

    Vertices come scaled and moved; points on rims are taken times the scale and moved by the origin here.
    """

    def __init__(self, scale: float, origin: F64) -> None:
        self._scale, self._origin = scale, origin
        self._start: F64 | None = None
        self._found, self._balance = nothing_found(), 0

    def add(self, both: F64, base: int, faces: I32, rims: F64 = _NO_RIMS) -> None:
        """Take the next piece: vertices (n, 3) behind those of the piece before, faces (m, 3), points on rims (k, 3).

        The first vertex has the number `base`; negative numbers -1 - p stand for rims[p].
        """
        if len(faces):
            if self._start is None:
                v = int(faces[0, 0])
                self._start = both[v - base].copy() if v >= 0 else rims[-1 - v] * self._scale + self._origin
            numbered = read_only(faces)
            given = read_only(both), base, numbered, read_only(rims), self._scale, self._origin
            add_sums(*given, self._start, self._found)
            # a sum of hashes of the edges with their directions, modulo the word it is kept in
            self._balance = (self._balance + int(edge_balance(numbered))) % 2**64

    @property
    def balanced(self) -> bool:
        """True if every edge runs as often in one direction as in the other; False without triangles."""
        return self._start is not None and self._balance == 0

    @property
    def box_and_volume(self) -> tuple[F64, F64, float]:
        """Low and high corner, (3,) each, and volume."""
        return self._found[3:6].copy(), self._found[6:].copy(), float(self._found[0] / 6.0)


_ROWS = 2**20  # of faces that are numbered at a time

Arrays = tuple[F64, I32]


class MeshStore:
    """Takes vertices and faces as they come; a mesh beyond `limit` bytes goes into nameless files in `folder`.

    The files vanish with it or with the process. Memory for the `expected` numbers of vertices and faces is reserved at
    once, which is filled in less time.
    """

    def __init__(self, limit: int, folder: Path, expected: tuple[int, int] = (0, 0)) -> None:
        self._limit = limit
        self._folder = folder
        fits = 24 * expected[0] + 12 * expected[1] <= limit
        self._vertices = np.empty((expected[0] if fits else 0, 3))
        self._faces = np.empty((expected[1] if fits else 0, 3), np.int32)
        self._files: tuple[IO[bytes], IO[bytes]] | None = None
        self._n = self._m = 0

    def add(self, vertices: F64, faces: I32) -> None:
        """Append vertices (n, 3) and faces (m, 3); of the latter, negative ones -1 - p stand for points on rims.

        ResourceError if the mesh has more vertices than 32 bits count, OSError if the disk is full.
        """
        n, m = self._n + len(vertices), self._m + len(faces)
        if n > np.iinfo(np.int32).max:
            raise ResourceError(
                f"the surface has more than {np.iinfo(np.int32).max} vertices",
                hint="sample the field more coarsely, or extract the part in pieces",
            )
        if self._files is None and 24 * n + 12 * m > self._limit:
            self._move_to_files()
        if self._files is not None:
            _write(self._files[0], vertices)
            _write(self._files[1], faces)
        else:
            # no other reference exists yet, whatever a debugger or a profiler counts
            if n > len(self._vertices):
                self._vertices.resize((n, 3), refcheck=False)
            if m > len(self._faces):
                self._faces.resize((m, 3), refcheck=False)
            self._vertices[self._n : n] = vertices
            self._faces[self._m : m] = faces
        self._n, self._m = n, m

    def finish(self, points: F64) -> Arrays:
        """The mesh, with the points on rims behind the other vertices; read-only if it is in files."""
        first = self._n
        self.add(points, np.empty((0, 3), np.int32))
        if self._files is None:
            self._vertices.resize((self._n, 3), refcheck=False)
            self._faces.resize((self._m, 3), refcheck=False)
            if len(points):
                from sppm_pipeline.features.surface.numerics.rim_points import number_points

                number_points(self._faces, first)
            return self._vertices, self._faces
        if len(points):
            self._number_in_file(first)
        vertices, faces = (_mapped(file) for file in self._files)
        return np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(faces, np.int32).reshape(-1, 3)

    def _move_to_files(self) -> None:
        self._files = tuple(  # type: ignore[assignment]
            tempfile.TemporaryFile(prefix="sppm-mesh-", dir=self._folder)  # noqa: SIM115 - gone with the mapping
            for _ in range(2)
        )
        assert self._files is not None
        _write(self._files[0], self._vertices[: self._n])
        _write(self._files[1], self._faces[: self._m])
        self._vertices, self._faces = np.empty((0, 3)), np.empty((0, 3), np.int32)

    def _number_in_file(self, first: int) -> None:
        from sppm_pipeline.features.surface.numerics.rim_points import number_points

        assert self._files is not None
        file = self._files[1]
        for row in range(0, self._m, _ROWS):
            file.seek(12 * row)
            faces = np.frombuffer(file.read(12 * min(_ROWS, self._m - row)), np.int32).reshape(-1, 3).copy()
            if (faces < 0).any():
                number_points(faces, first)
                file.seek(12 * row)
                _write(file, faces)


def _write(file: IO[bytes], rows: NDArray[Any]) -> None:
    if rows.size:
        file.write(np.ascontiguousarray(rows).reshape(-1).view(np.uint8).data)


def _mapped(file: IO[bytes]) -> mmap.mmap:
    file.flush()
    mapping = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    file.close()
    return mapping


MEMORY_SHARE = 4
"""A mesh larger than the memory limit over this number goes into temporary files, a heuristic: stages after it may hold
copies. At 2 these may exceed the limit, at 8 more meshes go by way of the disk, which is slower."""


@dataclass(frozen=True, kw_only=True)
class MarchingCubes(Stage):
    """Extract the boundary of the solid: closed, oriented outward, without degenerate triangles.

    Cells and tilings are capped at the border of their box; the nodes of the mesh on opposite faces of a periodic cell
    match one by one. The field is sampled slab by slab, so that the memory is that of the mesh. A tiling that is not
    cut to a part takes not even that with ``islands: remove`` if only `write.mesh` reads the mesh, as STL, PLY or OBJ:
    the file is written meanwhile, and the time of writing counts as that of this stage. With ``backend:
    reference`` scikit-image's independent implementation is used, slower and on all samples at once, for comparison.
    """

    name: ClassVar[str] = "extract.marching_cubes"
    advice: ClassVar[str] = "lower `resolution`, or slice without a mesh (`slice.field`)"
    version: ClassVar[int] = 4

    resolution: int | None = options.resolution(
        None, note="32 if `voxel` is not given either", minimum=MIN_VOXELS, maximum=MAX_VOXELS
    )
    voxel: Length | None = options.voxel(
        None, note="at most this long, instead of `resolution`; the cell is cut into equal parts", formerly="spacing"
    )
    caps: bool = option(
        True, help="close the surface at the border of a cell or tiling; without, it ends there in open boundaries"
    )
    islands: str = options.islands("auto", note="auto yields to that of a part")
    exact: bool = options.exact(False)
    backend: str = option("compiled", help="which implementation runs", choices=("compiled", "reference"))

    def check_options(self) -> None:
        if self.resolution is not None and self.voxel is not None:
            raise ConfigError("`resolution` and `voxel` exclude each other")
        if self.backend == "reference" and not self.caps:
            raise ConfigError("the reference implementation always closes the surface: leave out `caps: false`")

    def estimate(self, palette: Palette, field: Size) -> Size:
        n = expected_voxels(field.body.edge_mm, self.resolution, self.voxel)
        return field.grid(n, at_once=KEPT_SAMPLES, triangles=field.body.triangles(n))

    def run(self, context: Context, field: ScalarField) -> SurfaceMesh:
        """Sample the nodes of a grid and extract the surface, in mm (cell sizes for a cell without a size)."""
        n = voxels_along_edge(field, self.resolution, self.voxel)
        if (coarse := field.coarseness(1 / n)) is not None:
            context.warn(coarse)
        islands = islands_for(field, self.islands)
        surface = FieldSurface(field.exactly() if self.exact else field, node_grid(field, n), islands, self.caps)
        scale = field.edge_mm if field.edge_mm is not None else 1.0
        if self.backend == "reference":
            made = _by_reference(surface, context, scale, field.origin_mm)
        else:
            made = _compiled(surface, context, scale, field.origin_mm)
        context.report(resolution=n, voxel=scale / n, **made.findings)
        if warning := removal_warning(made.findings.get("removed_share", 0.0)):
            context.warn(warning)
        if not made.counts[1]:
            raise DesignError(
                "there is no surface to mesh: at this resolution the whole box is void, or solid without `caps`",
                hint="there is no solid if the porosity is too high or the level too low; lower the porosity",
            )
        if self.caps and not made.measures.balanced:
            raise ValueError("the mesh is not closed")
        if self.caps and islands != "keep" and not on_torus(field) and _in_memory(made, context):
            context.report(pieces=find_shells(*made.arrays).bodies)  # type: ignore[misc]
        if field.edge_mm is None:
            context.warn("the cell has no physical size: one cell size is written as 1 mm")
        if made.arrays is None:
            return SurfaceMesh.handed_on(*made.counts, "surface", made.measures.box_and_volume)
        return SurfaceMesh.measured(*made.arrays, "surface", made.measures.box_and_volume)


class _Extracted(NamedTuple):
    """A mesh, or what is known of one that was given away in pieces."""

    arrays: tuple[F64, I32] | None
    counts: tuple[int, int]
    measures: StreamedMeasures
    findings: dict[str, Any]


def _in_memory(made: _Extracted, context: Context) -> bool:
    """True of a mesh that is neither given away nor in files, where its vertices would be read in no order."""
    return made.arrays is not None and sum(array.nbytes for array in made.arrays) <= context.memory // MEMORY_SHARE


def _compiled(surface: FieldSurface, context: Context, scale: float, origin: tuple[float, float, float]) -> _Extracted:
    """The mesh in mm, given away piece by piece if those who read it take it so."""

    def stream() -> MeshStream:
        return surface.stream(context.threads, lambda done, of: context.progress(done, of, "planes"))

    pieces = stream()
    readers: Sequence[PieceTaker] = context.begin_readers()
    predicted = pieces.predicted() if readers else None
    if predicted is None or not predicted.faces:
        return _stored(pieces, context, scale, origin)
    try:
        if all(reader.begin(predicted.moved(scale, np.array(origin))) for reader in readers):
            if (given := _handed_on(pieces, readers, scale, origin)) is not None:
                return given
            pieces = stream()
    except BaseException:
        for reader in readers:
            reader.drop()
        raise
    for reader in readers:
        reader.drop()
    return _stored(pieces, context, scale, origin)


def _handed_on(
    pieces: MeshStream, readers: Sequence[PieceTaker], scale: float, origin: tuple[float, float, float]
) -> _Extracted | None:
    """Give away all pieces; None if a reader finds that the mesh is not as predicted."""
    measures, window = StreamedMeasures(scale, np.array(origin)), PieceWindow(scale, np.array(origin))
    faces = 0
    for piece in pieces:
        points = window.push(piece.vertices)
        measures.add(points, window.base, piece.faces)
        for reader in readers:
            reader.add(points, window.base, window.known, piece.faces)
        faces += len(piece.faces)
    if not all(reader.finish() for reader in readers):
        return None
    return _Extracted(None, (window.base + len(points), faces), measures, pieces.findings)


def _stored(stream: MeshStream, context: Context, scale: float, origin: tuple[float, float, float]) -> _Extracted:
    """The whole mesh; one that takes more than a share of the memory lies in files."""
    measures, window = StreamedMeasures(scale, np.array(origin)), PieceWindow(scale, np.array(origin))
    store: MeshStore | None = None
    for piece in stream:
        if store is None:  # what to expect is known once the first piece is there
            store = MeshStore(context.memory // MEMORY_SHARE, context.scratch(), stream.expected)
        both = window.push(piece.vertices)
        measures.add(both, window.base, piece.faces, stream.points)
        store.add(both[window.known :], piece.faces)
    nothing = np.empty((0, 3)), np.empty((0, 3), np.int32)
    arrays = nothing if store is None else store.finish(stream.points * scale + np.array(origin))
    return _Extracted(arrays, (len(arrays[0]), len(arrays[1])), measures, stream.findings)


def _by_reference(
    surface: FieldSurface, context: Context, scale: float, origin: tuple[float, float, float]
) -> _Extracted:
    from sppm_pipeline.features.surface.numerics.placing import Samples, place_vertices
    from sppm_pipeline.method.part.crossings import Crossings

    (x, y, z), (h, _, _), _ = grid = surface.grid
    sampled = surface.slabs(context.threads)
    slabs = list(sampled)
    values = np.concatenate([slab.values for slab in slabs])
    padded = np.pad(values, 1, constant_values=1.0)
    vertices, faces = marching_cubes_reference(padded, 0.0, (x - h, y - h, z - h), (h, h, h))
    nothing = np.empty((0, 0, 0), np.float32)
    samples = Samples(grid, 0, values, nothing, nothing)
    if isinstance(surface.source, Part):
        fields = zip(*(slab.apart for slab in slabs if slab.apart is not None), strict=True)
        field, domain, skin = (*(np.concatenate(planes) for planes in fields), nothing)[:3]
        found = [slab.crossings for slab in slabs]
        edge, share, triangle = (np.concatenate([c[a] for c in found]) for a in range(3))
        samples = Samples(grid, 0, field, domain, skin, Crossings(edge, share, triangle, found[0].normals))
    place_vertices(vertices, samples)
    vertices *= scale
    vertices += np.array(origin)
    measures = StreamedMeasures(scale, np.array(origin))
    measures.add(vertices, 0, faces)
    return _Extracted((vertices, faces), (len(vertices), len(faces)), measures, sampled.findings)


def marching_cubes_reference(
    field: F32,
    level: float = 0.0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> tuple[F64, I32]:
    """Isosurface of (nz, ny, nx) samples by scikit-image: vertices (n, 3), faces (m, 3), wound outwards.

    After Lewiner et al. (2003), independent of this program's own. Ambiguous faces are decided by the trilinear
    interpolant instead. Samples equal to the level are raised to the next float32 above, where scikit-image would open
    edges. ResourceError if scikit-image is not installed.
    """
    try:
        from skimage.measure import marching_cubes
    except ImportError as error:
        raise ResourceError(
            "the reference extractor needs scikit-image", hint='pip install "sppm-pipeline[reference]"'
        ) from error
    samples = np.ascontiguousarray(field, np.float32)
    level32 = np.float32(level)
    if not samples.min() < level32 <= samples.max():
        return np.empty((0, 3)), np.empty((0, 3), np.int32)  # scikit-image refuses a field without surface
    samples = np.where(samples == level32, np.nextafter(level32, np.float32(np.inf)), samples)
    vertices, faces, _, _ = marching_cubes(  # type: ignore[no-untyped-call]
        samples, float(level32), gradient_direction="ascent", allow_degenerate=True
    )
    # In z, y, x taken as a right-handed frame these faces look into the solid; taken as x, y, z they are mirrored.
    positions = np.asarray(origin) + vertices[:, ::-1].astype(np.float64) * np.asarray(spacing)
    return positions, np.ascontiguousarray(faces, np.int32)
