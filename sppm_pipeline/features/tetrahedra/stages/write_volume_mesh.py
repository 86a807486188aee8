"""``write.volume_mesh``: tetrahedra for ParaView, Abaqus, CalculiX or Gmsh."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, DesignError, Stage, option, options
from sppm_pipeline.features.tetrahedra.volume_mesh import VolumeMesh
from sppm_pipeline.method.families.file_writer import extension_of, require_format, write_pieces

FORMATS = (".vtu", ".vtk", ".inp", ".msh")

COMMENTS = (
    "coordinates in mm; with forces in N, stresses and moduli are in MPa, densities in t/mm^3",
    "element sets: SOLID, MATERIAL1, ...",
    "node sets: XMIN ... ZMAX whole faces of the box, XMIN_INNER ... without its edges,",
    "YMIN_ZMIN ... edges without corners, XMIN_YMIN_ZMIN ... corners",
)
"""Lines at the top of an .inp file."""


@dataclass(frozen=True, kw_only=True)
class WriteVolumeMesh(Stage):
    """Write a volume mesh; the extension chooses the format: VTU, legacy VTK, Abaqus INP or Gmsh MSH 4.1.

    A .vtu or .vtk file, for ParaView and PyVista, has the cell array ``material``. An .inp file, for Abaqus and
    CalculiX, has elements C3D4 or C3D10, sets of elements, and sets of the nodes in the faces of the box (of the
    bounding box, for a mesh that is no cell), on its edges and at its corners; with `job`, all that CalculiX needs to
    find the stiffness of the cell. An .msh file has the physical groups ``material1``, ... and the triangles ``XMIN``
    ... ``ZMAX`` in the faces of the box and ``SURFACE``; of a matched periodic cell the copies of nodes are listed as
    well. Coordinates are millimeters.
    """

    name: ClassVar[str] = "write.volume_mesh"
    advice: ClassVar[str] = "mesh with a lower `resolution`"

    path: str = options.write_path("mesh.vtu", suffixes=FORMATS)
    compress: bool = option(
        False, help="make a .vtu file smaller; its bytes then depend on the version of the library zlib"
    )
    tie_faces: bool = option(
        False,
        help="tie copies on opposite faces in an .inp file by *EQUATION to three nodes REFX, REFY, REFZ that carry the "
        "mean strain",
        formerly="periodic",
    )

    job: bool = option(
        False,
        help="add materials and six load cases to an .inp file, a job from which CalculiX finds the effective "
        "stiffness; needs `tie_faces`",
    )
    young: float | tuple[float, ...] = options.young(1.0, note="or of each material; of a `job`")
    poisson: float | tuple[float, ...] = options.poisson(0.3, note="or of each material; of a `job`")

    def check_options(self) -> None:
        inp_only = dict.fromkeys(("tie_faces", "job", "young", "poisson"), ".inp")
        require_format(self, self.path, FORMATS, {"compress": ".vtu"} | inp_only)
        if self.job and not self.tie_faces:
            raise ConfigError("a job needs tied faces, as it loads the cell through them", hint="add `tie_faces: true`")
        if not self.job and (self.young, self.poisson) != (1.0, 0.3):
            raise ConfigError("`young` and `poisson` are the materials of a job", hint="add `job: true`")

    @property
    def rated_as(self) -> str:
        return {".vtk": "write.vtu"}.get(extension_of(self.path), f"write{extension_of(self.path)}")

    def run(self, context: Context, mesh: VolumeMesh) -> None:
        """Write the file."""
        encode = {".inp": self._inp, ".msh": self._msh}.get(extension_of(self.path), self._vtk)
        size = write_pieces(context, self.path, encode(mesh))
        context.report(bytes=size, cells=len(mesh.cells), nodes=len(mesh.nodes))

    def _vtk(self, mesh: VolumeMesh) -> Iterator[bytes]:
        from sppm_pipeline.services.formats import vtu

        if extension_of(self.path) == ".vtk":
            return vtu.encode_legacy(mesh.nodes, mesh.cells, mesh.material_of_cells)
        return vtu.encode(mesh.nodes, mesh.cells, mesh.material_of_cells, self.compress)

    def _inp(self, mesh: VolumeMesh) -> Iterator[bytes]:
        from sppm_pipeline.features.tetrahedra.numerics.node_sets import box_node_sets
        from sppm_pipeline.features.tetrahedra.numerics.periodic import matched_nodes
        from sppm_pipeline.services.formats import inp

        if self.tie_faces and not mesh.matched:
            raise DesignError(
                "opposite faces of this mesh do not match, so that they can't be tied to each other",
                hint="mesh a periodic cell, or leave out `tie_faces`",
            )
        standing = matched_nodes(mesh.nodes, mesh.around) if self.tie_faces else None
        sets = box_node_sets(mesh.nodes, mesh.around)
        yield from inp.encode(mesh.nodes, mesh.cells, mesh.material_of_cells, sets, standing, COMMENTS)
        if self.job and standing is not None:
            yield from inp.stiffness_job(self._moduli(mesh), standing, np.asarray(mesh.around))

    def _moduli(self, mesh: VolumeMesh) -> dict[int, tuple[float, float]]:
        """Young's modulus and Poisson's ratio of each material of the mesh."""
        materials = [int(material) for material in np.unique(mesh.material_of_cells)]

        def of(name: str, given: float | tuple[float, ...]) -> list[float]:
            values = given if isinstance(given, tuple) else (given,) * materials[-1]
            if len(values) < materials[-1]:
                raise ConfigError(f"the mesh has {materials[-1]} materials, `{name}` gives values for {len(values)}")
            return [values[material - 1] for material in materials]

        return dict(zip(materials, zip(of("young", self.young), of("poisson", self.poisson), strict=True), strict=True))

    def _msh(self, mesh: VolumeMesh) -> Iterator[bytes]:
        from sppm_pipeline.features.tetrahedra.numerics.node_sets import boundary_surfaces, box_copies
        from sppm_pipeline.features.tetrahedra.numerics.periodic import matched_nodes
        from sppm_pipeline.services.formats import msh

        box = mesh.around
        copies = box_copies(mesh.nodes, matched_nodes(mesh.nodes, box), box) if mesh.matched else None
        surfaces = boundary_surfaces(mesh.nodes, mesh.cells, box)
        return msh.encode(mesh.nodes, mesh.cells, mesh.material_of_cells, surfaces, copies)
