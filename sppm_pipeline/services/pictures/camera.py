"""Position of the viewer, and projection of points into the picture."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.arrays import F64


class Camera(NamedTuple):
    """Direction from which a part is seen; z points up in the picture.

    Attributes
    ----------
    azimuth : float
        Degrees from the x axis towards the y axis to where the viewer stands. At -60 the x axis runs to the right and
        the y axis away from the viewer.
    elevation : float
        Degrees above the x-y plane, -90..90.
    field_of_view : float
        Angle in degrees under which the part's bounding ball is seen; 0 is the orthographic view from infinitely far.
    """

    azimuth: float = -60.0
    elevation: float = 25.0
    field_of_view: float = 0.0


class Frame(NamedTuple):
    """A camera that has been pointed at a part."""

    axes: F64  # (3, 3) unit vectors right, up, and towards the viewer, as rows
    target: F64  # the point that is looked at; the origin of view coordinates
    distance: float  # of the viewer from the target; 0 for the orthographic view
    scale: float  # pixels per unit of length at the target
    column: float  # where the target lands, in pixels; pixel (r, c) covers r..r+1 and c..c+1
    row: float


def _view_coordinates(points: F64, axes: F64, target: F64) -> tuple[F64, ...]:
    # Written out instead of a matrix product: BLAS may round differently with another number of threads.
    x, y, z = (points[:, axis] - target[axis] for axis in range(3))
    return tuple(axis[0] * x + axis[1] * y + axis[2] * z for axis in axes)


def framed(camera: Camera, points: F64, size: tuple[int, int], margin: float = 0.04) -> Frame:
    """Point a camera at points (n, 3) so that they fill a picture (width, height) but for a margin on each side."""
    if not -90.0 <= camera.elevation <= 90.0:
        raise DesignError(f"the elevation is {camera.elevation} degrees, allowed are -90 to 90")
    if not 0.0 <= camera.field_of_view <= 120.0:
        raise DesignError(
            f"the field of view is {camera.field_of_view} degrees, allowed are 0 to 120",
            hint="0 is the orthographic view; 20 looks natural",
        )
    width, height = size
    if width < 1 or height < 1:
        raise DesignError(f"the picture is {width} x {height} pixels", hint="use at least one pixel")
    azimuth, elevation = math.radians(camera.azimuth), math.radians(camera.elevation)
    cos_a, sin_a, cos_e, sin_e = math.cos(azimuth), math.sin(azimuth), math.cos(elevation), math.sin(elevation)
    axes = np.array(
        [[-sin_a, cos_a, 0.0], [-sin_e * cos_a, -sin_e * sin_a, cos_e], [cos_e * cos_a, cos_e * sin_a, sin_e]]
    )
    low, high = points.min(axis=0), points.max(axis=0)
    target = (low + high) / 2
    distance = 0.0
    right, up, towards = _view_coordinates(points, axes, target)
    if camera.field_of_view > 0.0:
        radius = float(np.sqrt((right**2 + up**2 + towards**2).max()))
        # A single point has no size; any distance shows it.
        distance = max(radius, 1e-12) / math.sin(math.radians(camera.field_of_view) / 2)
        right, up = right * distance / (distance - towards), up * distance / (distance - towards)
    spans = float(np.ptp(right)), float(np.ptp(up))
    room = 1.0 - 2.0 * margin
    scales = [room * pixels / span for pixels, span in zip((width, height), spans, strict=True) if span > 0.0]
    scale = min(scales) if scales else 1.0
    return Frame(
        axes,
        target,
        distance,
        scale,
        width / 2 - scale * float(right.min() + right.max()) / 2,
        height / 2 + scale * float(up.min() + up.max()) / 2,
    )


def projected(frame: Frame, points: F64) -> F64:
    """Place of points (n, 3) in the picture: column and row in pixels, and nearness.

    Nearness is a number that is linear over a projected triangle and grows towards the viewer (the coordinate towards
    the viewer itself in the orthographic view, else 1 / distance from the viewer's plane).
    """
    right, up, towards = _view_coordinates(points, frame.axes, frame.target)
    if frame.distance > 0.0:
        nearness = 1.0 / (frame.distance - towards)
        right, up = right * frame.distance * nearness, up * frame.distance * nearness
    else:
        nearness = towards
    return np.stack([frame.column + frame.scale * right, frame.row - frame.scale * up, nearness], axis=1)
