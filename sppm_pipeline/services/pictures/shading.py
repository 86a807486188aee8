"""Shading of a depth, normal and color buffer: lights, ambient occlusion, antialiasing.

Porous parts are hard to read under plain lights, since every strut looks like every other. A pore differs
from a strut in how much of the sky a point sees. Screen-space ambient occlusion estimates it from the depth image:
around each pixel, points of a half ball above the surface are tested for being behind something that is seen.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F32, F64, I64, U8
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.pictures.camera import Frame
from sppm_pipeline.services.threads import in_bands

Color = tuple[int, int, int]

#: Colors of surfaces, of cuts through the material, and of a solid skin.
BONE: Color = (226, 214, 192)
CUT: Color = (212, 124, 88)
SKIN: Color = (120, 150, 178)
OWN: Color = (204, 196, 180)
"""Of the surface of a part, where it is solid, which is no cut."""


class Material(NamedTuple):
    """A color of the microstructure, and of the part's own surface and skin, and how both shine."""

    color: Color
    own: Color
    gloss: float = 0.05  # strength of the highlight
    metal: float = 0.0  # share of the light that is a reflection of a bright sky and a dark ground


MATERIALS = {
    "bone": Material(BONE, OWN),
    "resin": Material((150, 166, 186), (162, 177, 195), 0.22),
    "titanium": Material((176, 174, 170), (186, 184, 180), 0.18, 0.6),
}
"""Materials by name; colors and shine are chosen by eye."""

Background = str | Color

BACKGROUNDS: dict[str, tuple[Color, Color]] = {
    "light": ((250, 251, 252), (222, 227, 233)),
    "dark": ((44, 49, 57), (20, 23, 28)),
}
"""Colors at the top and at the bottom of the picture."""

TRANSPARENT = "transparent"

_SAMPLES = 16  # per radius and pixel; neighboring pixels use rotated sets, 16 of them, which a 4 x 4 mean unites
_BAND = 64  # rows that are composed at a time
_RADII = (0.022, 0.11)  # of the height of the picture: the first for creases and edges, the second for pores


class Seen(NamedTuple):
    """Surface in each sample of a picture; (h, w) are its height and width times the supersampling."""

    # (h, w), coordinate towards the viewer in samples (length times scale); -inf where nothing is seen
    depth: F32
    normal: F32  # (h, w, 3) in the frame right, up, towards the viewer
    color: U8  # (h, w, 3), sRGB


def empty_seen(width: int, height: int) -> Seen:
    """Nothing seen yet in a picture of width x height samples."""
    return Seen(
        np.full((height, width), -np.inf, np.float32),
        np.zeros((height, width, 3), np.float32),
        np.zeros((height, width, 3), np.uint8),
    )


def _ball_points() -> F32:
    """Points in the unit ball, denser towards its center, the same everywhere: a spiral on the sphere."""
    n = np.arange(_SAMPLES)
    z = 1.0 - (2.0 * n + 1.0) / _SAMPLES
    angle = n * np.pi * (3.0 - np.sqrt(5.0))
    # Steps through the radii in an order that has nothing to do with the height z.
    radius = ((n * 7 % _SAMPLES) + 1.0) / _SAMPLES
    ring = np.sqrt(1.0 - z * z)
    points = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    return np.asarray(points * radius[:, None], np.float32)


def _rotations() -> F32:
    """Cosine, sine and size of 16 turns in the order of a 4 x 4 ordered dither, so that neighbors differ most."""
    order = np.array([0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5])
    angle = order * (2.0 * np.pi / 16.0)
    size = 0.76 + 0.03 * (order * 5 % 16)
    return np.asarray(np.stack([np.cos(angle), np.sin(angle), size], axis=1), np.float32)


@jit
def _occlusion(
    depth: F32, normal: F32, ball: F32, rotations: F32, radius: float, hidden: F32, start: int, stop: int
) -> None:
    """Fraction of the points of a half ball above each sample that lie behind something seen, in some rows."""
    height, width = depth.shape
    reach = np.float32(radius)
    bias = np.float32(0.03) * reach
    soft = np.float32(1.0) / (np.float32(0.2) * reach)
    for r in range(start, stop):
        for c in range(width):
            here = depth[r, c]
            hidden[r, c] = 0.0
            if here == -np.inf:
                continue
            nx, ny, nz = normal[r, c, 0], normal[r, c, 1], normal[r, c, 2]
            # of a surface seen edge-on the slope has no bound
            steep = np.float32(1.0) / max(nz, np.float32(0.15))
            turn = (r & 3) * 4 + (c & 3)
            span = reach * rotations[turn, 2]
            cos, sin = rotations[turn, 0] * span, rotations[turn, 1] * span
            total = np.float32(0.0)
            for s in range(ball.shape[0]):
                x = cos * ball[s, 0] - sin * ball[s, 1]
                y = sin * ball[s, 0] + cos * ball[s, 1]
                z = span * ball[s, 2]
                if x * nx + y * ny + z * nz < 0.0:
                    x, y, z = -x, -y, -z
                cc = int(c + x + np.float32(0.5))
                rr = int(r - y + np.float32(0.5))
                if 0 <= cc < width and 0 <= rr < height:
                    # To the center of the sample that was hit, keeping the height above the tangent plane.
                    z -= ((np.float32(cc - c) - x) * nx + (np.float32(r - rr) - y) * ny) * steep
                    gap = depth[rr, cc] - (here + z)
                    if gap > bias:
                        # A soft threshold keeps facets and rounding from showing. Something far in front is not known
                        # to reach back here: it counts the less the farther.
                        total += min(min((gap - bias) * soft, np.float32(1.0)), np.float32(1.5) * reach / gap)
            hidden[r, c] = total / np.float32(ball.shape[0])


@jit
def _smoothed(depth: F32, hidden: F32, radius: float, mean: F32, start: int, stop: int) -> None:
    """Mean over 4 x 4 samples of like depth, in some rows."""
    height, width = depth.shape
    near = np.float32(0.35 * radius)
    for r in range(start, stop):
        for c in range(width):
            here = depth[r, c]
            if here == -np.inf:
                continue
            total, count = np.float32(0.0), np.float32(0.0)
            for rr in range(max(r - 2, 0), min(r + 2, height)):
                for cc in range(max(c - 2, 0), min(c + 2, width)):
                    if abs(depth[rr, cc] - here) < near:
                        total += hidden[rr, cc]
                        count += np.float32(1.0)
            mean[r, c] = total / count


@jit
def light_of(
    nx: np.float32,
    ny: np.float32,
    nz: np.float32,
    color: U8,
    creases: np.float32,
    pores: np.float32,
    strength: np.float32,
    linear: F32,
    finish: F32,
) -> tuple[np.float32, np.float32, np.float32]:
    """Light (red, green, blue) from a point: its normal, its color, and how much of creases and pores hides it.

    `finish` are the gloss and the metal of a `Material`.
    """
    # Unit vectors towards a warm key light at the upper left, a cool fill light at the right, and half way to the key.
    kx, ky, kz = np.float32(-0.4603), np.float32(0.6554), np.float32(0.5989)
    fx, fy, fz = np.float32(0.8111), np.float32(0.1217), np.float32(0.5721)
    hx, hy, hz = np.float32(-0.2574), np.float32(0.3665), np.float32(0.8941)
    open_ = (np.float32(1.0) - strength * np.float32(0.75) * creases) * (np.float32(1.0) - strength * pores)
    open_ = max(open_, np.float32(0.0))
    key = max(nx * kx + ny * ky + nz * kz, np.float32(0.0))
    fill = max(nx * fx + ny * fy + nz * fz, np.float32(0.0))
    shine = max(nx * hx + ny * hy + nz * hz, np.float32(0.0))
    shine *= shine
    shine *= shine
    shine *= shine
    shine *= shine
    shine *= shine
    sky = np.float32(0.5) + np.float32(0.5) * ny
    # Lights reach into pores less than the open square says, ambient light as it says.
    direct = np.float32(0.25) * open_ + np.float32(0.75) * open_ * open_
    warm = np.float32(0.82) * key * direct
    cool = np.float32(0.36) * fill * direct
    round_ = (np.float32(0.17) + np.float32(0.22) * sky) * open_
    gloss = finish[0] * shine * direct
    # what a mirror shows of a room: how far up it looks from there, with a bright band above the horizon
    metal, high = finish[1], np.float32(2.0) * nz * ny
    room = np.float32(0.30) + np.float32(0.55) * max(high, np.float32(0.0))
    room += np.float32(1.1) / (np.float32(1.0) + np.float32(24.0) * (high - np.float32(0.55)) ** 2)
    mirror, dull = metal * room * (np.float32(0.15) + np.float32(0.85) * open_), np.float32(1.0) - metal
    return (
        linear[color[0]] * (dull * (warm * np.float32(1.03) + cool * np.float32(0.90) + round_) + mirror) + gloss,
        linear[color[1]] * (dull * (warm + cool + round_) + mirror) + gloss,
        linear[color[2]] * (dull * (warm * np.float32(0.95) + cool * np.float32(1.12) + round_) + mirror) + gloss,
    )


@jit
def _lit(
    normal: F32,
    depth: F32,
    color: U8,
    creases: F32,
    pores: F32,
    strength: np.float32,
    linear: F32,
    finish: F32,
    fine: int,
    light: F32,
) -> None:
    """Light of `fine` x `fine` samples for each pixel, as `Lit` has it."""
    share = np.float32(1.0 / (fine * fine))
    for r in range(light.shape[0]):
        for c in range(light.shape[1]):
            red, green, blue, seen = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for rr in range(r * fine, (r + 1) * fine):
                for cc in range(c * fine, (c + 1) * fine):
                    if depth[rr, cc] == -np.inf:
                        continue
                    a, b, d = light_of(
                        normal[rr, cc, 0], normal[rr, cc, 1], normal[rr, cc, 2], color[rr, cc],
                        creases[rr, cc], pores[rr, cc], strength, linear, finish,
                    )  # fmt: skip
                    red += a
                    green += b
                    blue += d
                    seen += np.float32(1.0)
            light[r, c, 0] = red * share
            light[r, c, 1] = green * share
            light[r, c, 2] = blue * share
            light[r, c, 3] = seen * share


@jit
def add_light(
    pixels: I64,
    depths: F32,
    normals: F32,
    colors: U8,
    depth: F32,
    creases: F32,
    pores: F32,
    strength: np.float32,
    linear: F32,
    finish: F32,
    light: F32,
    start: int,
    stop: int,
) -> None:
    """Add the light of more rays to some pixels; what hides the sky is that of the pixel nearest in depth."""
    height, width = depth.shape
    share = np.float32(1.0 / (depths.shape[1] + 1))
    for p in range(start, stop):
        r, c = pixels[p] // width, pixels[p] % width
        for s in range(depths.shape[1]):
            if depths[p, s] == -np.inf:
                continue
            near = np.inf
            crease, pore = np.float32(0.0), np.float32(0.0)
            for rr in range(max(r - 1, 0), min(r + 2, height)):
                for cc in range(max(c - 1, 0), min(c + 2, width)):
                    gap = abs(depth[rr, cc] - depths[p, s])
                    if gap < near:
                        near = gap
                        crease, pore = creases[rr, cc], pores[rr, cc]
            red, green, blue = light_of(
                normals[p, s, 0], normals[p, s, 1], normals[p, s, 2], colors[p, s], crease, pore, strength, linear,
                finish,
            )  # fmt: skip
            light[r, c, 0] += red
            light[r, c, 1] += green
            light[r, c, 2] += blue
            light[r, c, 3] += np.float32(1.0)
        for channel in range(4):
            light[r, c, channel] *= share


def _linear_light(coded: F64) -> F64:
    """From sRGB values 0..1 to light (IEC 61966-2-1)."""
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def _coded_light(light: F64) -> F64:
    """From light 0..1 to sRGB values (IEC 61966-2-1)."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


LINEAR = _linear_light(np.arange(256) / 255.0).astype(np.float32)
"""Light of each sRGB value."""


class Hidden(NamedTuple):
    """Share of the sky hidden from each sample (h, w), 0 to 1."""

    creases: F32  # by something near
    pores: F32  # by something farther away


def hidden_sky(seen: Seen, threads: int = 1) -> Hidden:
    """Ambient occlusion of a scene (Mittring 2007, "Finding next gen: CryEngine 2", of the depth image)."""
    height, width = seen.depth.shape
    found = []
    for share in _RADII:
        radius = share * height
        around, mean = np.empty((height, width), np.float32), np.zeros((height, width), np.float32)
        ball, turns = _ball_points(), _rotations()
        in_bands(partial(_occlusion, seen.depth, seen.normal, ball, turns, radius, around), height, threads)
        in_bands(partial(_smoothed, seen.depth, around, radius, mean), height, threads)
        found.append(mean)
    return Hidden(*found)


@jit
def _shaded(depth: F32, reach: float, shade: F32, start: int, stop: int) -> None:
    """Share of the key light that each sample does not get, as something seen is in its way, in some rows."""
    height, width = depth.shape
    span = np.float32(0.8) * reach
    for r in range(start, stop):
        for c in range(width):
            here = depth[r, c]
            shade[r, c] = 0.0
            if here == -np.inf:
                continue
            # steps grow with the distance, and begin elsewhere in neighboring samples, which a mean unites
            most, step = np.float32(0.0), np.float32(1.5) + np.float32(0.25) * np.float32((r & 3) * 4 + (c & 3))
            way = step
            while way < reach:
                rr, cc = int(r - way * np.float32(0.6554)), int(c - way * np.float32(0.4603))
                if not (0 <= rr < height and 0 <= cc < width):
                    break
                above = depth[rr, cc] - (here + way * np.float32(0.5989))
                # what is far in front of the ray does not reach back to it
                if above > np.float32(1.0):
                    edge = min((above - np.float32(1.0)) / (np.float32(0.08) * way + np.float32(1.0)), np.float32(1.0))
                    most = max(most, edge * min(np.float32(1.0), span / above) * (np.float32(1.0) - way / reach))
                way += step
                step *= np.float32(1.08)
            shade[r, c] = most


def shaded(seen: Seen, threads: int = 1) -> F32:
    """Soft shadows on a scene, as shares of the key light (h, w); rays of light pass through the depth image, so that
    only what is seen casts a shadow."""
    height, width = seen.depth.shape
    raw, soft = np.empty((height, width), np.float32), np.zeros((height, width), np.float32)
    reach = 0.3 * height
    in_bands(partial(_shaded, seen.depth, reach, raw), height, threads)
    in_bands(partial(_smoothed, seen.depth, raw, reach, soft), height, threads)
    return soft


def on_ground(seen: Seen, frame: Frame, light: F32) -> None:
    """Put the shadow that a part casts on the ground below it behind the light of a picture, and darken what is far.

    The ground is the level of the lowest surface that is seen, and the light comes from above the viewer, to the left.
    `light` (h, w, 4), as `lit` gives it, is changed; a shadow is black with the opacity of the fourth channel.
    """
    from scipy.ndimage import gaussian_filter

    height, width = seen.depth.shape
    rows, columns = np.nonzero(np.isfinite(seen.depth))
    if not len(rows):
        return
    depth = seen.depth[rows, columns].astype(np.float64)
    low, high = float(depth.min()), float(depth.max())
    light[rows, columns, :3] *= (0.72 + 0.28 * (depth - low) / max(high - low, 1e-9))[:, None]
    right, up, toward = frame.axes
    across, above = columns - frame.column, frame.row - rows
    z = across * right[2] + above * up[2] + depth * toward[2]
    # the way of the light to the ground, in the frame of the picture
    way = np.array([0.35, 0.0, 0.0]) + np.array([-right[2], -up[2], -toward[2]])
    drop = (z - z.min()) / -(way[0] * right[2] + way[1] * up[2] + way[2] * toward[2])
    c = np.rint(columns + drop * way[0]).astype(int)
    r = np.rint(rows - drop * way[1]).astype(int)
    there = (r >= 0) & (r < height) & (c >= 0) & (c < width)
    ground = np.zeros((height, width), np.float32)
    ground[r[there], c[there]] = 1.0
    dark = 0.35 * gaussian_filter(ground, 0.006 * height) + 0.25 * gaussian_filter(ground, 0.03 * height)
    light[..., 3] += (1 - light[..., 3]) * dark


def lit(
    seen: Seen, hidden: Hidden | None, occlusion: float, supersampling: int = 1, material: Material = MATERIALS["bone"]
) -> F32:
    """Light of each pixel, (h, w, 4) float32: red, green and blue of what is seen, and the share of samples with any.

    Without `hidden` nothing is in the shade of anything.
    """
    height, width = (n // supersampling for n in seen.depth.shape)
    creases, pores = hidden or (np.zeros_like(seen.depth),) * 2
    light = np.empty((height, width, 4), np.float32)
    strength, finish = np.float32(occlusion), finish_of(material)
    _lit(seen.normal, seen.depth, seen.color, creases, pores, strength, LINEAR, finish, supersampling, light)
    return light


def finish_of(material: Material) -> F32:
    """Gloss and metal as kernels take them."""
    return np.array([material.gloss, material.metal], np.float32)


def check_background(background: Background) -> None:
    """Refuse words that mean no background."""
    if isinstance(background, str) and background != TRANSPARENT and background not in BACKGROUNDS:
        raise ValueError(f"the background is {background!r}, allowed are {', '.join(BACKGROUNDS)} and {TRANSPARENT}")


def on_background(light: F32, background: Background) -> U8:
    """The picture in sRGB (h, w, 3), or (h, w, 4) if transparent, of light (h, w, 4) as `lit` gives it."""
    check_background(background)
    height, width = light.shape[:2]
    table = np.rint(255.0 * _coded_light(np.linspace(0.0, 1.0, 8192))).astype(np.uint8)
    top = np.float32(len(table) - 1)
    transparent = background == TRANSPARENT
    picture = np.empty((height, width, 4 if transparent else 3), np.uint8)
    if not transparent:
        ends = BACKGROUNDS[background] if isinstance(background, str) else (background, background)
        down = np.linspace(0.0, 1.0, height)[:, None]
        gradient = (np.array(ends[0]) * (1.0 - down) + np.array(ends[1]) * down) / 255.0
        behind = _linear_light(gradient).astype(np.float32)
    for start in range(0, height, _BAND):  # a band at a time, for memory
        band = light[start : start + _BAND]
        seen = band[..., 3:]
        if transparent:
            shown = band[..., :3] / np.maximum(seen, np.float32(1e-6))
            picture[start : start + _BAND, :, 3:] = np.rint(255 * seen)
        else:
            shown = band[..., :3] + (1 - seen) * behind[start : start + _BAND, None]
        places = (np.minimum(shown, np.float32(1.0)) * top + np.float32(0.5)).astype(np.int16)
        picture[start : start + _BAND, :, :3] = table[places]
    return picture
