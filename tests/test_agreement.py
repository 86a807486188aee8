"""Layers straight from the field agree with sections of the extracted mesh, cut by trimesh, filled by a plain rule."""

import json

import numpy as np
import pytest
import trimesh
from PIL import Image

VOXELS = 32  # along a cell edge
# no multiple of the pixels: a node of the mesh's grid at a pixel's center has the sign of that pixel by construction
FINE, COARSE = 61, 23
YAML = f"""sppm: 1
name: agreement
seed: 5
params: {{mesh_voxels: {FINE}}}
recipes:
  cell:
    - {{stage: sample.mirrored_faces, total: 30, share: 0.5}}
    - {{stage: sample.dart_throwing, total: 30}}
    - {{stage: connect.mbdst, degree: [2, 5], mode: greedy}}
    - {{stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.05}}
pipeline:
  - {{stage: tileset.wang_3color, recipe: cell, porosity: 0.5, colors: 2, resolution: 24, tolerance: 0.02}}
  - {{stage: read.primitive, shape: ball, size: [9 mm, 8 mm, 7 mm]}}
  - {{stage: tile.wang_3color, cell: 4 mm}}
  - {{stage: fill.implicit, islands: remove}}
  - {{stage: slice.field, resolution: {VOXELS}}}
  - {{stage: write.png, path: slices, sheet: 0}}
  - {{stage: extract.marching_cubes, resolution: "${{mesh_voxels}}", islands: remove}}
  - {{stage: write.mesh, path: part.stl}}
"""


def layers(folder):
    """The stack as written: layers, rows from low to high y, columns from low to high x; and its manifest."""
    manifest = json.loads((folder / "slices" / "manifest.json").read_text())
    files = sorted((folder / "slices").glob("*.png"))
    assert len(files) == manifest["layers"]
    return np.stack([np.asarray(Image.open(f).convert("L"))[::-1] >= 128 for f in files]), manifest


def filled(segments, x, y):
    """Whether pixel centers (rows at `y`, columns at `x`) lie within an outline: even-odd along every row."""
    a, b = segments[:, 0], segments[:, 1]
    image = np.zeros((len(y), len(x)), bool)
    for row, height in enumerate(y):
        crossed = (a[:, 1] <= height) != (b[:, 1] <= height)
        (ax, ay), (bx, by) = a[crossed].T, b[crossed].T
        at = ax + (height - ay) / (by - ay) * (bx - ax)
        image[row] = np.searchsorted(np.sort(at), x) % 2 == 1
    return image


def sections(folder, manifest, shift=0.0):
    """Sections of the mesh file at the mid-height of every layer, or `shift` layers above it."""
    mesh = trimesh.load_mesh(folder / "part.stl")
    ox, oy, oz = manifest["origin_mm"]
    x = ox + (np.arange(manifest["width_px"]) + 0.5) * manifest["pixel_mm"][0]
    y = oy + (np.arange(manifest["height_px"]) + 0.5) * manifest["pixel_mm"][1]
    heights = (np.arange(manifest["layers"]) + 0.5 + shift) * manifest["layer_mm"]
    pieces, frames, _ = trimesh.intersections.mesh_multiplane(mesh, (0, 0, oz), (0, 0, 1), heights)
    cut = [
        np.asarray(piece).reshape(-1, 2, 2) @ frame[:2, :2].T + frame[:2, 3]
        for piece, frame in zip(pieces, frames, strict=True)
    ]
    return np.stack([filled(segments, x, y) for segments in cut])


def overlap(a, b):
    """Intersection over union."""
    return (a & b).sum() / (a | b).sum()


def test_even_odd_rule_fills_a_ring():
    outer, inner = (np.array([[-r, -r], [r, -r], [r, r], [-r, r]]) for r in (3.0, 1.0))
    ring = np.concatenate([np.stack([p, np.roll(p, -1, axis=0)], axis=1) for p in (outer, inner)])
    at = np.arange(-4.5, 5)
    across = np.maximum(*np.abs(np.meshgrid(at, at)))
    np.testing.assert_array_equal(filled(ring, at, at), (across < 3) & (across > 1))


def test_layers_are_the_sections_of_the_mesh(run_yaml):
    _, folder = run_yaml(YAML, to="fine")
    ours, manifest = layers(folder)
    theirs = sections(folder, manifest)
    fine = overlap(ours, theirs)
    assert fine >= 0.99  # 0.994 measured; the rest is the mesh's chords, a quarter of it at twice as fine
    # nothing of this is luck: a mirrored part, or one cut a quarter of a layer off, is another part
    assert max(overlap(ours, theirs[:, ::-1]), overlap(ours, theirs[:, :, ::-1])) < 0.6
    below, above = (overlap(ours, sections(folder, manifest, shift)) for shift in (-0.25, 0.25))
    assert max(below, above) < fine - 0.02
    assert below == pytest.approx(above, abs=0.01)  # so the layers are cut in their middle

    _, folder = run_yaml(YAML, p=[f"mesh_voxels={COARSE}"], to="coarse")
    assert 0.95 < overlap(ours, sections(folder, manifest)) < fine
