"""Pipelines in several sizes by which `benchmarks.rates` measures what stages cost.

Each has a text, in which ``$name`` stands for a value, and for each name its values, a run each.
"""

from __future__ import annotations

from typing import Any

CELL = """
  - {stage: sample.mirrored_faces, edge: 2, total: $n, share: 0.5}
  - {stage: sample.dart_throwing, total: $n}
  - {stage: connect.mbdst, degree: [3, 5], mode: $mode}
  - {stage: field.gaussian, omega: $omega, mu: $omega, level: 0.25}
"""

TILES = """
recipes:
  cell:
    - {stage: sample.mirrored_faces, total: $n, share: 0.5}
    - {stage: sample.dart_throwing, total: $n}
    - {stage: connect.mbdst, mode: greedy}
    - {stage: field.gaussian, pore_radius: 0.12, tunnel_radius: 0.04}
pipeline:
"""

SIZES = {"n": (42, 42, 70, 100), "omega": (20, 20, 25, 30), "mode": ("greedy",) * 4}

ONE_CELL = {"n": (42,) * 5, "omega": (20,) * 5, "mode": ("greedy",) * 5}
"""Pores, parameters and modes; the first run warms up and is not counted."""

PIPELINES: dict[str, tuple[str, dict[str, tuple[Any, ...]]]] = {
    **{
        f"connect {mode}": (
            "pipeline:" + CELL,
            {"n": (42, 30, 66, 110), "omega": (20, 20, 30, 30), "mode": (mode,) * 4},
        )
        for mode in ("greedy", "exact")
    },
    "neighbors": (
        """pipeline:
  - {stage: sample.dart_throwing, total: $n}
  - {stage: connect.relative_neighbors}
""",
        {"n": (100, 100, 1000, 3000)},
    ),
    "samplers": (
        """pipeline:
  - {stage: sample.elimination, count: $n}
  - {stage: connect.mst}
  - {stage: field.gaussian, pore_radius: 0.1, tunnel_radius: 0.03}
""",
        SIZES,
    ),
    "hyperuniform": (
        """pipeline:
  - {stage: sample.hyperuniform, count: $n, stealth: 0.5, spacing: 0.1}
  - {stage: connect.mst}
  - {stage: field.gaussian, pore_radius: 0.1, tunnel_radius: 0.03}
""",
        SIZES,
    ),
    "walls": (
        """pipeline:
  - {stage: sample.dart_throwing, total: $n}
  - {stage: connect.mst}
  - {stage: field.walls}
""",
        {"n": (100, 100, 1000, 5000)},
    ),
    "checks": (
        "pipeline:" + CELL + """
  - {stage: check.porosity, resolution: $r}
  - {stage: check.connectivity, resolution: $r}
  - {stage: check.sizes, resolution: $r}
  - {stage: write.graph}
  - {stage: write.network, resolution: $r, cell: 5 mm}
  - {stage: write.picture, resolution: $r, image_size: [$p, $p]}
  - {stage: extract.phases, resolution: $r, coating: 0.05, filling: true}
  - {stage: extract.voxels, resolution: $r}
  - {stage: write.npy}
  - {stage: write.tiff}
  - {stage: write.vti}
""",
        {**SIZES, "r": (32, 32, 64, 100), "p": (300, 300, 700, 1200)},
    ),
    "meshes": (
        "pipeline:" + CELL + """
  - {stage: extract.marching_cubes, resolution: $r}
  - {stage: check.mesh}
  - {stage: write.stl}
  - {stage: write.ply}
  - {stage: write.obj}
  - {stage: write.off}
  - {stage: write.glb}
  - {stage: write.glb, id: smooth, path: smooth.glb, normals: true}
  - {stage: write.3mf}
  - {stage: write.picture, resolution: $r}
  - {stage: read.mesh, path: $mesh}
""",
        {**SIZES, "r": (24, 24, 40, 64), "mesh": ("mesh.stl",) * 4},
    ),
    "large meshes": (
        TILES + """
  - {stage: tileset.wang_3color, recipe: cell, porosity: 0.6, resolution: 16, tolerance: 0.05, colors: 2}
  - {stage: tile.wang_3color, cells: [$c, $c, $c], cell: 4 mm}
  - {stage: extract.marching_cubes, resolution: $r}
""",
        {"n": (42, 42, 60, 72), "c": (2, 3, 5, 7), "r": (32, 32, 40, 32)},
    ),
    "level set": (
        "pipeline:" + CELL + "  - {stage: extract.manifold_sdf, resolution: $r}\n",
        {**SIZES, "r": (12, 12, 16, 24)},
    ),
    "tetrahedra": (
        "pipeline:" + CELL + """
  - {stage: mesh.isosurface_stuffing, resolution: $r, order: $order}
  - {stage: write.vtu}
  - {stage: write.inp}
  - {stage: write.msh}
  - {stage: mesh.boundary}
""",
        {**ONE_CELL, "r": (12, 12, 20, 28, 16), "order": (1, 1, 1, 1, 2)},
    ),
    "stiffness of tetrahedra": (
        "pipeline:" + CELL + """
  - {stage: mesh.isosurface_stuffing, resolution: $r, order: $order}
  - {stage: homogenize.tet}
""",
        {**ONE_CELL, "r": (8, 8, 12, 16, 10), "order": (1, 1, 1, 1, 2)},
    ),
    "homogenization": (
        "pipeline:" + CELL + """
  - {stage: homogenize.voxel, resolution: $r}
  - {stage: write.stiffness, image_size: [$p, $p]}
  - {stage: homogenize.conductivity, resolution: $r}
""",
        {**SIZES, "r": (16, 24, 32, 64), "p": (300, 300, 600, 900)},
    ),
    "flow": (
        "pipeline:" + CELL + """
  - {stage: homogenize.permeability, resolution: $r}
  - {stage: write.flow, image_size: [$p, $p]}
  - {stage: homogenize.acoustics, resolution: $r, cell: 5 mm}
  - {stage: write.absorption}
""",
        {**SIZES, "r": (16, 16, 24, 40), "p": (300, 300, 600, 900)},
    ),
    "tuning": (
        "recipes:\n  cell:" + CELL + """pipeline:
  - {stage: tune.porosity, recipe: cell, target: 0.55, resolution: $r}
  - {stage: tune.porosity, id: counted, recipe: cell, target: 0.55, resolution: $r, fit_count: true}
  - {stage: tune.retry, recipe: cell}
  - {stage: tune.stiffness, recipe: cell, target: 0.25, resolution: $h, vary: field.gaussian.level, low: 0.1, high: 0.6,
     accuracy: 0.1}
  - {stage: homogenize.realizations, recipe: cell, resolution: $h, draws: 2}
  - {stage: write.chart, x: cells, y: E_x}
  - {stage: write.table, columns: [cells, E_x]}
  - {stage: write.bars, label: sample, columns: [E_x]}
""",
        {**SIZES, "r": (16, 16, 24, 40), "h": (8, 12, 16, 24)},
    ),
    "property": (
        "recipes:\n  cell:" + CELL + """  - {stage: check.porosity, resolution: $r}
pipeline:
  - {stage: tune.property, recipe: cell, of: check.porosity.porosity, target: 0.5, vary: field.gaussian.level, low: 0.1,
     high: 0.6, accuracy: 0.4}
""",
        {**SIZES, "r": (8, 8, 12, 16)},
    ),
    "tile sets": (
        TILES + """
  - {stage: tileset.wang_3color, id: wang, recipe: cell, colors: $c, porosity: 0.6, resolution: $r, tolerance: 0.05}
  - {stage: write.picture, id: sheet, path: sheet.png, resolution: $r}
  - {stage: tile.wang_3color, cells: [$k, $k, $k], cell: 5 mm}
  - {stage: check.residual_periodicity}
  - {stage: check.porosity, resolution: 16}
  - {stage: write.picture, id: tiling, path: tiling.png, resolution: $r}
  - {stage: slice.field, resolution: $r}
  - {stage: write.png, sheet: $s}
  - {stage: slice.field, id: uneven, pixel: $pixel}
  - {stage: write.png, id: uneven_layers, path: uneven, from: uneven, sheet: 0}
  - {stage: tile.periodic, cells: [$k, $k, $k], cell: 5 mm, from: wang}
  - {stage: extract.unit_cell, resolution: $r}
  - {stage: write.3mf}
  - {stage: write.glb}
  - {stage: tileset.free_faces, recipe: cell, colors: 1, interiors: $k, porosity: 0.6, resolution: $r, tolerance: 0.05}
  - {stage: tile.free_faces, cells: [$k, $k, $k], cell: 5 mm}
  - {stage: slice.field, id: free, resolution: $r}
  - {stage: write.png, id: free_layers, path: free, from: free, sheet: 0}
  - {stage: tileset.corner_colors, recipe: cell, colors: 2, porosity: 0.6, resolution: $r, tolerance: 0.05}
  - {stage: tile.corner_colors, cells: [$k, $k, $k], cell: 5 mm}
  - {stage: tile.fresh, recipe: cell, cells: [$c, $c, $c], cell: 5 mm, porosity: 0.6, resolution: 16}
  - {stage: tile.scattered, recipe: cell, cells: [$c, $c, $c], cell: 5 mm, porosity: 0.6, resolution: 16}
""",
        {
            "n": (42, 42, 60, 72),
            "c": (1, 2, 2, 3),
            "r": (16, 16, 24, 32),
            "k": (2, 3, 4, 6),
            "s": (0, 0, 3, 6),
            "pixel": ("0.33 mm", "0.33 mm", "0.17 mm", "0.13 mm"),
        },
    ),
    "graded": (
        TILES + """
  - {stage: grade.table, of: porosity, along: x, values: [[0, 0.5], [30, 0.7]]}
  - {stage: tile.graded, recipe: cell, cells: [$c, $c, 1], cell: 5 mm, resolution: $r}
  - {stage: tune.local_porosity, resolution: $r}
  - {stage: check.local_porosity, resolution: $r}
""",
        {"n": (42, 42, 60, 72), "c": (1, 2, 3, 4), "r": (16, 24, 32, 40)},
    ),
    "fresh cells": (
        TILES + """
  - {stage: tile.fresh, recipe: cell, cells: [$c, $c, $c], cell: 5 mm, periodic: true}
  - {stage: tile.fresh, id: tuned, recipe: cell, cells: [$c, $c, $c], cell: 5 mm, periodic: true, porosity: 0.6,
     resolution: 16}
""",
        {"n": (42, 42, 60, 72), "c": (2, 4, 8, 12)},
    ),
    "maps": (
        TILES + """
  - {stage: read.primitive, shape: ball, size: [20, 20, 20], facets: $f}
  - {stage: grade.table, of: stress, along: x, values: [[-10, 0], [10, 40]]}
  - {stage: grade.distance, of: depth}
  - {stage: grade.formula, of: weight, formula: "smoothstep(2, 8, x) + 0*depth*stress"}
  - {stage: grade.stiffness, of: soft, wanted: stress, values: [[0.3, 9], [0.8, 1]]}
  - {stage: tileset.free_faces, id: one, recipe: cell, colors: 1, interiors: 2, resolution: 16}
  - {stage: tileset.free_faces, id: two, recipe: cell, colors: 1, interiors: 2, resolution: 16}
  - {stage: tileset.join, from: {first: one, second: two}}
  - {stage: tile.joined, cells: [$k, $k, 2], cell: 3 mm}
  - {stage: tile.free_faces, id: box, cells: [$k, $k, 2], cell: 3 mm, periodic: true}
  - {stage: field.blend, probes: $p, from: {first: box, second: box}}
  - {stage: warp.cylinder, inner_radius: 4 mm, from: box}
  - {stage: warp.sphere, inner_radius: 4 mm, from: box}
""",
        {"n": (42, 42, 60, 72), "f": (32, 32, 64, 128), "k": (2, 3, 6, 10), "p": (30000, 30000, 200000, 1000000)},
    ),
    "parts": (
        TILES + """
  - {stage: tileset.wang_3color, recipe: cell, porosity: 0.6, resolution: 16, tolerance: 0.05, colors: 2}
  - {stage: read.primitive, shape: torus_knot, size: [$k mm, $k mm, $k mm], facets: $f}
  - {stage: tile.wang_3color, cell: 4 mm}
  - {stage: fill.implicit}
  - {stage: write.view, grid_samples: $v}
  - {stage: slice.field, pixel: $pixel}
  - {stage: write.png}
  - {stage: write.picture, resolution: $r}
  - {stage: extract.marching_cubes, resolution: $r}
  - {stage: write.stl}
  - {stage: slice.mesh, pixel: $pixel}
  - {stage: write.png, id: mesh_layers, path: mesh_layers}
  - {stage: slice.field, id: even, resolution: $r, from: fill.implicit}
  - {stage: write.png, id: even_layers, path: even, from: even}
  - {stage: check.print, from: even}
""",
        {"n": (42, 42, 60, 72), "k": (8, 8, 12, 18), "f": (32, 32, 64, 96), "r": (16, 16, 24, 32),
         "v": (100_000, 100_000, 1_000_000, 3_500_000),
         "pixel": ("0.2 mm", "0.2 mm", "0.1 mm", "0.08 mm")},
    ),
    "repairs": (
        TILES + """
  - {stage: tileset.wang_3color, recipe: cell, porosity: 0.6, resolution: 16, tolerance: 0.05, colors: 2}
  - {stage: read.primitive, shape: box, size: [$k mm, $k mm, $h mm]}
  - {stage: tile.wang_3color, cell: 4 mm}
  - {stage: fill.implicit, skin: 0.6 mm}
  - {stage: fix.drains, most: 3}
  - {stage: fix.fill, voxel: $pixel}
  - {stage: tune.orientation}
""",
        {"n": (42, 42, 60, 72), "k": (8, 8, 12, 18), "h": (6, 6, 20, 12),
         "pixel": ("0.2 mm", "0.2 mm", "0.15 mm", "0.1 mm")},
    ),
    "hexahedra": (
        TILES + """
  - {stage: read.hexahedra, path: $hexahedra, squares: $f}
  - {stage: tile.hexahedra, recipe: cell, path: $hexahedra}
  - {stage: tile.hexahedra, id: tuned, recipe: cell, path: $hexahedra, porosity: 0.6, resolution: $r, rounds: $k,
     trials: 1}
""",
        {"n": (42, 42, 60, 72), "hexahedra": ("mesh.vtu",) * 4, "f": (2, 2, 8, 4), "r": (16, 16, 24, 32),
         "k": (1, 0, 1, 1)},
    ),
    "booleans": (
        TILES + """
  - {stage: tileset.wang_3color, recipe: cell, porosity: 0.6, resolution: 16, tolerance: 0.05, colors: 2}
  - {stage: read.primitive, shape: ball, size: [$k mm, $k mm, $k mm], facets: $f}
  - {stage: tile.wang_3color, cell: 4 mm}
  - {stage: fill.boolean, resolution: $r, from: {field: tile.wang_3color, domain: read.primitive}}
  - {stage: read.primitive, id: tool, shape: cylinder, size: [2 mm, 2 mm, 30 mm]}
  - {stage: fill.combine, operation: difference, from: {mesh: fill.boolean, tool: tool}}
""",
        {"n": (42, 42, 60, 72), "k": (8, 8, 12, 12), "f": (32, 32, 64, 64), "r": (12, 16, 32, 48)},
    ),
    "crushing": (
        """recipes:
  cell:
    - {stage: sample.dart_throwing, total: $n}
    - {stage: connect.mst}
    - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.06}
  tuned:
    - {stage: tune.porosity, recipe: cell, target: 0.5, resolution: 24, tolerance: 0.01}
pipeline:
  - {stage: tune.porosity, recipe: cell, target: 0.6, resolution: 24, tolerance: 0.01}
  - {stage: crush.voxel, id: crush, resolution: $h, rate: 0.02, yield_stress: 0.02}
  - {stage: write.frames, from: crush, image_size: [$w, $w]}
  - {stage: tune.plateau, recipe: tuned, resolution: $h, rate: 0.02, yield_stress: 0.02, low: 0.4, high: 0.7, first: 3,
     target: 0.003, accuracy: 0.49}
""",
        {"n": (20, 20, 20, 20), "h": (8, 10, 16, 24), "w": (100, 200, 400, 300)},
    ),
    "curves": (
        """pipeline:
  - {stage: read.compression, path: test.csv, size: [45, 45, 45]}
  - {stage: measure.compression}
  - {stage: write.curves, measures: true}
""",
        {"unused": (1, 2, 3, 4)},
    ),
}  # fmt: skip
