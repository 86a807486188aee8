"""The paper's mesh-free job as one would write it with numpy, networkx, SciPy and Pillow.

27 tiles are drawn one after the other, each evaluated on its 32^3 voxels with every kernel that can reach it; finished
binary tiles are copied into the assembly, islands are removed with scipy.ndimage, and layers saved with Pillow.

Usage: python -m benchmarks.rivals.obvious_mesh_free CELLS FOLDER
"""

from __future__ import annotations

import sys
from pathlib import Path

import networkx
import numpy as np
from PIL import Image
from scipy import ndimage

EDGE, OMEGA, MU, PORES, VOXELS, POROSITY = 2.0, 30.0, 30.0, 110, 32, 0.7


def throw(rng: np.random.Generator, count: int, spacing: float, low: float, high: float) -> np.ndarray:
    points: list[np.ndarray] = []
    while len(points) < count:
        candidate = rng.uniform(low, high, 3)
        if all(np.linalg.norm(candidate - p) >= spacing for p in points):
            points.append(candidate)
    return np.array(points)


def joined(points: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """A minimum spanning tree with edges added until every pore has three tunnels."""
    graph = networkx.Graph()
    n = len(points)
    pairs = [(float(np.linalg.norm(points[i] - points[j])), i, j) for i in range(n) for j in range(i)]
    graph.add_weighted_edges_from((i, j, w) for w, i, j in pairs)
    tree = networkx.minimum_spanning_tree(graph)
    for _, i, j in sorted(pairs):
        if (tree.degree(i) < 3 and tree.degree(j) < 5) or (tree.degree(j) < 3 and tree.degree(i) < 5):
            tree.add_edge(i, j)
    return [(points[i], points[j]) for i, j in tree.edges]


def field(pores: np.ndarray, tunnels: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    axis = (np.arange(VOXELS) + 0.5) / VOXELS * EDGE
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    total = np.zeros((VOXELS,) * 3)
    for p in pores:
        total += np.exp(-OMEGA * ((grid - p) ** 2).sum(-1))
    for a, b in tunnels:
        along = b - a
        t = np.clip(((grid - a) @ along) / (along @ along), 0, 1)
        total += np.exp(-MU * np.linalg.norm(grid - a - t[..., None] * along, axis=-1))
    return total


def main() -> None:
    cells, folder = int(sys.argv[1]), Path(sys.argv[2])
    rng = np.random.default_rng(2)
    spacing, per_face = 0.29, 15
    faces = {}
    for axis in range(3):
        for color in range(3):
            points = throw(rng, per_face, spacing * 0.8, 0.1, EDGE - 0.1)
            points[:, axis] = 0
            faces[axis, color] = points, joined(points)
    sums = []
    for tile in range(27):
        inside = throw(rng, PORES - 3 * per_face, spacing, spacing, EDGE - spacing)
        pores, tunnels = [inside], joined(inside)
        for axis, color in enumerate((tile // 9, tile // 3 % 3, tile % 3)):
            for side in (0.0, EDGE):
                shift = np.zeros(3)
                shift[axis] = side
                points, own = faces[axis, color]
                pores.append(points + shift)
                tunnels += [(a + shift, b + shift) for a, b in own]
                for p in points + shift:
                    tunnels.append((p, inside[np.argmin(((inside - p) ** 2).sum(1))]))
        sums.append(field(np.concatenate(pores), tunnels))
    level = np.quantile(np.stack(sums), 1 - POROSITY)
    tiles = [s < level for s in sums]
    n = cells * VOXELS
    assembly = np.zeros((n, n, n), bool)
    runs = rng.integers(0, 3, (3, cells, cells))
    for i in range(cells):
        for j in range(cells):
            for k in range(cells):
                tile = 9 * runs[0, j, k] + 3 * runs[1, i, k] + runs[2, i, j]
                at = tuple(slice(c * VOXELS, (c + 1) * VOXELS) for c in (i, j, k))
                assembly[at] = tiles[tile]
    labels, _ = ndimage.label(assembly)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    assembly = labels == sizes.argmax()
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(n):
        layer = (assembly[:, ::-1, k].T * np.uint8(255)).astype(np.uint8)
        Image.fromarray(layer).save(folder / f"{k:05d}.png")


if __name__ == "__main__":
    main()
