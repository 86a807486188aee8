"""Depths in tunnels against the distance from segments."""

import numpy as np
import pytest

from sppm_pipeline.features.walls.numerics.walls import OPEN, opening, raise_to_depth, wall_field
from sppm_pipeline.services.grid import Grid

GRID = Grid((-0.1, 0.0, 0.05), (0.037, 0.051, 0.043), (31, 19, 21))


def tunnels(seed):
    rng = np.random.default_rng(seed)
    starts, ends = rng.random((12, 3)), rng.random((12, 3))
    ends[0] = starts[0]  # a ball
    ends[1] = starts[1] + [0.4, 0, 0]  # along the rows
    ends[2] = starts[2] - [0, 0, 0.4]
    return starts, ends, rng.uniform(0.03, 0.08, 12)


def depth(grid, starts, ends, radii):
    """Radius less distance, for the nearest tunnel."""
    x, y, z = (grid.axis(a) for a in range(3))
    where = np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], -1)
    found = np.full(where.shape[:3], -np.inf)
    for a, b, radius in zip(starts, ends, radii, strict=True):
        along = b - a
        share = np.clip((where - a) @ along / max(along @ along, 1e-30), 0, 1)
        found = np.maximum(found, radius - np.linalg.norm(where - a - share[..., None] * along, axis=-1))
    return found


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_depths_are_exact_up_to_the_margin(seed):
    args = tunnels(seed)
    out = np.full((21, 19, 31), -0.06, np.float32)
    raise_to_depth(out, GRID, *args, 0.06)
    np.testing.assert_allclose(out, np.maximum(depth(GRID, *args), -0.06), atol=3e-7)
    for first, layers in ((0, 1), (4, 7)):
        part = np.full((layers, 19, 31), -0.06, np.float32)
        raise_to_depth(part, GRID, *args, 0.06, 2, first)
        assert part.tobytes() == out[first : first + layers].tobytes()


@pytest.mark.parametrize("rounding", [0.0, 0.05])
def test_a_point_is_solid_where_the_thickness_exceeds_its_opening(rounding):
    """Both ways to the sign agree for every thickness, and no thickness closes a tunnel."""
    rng = np.random.default_rng(7)
    distance = rng.uniform(-0.02, 0.3, (4, 20, 50)).astype(np.float32)
    inside = rng.uniform(-0.15, 0.1, distance.shape).astype(np.float32)
    needed = opening(distance.copy(), inside, rounding)
    assert (needed[inside >= 0] == OPEN).all()
    for half in (0.01, 0.05, 0.12, 0.4):
        field = wall_field(distance.copy(), inside, half, rounding)
        clear = np.abs(needed - half) > 1e-5
        np.testing.assert_array_equal((field < 0)[clear], (needed < half)[clear])
        if not rounding:
            np.testing.assert_array_equal(field, np.maximum(distance - np.float32(half), inside))


def test_rims_are_round():
    """Between the side of a wall and the surface of a tunnel there is an arc of the given radius, no edge."""
    angle = np.linspace(0.01, np.pi / 2 - 0.01, 40)
    distance = (0.1 - 0.04 + 0.04 * np.sin(angle)).astype(np.float32)
    inside = (-0.04 + 0.04 * np.cos(angle)).astype(np.float32)
    np.testing.assert_allclose(wall_field(distance.copy(), inside, 0.1, 0.04), 0, atol=1e-7)
    np.testing.assert_allclose(opening(distance, inside, 0.04), 0.1, atol=1e-6)
