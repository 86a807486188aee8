"""The case tables: loops on the faces, triangles without a diagonal in a face."""

from collections import Counter

import numpy as np
import pytest

from sppm_pipeline.services.mesh.marching_tables import case_tables, separations

CORNERS = np.array([[c & 1, c >> 1 & 1, c >> 2] for c in range(8)])
ENDS = {
    **{y + 2 * z: (2 * y + 4 * z, 1 + 2 * y + 4 * z) for y in (0, 1) for z in (0, 1)},
    **{4 + x + 2 * z: (x + 4 * z, x + 2 + 4 * z) for x in (0, 1) for z in (0, 1)},
    **{8 + x + 2 * y: (x + 2 * y, x + 2 * y + 4) for x in (0, 1) for y in (0, 1)},
}


def faces_of(edge: int) -> set[tuple[int, int]]:
    a, b = (CORNERS[corner] for corner in ENDS[edge])
    return {(axis, int(a[axis])) for axis in range(3) if a[axis] == b[axis]}


def triangles_of(case: int) -> list[list[int]]:
    tables = case_tables()
    return tables.triangles[case, : 3 * int(tables.counts[case])].reshape(-1, 3).tolist()


def rims_of(case: int) -> Counter[tuple[int, int]]:
    """Directed edges without a partner within the cube."""
    uses = Counter((t[i], t[(i + 1) % 3]) for t in triangles_of(case) for i in range(3))
    assert max(uses.values(), default=1) == 1
    return Counter(edge for edge in uses if edge[::-1] not in uses)


@pytest.mark.parametrize("case", range(256))
def test_triangles_use_exactly_the_crossed_edges(case: int) -> None:
    crossed = {edge for edge, (a, b) in ENDS.items() if (case >> a & 1) != (case >> b & 1)}
    assert {edge for triangle in triangles_of(case) for edge in triangle} == crossed


@pytest.mark.parametrize("case", range(256))
def test_only_rims_lie_in_a_face(case: int) -> None:
    rims = rims_of(case)
    for triangle in triangles_of(case):
        assert not faces_of(triangle[0]) & faces_of(triangle[1]) & faces_of(triangle[2])
        for i in range(3):
            edge = triangle[i], triangle[(i + 1) % 3]
            assert bool(faces_of(edge[0]) & faces_of(edge[1])) == (edge in rims)


def test_neighboring_cubes_agree_on_their_common_face() -> None:
    for axis in range(3):
        low = [corner for corner in range(8) if not CORNERS[corner][axis]]
        high = [corner + (1 << axis) for corner in low]
        edges_low = [edge for edge in range(12) if (axis, 0) in faces_of(edge)]
        partner = {tuple(ENDS[edge]): edge for edge in range(12)}
        moved = {edge: partner[tuple(end + (1 << axis) for end in ENDS[edge])] for edge in edges_low}
        seen: dict[tuple[int, ...], set[tuple[int, int]]] = {}
        for case in range(256):
            on_low = {edge for edge in rims_of(case) if all((axis, 0) in faces_of(e) for e in edge)}
            signs = tuple(case >> corner & 1 for corner in low)
            assert seen.setdefault(signs, on_low) == on_low
        for case in range(256):
            on_high = {edge for edge in rims_of(case) if all((axis, 1) in faces_of(e) for e in edge)}
            signs = tuple(case >> corner & 1 for corner in high)
            assert on_high == {(moved[b], moved[a]) for a, b in seen[signs]}


def test_solid_corners_on_the_diagonal_of_a_face_are_separated() -> None:
    assert len(triangles_of(0b00001001)) == 2  # two corners, each cut off by a triangle of its own
    assert len(rims_of(0b00001001)) == 6


def test_at_most_five_triangles() -> None:
    assert case_tables().counts.max() == 5
    assert case_tables().counts[0] == case_tables().counts[255] == 0


def test_polygons_of_a_cube_are_kept_apart():
    """Two opposite corners: what is next to one may not reach beyond the middle between them."""
    planes = separations()
    several = [case for case in range(256) if planes[case].any()]
    assert len(several) == 90  # and two whose faces are all passed twice
    assert not planes[0b00000001].any()
    opposite = planes[0b10000001]
    assert np.count_nonzero(opposite.any(axis=2)) == 6  # one other polygon, and each face has a side of one of them
    for face in range(6):
        axis, side = divmod(face, 2)
        for place in ((0.1, 0.2), (0.3, 0.35), (0.9, 0.95)):
            point = np.insert(np.array(place), axis, side)
            near = point.sum() < 1.5 if side == 0 else point.sum() > 1.5
            assert (planes[0b10000001, face, 0, :3] @ point <= planes[0b10000001, face, 0, 3]) == near
