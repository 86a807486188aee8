"""``write.frames``: pictures, an animation and meshes of a body while it is crushed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_crushing.compression import CrushedBody
from sppm_pipeline import Context, Palette, Size, Stage, option, options
from sppm_pipeline.numerics import VOXEL_FACES

if TYPE_CHECKING:
    from sppm_pipeline.pictures import Camera

UPRIGHT = {"z": (0, 1, 2), "x": (1, 2, 0), "y": (2, 0, 1)}
"""Axes in the order that puts the axis of compression on top."""


def exposed_triangles(
    voxels: NDArray[np.int32], grid: tuple[int, int, int], elements: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles (n, 3) of the faces that no other voxel covers, normals outwards, and the voxel (n,) of each.

    `voxels` (m, 3) are places in the grid (nx, ny, nz), `elements` (m, 8) nodes at the corners, in the order of
    `VOXEL_FACES`.
    """
    solid = np.zeros(tuple(n + 2 for n in grid), bool)
    places = voxels.astype(np.int64) + 1
    solid[tuple(places.T)] = True
    triangles, owners = [], []
    for beyond, corners in VOXEL_FACES:
        bare = np.flatnonzero(~solid[tuple((places + beyond).T)])
        quads = elements[bare][:, corners].astype(np.int64)
        triangles += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
        owners += [bare, bare]
    return np.concatenate(triangles), np.concatenate(owners)


def frame_pictures(
    voxels: NDArray[np.int32], grid: tuple[int, int, int], elements: NDArray[np.int32], frames: NDArray[np.float32],
    colors: Iterator[NDArray[np.uint8]], *, released: NDArray[np.bool_] | None = None, axis: str, camera: Camera,
    size: tuple[int, int], section: float | None,
) -> Iterator[NDArray[np.uint8]]:  # fmt: skip
    """A picture (height, width, 3) of each frame, all at one scale, the axis of compression upright.

    `frames` (f, p, 3) are positions of the nodes, `colors` those of the voxels (m, 3), frame by frame; `released`
    (f, m) says which voxels have failed and are not drawn, if any can. The camera is in the turned axes. `section` is
    the share of the undeformed block that is kept, along the second of the turned axes, the far side; a layer of voxels
    at least.
    """
    from sppm_pipeline.pictures import render_mesh

    turned = list(UPRIGHT[axis])
    kept = np.ones(len(voxels), bool)
    if section is not None:
        along = voxels[:, turned[1]]
        kept = along >= min((1 - section) * grid[turned[1]] - 0.5, along.max())  # the farthest layer at least
    shown = [kept] * len(frames) if released is None or not len(released) else [kept & ~gone for gone in released]
    drawn: list[tuple[NDArray[Any], NDArray[Any], NDArray[Any]]] = []
    for number, here in enumerate(shown):
        if number and np.array_equal(here, shown[number - 1]):
            drawn.append(drawn[-1])
            continue
        triangles, owners = exposed_triangles(voxels[here], grid, elements[here])
        nodes, faces = np.unique(triangles, return_inverse=True)
        drawn.append((nodes, faces.reshape(triangles.shape), np.flatnonzero(here)[owners]))
    positions = [frame[nodes][:, turned].astype(np.float64) for frame, (nodes, _, _) in zip(frames, drawn, strict=True)]
    every = np.concatenate(positions)
    low, high = every.min(axis=0), every.max(axis=0)
    # the corners of a box around all frames belong to no triangle: they hold the view still
    corners = np.array([[(low, high)[(c >> a) & 1][a] for a in range(3)] for c in range(8)])
    for here, (_, faces, owners), color in zip(positions, drawn, colors, strict=True):
        points = np.concatenate([here, corners])
        yield render_mesh(points, faces, camera=camera, size=size, face_colors=color[owners])


PER_ROW = 6
"""Frames in a row of the strip, for pages and slides."""

HIGHEST = 99.0
"""Percentile of the plastic strain in the last frame at which the scale of colors ends: the few largest, at notches of
the voxels, would leave all others in one color."""


@dataclass(frozen=True, kw_only=True)
class WriteFrames(Stage):
    """Draw a crushed body at each of its frames: a strip of pictures and an animation, and if requested meshes.

    The folder holds ``strip.png``, ``animation.png`` (an animated PNG, as browsers show it), and with `meshes` a
    ``.vtu`` file of each frame for ParaView, with the arrays ``plastic_strain`` and ``phase``. The axis of compression
    points up in all pictures.
    """

    name: ClassVar[str] = "write.frames"
    advice: ClassVar[str] = "lower `image_size`, or keep fewer frames"

    path: str = options.write_path("frames", suffixes=("/",))
    color: str = option(
        "plastic_strain", help="what the colors of voxels show", choices=("plastic_strain", "phase", "none")
    )
    animation: bool = option(True, help="write animation.png")
    pause: float = option(0.4, help="time for which the animation shows a frame", unit="s", above=0, maximum=60)
    meshes: bool = option(False, help="write a .vtu file of each frame")
    image_size: tuple[int, int] = options.image_size((420, 460), note="of one frame", minimum=16)
    azimuth: float = options.azimuth(-60.0)
    elevation: float = options.elevation(18.0)
    section: float | None = options.section(None)

    def estimate(self, palette: Palette, body: Size) -> Size:
        # a crushed body counts its nodes three times, and once for each of its frames
        frames = max(1.0, body.nodes / body.resident - 3) if body.resident else 1.0
        # of the six faces of a voxel of a wall, two or three are bare, two triangles each
        return Size(pixels=frames * self.image_size[0] * self.image_size[1], triangles=5 * frames * body.resident)

    def run(self, context: Context, body: CrushedBody) -> None:
        """Draw and write."""
        from PIL import Image

        from sppm_pipeline.formats import encode_cells
        from sppm_pipeline.pictures import Camera, contact_sheet, with_scale

        folder = context.output(self.path)
        folder.mkdir(parents=True)
        top = float(np.percentile(body.frame_alpha[-1], HIGHEST)) if self.color == "plastic_strain" else 0.0
        if self.color == "plastic_strain" and top == 0:
            context.warn("nothing has yielded, so that the frames have one color")
        drawn = frame_pictures(
            body.voxels, body.grid, body.elements, body.frame_nodes, _colors(body, self.color, top),
            axis=body.axis, camera=Camera(azimuth=self.azimuth, elevation=self.elevation), size=self.image_size,
            section=self.section, released=body.frame_released,
        )  # fmt: skip
        pictures, total = [], len(body.frame_strains)
        for number, picture in enumerate(drawn, 1):
            pictures.append(picture)
            context.progress(number, total, "frames drawn")
        labels = [f"strain {100 * strain:.3g} %" for strain in body.frame_strains]
        width = max(110, self.image_size[0] // 3)

        def scaled(sheet: NDArray[np.uint8]) -> NDArray[np.uint8]:
            return with_scale(sheet, 0.0, top, "plastic strain", width) if top > 0 else sheet

        strip = scaled(contact_sheet(pictures, labels, columns=min(PER_ROW, total), title=body.name))
        Image.fromarray(strip).save(folder / "strip.png")
        if self.animation:
            sheets = [contact_sheet([one], [label]) for one, label in zip(pictures, labels, strict=True)]
            first, *others = [Image.fromarray(scaled(sheet)) for sheet in sheets]
            first.save(
                folder / "animation.png", save_all=True, append_images=others, duration=1000 * self.pause, loop=0
            )
        if self.meshes:
            for number, nodes in enumerate(body.frame_nodes):
                left = ~body.frame_released[number] if body.frame_released.size else slice(None)
                data = {"plastic_strain": body.frame_alpha[number][left], "phase": body.phases[left]}
                with (folder / f"frame_{number:03}.vtu").open("wb") as file:
                    file.writelines(encode_cells(nodes, body.elements[left], data))
        context.report(frames=total, plastic_strain_scale=top)


def _colors(body: CrushedBody, by: str, top: float) -> Iterator[NDArray[np.uint8]]:
    """Colors of the voxels, frame by frame."""
    from sppm_pipeline.pictures import BONE, colors_of

    for alpha in body.frame_alpha:
        if by == "phase" and body.phases.max() > 1:
            yield colors_of(body.phases.astype(np.float64), 1.0, float(body.phases.max()))
        elif top > 0:
            yield colors_of(alpha.astype(np.float64), 0.0, top)
        else:
            yield np.tile(np.array(BONE, np.uint8), (len(alpha), 1))
