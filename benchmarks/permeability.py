"""Permeability: spheres whose drag is known, and what a cell costs beside the unit matrix as pressure preconditioner.

Usage: python -m benchmarks.permeability [SIZES ...]
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import table
from sppm_pipeline.features.flow.numerics import stokes
from sppm_pipeline.features.flow.numerics.faces import faces_of_field, percolating
from sppm_pipeline.method.stages.connect_relative_neighbors import RelativeNeighbors
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.multigrid.solver import Stop
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

SC = ((0.5, 0.5, 0.5),)
BCC = ((0.0, 0.0, 0.0), (0.5, 0.5, 0.5))
FCC = ((0.0, 0.0, 0.0), (0.5, 0.5, 0.0), (0.5, 0.0, 0.5), (0.0, 0.5, 0.5))
DRAGS = (
    ("SC", SC, 0.064, 2.810), ("SC", SC, 0.125, 4.292), ("SC", SC, 0.216, 7.442), ("SC", SC, 0.343, 15.4),
    ("SC", SC, 0.45, 28.1), ("SC", SC, 0.5236, 42.1), ("BCC", BCC, 0.6802, 163.0), ("FCC", FCC, 0.7405, 435.0),
)  # fmt: skip
"""Lattice, centers, share of the spheres, drag over that of Stokes (Zick and Homsy 1982)."""

Sample = Callable[[Grid], NDArray[np.float32]]


def outside(centers: Any, radius: float) -> Sample:
    """Distance from spheres, (nz, ny, nx)."""

    def sample(grid: Grid) -> NDArray[np.float32]:
        x, y, z = grid.axis(0), grid.axis(1)[:, None], grid.axis(2)[:, None, None]
        squares = [sum(((v - c + 0.5) % 1 - 0.5) ** 2 for v, c in zip((x, y, z), p, strict=True)) for p in centers]
        return np.asarray(np.sqrt(np.min(squares, axis=0)) - radius, np.float32)

    return sample


def cell() -> Sample:
    """A cell of 42 pores with tunnels of radius 0.035."""
    field = recipe_of(
        DartThrowing(total=42, share=0.5),
        RelativeNeighbors(),
        GaussianField(pore_radius=Length(0.13), tunnel_radius=Length(0.035)),
    ).run(PlainContext(4))
    return lambda grid: field.sample_zyx(grid, 0, grid.shape[2], 1)


def main(sizes: list[int]) -> None:
    """Print both tables."""
    rows = []
    for name, centers, share, known in DRAGS:
        radius = (3 * share / 4 / np.pi / len(centers)) ** (1 / 3)
        row = [f"{name} {share:g}", f"{known:g}"]
        for n in sizes:
            faces = percolating(faces_of_field(outside(centers, radius), (n, n, n), 1 / n)).faces
            k = stokes.stokes_flow(faces, 1 - share, (True, False, False)).permeability[0, 0] / n**2
            row.append(f"{100 * (1 / (6 * np.pi * radius * len(centers) * k) / known - 1):+.2f} %")
        rows.append(row)
    table("drag of spheres", ["spheres", "known", *(f"error at {n}^3" for n in sizes)], rows)
    rows, sample = [], cell()
    for n in sizes:
        started = time.process_time()
        faces = faces_of_field(sample, (n, n, n), 1 / n)
        way = percolating(faces)
        sampled = time.process_time()
        found = stokes.stokes_flow(way.faces, faces.porosity, way.wraps)
        solved = time.process_time()
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        velocity = [stokes._velocity_hierarchy(way.faces, (1.0, 1.0, 1.0), d, 1.0) for d in range(3)]
        nothing = [np.zeros(n**3, np.float32)] * 3
        weights = np.concatenate([weight.reshape(-1) for weight in way.faces.weights])
        plain = stokes._Problem(weights, (1.0, 1.0, 1.0), velocity, nothing, (n, n, n))
        _, cases = plain.solve([0, 1, 2], Stop(0.0, 1e-3, 500), 0.0, np.dtype(np.float32), 1)
        rows.append([
            f"{n}^3", f"{1e4 * found.permeability[0, 0] / n**2:.4f}",
            f"{sampled - started:.2f}", f"{solved - sampled:.2f}", f"{peak:.0f}",
            " ".join(str(case.iterations) for case in found.solved), " ".join(str(case.iterations) for case in cases),
        ])  # fmt: skip
    header = ["voxels", "k11, 1e-4", "CPU s sampled", "solved", "peak MB", "iterations", "with the unit matrix"]
    table("a cell, three flows", header, rows)


if __name__ == "__main__":
    main([int(size) for size in sys.argv[1:]] or [32, 64])
