"""``read.volume_mesh``: tetrahedra made by another program."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, InputError, Length, Stage, options
from sppm_pipeline.formats import check_elements, read_elements
from sppm_pipeline.numerics import F64, I32, U8
from sppm_tetrahedra.volume_mesh import VolumeMesh, face_match

FLAT = 1e-12
"""Volume of a cell, over the cube of its size, up to which it counts as none."""

NODES = {"tetra": 4, "tetra10": 10}
MATERIAL_DATA = ("material", "gmsh:physical", "medit:ref", "MaterialIds")


@dataclass(frozen=True, kw_only=True)
class ReadVolumeMesh(Stage):
    """Read tetrahedra from a VTU, VTK, Abaqus INP or Gmsh MSH file; the reader is the library meshio.

    Points, lines and surface elements in the file are passed over; other solids than tetrahedra are refused. Cells
    that are numbered inside out are turned. Materials come from the cell data ``material``, ``gmsh:physical``,
    ``medit:ref`` or ``MaterialIds``, or from the element sets of an INP file, and are numbered from 1 in the order of
    their numbers or names.
    """

    name: ClassVar[str] = "read.volume_mesh"
    libraries: ClassVar[tuple[str, ...]] = ("meshio",)

    path: Path = options.read_path(note=".vtu, .vtk, .inp or .msh")
    unit: str = options.unit("mm")
    periodic: bool = options.periodic(
        False, note="those of the bounding box of the mesh, which is a cell", formerly="cell"
    )

    @property
    def periodic_box(self) -> bool:
        """True if the mesh has the box of a cell; see `HomogenizeTet.requires`."""
        return self.periodic

    def check_options(self) -> None:
        check_elements(self.path)

    def run(self, context: Context) -> VolumeMesh:
        """Read the file."""
        hint = "is it cut off, or of a version that meshio does not know? write it again, perhaps as VTU"
        read = read_elements(self.path, hint)
        blocks = [(place, block) for place, block in enumerate(read.cells) if block.type in NODES]
        others = sorted({block.type for block in read.cells if block.dim > 2} - set(NODES))
        if others:
            raise InputError(
                f"{self.path.name} holds elements of type {', '.join(others)}; only tetrahedra can be used",
                hint="convert them, or mesh with tetrahedra",
            )
        kinds = {block.type for _, block in blocks}
        if len(kinds) != 1:
            raise InputError(
                f"{self.path.name} holds {'both straight and quadratic' if kinds else 'no'} tetrahedra",
                hint="export the solid with elements of one order",
            )
        cells = np.concatenate([np.asarray(block.data, np.int64) for _, block in blocks])
        nodes = np.asarray(read.points, np.float64)
        if nodes.ndim != 2 or nodes.shape[1] != 3 or not np.isfinite(nodes).all():
            raise InputError(f"{self.path.name}: the nodes are no finite points in space")
        if not cells.size or cells.min() < 0 or cells.max() >= len(nodes):
            raise InputError(f"{self.path.name}: a cell names a node that does not exist")
        used, numbered = np.unique(cells, return_inverse=True)
        nodes, cells = nodes[used] * Length(1.0, self.unit).mm(), numbered.reshape(cells.shape).astype(np.int32)
        cells = self._oriented(context, nodes, cells)
        materials = self._materials(context, read, [place for place, _ in blocks])
        box, matched = None, False
        if self.periodic:
            box = np.array([nodes.min(axis=0), nodes.max(axis=0)])
            match = face_match(nodes, cells, box)
            matched = bool(match.matched.all() and not match.mismatched.any())
            if not matched:
                context.warn(
                    f"opposite faces of the box do not match: {match.matched.tolist()} triangles have a copy across x, "
                    f"y, z, {match.mismatched.tolist()} overlap others"
                )
        return VolumeMesh(nodes, cells, box, matched, materials, name=self.path.name)

    def _oriented(self, context: Context, nodes: F64, cells: I32) -> I32:
        from sppm_tetrahedra.numerics.quality import volumes

        signed = volumes(nodes, cells)
        corners = nodes[cells[:, :4]]
        size = (corners.max(axis=1) - corners.min(axis=1)).max(axis=1)
        flat = int((np.abs(signed) <= FLAT * size**3).sum())
        if flat:
            raise InputError(f"{self.path.name}: {flat} tetrahedra have no volume", hint="repair the mesh")
        inverted = signed < 0
        if inverted.any():
            context.warn(f"{int(inverted.sum())} tetrahedra were numbered inside out and have been turned")
            # exchange corners 2 and 3, and with them the edges 12 and 13, 02 and 03
            turned = [0, 1, 3, 2] if cells.shape[1] == 4 else [0, 1, 3, 2, 4, 8, 7, 6, 5, 9]
            cells = np.where(inverted[:, None], cells[:, turned], cells)
        return cells

    def _materials(self, context: Context, read: Any, places: list[int]) -> U8 | None:
        given: list[NDArray[Any]] = []
        for name in MATERIAL_DATA:
            if name in read.cell_data:
                given = [np.ravel(read.cell_data[name][place]) for place in places]
                break
        else:
            sets = {
                name: members
                for name, members in sorted(read.cell_sets.items())
                if not name.startswith("gmsh:") and any(len(members[place]) for place in places)
            }
            counts = [len(block.data) for block in read.cells]
            given = [np.zeros(counts[place], np.int64) for place in places]
            for number, members in enumerate(sets.values(), 1):
                for values, place in zip(given, places, strict=True):
                    inside = np.asarray(members[place], np.int64)
                    values[inside[values[inside] == 0]] = number
        found, numbered = np.unique(np.concatenate(given), return_inverse=True)
        if len(found) > 255:
            context.warn(f"the cells have {len(found)} numbers of materials, too many: all are taken as one material")
            return None
        return (1 + numbered.ravel()).astype(np.uint8)
