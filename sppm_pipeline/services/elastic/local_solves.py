"""Corrections on small boxes, where an iteration is slow because a part of a body hangs by little.

The coarse grids of a multigrid cycle join what thin voids part. Where a load bends a flap or a cut strut on a thin
neck, they hold it far too firmly, and each cycle brings a small part of the displacement only, while all the rest of
the body has converged. Such places are few and small, and they stand out in the last direction of conjugate gradients:
each is solved by itself, with all around it held, one after another (a multiplicative Schwarz method; Smith, Bjørstad
and Gropp, "Domain Decomposition", 1996, chapter 1). Every such step lowers the energy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import Bools
from sppm_pipeline.services.elastic.elastic_level import Moduli

if TYPE_CHECKING:
    from sppm_pipeline.services.elastic.loaded import HeldBody

BLOCKS = 32
"""Blocks along the longest axis, in which the direction is measured. On cubes of 8^3 cells of the paper these are a
quarter of a cell, somewhat more than the thickness of a strut."""

MIN_BLOCK = 2
"""Voxels along the edge of a block, at least."""

SHARE = 1 / 400
"""Share of the blocks that count, those that move most: fewer if they make most of the squared direction, more until
they make half. Half of it leaves 1.1 times the error behind, at 16 voxels a cell."""

COVERED = 0.9
"""... of the squared direction, beyond which blocks hardly matter."""

MAX_SHARE = 1 / 100
"""Share of the blocks that half of the squared direction may lie in; where a body bends as a whole it is a third."""

SURROUNDINGS = 2
"""Blocks around each of them that are solved along: what it hangs by. 3 leaves 0.54 times the error, for boxes of twice
the volume."""

MAX_VOLUME = 0.25
"""Share of the body that all boxes together may have: on as much of the body, solving them costs up to four times what
the iterations do."""

TOLERANCE = 1e-3
"""Relative error of energy that is left in a box: the iteration that goes on is as slow there as before."""

ITERATIONS = 300
"""... in a box, at the most: some 10 to 60 are made."""


def correct_locally(
    moduli: Moduli, fixed: Bools, weight: NDArray[Any], make: Callable[[Moduli, Bools], HeldBody], b: NDArray[Any],
    u: NDArray[Any], p: NDArray[Any],
) -> tuple[float, float]:  # fmt: skip
    """Correct displacements in boxes around what moves most in a direction.

    Parameters
    ----------
    moduli : Moduli
        Of the voxels (nz, ny, nx).
    fixed : (3, nz + 1, ny + 1, nx + 1) bool
        What is held.
    weight : (nz + 1, ny + 1, nx + 1)
        0 at nodes of the void, where directions have values without a meaning.
    make : callable
        From the same two of a box to its solver.
    b : flat
        Residual forces, which become those of the corrected displacements.
    u : flat
        Displacements.
    p : flat
        The last direction of conjugate gradients.

    Returns
    -------
    gain, left : float
        Twice what the energy falls by, and about twice that by which it could fall further in the boxes; 0 if the
        direction is not concentrated in a few places, and nothing was done.
    """
    left, moved = b.reshape(fixed.shape), u.reshape(fixed.shape)
    gain, rest = 0.0, 0.0
    for low, high in moving_boxes(p.reshape(fixed.shape), weight):
        voxels = tuple(slice(a, z) for a, z in zip(low, high, strict=True))
        nodes = (slice(None), *(slice(a, z + 1) for a, z in zip(low, high, strict=True)))
        held = fixed[nodes].copy()
        for axis, size in enumerate(fixed.shape[1:]):
            sides = np.moveaxis(held, axis + 1, 0)
            sides[0] |= low[axis] > 0
            sides[-1] |= high[axis] < size - 1
        body = make(moduli.each(lambda values, box=voxels: np.ascontiguousarray(values[box])), held)  # type: ignore[misc]
        force = np.where(held, 0, left[nodes])
        try:
            step, solved = body.solve(force, energy=TOLERANCE, iterations=ITERATIONS, local=False)
        except ArithmeticError:  # a hinge at its side; the iteration takes it as it is
            continue
        back = body.forces(step)
        won = 2 * np.vdot(force.astype(np.float64), step) - np.vdot(back.astype(np.float64), step)
        if won > 0:
            moved[nodes] += step
            inside = left[nodes]
            inside -= back
            inside[fixed[nodes]] = 0
            gain += float(won)
            rest += float(won) * min(solved.error, 1.0)
    return gain, rest


def moving_boxes(p: NDArray[Any], weight: NDArray[Any]) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Boxes of voxels, the first and the one behind the last along z, y, x, around what moves most.

    Parameters
    ----------
    p : (3, nz + 1, ny + 1, nx + 1)
        Displacements.
    weight : (nz + 1, ny + 1, nx + 1)
        0 at nodes that do not count.

    Returns
    -------
    list of pairs
        Empty if half of what moves is in more than a few places, or these are large.
    """
    from scipy.ndimage import binary_dilation, find_objects, label

    size = p.shape[1:]
    block = max(MIN_BLOCK, -(-max(size) // BLOCKS))
    _, rows, columns = (np.arange(0, n, block) for n in size)
    layers = []
    for k in range(0, size[0], block):
        some = np.where(weight[k : k + block] > 0, p[:, k : k + block], 0)
        layers.append(np.einsum("czyx,czyx->yx", some, some, dtype=np.float64))
    squares = np.add.reduceat(np.add.reduceat(np.stack(layers), rows, 1), columns, 2)
    order = np.argsort(-squares, axis=None, kind="stable")
    sums = np.cumsum(squares.reshape(-1)[order])
    half, most = (1 + int(np.searchsorted(sums, part * sums[-1])) for part in (0.5, COVERED))
    if half > MAX_SHARE * squares.size:
        return []
    chosen = np.zeros(squares.size, bool)
    chosen[order[: max(half, min(most, round(SHARE * squares.size)))]] = True
    near = binary_dilation(chosen.reshape(squares.shape), np.ones((3, 3, 3), bool))
    boxes = []
    for found in find_objects(label(near)[0]):
        # the blocks next to those that were chosen are in already
        low = tuple(max(0, (s.start - SURROUNDINGS + 1) * block) for s in found)
        high = tuple(min(n - 1, (s.stop + SURROUNDINGS - 1) * block) for s, n in zip(found, size, strict=True))
        boxes.append((low, high))
    volume = sum(math.prod(b - a for a, b in zip(low, high, strict=True)) for low, high in boxes)
    return boxes if volume <= MAX_VOLUME * math.prod(n - 1 for n in size) else []
