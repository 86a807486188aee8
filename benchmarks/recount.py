"""The porosity of a cell of a laid structure, counted again from its pores and tunnels alone.

It shares no code with the program's sums, layouts and levels: kernels are placed and summed here by numpy, in float64.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.fields.tiling import Tiling

_PORE_REACH, _TUNNEL_REACH = 18.0, 16.0  # exponents beyond which a kernel is left out: 2e-8 and 1e-7


def laid_kernels(tiling: Tiling) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """All pores, rows (x, y, z, omega), and tunnels, rows (start, end, mu), of a layout that does not repeat.

    Sizes are those of the microstructure's kernels, found again by their places.
    """
    micro, arrays = tiling.tileset.micro, tiling.arrays
    graph, kernels = micro.graph, micro.pieces.kernels
    if kernels.pore_metric is not None:
        raise ValueError("stretched kernels can't be counted again")
    pores, halo = graph.pores, arrays.halo
    # rounded, as a place has to be the same key to its last digit
    omega = {tuple(c): w for c, w in zip(kernels.centers.round(12).tolist(), kernels.omega.tolist(), strict=True)}
    mu = {
        (*a, *b): m
        for a, b, m in zip(
            kernels.starts.round(12).tolist(), kernels.ends.round(12).tolist(), kernels.mu.tolist(), strict=True
        )
    }
    places: dict[int, list[NDArray[np.integer]]] = {}
    faces_at: dict[tuple[int, ...], set[tuple[int, int, int, int]]] = {}
    for cell in np.argwhere(arrays.interior >= 0):
        interior = int(arrays.interior[tuple(cell)])
        places.setdefault(interior, []).append(cell - halo)
        for axis in range(3):
            for side in range(2):
                at = cell.copy()
                at[axis] += side
                color = int(arrays.faces[axis][tuple(at)])
                if color >= 0:
                    faces_at.setdefault(tuple(cell - halo), set()).add((interior, axis, side, color))
    # pieces are numbered interiors first, then the colors of the faces across x, y and z
    first_color = np.concatenate([[0], np.cumsum(pores.colors)])
    for axis in range(3):
        for at in np.argwhere(arrays.faces[axis] >= 0):
            piece = pores.interiors + int(first_color[axis]) + int(arrays.faces[axis][tuple(at)])
            places.setdefault(piece, []).append(at - halo)
    found = [
        (*(center + place), omega[tuple(center.round(12).tolist())])
        for center, piece in zip(pores.centers, pores.piece, strict=True)
        for place in places.get(int(piece), [])
    ]
    tunnels = []
    for (i, j), shift in zip(graph.edges, graph.shift, strict=True):
        start, end = pores.centers[i], pores.centers[j] + shift
        width = mu[(*start.round(12).tolist(), *end.round(12).tolist())]
        one, other = int(pores.piece[i]), int(pores.piece[j])
        if one < pores.interiors <= other:  # a connector stands where its interior meets its face
            face = other - pores.interiors
            axis = int(np.searchsorted(first_color, face, side="right")) - 1
            key = (one, axis, int(shift[axis]), face - int(first_color[axis]))
            where = [place for place in places[one] if key in faces_at[tuple(place)]]
        else:
            where = places.get(one, [])
        tunnels += [(*(start + place), *(end + place), width) for place in where]
    return np.array(found), np.array(tunnels).reshape(-1, 7)


def recounted_porosity(
    kernels: tuple[NDArray[np.float64], NDArray[np.float64]],
    log_level: NDArray[np.float64],
    cell: tuple[int, int, int],
    n: int,
) -> float:
    """Share of void in a cell on n^3 voxel centers, for linear tunnels and a level between control points.

    `kernels` are those of `laid_kernels`; `log_level` (nx, ny, nz) are control points of ln C, one a cell.
    """
    pores, tunnels = kernels
    t = (np.arange(n) + 0.5) / n
    x, y, z = (c + t for c in cell)
    # from each pore to the nearest point of the cell
    near = np.array([np.clip(pores[:, a], c, c + 1) - pores[:, a] for a, c in enumerate(cell)])
    pores = pores[(near**2).sum(0) * pores[:, 3] < _PORE_REACH]
    # a Gaussian is a product over the axes: three short vectors a pore, not n^3 exponentials
    along = [np.exp(-pores[:, 3, None] * (p - pores[:, a, None]) ** 2) for a, p in enumerate((x, y, z))]
    flat = (along[0][:, :, None] * along[1][:, None, :]).reshape(len(pores), n * n)
    total = (flat.T @ along[2]).reshape(n, n, n)
    reaches = _TUNNEL_REACH / tunnels[:, 6]
    low_ends, high_ends = np.minimum(tunnels[:, :3], tunnels[:, 3:6]), np.maximum(tunnels[:, :3], tunnels[:, 3:6])
    corner = np.array(cell)
    meeting = ((low_ends - reaches[:, None] < corner + 1) & (high_ends + reaches[:, None] > corner)).all(1)
    for row, reach in zip(tunnels[meeting], reaches[meeting], strict=True):
        start, end, mu = row[:3], row[3:6], row[6]
        box = []
        for p, a, b in zip((x, y, z), start, end, strict=True):
            low, high = np.searchsorted(p, (min(a, b) - reach, max(a, b) + reach))
            box.append(slice(int(low), int(high)))
        points = np.stack(np.meshgrid(x[box[0]], y[box[1]], z[box[2]], indexing="ij"), -1) - start
        if points.size:
            axis = end - start
            # the nearest point of the tunnel's axis
            share = np.clip(points @ axis / (axis @ axis), 0, 1)
            total[tuple(box)] += np.exp(-mu * np.linalg.norm(points - share[..., None] * axis, axis=-1))
    # quadratic B-splines, whose control points stand at the centers of cells
    weights = [(1 - t) ** 2 / 2, 0.5 + t - t**2, t**2 / 2]
    level = np.zeros((n, n, n))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                # the outermost control points go on beyond the box
                place = tuple(
                    min(max(c + d - 1, 0), size - 1)
                    for c, d, size in zip(cell, (i, j, k), log_level.shape, strict=True)
                )
                level += log_level[place] * np.einsum("a,b,c->abc", weights[i], weights[j], weights[k])
    return float((total >= np.exp(level)).mean())
