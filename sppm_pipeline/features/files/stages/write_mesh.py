"""``write.mesh``: a triangle mesh as STL, PLY, OBJ, OFF, 3MF or GLB."""

from __future__ import annotations

import hashlib
import importlib
import os
import secrets
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, ClassVar

import numpy as np

import sppm_pipeline
from sppm_pipeline import ConfigError, Context, DesignError, Palette, Size, Stage, SurfaceMesh, option, options
from sppm_pipeline.method.families.file_writer import (
    ADVICE,
    extension_of,
    require_format,
    require_triangles,
    write_all,
    write_hashed,
    write_pieces,
)
from sppm_pipeline.method.nouns.mesh import ExpectedSize, RepeatedMesh
from sppm_pipeline.services.arrays import F64, I32
from sppm_pipeline.services.formats.encoding import InPieces, largest
from sppm_pipeline.services.threads import ordered_map

_READ_AT_ONCE = 2**20  # bytes


class PieceFile:
    """Takes the pieces of a mesh (`mesh_pieces.PieceTaker`), and is a file in the end.

    Until then it lies in a `folder` for temporary files. What comes in front in the file is hashed as it comes. What
    comes behind is written to its place, if that is known, and hashed at the end; or triangles wait in a nameless file.
    `in_pieces` is called with the numbers of vertices and triangles, and bounds of the largest coordinate: see
    `ply.in_pieces`. With more than one thread, a piece is written while the next one is made; the bytes do not depend
    on it.
    """

    def __init__(
        self, folder: Path, in_pieces: Callable[[int, int, tuple[float, float]], InPieces | None], threads: int
    ) -> None:
        self._path = folder / f".sppm-mesh-{secrets.token_hex(6)}"
        self._in_pieces, self._threads = in_pieces, threads
        self._file: IO[bytes] | None = None
        self._pool: ThreadPoolExecutor | None = None
        self.whole = False

    def begin(self, predicted: ExpectedSize) -> bool:
        """See `PieceTaker.begin`."""
        pieces = self._in_pieces(predicted.vertices, predicted.faces, predicted.reach)
        if pieces is None:
            return False
        self._pieces, self._predicted = pieces, predicted
        self._digest = hashlib.sha256()
        self._file = self._path.open("xb+", buffering=0)
        self._pool = ThreadPoolExecutor(1) if self._threads > 1 else None
        self._waiting: Future[None] | None = None
        self._spool: IO[bytes] | None = None
        if pieces.back is not None and pieces.back_at is None:
            self._spool = tempfile.TemporaryFile(dir=self._path.parent, buffering=0)  # noqa: SIM115 - see `drop`
        self._spooled: list[tuple[int, int, str]] = []  # base, triangles, type of the corners
        self._vertices = self._faces = self._size = 0
        self._back_at = pieces.back_at or 0
        self._largest = 0.0
        self._put([(self._file, 0, memoryview(pieces.head))])
        self._digest.update(pieces.head)
        self._size = len(pieces.head)
        return True

    def add(self, points: F64, base: int, known: int, faces: I32) -> None:
        """See `PieceTaker.add`."""
        assert self._file is not None
        corners = faces - np.int32(base)
        # a negative number is a large one when its sign is not looked at
        if corners.size and int(corners.view(np.uint32).max()) >= len(points):
            # checked as the pieces pass: afterwards they are forgotten
            raise ValueError("a triangle names a vertex that does not exist")
        found = largest(points[known:].reshape(-1))
        if not np.isfinite(found):
            raise ValueError("mesh vertices must be finite")
        self._largest = max(self._largest, found)
        front = self._pieces.front(points, known, corners)
        parts = [(self._file, self._size, front)]
        if self._spool is not None:
            # numbers within a small piece fit 16 bits, which halves what waits on the disk
            kind = "<u2" if len(points) <= 2**16 else "<i4"
            self._spooled.append((base, len(faces), kind))
            parts.append((self._spool, -1, corners.astype(kind).reshape(-1).view(np.uint8).data))
        elif self._pieces.back is not None:
            back = self._pieces.back(faces)
            parts.append((self._file, self._back_at, back))
            self._back_at += len(back)
        self._put(parts)
        self._digest.update(front)
        self._size += len(front)
        self._vertices, self._faces = base + len(points), self._faces + len(faces)

    def finish(self) -> bool:
        """See `PieceTaker.finish`."""
        self._wait()
        assert self._file is not None
        predicted = self._predicted
        as_predicted = (self._vertices, self._faces) == (predicted.vertices, predicted.faces)
        if not as_predicted or not self._pieces.fits(self._largest):
            return False
        if self._spool is not None:
            self._file.seek(self._size)
            self._size += write_hashed(self._file, self._spooled_triangles(), self._digest, self._threads)
        elif self._pieces.back is not None:
            self._file.seek(self._size)
            room = memoryview(bytearray(_READ_AT_ONCE))
            while count := self._file.readinto(room):  # type: ignore[attr-defined]
                self._digest.update(room[:count])
                self._size += count
        self._close()
        self.whole = True
        return True

    def drop(self) -> None:
        """See `PieceTaker.drop`."""
        self._close()
        self.whole = False
        self._path.unlink(missing_ok=True)

    def hand_over(self, context: Context, name: str) -> int:
        """Make the file an output of a stage; returns its size in bytes."""
        # by a rename: the output is whole or not there
        os.replace(self._path, context.output(name))
        context.hashed(name, self._digest.hexdigest())
        return self._size

    def _spooled_triangles(self) -> Iterator[memoryview]:
        """Bytes of the triangles that were held back, which follow the rest."""
        assert self._spool is not None
        spool, back = self._spool, self._pieces.back
        assert back is not None
        spool.seek(0)

        def blocks() -> Iterator[I32]:
            for base, count, kind in self._spooled:
                corners = np.empty((count, 3), kind)
                rest = corners.reshape(-1).view(np.uint8).data
                while rest:
                    got = spool.readinto(rest)  # type: ignore[attr-defined]
                    if not got:
                        raise OSError("the temporary file of the triangles is cut off")
                    rest = rest[got:]
                yield corners.astype(np.int32) + np.int32(base)

        return ordered_map(back, blocks(), self._threads)

    def _put(self, parts: list[tuple[IO[bytes], int, memoryview]]) -> None:
        """Write parts to their places, or where a file stands for -1; what was handed over before is done then."""

        def put() -> None:
            for file, at, part in parts:
                if at >= 0:
                    file.seek(at)
                write_all(file, part.cast("B") if part.nbytes else part)

        self._wait()
        if self._pool is None:
            put()
        else:
            self._waiting = self._pool.submit(put)

    def _wait(self) -> None:
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            waiting.result()

    def _close(self) -> None:
        if self._file is None:
            return
        if self._pool is not None:
            self._pool.shutdown(wait=True)
        self._file.close()
        if self._spool is not None:
            self._spool.close()
        self._file = self._spool = self._pool = None


ENCODERS = {
    ".stl": "sppm_pipeline.services.formats.stl",
    ".ply": "sppm_pipeline.services.formats.ply",
    ".obj": "sppm_pipeline.features.files.formats.obj",
    ".off": "sppm_pipeline.features.files.formats.off",
    ".3mf": "sppm_pipeline.features.files.formats.three_mf",
    ".glb": "sppm_pipeline.features.files.formats.glb",
}
"""Extension -> module that encodes it."""

IN_PIECES = (".stl", ".ply", ".obj")
"""Formats that can be written while the mesh is made."""


@dataclass(frozen=True, kw_only=True)
class WriteMesh(Stage):
    """Write a triangle mesh; the extension chooses the format: binary STL or PLY, OBJ, OFF, 3MF or GLB.

    Coordinates are millimeters; a GLB is in meters with y up, as its specification says. The copies that
    `extract.unit_cell` places become one object of touching solids, which slicing programs unite. A .glb file holds
    their mesh once and places it, and so does a .3mf file with `copies: components`, which slicing programs may take
    for many parts to be laid side by side.
    """

    name: ClassVar[str] = "write.mesh"
    advice: ClassVar[str] = ADVICE

    path: str = options.write_path("mesh.stl", suffixes=ENCODERS)
    title: str | None = options.title(None, note="in a .3mf file; the name of the mesh if omitted")
    description: str | None = option(
        None, help="a sentence kept in a .3mf file, for instance the parameters of the design"
    )
    normals: bool = option(
        False, help="whether each vertex of a .glb file has a normal, so that viewers shade smoothly"
    )

    copies: str = option(
        "merged",
        help="what becomes of the copies of a cell in a .3mf file: merged into one object, or components that place a "
        "mesh that is stored once",
        choices=("merged", "components"),
    )

    def check_options(self) -> None:
        only_for = {"title": ".3mf", "description": ".3mf", "copies": ".3mf", "normals": ".glb"}
        require_format(self, self.path, ENCODERS, only_for)
        for name, text in (("title", self.title), ("description", self.description)):
            if text is not None and not text.isprintable():
                raise ConfigError(f"`{name}` has characters that cannot be printed: {text!r}")

    def estimate(self, palette: Palette, mesh: Size) -> Size:
        if self._placed:
            return Size(triangles=mesh.triangles, copies=mesh.copies)
        return Size(triangles=mesh.triangles * max(1.0, mesh.copies))

    @property
    def rated_as(self) -> str:
        return f"write{extension_of(self.path)}" + (".normals" if self.normals else "")

    def begin(self, context: Context) -> PieceFile | None:
        extension = extension_of(self.path)
        if extension not in IN_PIECES:
            return None
        in_pieces = importlib.import_module(ENCODERS[extension]).in_pieces
        return PieceFile(context.scratch(), in_pieces, context.threads)

    def run(self, context: Context, mesh: SurfaceMesh | RepeatedMesh) -> None:
        """Write the file."""
        if isinstance(mesh, SurfaceMesh) and not mesh.is_whole:
            context.report(bytes=context.begun.hand_over(context, self.path), triangles=mesh.counts[1])
            return
        extension = extension_of(self.path)
        options: dict[str, Any] = {"threads": context.threads}
        placed = 1
        if isinstance(mesh, RepeatedMesh):
            require_triangles(mesh.mesh, self.path)
            if not len(mesh.offsets):
                raise DesignError(f"{mesh.mesh.name!r} has no copies: there is nothing to write to {self.path}")
            context.report(copies=len(mesh.offsets))
            if self._placed:
                once, placed, options["offsets"] = mesh.mesh, len(mesh.offsets), mesh.offsets
            else:
                once = mesh.whole()
        else:
            require_triangles(mesh, self.path)
            once = mesh
        if extension == ".3mf":
            options |= self._labels(once.name)
        elif extension == ".glb":
            options["normals"] = self.normals
        encode = importlib.import_module(ENCODERS[extension]).encode
        size = write_pieces(context, self.path, encode(once.vertices, once.faces, **options))
        context.report(bytes=size, triangles=placed * len(once.faces))

    @property
    def _placed(self) -> bool:
        """True if the file holds the mesh of copies once."""
        return extension_of(self.path) == ".glb" or self.copies == "components"

    def _labels(self, mesh_name: str) -> dict[str, Any]:
        """Name and metadata of a 3MF."""
        name = "".join(c if c.isprintable() else "?" for c in mesh_name)
        about = {"Title": self.title or name, "Application": f"sppm_pipeline {sppm_pipeline.__version__}"}
        if self.description:
            about["Description"] = self.description
        return {"name": name, "metadata": about}
