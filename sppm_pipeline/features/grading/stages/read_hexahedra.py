"""``read.hexahedra``: the surface of a mesh of hexahedra, as the part that its cells fill."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from sppm_pipeline import Context, Palette, Size, Stage, SurfaceMesh, option, options
from sppm_pipeline.errors import InputError
from sppm_pipeline.features.grading.curved_cells import HexahedralCells
from sppm_pipeline.features.grading.hexahedra_file import Hexahedra, read_hexahedra
from sppm_pipeline.features.grading.numerics.hexahedral_mesh import boundary_triangles, checked_mesh, split
from sppm_pipeline.nouns.length import UNITS_IN_MM
from sppm_pipeline.nouns.size import Geometry
from sppm_pipeline.services.formats.element_file import check_elements

if TYPE_CHECKING:
    from sppm_pipeline.features.grading.numerics.hexahedral_mesh import HexahedralMesh


def mesh_of(read: Hexahedra, path: Path, unit: str, context: Context | None = None) -> HexahedralMesh:
    """The mesh of what was read, mm, checked (`InputError` names an element); a warning names an odd order of nodes."""
    try:
        mesh = checked_mesh(read.points * UNITS_IN_MM[unit], read.elements)
    except ValueError as error:
        raise InputError(
            f"{path.name}: {error}",
            hint="export a mesh of straight hexahedra that meet face to face, none of them flat or turned inside out",
        ) from None
    if context is not None:
        warn_of_order(mesh, path, context)
    return mesh


def warn_of_order(mesh: HexahedralMesh, path: Path, context: Context) -> None:
    """Warn of nodes in another order than expected."""
    if mesh.turned:
        context.warn(f"the nodes of hexahedra in {path.name} are numbered {mesh.turned}, and are taken so")


MAX_BYTES = 64 * 2**20
"""Larger files are not read for an estimate; 100 000 quadratic elements as text take about as much."""


class MeshSize(NamedTuple):
    """Size of a mesh for an estimate: elements, boundary faces, box, volume, area, edges of cubes as large as the
    smallest, mean and largest element; lengths in mm.
    """

    hexahedra: int
    faces: int
    box: tuple[float, float, float]
    volume: float
    area: float
    cell: tuple[float, float, float]


def size_of_mesh(path: Path, unit: str) -> MeshSize:
    """The size of the mesh in a file, which is read once as long as it does not change.

    `LookupError` if the file is too large for that; `InputError` or `OSError` if it is no mesh of hexahedra, or is not
    there.
    """
    there = path.stat()
    if there.st_size > MAX_BYTES:
        raise LookupError("the mesh is too large to be read for an estimate")
    # size and time are keys of the cache: a file that was written again is read again
    return _size_of(path, unit, there.st_size, there.st_mtime_ns)


@functools.lru_cache(maxsize=8)
def _size_of(path: Path, unit: str, size: int, changed: int) -> MeshSize:
    mesh = mesh_of(read_hexahedra(path), path, unit)
    volumes = HexahedralCells(mesh.corners).volumes
    edges = np.cbrt(volumes)
    x, y, z = np.ptp(mesh.corners.reshape(-1, 3), axis=0).tolist()
    quads = mesh.nodes[mesh.boundary]
    # half of the cross product of the diagonals: exact for plane faces
    area = np.linalg.norm(np.cross(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]), axis=1).sum() / 2
    cell = float(edges.min()), float(edges.mean()), float(edges.max())
    return MeshSize(len(volumes), len(quads), (x, y, z), float(volumes.sum()), float(area), cell)


def cells_of_mesh(
    read: Hexahedra, path: Path, unit: str, parts: int, context: Context | None = None
) -> HexahedralCells:
    """The hexahedra of a mesh as cells, each cut into `parts` along each axis."""
    corners = mesh_of(read, path, unit, context).corners
    return HexahedralCells(split(corners, (parts,) * 3) if parts > 1 else corners, parts**3)


@dataclass(frozen=True, kw_only=True)
class ReadHexahedra(Stage):
    """Read a mesh of hexahedra from a VTU, VTK, Abaqus INP or Gmsh MSH file, and take the surface at which it ends.

    It is the part that `tile.hexahedra` and `warp.hexahedra` fill: give it to `fill.implicit` as the domain. The mesh
    is checked: elements meet face to face, none is flat, inside out or listed twice. Nodes at the same place are taken
    as one, and nodes that are numbered in another order than VTK's are put in order with a warning. The reader is
    the library meshio.
    """

    name: ClassVar[str] = "read.hexahedra"
    libraries: ClassVar[tuple[str, ...]] = ("meshio",)
    reported: ClassVar[tuple[str, ...]] = ("hexahedra",)

    path: Path = options.read_path(note="a mesh of hexahedra: .vtu, .vtk, .inp or .msh")
    unit: str = options.unit("mm", note="of the nodes")
    squares: int = option(
        4, help="squares along each edge of a face, by which faces that are twisted are followed", minimum=1, maximum=64
    )

    def check_options(self) -> None:
        check_elements(self.path)

    def estimate(self, palette: Palette) -> Size:
        mesh = size_of_mesh(self.path, self.unit)
        part = Geometry(edge_mm=1.0, box=mesh.box, volume=mesh.volume, envelope=mesh.area)
        return Size(cells=mesh.hexahedra, triangles=2.0 * self.squares**2 * mesh.faces, geometry=part)

    def run(self, context: Context) -> SurfaceMesh:
        """Read, check, and cut the faces into triangles."""
        mesh = mesh_of(read_hexahedra(self.path), self.path, self.unit, context)
        context.report(hexahedra=len(mesh.corners))
        return SurfaceMesh(*boundary_triangles(mesh, self.squares), name=self.path.name)
