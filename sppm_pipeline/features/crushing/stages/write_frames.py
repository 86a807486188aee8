"""``write.frames``: pictures, an animation and meshes of a body while it is crushed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, Palette, Size, Stage, option, options
from sppm_pipeline.features.crushing.compression import CrushedBody

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

        from sppm_pipeline.features.crushing.crushed_view import frame_pictures
        from sppm_pipeline.formats import encode_hexahedra
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
                    file.writelines(encode_hexahedra(nodes, body.elements[left], data))
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
