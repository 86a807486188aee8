"""Connected parts of the graph of pores and tunnels of a whole layout, found piece by piece."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.assembly.contents import TilingArrays, connector_code
from sppm_pipeline.services.arrays import I32, I64


def parts_of_layout(
    piece: NDArray[np.integer],
    edges: NDArray[np.integer],
    shift: NDArray[np.integer],
    interiors: int,
    colors: tuple[int, int, int],
    tiling: TilingArrays,
) -> int:
    """Number of connected parts of the graph of a layout, with the cells around it; a pore without tunnels is one.

    On every pore center and tunnel axis the sum of the kernels is at least 1. Under a level below 1 all of them are
    void, so that in one part they lie in one component of the void.

    `piece` (n,) is that of each pore: interiors, then face patterns by axis and color; `colors` the number of interiors
    and of face patterns of each axis. Tunnels `edges` (m, 2), `shift` (m, 3) from an interior to a face have the shift
    1 where they end on its high side.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    def components(nodes: int, first: NDArray[np.integer], second: NDArray[np.integer]) -> tuple[int, I32]:
        links = coo_array((np.ones(len(first), np.int8), (first, second)), (nodes, nodes))
        found: tuple[int, I32] = connected_components(links, directed=False)
        return found

    first, second = (edges[:, end].astype(np.int64) for end in range(2))
    crossing = (piece[first] < interiors) & (piece[second] >= interiors)
    # parts within pieces first, of which there are few, then the layout of many places
    _, within = components(len(piece), first[~crossing], second[~crossing])
    if not sum(colors):
        return int(within.max(initial=-1)) + 1  # blocks without faces are joined across their borders, each once
    # the parts within each piece, numbered from 0 in each
    order = np.unique(np.column_stack([piece, within]), axis=0)
    begin = np.searchsorted(order[:, 0], np.arange(interiors + sum(colors) + 1))
    own = np.empty(int(within.max(initial=0)) + 1, np.int64)
    own[order[:, 1]] = np.arange(len(order)) - begin[order[:, 0]]
    counts, local = np.diff(begin), own[within]
    # every place of the layout is given as many nodes as its piece has parts
    first_color = np.concatenate([[0], np.cumsum(colors)])
    pieces = [tiling.interior.ravel().astype(np.int64)]
    for axis, faces in enumerate(tiling.faces):
        shown = np.take(faces, range(faces.shape[axis] - 1), axis) if tiling.periodic else faces
        pieces.append(np.where(shown >= 0, interiors + first_color[axis] + shown, -1).ravel().astype(np.int64))
    flat = np.concatenate(pieces)
    sizes = np.where(flat >= 0, counts[flat], 0)
    node = np.concatenate([[0], np.cumsum(sizes)])
    start = np.cumsum([0, *(len(p) for p in pieces)])
    # which parts a connector joins, by interior, axis, side and color
    ends, most = piece[second[crossing]], max(colors)
    axis_of = np.searchsorted(first_color, ends - interiors, side="right") - 1
    codes = connector_code(
        piece[first[crossing]], axis_of, shift[crossing].sum(1), ends - interiors - first_color[axis_of], colors=most
    )
    joins = np.unique(np.column_stack([codes, local[first[crossing]], local[second[crossing]]]), axis=0)
    known, begins = np.unique(joins[:, 0], return_index=True)
    at: I64 = np.concatenate([begins, [len(joins)]])
    cells = np.argwhere(tiling.interior >= 0)
    number = np.asarray(np.ravel_multi_index(tuple(cells.T), tiling.interior.shape))
    # each face of each cell: the connectors that its interior has to a face of that color
    links = [np.zeros((0, 2), np.int64)]
    for axis, faces in enumerate(tiling.faces):
        shape = tuple(n - (tiling.periodic and a == axis) for a, n in enumerate(faces.shape))
        for side in range(2):
            place = cells.copy()
            place[:, axis] += side
            color = faces[tuple(place.T)]
            place[:, axis] %= shape[axis]
            face = start[1 + axis] + np.asarray(np.ravel_multi_index(tuple(place.T), shape))
            code = connector_code(tiling.interior[tuple(cells.T)], axis, side, color, colors=most)
            row = np.minimum(np.searchsorted(known, code), max(len(known) - 1, 0))
            there = np.flatnonzero((color >= 0) & (known[row] == code)) if len(known) else np.zeros(0, np.int64)
            times = at[row[there] + 1] - at[row[there]]
            which = np.repeat(at[row[there]], times) + _counted(times)
            links.append(
                np.column_stack([
                    node[np.repeat(number[there], times)] + joins[which, 1],
                    node[np.repeat(face[there], times)] + joins[which, 2],
                ])
            )  # fmt: skip
    pairs = np.concatenate(links)
    return components(int(node[-1]), pairs[:, 0], pairs[:, 1])[0]


def _counted(times: I64) -> I64:
    """0, 1, ... for each entry in turn."""
    ends = np.cumsum(times)
    return np.arange(int(ends[-1]) if len(ends) else 0) - np.repeat(ends - times, times)
