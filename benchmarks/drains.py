"""Drains of CAD parts, checked by geometry that knows how the parts were made.

    python -m benchmarks.drains [SEEDS] [FAMILY ...]

Ten families of parts (brackets, plates, flanges, housings, ...) of random dimensions, SEEDS (5) of each, are filled
behind a skin with one of three structures in turn, and drained by `fix.drains`. Edges are those of the mesh, holes are
known from the drawing. For each part: how near drains come to holes, edges and the build plate, in diameters from
rim to rim, and the void that is left.
"""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Callable
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

import sppm_pipeline as sppm

F64 = NDArray[np.float64]

DIAMETER, SKIN, CELL = 1.5, 1.0, 6.0
"""Of drains, of the skin, and of cells of the structure, mm."""

SHARP = np.cos(np.radians(40))
"""Cosine of the angle between two triangles from which their edge counts."""

WORTH = 2e-3
"""Share of the closed void from which one is to be drained: the default of the stage."""


class Hole(NamedTuple):
    """A concave cylinder or cone of a part: two ends on its axis, and the radii there, mm."""

    a: F64
    b: F64
    radii: tuple[float, float]


class Drawing:
    """A body, and the holes that were cut into it."""

    def __init__(self, body: Manifold) -> None:
        self.body = body
        self.holes: list[Hole] = []

    def drill(self, a: object, b: object, radius: float, other: float | None = None, over: float = 1.0) -> None:
        """Cut a cylinder or cone from `a`, at the surface, to `b`; it begins `over` mm before, to cut through."""
        start, end = np.array(a, float), np.array(b, float)
        along = end - start
        length = float(np.linalg.norm(along))
        last = radius if other is None else other
        tool = Manifold.cylinder(length, radius, last, 64)
        if over:
            tool += Manifold.cylinder(over + 1e-3, radius, radius, 64).translate((0, 0, -over))
        z = along / length
        x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
        x /= np.linalg.norm(x)
        frame = np.column_stack([x, np.cross(z, x), z, start])
        self.body -= tool.transform(frame)
        self.holes.append(Hole(start, end, (radius, last)))


def box(*size: float) -> Manifold:
    """A box from the origin."""
    return Manifold.cube(size)


def rod(a: object, b: object, radius: float) -> Manifold:
    """A round rod between two points."""
    start, along = np.array(a, float), np.array(b, float) - np.array(a, float)
    z = along / np.linalg.norm(along)
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return Manifold.cylinder(float(np.linalg.norm(along)), radius, radius, 96).transform(
        np.column_stack([x, np.cross(z, x), z, start])
    )


def bracket(u: Callable[[float, float], float]) -> Drawing:
    """An angle with bolt holes in both legs and a fillet in its corner."""
    length, width, height, t, r = u(32, 55), u(26, 40), u(28, 45), u(6, 9), u(2, 5)
    body = box(length, width, t) + box(t, width, height)
    body += box(t + r, width, t + r) - rod((t + r, -1, t + r), (t + r, width + 1, t + r), r)
    made = Drawing(body)
    d = u(2, 3.2)
    for y in (0.25 * width, 0.75 * width):
        made.drill((0.72 * length, y, t), (0.72 * length, y, 0), d, over=20)
        made.drill((t, y, 0.72 * height), (0, y, 0.72 * height), d, over=40)
    return made


def plate(u: Callable[[float, float], float]) -> Drawing:
    """A plate with countersunk holes in its corners and a blind bore."""
    x, y, t = u(40, 65), u(32, 48), u(8, 12)
    made = Drawing(box(x, y, t))
    d, sink = u(1.6, 2.6), u(1.2, 2.2)
    for px in (0.15 * x, 0.85 * x):
        for py in (0.17 * y, 0.83 * y):
            made.drill((px, py, t), (px, py, t - sink), d + sink, d)
            made.drill((px, py, t - sink), (px, py, 0), d, over=0)
    made.drill((x / 2, y / 2, t), (x / 2, y / 2, t - u(2, 4)), u(5, 9))
    return made


def flange(u: Callable[[float, float], float]) -> Drawing:
    """A disc with a hub, a bore and a circle of bolt holes."""
    radius, t, hub, height, bore = u(20, 30), u(7, 10), u(11, 15), u(18, 28), u(4, 7)
    made = Drawing(rod((0, 0, 0), (0, 0, t), radius) + rod((0, 0, 0), (0, 0, height), hub))
    made.drill((0, 0, height), (0, 0, 0), bore)
    for angle in np.linspace(0, 2 * np.pi, round(u(4, 8)), endpoint=False):
        at = (radius + hub) / 2 * np.array([np.cos(angle), np.sin(angle)])
        made.drill((*at, t), (*at, 0), u(1.5, min(2.5, (radius - hub) / 2 - 1.5)), over=1)
    return made


def housing(u: Callable[[float, float], float]) -> Drawing:
    """A block with a seat for a bearing, blind holes in its corners and a port in its side."""
    x, y, z, seat = u(42, 60), u(36, 48), u(22, 30), u(9, 13)
    made = Drawing(box(x, y, z))
    deep = u(8, z - 9)
    made.drill((x / 2, y / 2, z), (x / 2, y / 2, z - deep), seat)
    for px in (6.5, x - 6.5):
        for py in (6.5, y - 6.5):
            made.drill((px, py, z), (px, py, z - u(8, 14)), 2.0)
    made.drill((x, y / 2, z - deep / 2), (x / 2 + seat - 1, y / 2, z - deep / 2), u(1.5, 2.5))
    return made


def bosses(u: Callable[[float, float], float]) -> Drawing:
    """A base with round bosses, each with a blind hole."""
    x, y, t, r, h = u(45, 60), u(28, 40), u(7, 9), u(6, 8), u(8, 15)
    places = [(px * x, py * y) for px in (0.22, 0.78) for py in ((0.5,) if y < 34 else (0.27, 0.73))]
    body = box(x, y, t)
    for px, py in places:
        body += rod((px, py, t / 2), (px, py, t + h), r)
    made = Drawing(body)
    for px, py in places:
        d, deep = u(1.5, 2.5), u(6, h)
        made.drill((px, py, t + h), (px, py, t + h - deep), d)
        made.drill((px, py, t + h - deep), (px, py, t + h - deep - 0.6 * d), d, 0.0, over=0)  # the tip of a drill
    return made


def lug(u: Callable[[float, float], float]) -> Drawing:
    """A lug with a round end, a bore for a pin, and a slot."""
    x, r, t = u(38, 55), u(12, 17), u(9, 13)
    made = Drawing((rod((0, 0, 0), (0, 0, t), r) + box(1, 2 * r, t).translate((x, -r, 0))).hull())
    made.drill((0, 0, t), (0, 0, 0), u(4, 6))
    w, a, b = u(1.8, 2.8), 0.5 * x, 0.8 * x
    made.drill((a, 0, t), (a, 0, 0), w)
    made.drill((b, 0, t), (b, 0, 0), w)
    made.body -= box(b - a, 2 * w, t + 2).translate((a, -w, -1))
    return made


def rounded(u: Callable[[float, float], float]) -> Drawing:
    """A block with round edges and corners, through which holes lead that do not meet."""
    x, y, z, r = u(32, 48), u(28, 40), u(18, 26), u(4, 7)
    balls = [
        Manifold.sphere(r, 64).translate((px, py, pz)) for px in (r, x - r) for py in (r, y - r) for pz in (r, z - r)
    ]
    body = balls[0]
    for ball in balls[1:]:
        body += ball
    made = Drawing(body.hull())
    made.drill((0.3 * x, y / 2, z), (0.3 * x, y / 2, 0), u(2, 4))
    made.drill((0.7 * x, y, z / 2), (0.7 * x, 0, z / 2), u(2, 3.5))
    return made


def tee(u: Callable[[float, float], float]) -> Drawing:
    """A tee of thick pipe, one arm up."""
    x, r, h = u(40, 55), u(10, 13), u(12, 20)
    body = rod((-x / 2, 0, r), (x / 2, 0, r), r) + rod((0, 0, r), (0, 0, 2 * r + h), r)
    made = Drawing(body)
    bore = u(3, 4.5)
    made.drill((-x / 2, 0, r), (x / 2, 0, r), bore)
    made.drill((0, 0, 2 * r + h), (0, 0, r), bore)
    return made


def shaft(u: Callable[[float, float], float]) -> Drawing:
    """A stepped shaft that lies, with a center hole and a hole across."""
    x, r, step = u(50, 65), u(10, 13), u(1.5, 3)
    made = Drawing(rod((0, 0, r), (0.6 * x, 0, r), r) + rod((0, 0, r), (x, 0, r), r - step))
    d, deep = u(2, 4), u(1.5, 2.5)
    made.drill((x, 0, r), (x - u(10, 18), 0, r), d)
    made.drill((x, 0, r), (x - deep, 0, r), d + deep * np.tan(np.radians(30)), d)  # a center of 60 degrees
    made.drill((0.3 * x, 0, 2 * r), (0.3 * x, 0, 0), u(2, 3.5), over=1)
    return made


def ramp(u: Callable[[float, float], float]) -> Drawing:
    """A wedge with holes at right angles to its slope, and a hole through its thick end."""
    x, y, low, high = u(42, 58), u(28, 40), u(8, 10), u(20, 28)
    made = Drawing(box(x, y, low).hull() + (box(x, y, low) + box(0.25 * x, y, high)).hull())
    start = np.array([0.25 * x, 0, high])
    along = np.array([x, 0, low]) - start
    normal = np.array([-along[2], 0, along[0]]) / np.linalg.norm(along)
    for py in (0.28 * y, 0.72 * y):
        top = start + 0.55 * along + np.array([0, py, 0])
        made.drill(top, top - u(6, 8) * normal, u(1.6, 2.6), over=3)
    made.drill((0.12 * x, y, high / 2), (0.12 * x, 0, high / 2), u(2, 2.8))
    return made


FAMILIES: dict[str, Callable[[Callable[[float, float], float]], Drawing]] = {
    one.__name__: one for one in (bracket, plate, flange, housing, bosses, lug, rounded, tee, shaft, ramp)
}


def drawing(family: str, seed: int) -> Drawing:
    """A part of a family, with dimensions that are a function of the seed."""
    generator = np.random.default_rng([seed, *family.encode()])
    return FAMILIES[family](lambda low, high: float(generator.uniform(low, high)))


def mesh_of(body: Manifold) -> sppm.SurfaceMesh:
    """The surface of a body."""
    mesh = body.to_mesh64()
    return sppm.SurfaceMesh(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int32))


def sharp_edges(mesh: sppm.SurfaceMesh) -> F64:
    """Ends (n, 2, 3) of the edges in which two triangles meet at an angle."""
    points, faces = mesh.vertices, mesh.faces
    normals = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    sizes = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(sizes, 1e-300)[:, None]
    sides: dict[tuple[int, int], list[int]] = {}
    for number, face in enumerate(faces.tolist()):
        for a, b in ((0, 1), (1, 2), (2, 0)):
            sides.setdefault((min(face[a], face[b]), max(face[a], face[b])), []).append(number)
    sharp = [edge for edge, (one, other) in sides.items() if normals[one] @ normals[other] < SHARP]
    return np.asarray(points[np.array(sharp)])


def from_edges(points: F64, edges: F64) -> float:
    """The least distance of points from edges."""
    a, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    t = np.clip(((points[:, None] - a) * along).sum(2) / (along * along).sum(1), 0, 1)
    return float(np.linalg.norm(points[:, None] - a - t[..., None] * along, axis=2).min())


def from_hole(points: F64, hole: Hole) -> float:
    """The least distance of points from the surface of a cylinder or cone, as that of a segment in the half plane."""
    along = hole.b - hole.a
    length = float(np.linalg.norm(along))
    at = (points - hole.a) @ along / length
    off = np.linalg.norm(points - hole.a - np.outer(at, along / length), axis=1)
    flat = np.column_stack([at, off, np.zeros(len(at))])
    return from_edges(flat, np.array([[[0, hole.radii[0], 0], [length, hole.radii[1], 0]]]))


class Outcome(NamedTuple):
    """What was found of one part; distances from the rim of a drain in its diameters, infinite without drains."""

    drains: int
    hole: float
    edge: float
    plate: float
    before: float  # mm3 of closed void
    after: float
    left: int  # closed voids worth a drain
    largest: float  # mm3
    said: bool  # whether a warning says that voids are left


def closed(solid: NDArray[np.uint8], voxel: float) -> F64:
    """Volumes of the void that is shut in, mm3, found by SciPy."""
    from scipy.ndimage import label

    labels, count = label(np.pad(solid == 0, 1, constant_values=True))
    sizes = np.bincount(labels.ravel(), minlength=count + 1) * voxel
    sizes[[0, labels[0, 0, 0]]] = 0
    return np.asarray(sizes[sizes > 0])


KINDS = ("one void", "two voids", "pores apart")
"""Of structures: the paper's cell, a sheet between two voids, and pores that tunnels do not join."""


@functools.cache
def structure(kind: str) -> sppm.Microstructure:
    """A cell of a kind."""
    if kind == "one void":
        return sppm.cell("paper", porosity=0.7, seed=1)
    sheet: list[dict[str, object]] = [{"stage": "field.tpms", "surface": "gyroid", "form": "sheet"}]
    pores: list[dict[str, object]] = [
        {"stage": "sample.dart_throwing", "total": 10, "share": 0.6},
        {"stage": "connect.mst"},
        {"stage": "field.gaussian", "pore_radius": 0.17, "tunnel_radius": 0.01},
    ]
    recipe, target = (sheet, 0.7) if kind == "two voids" else (pores, 0.3)
    return sppm.tune.porosity(recipe=recipe, target=target, seed=1)


def outcome(made: Drawing, kind: str) -> Outcome:
    """Fill a part, drain it, and measure where the drains are."""
    mesh = mesh_of(made.body)
    with warnings.catch_warnings(record=True) as caught, TemporaryDirectory() as folder:
        warnings.simplefilter("always")
        cells = sppm.tile.periodic(cell=f"{CELL} mm")(structure(kind), mesh)
        part = sppm.fill.implicit(skin=f"{SKIN} mm", islands="keep")(cells, domain=mesh)
        drained = sppm.fix.drains(diameter=f"{DIAMETER} mm", most=12)(part, output=folder)
    said = any("closed voids" in str(warning.message) for warning in caught)
    (solid, grid), (opened, _) = part.coarse_solid(2), drained.coarse_solid(2)
    before, after = (closed(image, grid.spacing[0] ** 3) for image in (solid, opened))
    worth = after[after >= WORTH * before.sum()]
    edges = sharp_edges(mesh)
    hole = edge = plate = np.inf
    for *ends, radius in drained.drains:
        a, b = np.array(ends[:3]), np.array(ends[3:])
        axis = a + np.linspace(0, 1, 101)[:, None] * (b - a)
        steep = (b - a)[2] / np.linalg.norm(b - a)
        hole = min(hole, *(from_hole(axis, one) - radius for one in made.holes))
        edge = min(edge, from_edges(axis, edges) - radius)
        plate = min(plate, axis[:, 2].min() - radius * np.sqrt(1 - steep**2) - mesh.lower[2])
    return Outcome(
        len(drained.drains), hole / DIAMETER, edge / DIAMETER, plate / DIAMETER, float(before.sum()),
        float(after.sum()), len(worth), float(after.max(initial=0.0)), said,
    )  # fmt: skip


def main() -> None:
    """Print a row a part and a line for all."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    rows = []
    for family in sys.argv[2:] or FAMILIES:
        for seed in range(seeds):
            found = outcome(drawing(family, seed), KINDS[seed % 3])
            rows.append(found)
            print(
                f"{family:9} {seed} drains {found.drains:2} hole {found.hole:5.2f} edge {found.edge:5.2f} "
                f"plate {found.plate:5.2f} closed {found.before:7.1f} -> {found.after:6.2f} mm3, "
                f"{found.left} left, largest {found.largest:.2f}{' (said)' * found.said}",
                flush=True,
            )
    table = np.array([row[:4] for row in rows])
    near = [int((table[:, 1 + i] < 1).sum()) for i in range(3)]
    left = [row for row in rows if row.left]
    print(
        f"{len(rows)} parts, {int(table[:, 0].sum())} drains; parts with one within its diameter of a hole {near[0]}, "
        f"an edge {near[1]}, the plate {near[2]}; nearest {table[:, 1:].min(0).round(3).tolist()} diameters; with void "
        f"left {len(left)}, all of which it says: {all(row.said for row in left)}"
    )


if __name__ == "__main__":
    main()
