"""From a mesh or a field to the body of voxels that is loaded."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Part, ScalarField, SurfaceMesh
from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.parts.stubs import firm_faces, same_resultant
from sppm_pipeline.method.nouns.conditions import AXES, Condition, LoadCase, Region
from sppm_pipeline.method.part.inside import inside_layers, prepare_inside, way_for
from sppm_pipeline.method.porosity.fractions import solid_fractions
from sppm_pipeline.numerics import VOXEL_FACES, Grid, node_sums
from sppm_pipeline.services.arrays import F32, F64, I64, Bools
from sppm_pipeline.services.elastic.loaded import NodalValues

REACH, PLANE_REACH = 1.0, 0.75
"""Voxel edges from a region within which faces belong to it: voxels replace a curved wall by steps of one edge. Ends of
the box of a part lie on nodes, so that planes need less, and a wall one voxel thick has two sides."""

MIN_STIFF = 1e-9
"""Eigenvalue of the motions that are held, over the largest, from which on they count as held."""

MAX_LOOSE = 0.1
"""Share of the solid that may be loose and is left out; more is no part any more."""

MOTIONS = ("move along x", "move along y", "move along z", "turn about x", "turn about y", "turn about z")


class VoxelBody(NamedTuple):
    """Voxels of a part."""

    solid: Bools  # (nz, ny, nx)
    edges: tuple[float, float, float]  # of a voxel along x, y, z, mm
    origin: tuple[float, float, float]  # low corner of the first voxel, mm

    @property
    def nodes(self) -> tuple[int, int, int]:
        """Shape of the grid of nodes."""
        nz, ny, nx = self.solid.shape
        return nz + 1, ny + 1, nx + 1

    def points(self, nodes: I64) -> F64:
        """Places (n, 3) of nodes, by their number in the grid, mm."""
        z, y, x = np.unravel_index(nodes, self.nodes)
        return np.asarray(np.stack([x, y, z], axis=1) * np.array(self.edges) + np.array(self.origin))

    def used(self) -> Bools:
        """Nodes at a corner of a solid voxel."""
        return np.asarray(at_nodes(self.solid.view(np.uint8)) > 0)


def at_nodes(values: NDArray[Any]) -> NDArray[Any]:
    """Sums over the voxels (nz, ny, nx) around each node, (nz + 1, ny + 1, nx + 1)."""
    return node_sums(np.pad(values, ((0, 1),) * 3))


class Faces(NamedTuple):
    """Faces of solid voxels at the void: corners (n, 4), counterclockwise from outside, axis, side and voxel (n,)."""

    corners: I64
    axis: I64
    side: I64
    voxel: I64

    @property
    def keys(self) -> I64:
        """A number of each face, the same in any selection."""
        return self.voxel * 6 + self.axis * 2 + (self.side > 0)


SLAB = 16
"""Layers of voxels whose faces are looked at together: a large body has millions."""


def exposed_faces(body: VoxelBody, region: Region | None = None) -> Faces:
    """All faces of the body, or those that belong to a region."""
    padded = np.pad(body.solid, 1)
    nz, ny, nx = body.solid.shape
    found = [(np.zeros((0, 4), np.int64), *(np.zeros(0, np.int64),) * 3)]
    h, low = np.array(body.edges), np.array(body.origin)
    for beyond, corners in VOXEL_FACES:
        axis = int(np.flatnonzero(beyond)[0])
        if region is not None and region.kind == "plane" and axis != region.axis:
            continue
        x, y, z = beyond
        for first in range(0, nz, SLAB):
            last = min(nz, first + SLAB)
            neighbor = padded[1 + z + first : 1 + z + last, 1 + y : 1 + y + ny, 1 + x : 1 + x + nx]
            k, j, i = np.nonzero(body.solid[first:last] & ~neighbor)
            k += first
            if region is not None:
                reach = PLANE_REACH * h[axis] if region.kind == "plane" else REACH * float(h.max())
                centers = (np.stack([i, j, k], axis=1) + 0.5 + 0.5 * np.array(beyond)) * h + low
                near = region.distances(centers) <= reach * (1 + 1e-9)
                k, j, i = k[near], j[near], i[near]
            nodes = [((k + (c >> 2)) * (ny + 1) + j + (c >> 1 & 1)) * (nx + 1) + i + (c & 1) for c in corners]
            ones = np.ones(len(k), np.int64)
            found.append((np.stack(nodes, axis=1), axis * ones, beyond[axis] * ones, (k * ny + j) * nx + i))
    return Faces(*(np.concatenate([one[n] for one in found]) for n in range(4)))


def nodes_in(body: VoxelBody, region: Region, within: float) -> I64:
    """Nodes of the body within a distance of a region."""
    found = []
    used, layer = body.used(), int(np.prod(body.nodes[1:]))
    for k in range(body.nodes[0]):
        nodes = np.flatnonzero(used[k]) + k * layer
        found.append(nodes[region.distances(body.points(nodes)) <= within])
    return np.concatenate(found)


class Applied(NamedTuple):
    """A load case on a body."""

    fixed: Bools  # displacements that are given, (3, nz + 1, ny + 1, nx + 1)
    moved: NodalValues  # those that are not zero, mm
    pulled: NodalValues  # nodal forces, N
    regions: tuple[tuple[Condition, Faces], ...]  # what each condition has got of the surface

    @property
    def total(self) -> F64:
        """Sum of the loads (3,), N."""
        axis = self.pulled.at // (self.fixed.size // 3)
        return np.asarray(np.bincount(axis, self.pulled.values, 3), np.float64)


def applied(body: VoxelBody, case: LoadCase, mass: NDArray[np.floating]) -> Applied:
    """Put the conditions of a case on a body whose voxels have a mass, (nz, ny, nx) g.

    A `DesignError` says that a region touches nothing, or that conditions contradict each other.
    """
    count = int(np.prod(body.nodes))
    # unknowns, values, and the condition that they come from, in its order
    held: list[tuple[I64, float, int]] = []
    loads: list[NodalValues] = []
    regions = []
    h = np.array(body.edges)
    for number, one in enumerate(case.conditions):
        faces = exposed_faces(body, one.region)
        on_plane = one.region.kind == "plane" and not len(faces.voxel)
        nodes = nodes_in(body, one.region, 0.51 * h[one.region.axis] if on_plane else 1e-6 * float(h.min()))
        if not len(faces.voxel) and (one.kind == "pressure" or not len(nodes)):
            low, high = np.array(body.origin), np.array(body.origin) + h * body.solid.shape[::-1]
            raise DesignError(
                f"case {case.name!r}: {one.region.text!r} touches nothing of the part, which lies in "
                f"({', '.join(f'{v:g}' for v in low)}) to ({', '.join(f'{v:g}' for v in high)}) mm",
                hint="is it in the same place and unit, and not in a void of the part?",
            )
        regions.append((one, faces))
        area = h.prod() / h[faces.axis] / 4
        corners = faces.corners.reshape(-1)
        if one.kind == "displacement":
            nodes = np.union1d(nodes, corners)
            held += [
                (axis * count + nodes, value, number) for axis, value in enumerate(one.values) if value is not None
            ]
        elif one.kind == "force":
            at, share, firm = nodes, np.ones(len(nodes)), np.ones(len(nodes), bool)
            if len(corners):
                at, share = corners, np.repeat(area, 4)
                firm = np.repeat(firm_faces(faces.voxel, body.solid, mass), 4)
            forces = same_resultant(body.points(at), share, firm, np.array(one.values, np.float64))
            loads += [NodalValues(axis * count + at, forces[:, axis]) for axis in range(3) if forces[:, axis].any()]
        else:
            push = np.repeat(-area * faces.side * float(one.values[0] or 0), 4)
            loads.append(NodalValues(np.repeat(faces.axis, 4) * count + corners, push))
    if any(case.gravity):
        grams = NodalValues.of(at_nodes(mass / 8e3))
        loads += [NodalValues(axis * count + grams.at, grams.values * g) for axis, g in enumerate(case.gravity) if g]
    fixed, moved = _held(body, case, held)
    at, back = np.unique(np.concatenate([np.zeros(0, np.int64), *(one.at for one in loads)]), return_inverse=True)
    values = np.concatenate([np.zeros(0), *(one.values for one in loads)])
    pulled = NodalValues(at, np.asarray(np.bincount(back, values, len(at)), np.float64))
    for one in case.conditions:
        if one.kind == "force":
            _check_acts(case, one, fixed.reshape(3, -1), pulled)
    if not (pulled.values[~fixed.reshape(-1)[pulled.at]].any() or len(moved.at)):
        raise DesignError(
            f"case {case.name!r} has no load on what can move", hint="give a force, pressure, displacement or gravity"
        )
    return Applied(fixed, moved, pulled, tuple(regions))


def _held(body: VoxelBody, case: LoadCase, held: list[tuple[I64, float, int]]) -> tuple[Bools, NodalValues]:
    """Which displacements are given, and those that are not zero; conditions that contradict each other are refused."""
    fixed = np.zeros((3, *body.nodes), bool)
    at = np.concatenate([np.zeros(0, np.int64), *(one for one, _, _ in held)])
    counts = np.array([len(one) for one, _, _ in held], int)
    values, owner = (np.repeat([one[k] for one in held], counts) for k in (1, 2))
    order = np.argsort(at, kind="stable")
    at, values, owner = at[order], values[order], owner[order]
    clash = np.flatnonzero((at[1:] == at[:-1]) & (np.abs(np.diff(values)) > 1e-12))
    if len(clash):
        k = int(clash[0])
        one, other = (case.conditions[owner[n]].region.text for n in (k, k + 1))
        raise DesignError(
            f"case {case.name!r}: {one!r} and {other!r} move the same place along "
            f"{AXES[int(at[k] // (fixed.size // 3))]} by {values[k]:g} and {values[k + 1]:g} mm",
            hint="leave out one of them, or give regions that do not meet",
        )
    fixed.reshape(-1)[at] = True
    first = np.concatenate([[True], at[1:] != at[:-1]])[: len(at)] & (values != 0)
    return fixed, NodalValues(at[first], values[first])


def _check_acts(case: LoadCase, one: Condition, fixed: Bools, pulled: NodalValues) -> None:
    """Refuse forces that act only where the part is held along them: two conditions that contradict each other."""
    axes, nodes = np.divmod(pulled.at, fixed.shape[1])
    for axis, value in enumerate(one.values):
        here = nodes[axes == axis]
        if value and len(here) and fixed[axis, here].all():
            raise DesignError(
                f"case {case.name!r}: the force along {AXES[axis]} on {one.region.text!r} acts only where the part is "
                "held along it",
                hint="give regions that do not meet, or hold along other axes, as in 'x y on ...'",
            )


def held_solid(body: VoxelBody, case: LoadCase, fixed: Bools, *, drop: bool) -> tuple[Bools, float]:
    """The pieces of the body that are held against all rigid motions, and the share that is not and left out.

    Without `drop` that is refused, as is a largest piece that moves: a `DesignError` names the motions that are free.
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
        motions = (one, zero, zero, zero, z, -y), (zero, one, zero, -z, zero, x), (zero, zero, one, y, -x, zero)
        rows = [np.stack(motion, 1) for motion in motions]
        # a corner of several pieces holds all of them
        around = np.zeros((len(nodes), 8), labels.dtype)
        for a in range(8):
            corner = np.stack(np.unravel_index(nodes, body.nodes)) - np.array([[a >> 2], [a >> 1 & 1], [a & 1]])
            within = ((corner >= 0) & (corner < np.array(labels.shape)[:, None])).all(axis=0)
            around[within, a] = labels[tuple(corner[:, within])]
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
        return np.concatenate([[False], held])[labels], loose
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
        + (f" (axes through {', '.join(f'{round(v, 6):.3g}' for v in middle)} mm)" if len(nodes) and len(words) else "")
        + (f"; the part is in {count} pieces" if count > 1 else ""),
        hint="hold more of it by `fix`, or by `symmetry`",
    )


PARTS = 3
"""Samples along the edge of an element for the share that lies in the part: a plane in between errs by a 27th."""

MIN_SHARE = 0.1
"""Share of an element in the part below which it is left out: it would bear next to nothing, and hang loose."""


class SharedBody(NamedTuple):
    """A body, and how much of each voxel is there, (nz, ny, nx) float32."""

    body: VoxelBody
    share: F32


def fitted(lower: F64, upper: F64, edge: float) -> tuple[tuple[int, int, int], tuple[float, float, float]]:
    """Voxels along x, y, z that fill a box, and their edges, as near to one edge as that allows."""
    extent = np.maximum(np.asarray(upper) - np.asarray(lower), 1e-9)
    nx, ny, nz = (max(1, round(side / edge)) for side in extent.tolist())
    x, y, z = (extent / (nx, ny, nz)).tolist()
    return (nx, ny, nz), (x, y, z)


def mesh_body(mesh: SurfaceMesh, edge: float) -> SharedBody:
    """Elements of about an edge, mm, that fill a mesh."""
    (nx, ny, nz), edges = fitted(mesh.lower, mesh.upper, edge)
    fine = np.array(edges) / PARTS
    x, y, z = (np.asarray(mesh.lower) + fine / 2).tolist()
    hx, hy, hz = fine.tolist()
    grid = Grid((x, y, z), (hx, hy, hz), (nx * PARTS, ny * PARTS, nz * PARTS))
    scan = prepare_inside(mesh.vertices, mesh.faces, grid, way_for(mesh.bounds_solid))
    share = np.empty((nz, ny, nx), np.float32)
    for k in range(nz):
        layer = inside_layers(scan, k * PARTS, (k + 1) * PARTS).mask
        share[k] = layer.reshape(PARTS, ny, PARTS, nx, PARTS).mean(axis=(0, 2, 4))
    share[share < MIN_SHARE] = 0
    low_x, low_y, low_z = np.asarray(mesh.lower).tolist()
    return SharedBody(VoxelBody(share > 0, edges, (low_x, low_y, low_z)), share)


def _share(samples: F32) -> F32:
    """Solid fractions of voxels from two samples of a field along each edge, and one more at both ends."""
    z, y, x = (n // 2 - 1 for n in samples.shape)
    return solid_fractions(lambda *_: samples, (x, y, z), 1)


def field_body(field: ScalarField, per_cell: int, threads: int, *, binary: bool) -> SharedBody:
    """The very solid of a field or part, on voxels of about a cell size over `per_cell`; shares are solid fractions."""
    cell, start = field.physical_edge(), np.array(field.origin_mm)
    if isinstance(field, Part):
        lower, upper = np.asarray(field.domain.lower), np.asarray(field.domain.upper)
    else:
        lower, upper = start, start + cell * np.array(field.cells)
    (nx, ny, nz), edges = fitted(lower, upper, cell / per_cell)
    low, unit = (lower - start) / cell, np.array(edges) / cell

    def in_cells(grid: Grid) -> Grid:
        """A grid counted in voxels, from the low corner."""
        x, y, z = (low + unit * np.array(grid.origin)).tolist()
        hx, hy, hz = (unit * np.array(grid.spacing)).tolist()
        return Grid((x, y, z), (hx, hy, hz), grid.shape)

    if binary:
        grid = in_cells(Grid((0.5,) * 3, (1.0,) * 3, (nx, ny, nz)))
        share = field.solid_zyx(grid, 0, nz, threads).astype(np.float32)
    elif isinstance(field, Part):
        share = np.empty((nz, ny, nx), np.float32)
        half = in_cells(Grid((-0.25,) * 3, (0.5,) * 3, (2 * nx + 2, 2 * ny + 2, 2 * nz + 2)))
        for k in range(0, nz, SLAB):
            layers = share[k : k + SLAB]
            inner, skin, outer = field.fields_zyx(half, threads, 2 * k, 2 * (k + len(layers) + 1))
            # one field of all would have kinks where they meet, next to which slopes say nothing of the surface
            layers[:] = _share(inner)
            if skin is not None:
                layers[:] = 1 - (1 - layers) * (1 - _share(skin))
            layers *= _share(outer)
    else:
        share = solid_fractions(
            lambda grid, first, stop: field.sample_zyx(in_cells(grid), first, stop, threads), (nx, ny, nz), 1
        )
    x, y, z = lower.tolist()
    return SharedBody(VoxelBody(share > 0, edges, (x, y, z)), share)
