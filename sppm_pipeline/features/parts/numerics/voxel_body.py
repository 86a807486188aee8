"""Conditions on a body of voxels: which nodes are held, and what pulls at them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.nouns.conditions import AXES, Condition, LoadCase
from sppm_pipeline.numerics import VOXEL_FACES

REACH, PLANE_REACH = 1.0, 0.75
"""Voxel edges from a region within which faces belong to it: voxels replace a curved wall by steps of one edge. Ends of
the box of a part lie on nodes, so that planes need less, and a wall one voxel thick has two sides."""

MIN_STIFF = 1e-9
"""Eigenvalue of the motions that are held, over the largest, from which on they count as held."""

MAX_LOOSE = 0.1
"""Share of the solid that may be loose and is left out; more is no part any more."""

MOTIONS = ("move along x", "move along y", "move along z", "turn about x", "turn about y", "turn about z")


class VoxelBody(NamedTuple):
    """Voxels of a part.

    Attributes
    ----------
    solid : (nz, ny, nx) bool
    edges : (hx, hy, hz)
        Of a voxel, mm.
    origin : (x, y, z)
        Low corner of the first voxel, mm.
    """

    solid: NDArray[np.bool_]
    edges: tuple[float, float, float]
    origin: tuple[float, float, float]

    @property
    def nodes(self) -> tuple[int, int, int]:
        """Shape of the grid of nodes."""
        nz, ny, nx = self.solid.shape
        return nz + 1, ny + 1, nx + 1

    def points(self, nodes: NDArray[np.int64]) -> NDArray[np.float64]:
        """Places (n, 3) of nodes, by their number in the grid, mm."""
        z, y, x = np.unravel_index(nodes, self.nodes)
        return np.asarray(np.stack([x, y, z], axis=1) * np.array(self.edges) + np.array(self.origin))

    def used(self) -> NDArray[np.bool_]:
        """Nodes at a corner of a solid voxel."""
        found = np.zeros(self.nodes, bool)
        nz, ny, nx = self.solid.shape
        for a in range(8):
            found[(a >> 2) : nz + (a >> 2), (a >> 1 & 1) : ny + (a >> 1 & 1), (a & 1) : nx + (a & 1)] |= self.solid
        return found


class Faces(NamedTuple):
    """Faces of solid voxels at the void: corners (n, 4), counterclockwise from outside, axis, side and voxel (n,)."""

    corners: NDArray[np.int64]
    axis: NDArray[np.int8]
    side: NDArray[np.int8]
    voxel: NDArray[np.int64]


def exposed_faces(body: VoxelBody) -> Faces:
    """All faces of the body."""
    solid = body.solid
    padded = np.pad(solid, 1)
    _, ny, nx = body.nodes
    found = []
    for beyond, corners in VOXEL_FACES:
        x, y, z = beyond
        bare = (
            solid
            & ~padded[1 + z : 1 + z + solid.shape[0], 1 + y : 1 + y + solid.shape[1], 1 + x :][:, :, : solid.shape[2]]
        )
        voxel = np.flatnonzero(bare)
        k, j, i = np.unravel_index(voxel, solid.shape)
        nodes = [((k + (c >> 2)) * ny + j + (c >> 1 & 1)) * nx + i + (c & 1) for c in corners]
        axis = int(np.flatnonzero(beyond)[0])
        found.append((np.stack(nodes, axis=1), np.full(len(voxel), axis), np.full(len(voxel), beyond[axis]), voxel))
    corners_of, axes, sides, voxels = (np.concatenate([one[n] for one in found]) for n in range(4))
    return Faces(corners_of, axes.astype(np.int8), sides.astype(np.int8), voxels)


class Applied(NamedTuple):
    """A load case on a body; arrays are (3, nz + 1, ny + 1, nx + 1).

    Attributes
    ----------
    fixed : bool
        Displacements that are given.
    given : float64
        What they are, mm; 0 elsewhere.
    loads : float64
        Nodal forces, N.
    regions : tuple of (Condition, faces)
        Which of the exposed faces each condition has got.
    """

    fixed: NDArray[np.bool_]
    given: NDArray[np.float64]
    loads: NDArray[np.float64]
    regions: tuple[tuple[Condition, NDArray[np.int64]], ...]


def applied(body: VoxelBody, case: LoadCase, mass: NDArray[np.floating]) -> Applied:
    """Put the conditions of a case on a body whose voxels have a mass, (nz, ny, nx) g.

    Raises
    ------
    DesignError
        If a region touches nothing, or conditions contradict each other.
    """
    faces, used = exposed_faces(body), body.used()
    centers = body.points(faces.corners.reshape(-1)).reshape(-1, 4, 3).mean(axis=1)
    inner = np.flatnonzero(used)
    places = body.points(inner)
    given = np.full((3, used.size), np.nan)
    loads = np.zeros((3, used.size))
    regions, owner = [], np.full((3, used.size), -1)
    h = np.array(body.edges)
    for number, one in enumerate(case.conditions):
        plane = one.region.kind == "plane"
        reach = PLANE_REACH * h[one.region.axis] if plane else REACH * float(h.max())
        near = one.region.distances(centers) <= reach * (1 + 1e-9)
        if plane:
            near &= faces.axis == one.region.axis
        chosen = np.flatnonzero(near)
        within = 0.51 * h[one.region.axis] if plane and not len(chosen) else 1e-6 * float(h.min())
        nodes = inner[one.region.distances(places) <= within]
        if not len(chosen) and (one.kind == "pressure" or not len(nodes)):
            low, high = places.min(axis=0), places.max(axis=0)
            raise DesignError(
                f"case {case.name!r}: {one.region.text!r} touches nothing of the part, which lies in "
                f"({', '.join(f'{v:g}' for v in low)}) to ({', '.join(f'{v:g}' for v in high)}) mm",
                hint="is it in the same place and unit, and not in a void of the part?",
            )
        regions.append((one, chosen))
        if one.kind == "displacement":
            nodes = np.union1d(nodes, faces.corners[chosen])
            for axis, value in enumerate(one.values):
                if value is None:
                    continue
                before = given[axis, nodes]
                if (clash := np.abs(before - value) > 1e-12).any():
                    other = case.conditions[owner[axis, nodes[int(np.argmax(clash))]]]
                    raise DesignError(
                        f"case {case.name!r}: {other.region.text!r} and {one.region.text!r} move the same place along "
                        f"{AXES[axis]} by {before[int(np.argmax(clash))]:g} and {value:g} mm",
                        hint="leave out one of them, or give regions that do not meet",
                    )
                given[axis, nodes], owner[axis, nodes] = value, number
        elif one.kind == "force":
            if len(chosen):
                area = h.prod() / h[faces.axis[chosen]]
                share = np.bincount(faces.corners[chosen].reshape(-1), np.repeat(area, 4), used.size)
            else:
                share = np.bincount(nodes, minlength=used.size).astype(np.float64)
            for axis, value in enumerate(one.values):
                loads[axis] += share * (float(value or 0) / float(share.sum()))
        else:
            area = h.prod() / h[faces.axis[chosen]] * faces.side[chosen] * float(one.values[0] or 0) / 4
            for axis in range(3):
                here = faces.axis[chosen] == axis
                corners = faces.corners[chosen][here]
                loads[axis] -= np.bincount(corners.reshape(-1), np.repeat(area[here], 4), used.size)
    if any(case.gravity):
        weight = np.zeros(body.nodes)
        nz, ny, nx = body.solid.shape
        for a in range(8):
            weight[(a >> 2) : nz + (a >> 2), (a >> 1 & 1) : ny + (a >> 1 & 1), (a & 1) : nx + (a & 1)] += mass / 8e3
        loads += np.array(case.gravity)[:, None] * weight.reshape(-1)
    fixed = ~np.isnan(given)
    for one in case.conditions:
        if one.kind == "force":
            _check_acts(case, one, fixed, loads)
    shape = (3, *body.nodes)
    moved = np.nan_to_num(given)
    if not (loads[~fixed].any() or moved.any()):
        raise DesignError(
            f"case {case.name!r} has no load on what can move", hint="give a force, pressure, displacement or gravity"
        )
    return Applied(fixed.reshape(shape), moved.reshape(shape), loads.reshape(shape), tuple(regions))


def _check_acts(case: LoadCase, one: Condition, fixed: NDArray[np.bool_], loads: NDArray[np.float64]) -> None:
    """Refuse forces that act only where the part is held along them: two conditions that contradict each other."""
    for axis, value in enumerate(one.values):
        here = loads[axis] != 0
        if value and here.any() and fixed[axis, here].all():
            raise DesignError(
                f"case {case.name!r}: the force along {AXES[axis]} on {one.region.text!r} acts only where the part is "
                "held along it",
                hint="give regions that do not meet, or hold along other axes, as in 'x y on ...'",
            )


class Held(NamedTuple):
    """The solid that a case holds, and the share of it that was loose."""

    solid: NDArray[np.bool_]
    loose: float


def held_solid(body: VoxelBody, case: LoadCase, fixed: NDArray[np.bool_], *, drop: bool) -> Held:
    """The pieces of the body that are held against all rigid motions; others are left out, or refused without `drop`.

    Raises
    ------
    DesignError
        If a piece can move freely, with the motions that are free.
    """
    from scipy.ndimage import label

    labels, count = label(body.solid)
    sizes = np.bincount(labels.reshape(-1), minlength=count + 1)[1:]
    nodes = np.flatnonzero(fixed.any(axis=0))
    grams = np.zeros((count, 6, 6))
    middle = np.zeros(3)
    if len(nodes):
        places = body.points(nodes)
        middle = places.mean(axis=0)
        size = float(np.linalg.norm(np.array(body.edges) * body.solid.shape[::-1]))
        x, y, z = ((places - middle) / size).T
        zero, one = np.zeros(len(x)), np.ones(len(x))
        rows = [
            np.stack([one, zero, zero, zero, z, -y], 1),
            np.stack([zero, one, zero, -z, zero, x], 1),
            np.stack([zero, zero, one, y, -x, zero], 1),
        ]
        padded = np.pad(labels, 1)
        k, j, i = np.unravel_index(nodes, body.nodes)
        # a corner of several pieces holds all of them
        around = np.stack([padded[k + (a >> 2), j + (a >> 1 & 1), i + (a & 1)] for a in range(8)], axis=1)
        for piece in np.unique(around[around > 0]):
            mine = (around == piece).any(axis=1)
            for axis, row in enumerate(rows):
                own = row[mine & fixed[axis].reshape(-1)[nodes]]
                grams[piece - 1] += own.T @ own
    values = np.linalg.eigvalsh(grams)
    held = values[:, 0] > MIN_STIFF * np.maximum(values[:, -1], 1e-300)
    loose = float(sizes[~held].sum() / max(1, sizes.sum()))
    largest = int(np.argmax(sizes))
    if held[largest] and (not loose or (drop and loose < MAX_LOOSE)):
        return Held(np.concatenate([[False], held])[labels], loose)
    if held.any() and held[largest]:
        raise DesignError(
            f"case {case.name!r}: the part is in {count} pieces, and {loose:.0%} of it hangs loose: nothing holds it",
            hint="hold each piece, or join them",
        )
    found, vectors = np.linalg.eigh(grams[largest])
    free = vectors[:, found <= MIN_STIFF * max(found[-1], 1e-300)]
    words = [word for word, row in zip(MOTIONS, free, strict=True) if np.linalg.norm(row) > 0.7]
    raise DesignError(
        f"case {case.name!r}: nothing keeps the part from this: {', '.join(words) or 'a motion of its own'}"
        + (f" (axes through {', '.join(f'{v:.3g}' for v in middle)} mm)" if len(nodes) and len(words) else "")
        + (f"; the part is in {count} pieces" if count > 1 else ""),
        hint="hold more of it by `fix`, or by `symmetry`",
    )
