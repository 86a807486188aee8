"""Pictures of prints, drawn without matplotlib: layers in the colors of what is wrong with them, turns, and drains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.services.arrays import F64, I32, U8
from sppm_pipeline.services.pictures.shading import Color
from sppm_pipeline.services.pictures.sheets import contact_sheet

MARKS: tuple[tuple[str, Color], ...] = (
    ("void", (24, 26, 30)),
    ("solid", (236, 238, 241)),
    ("overhang", (150, 156, 166)),
    ("island", (255, 221, 51)),
    ("suction cup", (51, 136, 255)),
    ("resin trap", (255, 128, 0)),
)
"""Meaning and color of each code, in the order of `numerics.printing.scan`: those that users of UVtools know."""

_PANEL = 460

_VIEW = 320
"""Pixels along the side of the picture of an orientation: six of them fill the width of a screen."""


def marked_layer(codes: U8) -> U8:
    """A layer (ny, nx) of codes as a picture (ny, nx, 3), the side of largest y on top."""
    return np.array([color for _, color in MARKS], np.uint8)[codes[::-1]]


def marked_sheet(
    layers: Sequence[tuple[int, U8]], pixel: tuple[float, float], columns: Mapping[str, NDArray[Any]]
) -> U8:
    """Marked layers side by side, with what is wrong with each below it, and the meaning of the colors above.

    `layers` are numbers and codes (ny, nx), shown in the ratio of the pitches `pixel` along x and y; `columns` the
    curves of the report, (n,) each, whose areas are shown.
    """
    from PIL import Image, ImageDraw  # only pictures with text need Pillow

    from sppm_pipeline.services.pictures.sheets import font

    pictures, labels = [], []
    for k, codes in layers:
        ny, nx = codes.shape
        scale = _PANEL / max(nx, ny * pixel[1] / pixel[0])
        size = (max(1, round(nx * scale)), max(1, round(ny * pixel[1] / pixel[0] * scale)))
        way = Image.Resampling.BOX if scale < 1 else Image.Resampling.NEAREST
        pictures.append(np.asarray(Image.fromarray(marked_layer(codes)).resize(size, way)))
        areas = [
            f"{word} {columns[name][k]:.3g} mm^2"
            for word, name in (("sealed", "sealed_mm2"), ("floating", "floating_mm2"), ("overhang", "overhang_mm2"))
            if columns[name][k]
        ]
        labels.append(f"layer {k} ({columns['top_mm'][k]:.4g} mm): {', '.join(areas)}")
    sheet = contact_sheet(pictures, labels, columns=min(3, len(pictures)), text_size=15)
    legend = Image.new("RGB", (sheet.shape[1], 44), (255, 255, 255))
    pen, x = ImageDraw.Draw(legend), 20
    for word, color in MARKS:
        pen.rectangle((x, 14, x + 18, 32), fill=color, outline=(90, 90, 90))
        pen.text((x + 26, 23), word, fill=(52, 58, 66), font=font(15), anchor="lm")
        x += 26 + int(font(15).getlength(word)) + 26
    return np.concatenate([np.asarray(legend), sheet])


def orientations_sheet(rows: Sequence[Mapping[str, Any]], views: Sequence[F64], voxel: float) -> U8:
    """Orientations side by side, the best first, seen from the front, with turn, score and costs below each.

    `rows` have ``turn``, ``score``, ``supports_mm2``, ``cups_mm2``, ``height_mm``, ``pareto``; `views`, (nz, nx), are
    depths from 0 to 1, lowest layer first, NaN where nothing is; `voxel` is an edge, mm.
    """
    trimmed = [view[~np.isnan(view).all(1)] for view in views]
    side = max(max(view.shape) for view in trimmed)
    zoom = max(1, round(_VIEW / side))
    pictures, labels = [], []
    for row, view in zip(rows, trimmed, strict=True):
        framed = np.full((side, side), np.nan)
        left = (side - view.shape[1]) // 2
        framed[: len(view), left : left + view.shape[1]] = view  # all stand on one line
        light = np.nan_to_num(1 - 0.75 * framed)[..., None] * np.array(MARKS[1][1])
        picture = np.where(np.isnan(framed)[..., None], MARKS[0][1], light).astype(np.uint8)[::-1]
        pictures.append(picture.repeat(zoom, 0).repeat(zoom, 1))
        x, y, _ = row["turn"]
        costs = f"{row['supports_mm2']:.3g}, {row['cups_mm2']:.3g} mm2, {row['height_mm']:.3g} mm"
        labels.append(f"{'* ' if row['pareto'] else ''}{x:.4g}, {y:.4g}: {row['score']:.3g}; {costs}")
    title = (
        "Turn about x, y: score; supports, cups, height. * none is better in one and as good in all. "
        f"Voxels of {voxel:.3g} mm hide what is thinner"
    )
    return contact_sheet(pictures, labels, columns=6, title=title, gap=16, text_size=17)


def drains_sheet(part: SurfaceMesh, vertices: F64, faces: I32) -> U8:
    """A part from two opposite sides, above and below, with the plugs (n, 3), (m, 3) of its drains in color."""
    from sppm_pipeline.services.pictures.camera import Camera
    from sppm_pipeline.services.pictures.mesh_view import render_mesh

    points = np.concatenate([part.vertices, vertices])
    triangles = np.concatenate([part.faces, faces + len(part.vertices)])
    colors = np.repeat([MARKS[1][1], MARKS[5][1]], [len(part.faces), len(faces)], axis=0).astype(np.uint8)
    views = [Camera(azimuth, elevation) for azimuth in (-60.0, 120.0) for elevation in (25.0, -25.0)]
    pictures = [
        render_mesh(points, triangles, camera=view, size=(_PANEL, _PANEL), face_colors=colors) for view in views
    ]
    labels = [f"{'above' if view.elevation > 0 else 'below'}, from {view.azimuth:g} degrees" for view in views]
    return contact_sheet(pictures, labels, columns=2, text_size=15)
