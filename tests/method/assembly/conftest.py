"""Small random tile sets and tilings."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.method.assembly.contents import Pieces, TilingArrays, connector_code
from sppm_pipeline.method.kernels.kernels import Kernels, concatenated


class Sets:
    """Makers of pieces and tilings, and the obvious list of all kernels of a tiling."""

    @staticmethod
    def pieces(seed: int, interiors: int = 3, colors: int = 2, profile: str = "linear", share: float = 0.7) -> Pieces:
        """Random pieces; about `share` of the connectors are there."""
        rng = np.random.default_rng(seed)

        def kernels(points: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> Kernels:
            omega, mu = rng.uniform(80.0, 250.0, len(points)), rng.uniform(40.0, 90.0, len(starts))
            return Kernels(points, omega, starts, ends, mu * 10 if profile == "squared" else mu, profile)

        inside = []
        for _ in range(interiors):
            points = 0.1 + 0.8 * rng.random((8, 3))
            inside.append(kernels(points, points[:-1], points[1:]))
        faces: list[tuple[Kernels, ...]] = []
        for axis in range(3):
            row = []
            for _ in range(colors):
                points = 0.1 + 0.8 * rng.random((4, 3))
                points[:, axis] = 0.0
                row.append(kernels(points, points[:2], points[2:]))
            faces.append(tuple(row))
        connectors = {}
        for t in range(interiors):
            for axis in range(3):
                for side in range(2):
                    for color in range(colors):
                        if rng.random() < share:
                            ends = faces[axis][color].centers[:2].copy()
                            ends[:, axis] = side
                            connectors[t, axis, side, color] = kernels(np.zeros((0, 3)), inside[t].centers[:2], ends)
        return Pieces.of(inside, faces, connectors)

    @staticmethod
    def lone(pieces: Pieces, interior: int, colors: tuple[int, int, int]) -> Kernels:
        """All kernels of an interior among faces that are equal on opposite sides."""
        own, numbers = np.array([interior]), pieces.numbers
        members = [own]
        for axis, color in enumerate(np.array(colors)[:, None]):
            members.append(numbers.face(axis, color))
            members += [numbers.connector(own, axis, side, color) for side in (0, 1)]
        return concatenated(pieces[int(number[0])] for number in members)

    @staticmethod
    def combinations(tiling: TilingArrays) -> np.ndarray:
        """Interior and six face colors of every cell that is there, each combination once."""
        rows = []
        for i, j, k in np.argwhere(tiling.interior >= 0):
            x, y, z = tiling.faces
            colors = x[i, j, k], x[i + 1, j, k], y[i, j, k], y[i, j + 1, k], z[i, j, k], z[i, j, k + 1]
            rows.append((tiling.interior[i, j, k], *colors))
        return np.unique(np.array(rows, np.int32).reshape(-1, 7), axis=0)

    @staticmethod
    def tiling(
        seed: int, shape: tuple[int, int, int], pieces: Pieces, periodic: bool = False, holes: float = 0.25
    ) -> TilingArrays:
        """Random colors and interiors; about `holes` of the cells and faces are missing."""
        rng = np.random.default_rng(seed)

        def draw(count: int, size: tuple[int, ...]) -> np.ndarray:
            return np.where(rng.random(size) < holes, -1, rng.integers(0, count, size)).astype(np.int32)

        faces = []
        for axis in range(3):
            planes = draw(pieces.colors, tuple(s + (a == axis) for a, s in enumerate(shape)))
            if periodic:
                planes = np.concatenate([np.delete(planes, -1, axis), np.take(planes, [0], axis)], axis)
            faces.append(planes)
        return TilingArrays(draw(pieces.interiors, shape), (faces[0], faces[1], faces[2]), periodic)

    @staticmethod
    def every_kernel(pieces: Pieces, tiling: TilingArrays, images: int = 0) -> Kernels:
        """All kernels of a tiling by plain loops; of a periodic one with its images."""
        nx, ny, nz = tiling.shape
        numbers = pieces.numbers
        found = []
        for i, j, k in np.ndindex(nx + 1, ny + 1, nz + 1):
            place = np.array([i, j, k], dtype=float)
            for axis in range(3):
                last = (nx, ny, nz)[axis] - 1 if tiling.periodic else (nx, ny, nz)[axis]
                limit = [nx - 1, ny - 1, nz - 1]
                limit[axis] = last
                if i <= limit[0] and j <= limit[1] and k <= limit[2]:
                    color = tiling.faces[axis][i, j, k]
                    if color >= 0:
                        found.append(pieces[numbers.interiors + axis * numbers.colors + color].shifted(place))
            if i == nx or j == ny or k == nz or tiling.interior[i, j, k] < 0:
                continue
            t = int(tiling.interior[i, j, k])
            found.append(pieces[t].shifted(place))
            for axis in range(3):
                for side in range(2):
                    step = [i, j, k]
                    step[axis] += side
                    color = int(tiling.faces[axis][tuple(step)])
                    code = int(connector_code(t, axis, side, color, colors=pieces.colors))
                    if color >= 0 and code in pieces.codes.tolist():
                        number = numbers.interiors + 3 * numbers.colors + pieces.codes.tolist().index(code)
                        found.append(pieces[number].shifted(place))
        steps = range(-images, images + 1)
        size = np.array([nx, ny, nz])
        return concatenated(
            part.shifted(size * np.array([x, y, z])) for part in found for x in steps for y in steps for z in steps
        )


@pytest.fixture(scope="session")
def sets() -> type[Sets]:
    """The makers."""
    return Sets
