"""Pictures of a part: its conditions, and how it deforms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.parts.bodies import Applied, VoxelBody, at_nodes, exposed_faces
from sppm_pipeline.pictures import BONE, Camera, colors_of, contact_sheet, render_mesh, with_scale
from sppm_pipeline.services.arrays import F32, F64, I32, I64, Bools

if TYPE_CHECKING:
    from sppm_pipeline.features.parts.part_result import PartResult

COLORS = {"displacement": (60, 110, 190), "force": (200, 50, 40), "pressure": (230, 140, 30)}
"""Of what is held, pulled and pressed."""

MEANINGS = {"displacement": "held blue", "force": "pulled red", "pressure": "pressed orange"}

CAMERA, OPPOSITE = Camera(azimuth=-55.0, elevation=25.0), Camera(azimuth=125.0, elevation=-25.0)


def surface_of(body: VoxelBody) -> tuple[I64, I32, I64]:
    """Nodes at the surface (n,), triangles (m, 3) between them, and the voxel (m,) of each triangle."""
    faces = exposed_faces(body)
    quads = faces.corners
    nodes, corners = np.unique(np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]), return_inverse=True)
    return nodes, corners.reshape(-1, 3).astype(np.int32), np.concatenate([faces.voxel, faces.voxel])


SHOWN = 1 << 20
"""Solid voxels of which the surface is kept; larger bodies are coarsened, as no picture shows them."""


class Shell(NamedTuple):
    """The surface of a body, on blocks of its voxels if these are many."""

    block: int  # voxels along the edge of a block, solid where half of them are
    solid: Bools  # the body itself
    nodes: I64  # these as `surface_of` has them, of the blocks
    triangles: I32
    voxels: I64
    points: F32  # (n, 3)

    @classmethod
    def of(cls, body: VoxelBody) -> Shell:
        """The surface of a body."""
        block = 1
        while np.count_nonzero(body.solid) > SHOWN * block**3:
            block += 1
        share = _blocks(body.solid.astype(np.float32), block)
        x, y, z = (block * h for h in body.edges)
        coarse = VoxelBody(share >= 0.5, (x, y, z), body.origin) if block > 1 else body
        nodes, triangles, voxels = surface_of(coarse)
        return cls(block, body.solid, nodes, triangles, voxels, coarse.points(nodes).astype(np.float32))

    def moved(self, u: NDArray[Any]) -> F32:
        """Displacements (n, 3) of its points: of blocks, the means of the solid voxels around them."""
        if self.block == 1:
            return np.asarray(u.reshape(3, -1)[:, self.nodes].T, np.float32)
        counts = np.maximum(at_nodes(_blocks(self.solid.astype(np.float32), self.block)), 1e-30)
        sums = (at_nodes(_blocks(np.where(self.solid, one[:-1, :-1, :-1], 0), self.block)) for one in u)
        return np.stack([(each / counts).reshape(-1)[self.nodes] for each in sums], axis=1)

    def stresses(self, stress: F32) -> F32:
        """Stresses (m,) of its triangles: of blocks, the means of their solid."""
        if self.block > 1:
            share = _blocks(self.solid.astype(np.float32), self.block)
            stress = np.asarray(_blocks(stress, self.block) / np.maximum(share, 1e-30), np.float32)
        return np.asarray(stress.reshape(-1)[self.voxels])


def _blocks(values: NDArray[Any], block: int) -> F32:
    """Means of blocks; those at the ends are filled up with zeros."""
    if block == 1:
        return np.asarray(values, np.float32)
    for axis, n in enumerate(values.shape):
        values = np.add.reduceat(values, np.arange(0, n, block), axis=axis) / np.float32(block)
    return np.asarray(values, np.float32)


def conditions_picture(body: VoxelBody, cases: list[tuple[str, Applied]], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Each case from two opposite sides: blue where the part is held, red where pulled, orange where pressed."""
    nodes, triangles, _ = surface_of(body)
    points, every = body.points(nodes), exposed_faces(body).keys
    pictures, labels = list[NDArray[np.uint8]](), list[str]()
    for name, one in cases:
        colors = np.tile(np.array(BONE, np.uint8), (len(triangles) // 2, 1))
        for condition, faces in one.regions:
            colors[np.isin(every, faces.keys)] = COLORS[condition.kind]
        both = np.concatenate([colors, colors])
        pictures += [
            render_mesh(points, triangles, camera=camera, size=size, face_colors=both, smooth=False)
            for camera in (CAMERA, OPPOSITE)
        ]
        meanings = dict.fromkeys(MEANINGS[condition.kind] for condition, _ in one.regions)
        labels += [f"{name}: {', '.join(meanings)}", "the same from behind and below"]
    return np.asarray(contact_sheet(pictures, labels, columns=2))


def deformed_picture(result: PartResult, case: int, size: tuple[int, int]) -> NDArray[np.uint8]:
    """The deformed part in colors of the stress."""
    top = float(np.percentile(result.stresses[case], 99)) if result.stresses.size else 0.0
    drawn = render_mesh(
        result.shown(case).astype(np.float64), result.triangles,
        camera=CAMERA, size=size, face_colors=colors_of(result.stresses[case].astype(np.float64), 0.0, top),
        smooth=False,
    )  # fmt: skip
    label = f"{list(result.cases)[case]}: displacements {result.magnification:g} times"
    sheet = contact_sheet([drawn], [label])
    return np.asarray(with_scale(sheet, 0.0, top, "von Mises, MPa", max(120, size[0] // 5)) if top > 0 else sheet)


def density_picture(body: VoxelBody, density: F64, bounds: tuple[float, float], label: str) -> NDArray[np.uint8]:
    """The part from outside, and its far half: elements (m,) in colors of their density."""
    z, y, x = np.nonzero(body.solid)
    pictures = []
    for kept in (np.ones(len(y), bool), y >= body.solid.shape[1] // 2):
        shown, values = np.zeros_like(body.solid), np.zeros(body.solid.shape)
        shown[z[kept], y[kept], x[kept]] = True
        values[body.solid] = density
        half = body._replace(solid=shown)
        nodes, triangles, voxels = surface_of(half)
        colors = colors_of(values.reshape(-1)[voxels], *bounds)
        pictures.append(
            render_mesh(half.points(nodes), triangles, camera=CAMERA, size=(600, 480), face_colors=colors, smooth=False)
        )
    sheet = contact_sheet(pictures, [label, f"{label}, far half"], columns=2)
    return np.asarray(with_scale(sheet, *bounds, "relative density", 130))
