"""What stages that write meshes share: the file is written piece by piece, and nothing is not written at all."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

from sppm_pipeline.data.mesh import RepeatedMesh, SurfaceMesh
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.errors import DesignError
from sppm_pipeline.stage import Context, Stage

ADVICE = "extract with a lower `resolution`, or slice without a mesh (`slice.field`)"


@dataclass(frozen=True, kw_only=True)
class MeshWriter(Stage):
    """Base of writers of formats that know no copies: implement `encode` and declare the option `path`."""

    path: str

    advice: ClassVar[str] = ADVICE

    def estimate(self, palette: Palette, mesh: Size) -> Size:
        return written(mesh)

    @abstractmethod
    def encode(self, mesh: SurfaceMesh, threads: int) -> Iterable[bytes | memoryview]:
        """The content of the file, piece by piece; the same bytes for any number of threads."""

    def run(self, context: Context, mesh: SurfaceMesh) -> None:
        """Write the file."""
        _require_triangles(mesh, self.path)
        size = _write(context, self.path, self.encode(mesh, context.threads))
        context.report(bytes=size, triangles=len(mesh.faces))


def written(mesh: Size) -> Size:
    """The size of writing a mesh; what is repeated is written once, and a place for each copy."""
    return Size(triangles=mesh.triangles, copies=mesh.copies)


def write_mesh(
    context: Context,
    path: str,
    mesh: SurfaceMesh | RepeatedMesh,
    encode: Callable[..., Iterable[bytes | memoryview]],
    **options: Any,
) -> None:
    """Write a mesh, or a mesh once with the places of its copies, to an output file and report its size.

    Parameters
    ----------
    context : Context
    path : str
        The name of the output.
    mesh : SurfaceMesh or RepeatedMesh
    encode : callable
        Of vertices and faces, with the options `threads`, `offsets` and those given here.

    Raises
    ------
    DesignError
        If there are no triangles.
    """
    once = mesh.mesh if isinstance(mesh, RepeatedMesh) else mesh
    offsets = mesh.offsets if isinstance(mesh, RepeatedMesh) else None
    copies = 1 if offsets is None else len(offsets)
    _require_triangles(once, path)
    if not copies:
        raise DesignError(f"{once.name!r} has no copies: there is nothing to write to {path}")
    pieces = encode(once.vertices, once.faces, threads=context.threads, offsets=offsets, **options)
    size = _write(context, path, pieces)
    context.report(bytes=size, triangles=copies * len(once.faces), copies=copies)


def _require_triangles(mesh: SurfaceMesh, path: str) -> None:
    if not len(mesh.faces):
        raise DesignError(f"{mesh.name!r} has no triangles: there is nothing to write to {path}")


def _write(context: Context, name: str, pieces: Iterable[bytes | memoryview]) -> int:
    """Write an output file; returns its size."""
    size = 0
    with context.output(name).open("wb", buffering=0) as file:
        for piece in pieces:
            rest = memoryview(piece)
            while rest:  # without a buffer, one call may write less than it was given
                written = file.write(rest)
                size += written
                rest = rest[written:]
    return size
