"""Small pipelines of the three kinds that there are: a part from tiles, a tuned cell, and a sweep."""

PART = """sppm: 1
name: part
seed: 7
recipes:
  cell:
    - {stage: sample.mirrored_faces, total: 30, share: 0.5}
    - {stage: sample.dart_throwing, total: 30}
    - {stage: connect.mbdst, degree: [3, 5], mode: greedy}
    - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.05}
pipeline:
  - {stage: tileset.wang_3color, recipe: cell, porosity: 0.6, resolution: 16, tolerance: 0.05}
  - {stage: read.primitive, shape: ball, size: [12 mm, 12 mm, 12 mm]}
  - {stage: tile.wang_3color, cell: 4 mm}
  - {stage: fill.implicit}
  - {stage: slice.field, pixel: 0.25 mm}
  - {stage: write.png, path: slices}
  - {stage: write.picture, path: pictures/part.png, resolution: 12, image_size: [200, 150]}
  - {stage: extract.marching_cubes, resolution: 14}
  - {stage: write.mesh, id: stl, path: meshes/part.stl}
  - {stage: write.mesh, id: ply, path: meshes/part.ply}
"""

CELL = """sppm: 1
name: cell
seed: 1
recipes:
  cell:
    - {stage: sample.mirrored_faces, edge: 2, total: 40, share: 0.5}
    - {stage: sample.dart_throwing, total: 40}
    - {stage: connect.mbdst, degree: [3, 5], mode: greedy}
    - {stage: field.gaussian, omega: 30, mu: 30, level: 0.25}
pipeline:
  - {stage: tune.porosity, recipe: cell, target: 0.5, resolution: 24, tolerance: 0.01}
  - {stage: write.graph, path: graph.graphml}
  - {stage: check.connectivity, resolution: 24}
  - {stage: extract.marching_cubes, resolution: 24}
  - {stage: write.mesh, path: cell.ply}
"""

SWEEP = """sppm: 1
name: sweep
seed: 0
params: {pores: 30}
pipeline:
  - {stage: sample.mirrored_faces, edge: 2, total: "${pores}", share: 0.5}
  - {stage: sample.dart_throwing, total: "${pores}"}
  - {stage: connect.mbdst, degree: [3, 5], mode: greedy}
  - {stage: field.gaussian, omega: 30, mu: 30, level: 0.25}
  - {stage: check.porosity, resolution: 32}
  - {stage: write.graph, path: graph.graphml}
sweep:
  pores: [20, 40]
  seed: {from: 1, to: 3}
after:
  - {stage: write.chart, x: pores, y: check.porosity.porosity, path: chart.png}
"""

PIPELINES = {"part": (PART, []), "cell": (CELL, []), "sweep": (SWEEP, ["-j", "2"])}
"""Name -> configuration and further words of the command."""
