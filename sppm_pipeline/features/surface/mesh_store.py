"""A mesh put together from its pieces: in memory, and beyond a limit in temporary files that are mapped."""

from __future__ import annotations

import mmap
import tempfile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import ResourceError

_ROWS = 2**20  # of faces that are numbered at a time

Arrays = tuple[NDArray[np.float64], NDArray[np.int32]]


class MeshStore:
    """Takes vertices and faces as they come; a mesh beyond `limit` bytes goes into nameless files in `folder`.

    The files vanish with it or with the process. Memory for the `expected` numbers of vertices and faces is reserved at
    once, which is filled in less time. Vertices are stored times the scale, and moved by the origin.
    """

    def __init__(
        self,
        limit: int,
        folder: Path,
        expected: tuple[int, int] = (0, 0),
        scale: float = 1.0,
        origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self._limit = limit
        self._scale, self._origin = scale, np.array(origin)
        self._folder = folder
        fits = 24 * expected[0] + 12 * expected[1] <= limit
        self._vertices = np.empty((expected[0] if fits else 0, 3))
        self._faces = np.empty((expected[1] if fits else 0, 3), np.int32)
        self._files: tuple[IO[bytes], IO[bytes]] | None = None
        self._n = self._m = 0

    def add(self, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
        """Append vertices (n, 3) and faces (m, 3); of the latter, negative ones -1 - p stand for points on rims.

        Returns the vertices as they are stored, valid until the next ones come. ResourceError if the mesh has more
        vertices than 32 bits count, OSError if the disk is full.
        """
        from sppm_pipeline.features.surface.numerics.placing import put_rescaled

        n, m = self._n + len(vertices), self._m + len(faces)
        if n > np.iinfo(np.int32).max:
            raise ResourceError(
                f"the surface has more than {np.iinfo(np.int32).max} vertices",
                hint="sample the field more coarsely, or extract the part in pieces",
            )
        if self._files is None and 24 * n + 12 * m > self._limit:
            self._move_to_files()
        if self._files is not None:
            stored = np.empty(vertices.shape)
            put_rescaled(vertices, self._scale, self._origin, stored)
            _write(self._files[0], stored)
            _write(self._files[1], faces)
        else:
            # no other reference exists yet, whatever a debugger or a profiler counts
            if n > len(self._vertices):
                self._vertices.resize((n, 3), refcheck=False)
            if m > len(self._faces):
                self._faces.resize((m, 3), refcheck=False)
            stored = self._vertices[self._n : n]
            put_rescaled(vertices, self._scale, self._origin, stored)
            self._faces[self._m : m] = faces
        self._n, self._m = n, m
        return stored

    def finish(self, points: NDArray[np.float64]) -> Arrays:
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
