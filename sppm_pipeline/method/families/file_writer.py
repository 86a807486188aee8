"""Base of stages that write one file: the format chosen by the extension, the file written piece by piece."""

from __future__ import annotations

import dataclasses
import hashlib
from abc import abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import PurePath
from typing import IO, ClassVar, Protocol

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.services.threads import computed_ahead
from sppm_pipeline.stage import Context, Stage

ADVICE = "extract with a lower `resolution`, or slice without a mesh (`slice.field`)"
"""Hint of errors about meshes that do not fit."""


class Digest(Protocol):
    """A digest of `hashlib`."""

    def update(self, data: memoryview, /) -> None: ...


def extension_of(path: str) -> str:
    """The extension of a file name in lower case, with its dot."""
    return PurePath(path).suffix.lower()


def require_format(stage: Stage, path: str, known: Collection[str], only_for: Mapping[str, str]) -> None:
    """Raise ConfigError for an extension that isn't `known`, or options that its format does not have.

    Extensions are in lower case, with dots. `only_for` maps options to the extension they belong to; for every other
    one they must keep their defaults.
    """
    extension = extension_of(path)
    if extension not in known:
        raise ConfigError(f"`path` is {path!r}; it must end in {', '.join(known)}")
    defaults = {field.name: field.default for field in dataclasses.fields(stage)}
    for name, owner in only_for.items():
        if extension != owner and getattr(stage, name) != defaults[name]:
            raise ConfigError(
                f"`{name}` is an option of {owner} files; a {extension} file has no such option",
                hint=f"leave out `{name}`, or write a {owner} file",
            )


def require_triangles(mesh: SurfaceMesh, path: str) -> None:
    """Raise DesignError for a mesh without triangles."""
    if not len(mesh.faces):
        raise DesignError(f"{mesh.name!r} has no triangles: there is nothing to write to {path}")


def write_pieces(context: Context, path: str, pieces: Iterable[bytes | memoryview]) -> int:
    """Write an output file piece by piece, and hash it on the way; returns its size in bytes.

    With more than one thread, pieces are hashed while they are written.
    """
    digest = hashlib.sha256()
    with context.output(path).open("wb", buffering=0) as file:
        size = write_hashed(file, pieces, digest, context.threads)
    context.hashed(path, digest.hexdigest())
    return size


def write_hashed(file: IO[bytes], pieces: Iterable[bytes | memoryview], digest: Digest, threads: int) -> int:
    """Write pieces where a file without a buffer stands, and hash them; returns their size in bytes.

    With more than one thread, pieces are hashed while they are written.
    """

    def hashed() -> Iterator[memoryview]:
        for piece in pieces:
            view = memoryview(piece)
            if view.nbytes:
                rows = view.cast("B")  # what a write takes is counted in bytes
                digest.update(rows)
                yield rows

    size = 0
    for rows in computed_ahead(hashed(), threads):
        size += rows.nbytes
        write_all(file, rows)
    return size


def write_all(file: IO[bytes], rest: memoryview) -> None:
    """Write bytes where a file without a buffer stands."""
    while rest:  # without a buffer, one call may write less than it was given
        rest = rest[file.write(rest) :]


@dataclass(frozen=True, kw_only=True)
class MeshWriter(Stage):
    """Base of writers of a mesh format: implement `encode` and declare the option `path`."""

    path: str

    advice: ClassVar[str] = ADVICE

    @abstractmethod
    def encode(self, mesh: SurfaceMesh, threads: int) -> Iterable[bytes | memoryview]:
        """The content of the file, piece by piece; the same bytes for any number of threads."""

    def run(self, context: Context, mesh: SurfaceMesh) -> None:
        """Write the file."""
        require_triangles(mesh, self.path)
        size = write_pieces(context, self.path, self.encode(mesh, context.threads))
        context.report(bytes=size, triangles=len(mesh.faces))
