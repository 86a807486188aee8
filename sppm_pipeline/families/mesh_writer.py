"""Base class of stages that write a triangle mesh: one method names the encoder."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.errors import DesignError
from sppm_pipeline.stage import Context, Stage

__all__ = ["MeshWriter", "write_pieces"]


@dataclass(frozen=True, kw_only=True)
class MeshWriter(Stage):
    """Base of mesh writers: implement `encode` and declare the option `path`."""

    path: str

    @abstractmethod
    def encode(self, mesh: SurfaceMesh, threads: int) -> Iterable[bytes | memoryview]:
        """The content of the file, piece by piece; the same bytes for any number of threads."""

    def run(self, context: Context, mesh: SurfaceMesh) -> None:
        """Write the file piece by piece."""
        if not len(mesh.faces):
            raise DesignError(f"{mesh.name!r} has no triangles: there is nothing to write to {self.path}")
        size = write_pieces(context, self.path, self.encode(mesh, context.threads))
        context.report(bytes=size, triangles=len(mesh.faces))


def write_pieces(context: Context, name: str, pieces: Iterable[bytes | memoryview]) -> int:
    """Write an output file; returns its size in bytes."""
    size = 0
    with context.output(name).open("wb", buffering=0) as file:
        for piece in pieces:
            rest = memoryview(piece)
            while rest:  # without a buffer, one call may write less than it was given
                written = file.write(rest)
                size += written
                rest = rest[written:]
    return size
