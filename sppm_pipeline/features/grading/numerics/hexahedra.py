"""Meshes of hexahedra that are a block: rows, columns and layers found from which faces are shared, and mapped."""

from __future__ import annotations

import itertools
from collections import deque

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.grading.numerics.hexahedral_mesh import PLACES
from sppm_pipeline.features.grading.numerics.hexahedral_places import points_in


def block_of(hexahedra: NDArray[np.int64]) -> NDArray[np.int64]:
    """The nodes (nx + 1, ny + 1, nz + 1) of hexahedra (m, 8) as a block, whose axes are those of the first element.

    Nodes are in VTK's order; each element may begin at any corner, wound either way. `ValueError` if the elements are
    no block of nx x ny x nz.
    """
    cubes = hexahedra[:, PLACES].reshape(-1, 2, 2, 2)
    owners: dict[frozenset[int], list[int]] = {}
    for number, cube in enumerate(cubes):
        for axis, side in itertools.product(range(3), range(2)):
            owners.setdefault(frozenset(cube.take(side, axis).ravel().tolist()), []).append(number)
    if any(len(found) > 2 for found in owners.values()):
        raise ValueError("three elements share a face")
    place: dict[int, tuple[int, int, int]] = {0: (0, 0, 0)}
    turned = {0: cubes[0]}
    # from element to element across their faces, each turned so that it fits the one it was reached from
    waiting = deque([0])
    while waiting:
        number = waiting.popleft()
        cube = turned[number]
        for axis, side in itertools.product(range(3), range(2)):
            face = cube.take(side, axis)
            others = [other for other in owners[frozenset(face.ravel().tolist())] if other != number]
            if not others:
                continue
            step = [0, 0, 0]
            step[axis] = 2 * side - 1
            there = (place[number][0] + step[0], place[number][1] + step[1], place[number][2] + step[2])
            if others[0] in place:
                if place[others[0]] != there:
                    raise ValueError(f"elements {number} and {others[0]} are neighbors in two ways")
                continue
            place[others[0]] = there
            turned[others[0]] = _fitted(cubes[others[0]], face, axis, side)
            waiting.append(others[0])
    if len(place) < len(cubes):
        raise ValueError("its elements are not all connected by faces")
    sites = np.array([place[number] for number in range(len(cubes))])
    sites -= sites.min(axis=0)
    size = sites.max(axis=0) + 1
    if len(np.unique(sites, axis=0)) != len(cubes) or np.prod(size) != len(cubes):
        raise ValueError(f"{len(cubes)} elements do not fill a block of {size[0]} x {size[1]} x {size[2]}")
    nodes = np.full(tuple(size + 1), -1, np.int64)
    for number, (i, j, k) in enumerate(sites.tolist()):
        own = nodes[i : i + 2, j : j + 2, k : k + 2]
        if ((own >= 0) & (own != turned[number])).any():
            raise ValueError(f"element {number} and its neighbors do not meet node by node")
        own[...] = turned[number]
    return nodes


def _fitted(cube: NDArray[np.int64], face: NDArray[np.int64], axis: int, side: int) -> NDArray[np.int64]:
    """A cube turned so that its far side along an axis is a face."""
    for order in itertools.permutations(range(3)):
        # all 48 ways, mirrored ones too, as elements may be wound either way
        for flips in itertools.product((1, -1), repeat=3):
            made = cube.transpose(order)[:: flips[0], :: flips[1], :: flips[2]]
            if np.array_equal(made.take(1 - side, axis), face):
                return made
    raise ValueError("two elements share four nodes, but no face")


def mapped_in_block(
    corners: NDArray[np.float64], places: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Trilinear places in a block of hexahedra, and the determinant of the derivative; `places` (n, 3) count elements,
    and those beyond the block are continued from the element next to them.
    """
    size = np.array(corners.shape[:3]) - 1
    element = np.clip(np.floor(places), 0, size - 1).astype(np.int64)
    own = np.stack([corners[tuple((element + corner).T)] for corner in np.ndindex(2, 2, 2)], axis=1)
    points, derivative = points_in(own.reshape(-1, 2, 2, 2, 3), np.arange(len(places)), places - element)
    return points, np.linalg.det(derivative)
