"""What stages share that take meshes of hexahedra: the option of the path, and the mesh as cells."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from sppm_pipeline.data.curved_cells import HexahedralCells
from sppm_pipeline.data.length import UNITS_IN_MM
from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.formats.hexahedra_file import READERS, Hexahedra
from sppm_pipeline.stage import Context

if TYPE_CHECKING:
    from sppm_pipeline.numerics.grading.hexahedral_mesh import HexahedralMesh


def check_path(path: Path) -> None:
    """Raise `ConfigError` if a file is of no kind that holds hexahedra."""
    if path.suffix.lower() not in READERS:
        raise ConfigError(f"`path` is {str(path)!r}; known are {', '.join(READERS)}")


def mesh_of(read: Hexahedra, path: Path, unit: str, context: Context | None = None) -> HexahedralMesh:
    """The mesh of what was read, mm, checked; nodes in another order than expected are told.

    Raises
    ------
    InputError
        If elements do not fit together, naming one.
    """
    from sppm_pipeline.numerics.grading.hexahedral_mesh import checked_mesh

    try:
        mesh = checked_mesh(read.points * UNITS_IN_MM[unit], read.elements)
    except ValueError as error:
        raise InputError(
            f"{path.name}: {error}",
            hint="export a mesh of straight hexahedra that meet face to face, none of them flat or turned inside out",
        ) from None
    if mesh.turned and context is not None:
        context.warn(f"the nodes of hexahedra in {path.name} are numbered {mesh.turned}, and are taken so")
    return mesh


def cells_of_mesh(
    read: Hexahedra, path: Path, unit: str, parts: int, context: Context | None = None
) -> HexahedralCells:
    """The hexahedra of a mesh as cells, each cut into `parts` along each axis."""
    from sppm_pipeline.numerics.grading.hexahedral_mesh import split

    corners = mesh_of(read, path, unit, context).corners
    return HexahedralCells(split(corners, (parts,) * 3) if parts > 1 else corners, parts**3)
