"""``write.volume_mesh``: tetrahedra for ParaView, Abaqus, CalculiX or Gmsh."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, DesignError, Stage, option, options
from sppm_pipeline.formats import extension_of, require_format, write_pieces
from sppm_pipeline.numerics import I64
from sppm_tetrahedra.numerics.faces import BOUNDARY, FACES, face_neighbors
from sppm_tetrahedra.numerics.quality import EDGES
from sppm_tetrahedra.volume_mesh import VolumeMesh, matched_nodes, on_faces

SIDES = ("XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX")

_MID_NODE = {frozenset(ends): 4 + place for place, ends in enumerate(EDGES.tolist())}


def box_node_sets(nodes: NDArray[np.floating], box: NDArray[np.floating]) -> dict[str, I64]:
    """Nodes on the boundary of a box: name to ascending numbers of nodes.

    ``XMIN`` ... ``ZMAX``: the faces with their edges and corners. ``XMIN_INNER`` ...: without them. ``YMIN_ZMIN`` ...:
    the twelve edges without their corners. ``XMIN_YMIN_ZMIN`` ...: the eight corners. The last three kinds share no
    node.
    """
    low, high = on_faces(nodes, box)
    side = dict(zip(SIDES, np.stack([low, high], axis=2).reshape(len(nodes), 6).T, strict=True))
    count = low.sum(1) + high.sum(1)
    sets = {name: np.flatnonzero(flags) for name, flags in side.items()}
    sets |= {f"{name}_INNER": np.flatnonzero(flags & (count == 1)) for name, flags in side.items()}
    for size in (2, 3):
        for names in itertools.combinations(SIDES, size):
            if len({name[0] for name in names}) == size:
                members = np.logical_and.reduce([side[name] for name in names]) & (count == size)
                sets["_".join(names)] = np.flatnonzero(members)
    return sets


def boundary_surfaces(
    nodes: NDArray[np.floating], cells: NDArray[np.integer], box: NDArray[np.floating]
) -> dict[str, I64]:
    """The triangles of the boundary by name: those in the six faces of a box, and ``SURFACE``, the rest.

    (k, 3), or (k, 6) for quadratic cells: corners counterclockwise for a viewer outside, then nodes on the edges 01,
    12, 20.
    """
    cell, corner = np.nonzero(face_neighbors(cells) == BOUNDARY)
    columns = [list(face) for face in FACES.tolist()]
    if cells.shape[1] == 10:
        columns = [[*f, *(_MID_NODE[frozenset((f[i], f[(i + 1) % 3]))] for i in range(3))] for f in columns]
    triangles = np.asarray(cells, np.int64)[cell[:, None], np.array(columns)[corner]]
    flags = on_faces(nodes, box)
    surfaces, rest = {}, np.ones(len(triangles), np.bool_)
    for place, name in enumerate(SIDES):
        members = flags[place % 2][triangles[:, :3], place // 2].all(axis=1)
        surfaces[name] = triangles[members]
        rest &= ~members
    return {**surfaces, "SURFACE": triangles[rest]}


def box_copies(
    nodes: NDArray[np.floating], standing: NDArray[np.integer], box: NDArray[np.floating]
) -> dict[tuple[str, str], I64]:
    """For each high face of a periodic box the pairs of its nodes and their copies in the low face, (p, 2).

    `standing`, (n,), is that of `matched_nodes`; of nodes on edges and corners of the box, pairs straight across are
    taken.
    """
    low, high = on_faces(nodes, box)
    pairs = {}
    for axis in range(3):
        one, other = np.flatnonzero(high[:, axis]), np.flatnonzero(low[:, axis])
        # copies straight across have the same representative and lie on the same of the other faces
        keys = []
        for members in (one, other):
            across = np.delete(high[members], axis, axis=1)
            keys.append(4 * np.asarray(standing)[members] + across @ np.array([1, 2]))
        _, first, second = np.intersect1d(keys[0], keys[1], assume_unique=True, return_indices=True)
        pairs[SIDES[2 * axis + 1], SIDES[2 * axis]] = np.stack([one[first], other[second]], axis=1)
    return pairs


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
        from sppm_tetrahedra.formats import vtu

        if extension_of(self.path) == ".vtk":
            return vtu.encode_legacy(mesh.nodes, mesh.cells, mesh.material_of_cells)
        return vtu.encode(mesh.nodes, mesh.cells, mesh.material_of_cells, self.compress)

    def _inp(self, mesh: VolumeMesh) -> Iterator[bytes]:
        from sppm_tetrahedra.formats import inp

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
        young, poisson = mesh.constants("young", self.young), mesh.constants("poisson", self.poisson)
        return {int(m): (young[m - 1], poisson[m - 1]) for m in np.unique(mesh.material_of_cells)}

    def _msh(self, mesh: VolumeMesh) -> Iterator[bytes]:
        from sppm_tetrahedra.formats import msh

        box = mesh.around
        copies = box_copies(mesh.nodes, matched_nodes(mesh.nodes, box), box) if mesh.matched else None
        surfaces = boundary_surfaces(mesh.nodes, mesh.cells, box)
        return msh.encode(mesh.nodes, mesh.cells, mesh.material_of_cells, surfaces, copies)
