"""Finite elements in the files of other programs, read by meshio."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.services.formats.input_file import library, require_file, third_party_reader

READERS = {".vtu": "vtu", ".vtk": "vtk", ".inp": "abaqus", ".msh": "gmsh"}
"""Modules of meshio by the suffix of a file."""

LARGEST_FILE = 2 * 2**30
"""Bytes; larger files are refused before they are read."""


def check_elements(path: Path) -> None:
    """Raise `ConfigError` if the suffix of a file is none that `read_elements` reads: .vtu, .vtk, .inp, .msh."""
    if path.suffix.lower() not in READERS:
        raise ConfigError(f"`path` is {str(path)!r}; known are {', '.join(READERS)}")


def read_elements(path: Path, hint: str) -> Any:
    """What a VTU, VTK, Abaqus INP or Gmsh MSH file holds.

    Parameters
    ----------
    path : Path
    hint : str
        What to do about a file that can't be read, for the message.

    Returns
    -------
    meshio.Mesh

    Raises
    ------
    InputError
        If the file is none, is too large, or can't be read.
    ResourceError
        If meshio is not installed.
    """
    require_file(path, LARGEST_FILE)
    reader = library(f"meshio.{READERS[path.suffix.lower()]}", "volume")
    with third_party_reader("meshio", path.name, hint):
        return reader.read(path)
