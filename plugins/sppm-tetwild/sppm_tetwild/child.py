"""Functions of the child process: fTetWild on arrays."""

from __future__ import annotations

import importlib
import importlib.util
import sys
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import notify
from sppm_tetwild.random_device import SeededDevice


def tetrahedra(
    arrays: Mapping[str, NDArray[Any]], options: Mapping[str, Any]
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Nodes and tetrahedra inside a closed surface; and whether the random numbers were replaced."""
    notify("load fTetWild")
    pytetwild = _without_pyvista("pytetwild.pytetwild")
    library = sys.modules["pytetwild.PyfTetWildWrapper"]
    device = SeededDevice(Path(str(library.__file__)), "PyInit_PyfTetWildWrapper", options["seed"])
    notify("fill with tetrahedra")
    nodes, cells = pytetwild.tetrahedralize(
        arrays["vertices"],
        arrays["faces"],
        edge_length_fac=options["edge"],
        epsilon=options["epsilon"],
        optimize=options["optimize"],
        stop_energy=options["stop_energy"],
        coarsen=options["coarsen"],
        num_opt_iter=options["iterations"],
        num_threads=1,  # several give another mesh, and one that depends on how they interleave
        quiet=True,
    )
    made: dict[str, NDArray[Any]] = {
        "nodes": np.array(nodes, np.float64).reshape(-1, 3),
        "cells": np.array(cells, np.int32).reshape(-1, 4),
    }
    return made, {"draws": device.drawn}


def _without_pyvista(module: str) -> Any:
    """Import a module of pytetwild without running the package's ``__init__``.

    That imports pyvista and with it VTK, 140 MB that are needed for pictures only, though it declares numpy alone.
    """
    spec = importlib.util.find_spec("pytetwild")
    if spec is None or spec.submodule_search_locations is None:
        raise ModuleNotFoundError("No module named 'pytetwild'", name="pytetwild")
    package = types.ModuleType("pytetwild")
    package.__path__ = list(spec.submodule_search_locations)
    sys.modules["pytetwild"] = package
    return importlib.import_module(module)
