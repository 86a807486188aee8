"""Winding: neighbors made to agree, and pieces turned so that their normals point out of the solid.

Triangles agree if they run against each other along the edge they share. Where an edge belongs to just two triangles,
agreement spreads from one to the next, so that a *patch* of such triangles can only be right or wrong as a whole. Which
it is, is read off the sign of the volume of a closed patch. From the sides of an open one rays are sent: the outer side
is the one from which more of them escape (Takayama et al. 2014, "A simple method for correcting facet orientations").
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, I32, I64, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.adjacency import adjacency
from sppm_pipeline.services.mesh.box_tree import BoxTree, box_tree
from sppm_pipeline.services.mesh.measures import balanced_edges, components, read_only, volume
from sppm_pipeline.services.mesh.rays import exits_along, layers_around

RAYS = 256
"""Rays sent from each side of an open patch."""

DECISIVE = 0.2
"""An open patch is turned if the fractions of rays that escape from its two sides differ by more than this."""


class Orientation(NamedTuple):
    """The result of `orient`."""

    faces: I32  # wound outwards as far as that could be determined
    turned: int  # triangles that were turned
    patches: int  # pieces within which agreement spreads
    one_sided: int  # patches that cannot be made to agree, as a Möbius strip


class Shells(NamedTuple):
    """The pieces of a closed mesh that share no vertex."""

    labels: I32  # of each triangle
    volumes: F64  # negative where the normals point inwards
    around: I64  # how often the other pieces go around the first corner of each piece

    @property
    def cavities(self) -> Bools:
        """Pieces wound inwards, within the solid of others: they are hollows."""
        return (self.volumes < 0) & (self.around > 0)

    @property
    def inside_out(self) -> Bools:
        """Pieces wound inwards, within nothing: they can only be wrong."""
        return (self.volumes < 0) & (self.around <= 0)

    @property
    def buried(self) -> Bools:
        """Pieces wound outwards that start within the solid of others: what they enclose is solid anyway."""
        return (self.volumes > 0) & (self.around > 0)


def shells(vertices: F64, faces: I32, tree: BoxTree | None = None) -> Shells:
    """Tell the pieces of a mesh, (n, 3) and (m, 3), whose edges are balanced, and how they lie to each other."""
    count, labels = components(faces)
    points = np.ascontiguousarray(vertices, np.float64)
    first, volumes = _volumes(read_only(points), read_only(np.ascontiguousarray(faces, np.int32)), labels, count)
    around = np.zeros(count, np.int64)
    if count > 1:
        around = layers_around(
            tree or box_tree(points[faces]), labels, points[faces[first, 0]], np.arange(count, dtype=np.int32)
        )
    return Shells(labels, volumes, around)


def orient(vertices: F64, faces: I32) -> Orientation:
    """Wind the triangles of any mesh outwards.

    A closed mesh is left alone but for its pieces that are inside out, or all of it if its volume is negative.
    Otherwise neighbors are made to agree, most of a patch's area deciding for the rest; then each patch is turned as a
    whole if that is clearly right.
    """
    points, given = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int32)
    wound = given.copy()
    patches, one_sided = 0, 0
    balanced = balanced_edges(given)
    if not balanced:
        opposite = adjacency(given).opposite
        flips, labels, patches, one_sided = _agree(np.ascontiguousarray(given, np.int64), opposite)
        areas = _areas(points[given])
        against = np.bincount(labels, areas * flips, patches) > np.bincount(labels, areas, patches) / 2
        flips ^= against[labels]
        wound[flips] = wound[flips][:, ::-1]
        _turn_patches(points, wound, opposite, labels, patches)
        balanced = balanced_edges(wound)
    if balanced:
        if volume(points, wound) < 0:
            wound = np.ascontiguousarray(wound[:, ::-1])
        found = shells(points, wound)
        patches = patches or len(found.volumes)
        if found.inside_out.any():
            wrong = found.inside_out[found.labels]
            wound[wrong] = wound[wrong][:, ::-1]
    # a triangle has kept its winding if its corners still stand in the old order
    turned = int(np.count_nonzero((wound != given).any(axis=1)))
    return Orientation(wound, turned, int(patches), int(one_sided))


def _areas(triangles: F64) -> F64:
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


@jit
def _volumes(points: F64, faces: I32, labels: I32, count: int) -> tuple[I64, F64]:
    """First triangle and signed volume of each piece, from its first corner: a small piece far off loses no digits."""
    first, volumes = np.full(count, -1, np.int64), np.zeros(count)
    a, b, c = np.empty(3), np.empty(3), np.empty(3)
    for f in range(faces.shape[0]):
        piece = labels[f]
        if first[piece] < 0:
            first[piece] = f
        corner = faces[first[piece], 0]
        for axis in range(3):
            a[axis] = points[faces[f, 0], axis] - points[corner, axis]
            b[axis] = points[faces[f, 1], axis] - points[corner, axis]
            c[axis] = points[faces[f, 2], axis] - points[corner, axis]
        x, y, z = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
        volumes[piece] += (a[0] * x + a[1] * y + a[2] * z) / 6.0
    return first, volumes


def _turn_patches(points: F64, faces: I32, opposite: I64, labels: I32, n: int) -> None:
    """Turn, in place, patches that are wound inwards as a whole: first the open ones, then the closed ones."""
    is_open = np.zeros(n, np.bool_)
    is_open[labels[np.flatnonzero(opposite < 0) // 3]] = True
    if is_open.any():
        triangles = points[faces]
        tree = box_tree(triangles)
        starts, normals, own = _samples(triangles, labels, is_open, n)
        front, back = (
            np.bincount(labels[own], np.isinf(exits_along(tree, starts, _around(normals * side), own, True)), n)
            for side in (1.0, -1.0)
        )
        sent = np.maximum(np.bincount(labels[own], minlength=n), 1)
        wrong = (back - front) / sent > DECISIVE
        faces[wrong[labels]] = faces[wrong[labels]][:, ::-1]
    if not is_open.all():
        first, volumes = _volumes(read_only(points), read_only(faces), labels, n)
        inwards = np.flatnonzero(~is_open & (volumes < 0))
        if inwards.size:
            triangles = points[faces]
            corners = triangles[first[inwards], 0]
            around = layers_around(box_tree(triangles), labels, corners, inwards.astype(np.int32))
            wrong = np.zeros(n, np.bool_)
            wrong[inwards[around <= 0]] = True
            faces[wrong[labels]] = faces[wrong[labels]][:, ::-1]


def _samples(triangles: F64, labels: I32, selected: Bools, n: int) -> tuple[F64, F64, I64]:
    """Points spread evenly over the area of each selected patch, with normals and triangles."""
    order = np.argsort(labels, kind="stable")
    areas = _areas(triangles)[order]
    ends = np.cumsum(np.bincount(labels, minlength=n))
    own = []
    for patch in np.flatnonzero(selected):
        start = ends[patch - 1] if patch else 0
        share = np.cumsum(areas[start : ends[patch]])
        if share[-1] > 0:
            at = np.searchsorted(share, (np.arange(RAYS) + 0.5) / RAYS * share[-1])
            own.append(order[start + np.minimum(at, len(share) - 1)])
    chosen = np.concatenate(own) if own else np.empty(0, np.int64)
    t = triangles[chosen]
    normals = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return t.mean(axis=1), normals / np.where(length > 0, length, 1.0), chosen


def _around(normals: F64) -> F64:
    """A direction for each normal, spread over the half ball around it."""
    # the sequence of low discrepancy of Roberts (2018): 1 / p and 1 / p^2 of the plastic number p, p^3 = p + 1
    i = np.arange(len(normals))
    height = 1 - 2 * ((i * 0.7548776662466927) % 1)
    angle = 2 * np.pi * ((i * 0.5698402909980532) % 1)
    ring = np.sqrt(np.maximum(0.0, 1 - height**2))
    ways = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)
    ways *= np.where(np.einsum("ij,ij->i", ways, normals) < 0, -1.0, 1.0)[:, None]
    return ways


@jit
def _agree(faces: I64, opposite: I64) -> tuple[Bools, I32, int, int]:
    """Which triangles to turn so that all agree with the first of their patch; patches; and how many are one-sided."""
    flips = np.zeros(faces.shape[0], np.bool_)
    labels = np.full(faces.shape[0], -1, np.int32)
    queue = np.empty(faces.shape[0], np.int64)
    patches, one_sided = 0, 0
    for seed in range(faces.shape[0]):
        if labels[seed] >= 0:
            continue
        labels[seed] = patches
        queue[0] = seed
        done, known = 0, 1
        twisted = False
        while done < known:
            f = queue[done]
            done += 1
            for c in range(3):
                h = opposite[3 * f + c]
                if h < 0:
                    continue
                g = h // 3
                same = faces[f, c] == faces[g, h % 3]  # both run the same way: one has to be turned
                if labels[g] < 0:
                    labels[g] = patches
                    flips[g] = flips[f] ^ same
                    queue[known] = g
                    known += 1
                elif flips[g] != flips[f] ^ same:
                    twisted = True
        patches += 1
        one_sided += twisted
    return flips, labels, patches, one_sided
