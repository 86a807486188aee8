"""Solid of the front page's knot that is thin, as cut and with a border, and triangles of its mesh before and after.

Usage: ``python -m benchmarks.borders``. Thin is what has a local thickness below 0.3 mm on voxels of 0.05 mm; patches
are what of it is connected across faces of voxels. Times are those of a processor, the second of two runs.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import sppm_pipeline as sppm
from sppm_pipeline.features.surface.numerics.simplifying import qualities, simplify
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.connectivity.components import find_components
from sppm_pipeline.method.part.border import Border
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.surface_net import surface_net
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.local_thickness import local_thickness
from sppm_pipeline.services.mesh.measures import genus
from sppm_pipeline.testing.plain_context import PlainContext

ROOT = Path(__file__).resolve().parents[1]
THINNEST, STRUT, VOXEL, PATCH, WITHIN = 0.3, 0.5, 0.05, 50, 0.02


def main() -> None:
    """Print one line for each kind of border."""
    part: Part = sppm.run(str(ROOT / "configs" / "quickstart.yaml"), until="fill.implicit")["fill.implicit"]
    edge = part.physical_edge()
    low = (part.domain.lower + VOXEL / 2 - part.origin_mm) / edge
    nx, ny, nz = (round(float(side) / VOXEL) for side in part.domain.upper - part.domain.lower)
    grid = Grid((float(low[0]), float(low[1]), float(low[2])), (VOXEL / edge,) * 3, (nx, ny, nz))
    net = surface_net(part.domain.vertices[part.domain.faces], edge / 2, STRUT / 2, np.random.default_rng(0))
    ways = {
        "cut": part,
        "round": replace(part, border=Border(THINNEST)),
        "frame": replace(part, border=Border(THINNEST), fills=net.capsules),
    }
    for name, way in ways.items():
        for _ in range(2):  # the first one compiles
            made, start = replace(way), time.process_time()
            solid = np.concatenate([made.solid_zyx(grid, k, min(nz, k + 18)) for k in range(0, nz, 18)])
            taken = time.process_time() - start
        found = find_components(solid)
        share = found.sizes[0] / found.sizes.sum()
        thickness = local_thickness(np.pad(solid, 2), (False,) * 3)
        thin = (thickness > 0) & (thickness < THINNEST / VOXEL)
        patches = find_components(thin.view(np.uint8)).sizes
        mesh = MarchingCubes(resolution=40).run(PlainContext(), made)
        for _ in range(2):
            start = time.process_time()
            few = simplify(mesh.vertices, mesh.faces, WITHIN)
            simplified = time.process_time() - start
        print(
            f"{name:6} solid {solid.sum() * VOXEL**3:.1f} mm3 in {taken:.2f} s, {share:.2%} in "
            f"one piece; thin {thin.sum() / solid.sum():.2%}, {(patches > PATCH).sum()} patches above {PATCH} voxels; "
            f"{len(mesh.faces)} triangles, {len(few.faces)} within {few.farthest:.4f} mm in {simplified:.2f} s, genus "
            f"{genus(mesh.faces)} and {genus(few.faces)}, quality below 0.1: "
            f"{(qualities(mesh.vertices, mesh.faces) < 0.1).mean():.2%} and "
            f"{(qualities(few.vertices, few.faces) < 0.1).mean():.2%}"
        )


if __name__ == "__main__":
    main()
