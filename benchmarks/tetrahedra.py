"""Tetrahedral meshes of the paper's cell by isosurface stuffing: size, time, angles, and how the volume converges.

Usage: python -m benchmarks.tetrahedra
"""

from __future__ import annotations

import math

import numpy as np
from sppm_tetrahedra.numerics.quality import dihedral_histogram, quality
from sppm_tetrahedra.stages.mesh_isosurface_stuffing import IsosurfaceStuffing

from benchmarks.measure import repeat_in_process, table
from sppm_pipeline.method.fields.microstructure import Microstructure
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

EXACT = 384
"""Voxels along the edge whose centers tell the volume that the meshes are held against."""


LOG = math.log(1 / 0.25)  # an isolated kernel has the level 0.25 at its radius: exp(-omega r^2) and exp(-mu r)


def paper_cell() -> Microstructure:
    """66 pores, half of them on the faces, omega = mu = 30 in the cell [-1, 1]^3, as in configs/cell.yaml."""
    recipe = recipe_of(
        MirroredFaces(edge=Length(2.0, "mm"), total=66, share=0.5),
        DartThrowing(total=66),
        BoundedDegreeSubgraph(degree=(3, 5), mode="exact"),
        GaussianField(pore_radius=Length(math.sqrt(LOG / 30), "mm"), tunnel_radius=Length(LOG / 30, "mm"), level=0.25),
    )
    made = recipe.run(PlainContext(1))
    assert isinstance(made, Microstructure)
    return made


def solid_share(cell: Microstructure) -> float:
    """Share of voxel centers in the solid, slab by slab."""
    grid = cell_centers(EXACT)
    return float(np.mean([(cell.sample_layers(grid, k, k + 8) < 0).mean() for k in range(0, EXACT, 8)]))


def main() -> None:
    cell = paper_cell()
    exact = solid_share(cell) * cell.physical_edge() ** 3
    rows: list[list[object]] = []
    before = 0.0
    for n in (16, 32, 64):
        stage = IsosurfaceStuffing(resolution=n, islands="keep")
        mesh = stage.run(PlainContext(), cell)
        wall, cpu = repeat_in_process(lambda: stage.run(PlainContext(), cell), 3)  # noqa: B023
        shape = quality(mesh.nodes, mesh.cells)
        error = mesh.volume / exact - 1
        order = np.log2(before / abs(error)) if before else ""
        before = abs(error)
        rows.append(
            [n, len(mesh.cells), len(mesh.nodes), wall, cpu, shape.minimum_dihedral, shape.maximum_dihedral,
             shape.radius_ratio, 100 * error, order]
        )  # fmt: skip
        shares = 100 * dihedral_histogram(mesh.nodes, mesh.cells, 18) / (6 * len(mesh.cells))
        print(f"{n}: % of dihedral angles by tens of degrees: " + " ".join(f"{share:.2f}" for share in shares))
    head = ["cubes", "tets", "nodes", "wall s", "CPU s", "least", "greatest", "R/3r", "volume error %", "order"]
    table("isosurface stuffing of a cell, with sampling", head, rows)


if __name__ == "__main__":
    main()
