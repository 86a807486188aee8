"""Triangle meshes, and how one is handed over piece by piece while it is made, to what writes or measures it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.errors import DesignError
from sppm_pipeline.nouns.artifact import (
    NOTEBOOK_SIZE,
    Artifact,
    Surface,
    Viewable,
    frozen,
    in_rows,
    optional_module,
    whole_numbers,
)
from sppm_pipeline.services.arrays import F64, I32, U8
from sppm_pipeline.services.paging import blocks

if TYPE_CHECKING:
    from sppm_pipeline.services.mesh.outer_surface import OuterSurface

_MAX_VERTICES = 2**31 - 1  # faces are int32


@dataclass(frozen=True, eq=False)
class SurfaceMesh(Viewable):
    """An indexed triangle mesh; faces are oriented so that their normals point out of the solid.

    Attributes
    ----------
    vertices : (n, 3) float64, mm
    faces : (m, 3) int32
    name : str
        What a person would call it, for messages.
    groups : tuple of (str, int, int)
        Named stretches of the triangles, first <= i < last, as the file names them; they may overlap.
    """

    reported: ClassVar[tuple[str, ...]] = ("vertices", "triangles", "size_mm.#3", "volume_mm3")

    vertices: F64
    faces: I32
    name: str = "mesh"
    groups: tuple[tuple[str, int, int], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", frozen(in_rows(np.asarray(self.vertices, np.float64), 3, "vertices")))
        corners = whole_numbers(self.faces, np.int32, "the corners of triangles")
        object.__setattr__(self, "faces", frozen(in_rows(corners, 3, "the corners of triangles")))

    @classmethod
    def from_arrays(cls, vertices: ArrayLike, faces: ArrayLike, name: str = "mesh") -> SurfaceMesh:
        """A mesh of vertices (n, 3), mm, and triangles (m, 3), whose normals point out of the solid.

        Raises
        ------
        ValueError
            If a vertex is not finite, or a triangle names one that does not exist.
        """
        mesh = cls(np.array(vertices, np.float64), np.array(faces), name)
        mesh.check()
        return mesh

    @classmethod
    def measured(cls, vertices: F64, faces: I32, name: str, box_and_volume: tuple[F64, F64, float]) -> SurfaceMesh:
        """A mesh whose low corner, high corner and volume are known already."""
        mesh = cls(vertices, faces, name)
        mesh.__dict__["_measured"] = box_and_volume  # where the property would keep them
        return mesh

    def with_volume(self, volume: float) -> SurfaceMesh:
        """The same mesh with the volume of its union; not a number if it encloses none."""
        made = replace(self)
        made.__dict__.update(self.__dict__, _measured=(self.lower, self.upper, volume))
        return made

    @classmethod
    def handed_on(cls, vertices: int, faces: int, name: str, box_and_volume: tuple[F64, F64, float]) -> SurfaceMesh:
        """A mesh that was given away in pieces (`Context.begin_readers`): its numbers, and no arrays at all."""
        mesh = object.__new__(cls)
        mesh.__dict__.update(name=name, groups=(), _counts=(vertices, faces), _measured=box_and_volume)
        return mesh

    @property
    def is_whole(self) -> bool:
        """True if there are arrays; a mesh that was given away in pieces has none."""
        return "_counts" not in self.__dict__

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of vertices and triangles."""
        given: tuple[int, int] | None = self.__dict__.get("_counts")
        return given or (len(self.vertices), len(self.faces))

    @classmethod
    def from_trimesh(cls, mesh: Any, name: str = "mesh") -> SurfaceMesh:
        """A `trimesh.Trimesh`; see `from_arrays`."""
        return cls.from_arrays(mesh.vertices, mesh.faces, name)

    def to_trimesh(self) -> Any:
        """A `trimesh.Trimesh` with the same vertices and triangles.

        Raises
        ------
        ResourceError
            If trimesh is not installed.
        """
        # without `process` trimesh neither merges nor drops vertices
        return optional_module("trimesh").Trimesh(self.vertices.copy(), self.faces.copy(), process=False)

    def to_pyvista(self) -> Any:
        """A `pyvista.PolyData`.

        Raises
        ------
        ResourceError
            If pyvista is not installed.
        """
        return optional_module("pyvista").PolyData.from_regular_faces(self.vertices, self.faces)

    def check(self) -> None:
        """Finite vertices, indices in range."""
        if not self.is_whole:
            return  # those who took the pieces have seen to it
        # in blocks, as a mesh may lie in a file that is larger than the memory
        for rows in blocks(len(self.vertices), self.vertices):
            if not np.isfinite(self.vertices[rows]).all():
                raise ValueError("mesh vertices must be finite")
        for rows in blocks(len(self.faces), self.faces):
            # a negative index is a large one when its sign is not looked at
            if len(self.faces) and int(self.faces[rows].view(np.uint32).max()) >= len(self.vertices):
                raise ValueError("a triangle names a vertex that does not exist")
        if any(not 0 <= first < last <= len(self.faces) for _, first, last in self.groups):
            raise ValueError("a group holds triangles that do not exist")

    @cached_property
    def bounds_solid(self) -> bool:
        """True if the triangles bound a volume; if not, rays vote on what is inside."""
        from sppm_pipeline.services.mesh.measures import edge_counts

        return edge_counts(self.faces).bounds_solid

    @cached_property
    def outer_surface(self) -> OuterSurface | None:
        """The surface of the union of its shells, if some of its triangles lie within others; else None.

        The faces must be wound outwards.
        """
        from sppm_pipeline.services.mesh.outer_surface import outer_surface

        return outer_surface(self.vertices, self.faces)

    @cached_property
    def _measured(self) -> tuple[F64, F64, float]:
        """Low and high corner, and volume."""
        from sppm_pipeline.services.mesh.measures import box_and_volume

        return box_and_volume(self.vertices, self.faces)

    @property
    def lower(self) -> F64:
        """Low corner of the bounding box of the triangles, (3,) mm."""
        return self._measured[0]

    @property
    def upper(self) -> F64:
        """High corner of the bounding box of the triangles, (3,) mm."""
        return self._measured[1]

    def live_view(self) -> Surface:
        """Its triangles."""
        return Surface(self.vertices, self.faces, self.name, "mm")

    def picture(self) -> U8 | None:
        """Its triangles, seen from the front; None if it has none."""
        if not len(self.faces):
            return None
        from sppm_pipeline.services.pictures.mesh_view import render_mesh

        return render_mesh(self.vertices, self.faces, size=NOTEBOOK_SIZE)

    def summary(self) -> dict[str, Any]:
        """Counts, box and signed volume, None if there is none."""
        vertices, triangles = self.counts
        if not triangles:
            return {"name": self.name, "vertices": vertices, "triangles": 0}
        return {
            "name": self.name,
            "vertices": vertices,
            "triangles": triangles,
            "size_mm": [float(v) for v in self.upper - self.lower],
            "volume_mm3": None if math.isnan(self._measured[2]) else self._measured[2],
        }


@dataclass(frozen=True, eq=False)
class RepeatedMesh(Artifact):
    """A mesh placed at several positions; copies may touch each other, each is closed by itself.

    Attributes
    ----------
    mesh : SurfaceMesh
    offsets : (k, 3) float64, mm
        Shifts of the copies.
    """

    reported: ClassVar[tuple[str, ...]] = (
        "copies", "mesh.vertices", "mesh.triangles", "mesh.size_mm.#3", "mesh.volume_mm3",
    )  # fmt: skip

    mesh: SurfaceMesh
    offsets: F64

    def __post_init__(self) -> None:
        object.__setattr__(self, "offsets", frozen(np.asarray(self.offsets, np.float64).reshape(-1, 3)))

    def check(self) -> None:
        """A valid mesh, and finite positions."""
        self.mesh.check()
        if not np.isfinite(self.offsets).all():
            raise ValueError("the places of copies must be finite")

    def whole(self) -> SurfaceMesh:
        """One mesh of all copies; surfaces at which copies touch stay within it.

        Raises
        ------
        DesignError
            If it would have more vertices than 32 bits count.
        """
        n, copies = len(self.mesh.vertices), len(self.offsets)
        if n * copies > _MAX_VERTICES:
            raise DesignError(
                f"{copies} copies of {self.mesh.name!r} have {n * copies} vertices; one mesh counts {_MAX_VERTICES}",
                hint="write a .glb file or `copies: components`, which place copies, or slice without a mesh",
            )
        # copies are not merged where they touch, so each stays closed
        vertices = (self.offsets[:, None] + self.mesh.vertices[None]).reshape(-1, 3)
        faces = (np.arange(copies, dtype=np.int32)[:, None, None] * np.int32(n) + self.mesh.faces).reshape(-1, 3)
        return SurfaceMesh(vertices, faces, name=self.mesh.name)

    def summary(self) -> dict[str, Any]:
        """The mesh's numbers and the number of copies."""
        return {"copies": len(self.offsets), "mesh": self.mesh.summary()}


class ExpectedSize(NamedTuple):
    """Size of a mesh that is about to be made, certain."""

    vertices: int
    faces: int
    least: F64  # (2, 3): low and high corner; the box of the vertices reaches as far as this
    most: F64  # and no farther than this

    def moved(self, scale: float, origin: F64) -> ExpectedSize:
        """Of the mesh times a scale, and moved by an origin."""
        return self._replace(least=self.least * scale + origin, most=self.most * scale + origin)

    @property
    def reach(self) -> tuple[float, float]:
        """Between these lies the largest absolute coordinate."""
        least, most = (max(float(box[1].max()), float(-box[0].min())) for box in (self.least, self.most))
        return least, most


class PieceTaker(Protocol):
    """Consumer of the pieces of a mesh while the next ones are made, such as the writer of a file."""

    def begin(self, expected: ExpectedSize) -> bool:
        """True if such a mesh can be taken in pieces; called before anything else, once for each try."""

    def add(self, points: F64, base: int, known: int, faces: I32) -> None:
        """Take the triangles (m, 3) of the next piece, all with corners among these points.

        The points (n, 3) are the vertices of the piece before, `known` of them, and of this one, numbered from `base`
        on; they stay as they are until the call after the next one.
        """

    def finish(self) -> bool:
        """True if the mesh is complete and of the expected size; if not, nothing of it is used."""

    def drop(self) -> None:
        """Discard all pieces."""
