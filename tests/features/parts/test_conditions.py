"""Regions and conditions as they are written, on voxels, and what of them is refused."""

import re

import numpy as np
import pytest

from sppm_pipeline import ConfigError, DesignError, InputError, SurfaceMesh
from sppm_pipeline.features.parts.bodies import VoxelBody, applied, exposed_faces, held_solid, mesh_body
from sppm_pipeline.features.parts.stubs import same_resultant
from sppm_pipeline.method.nouns.conditions import LoadCase, condition_of, held_of, region_of
from sppm_pipeline.method.part.primitive_meshes import box_mesh

BLOCK = VoxelBody(np.ones((3, 4, 5), bool), (1.0, 2.0, 0.5), (-1.0, 0.0, 2.0))
"""5 x 8 x 1.5 mm from (-1, 0, 2)."""

MASS = np.full((3, 4, 5), 2.0, np.float32)
PART = SurfaceMesh(*box_mesh((1.5, 4.0, 2.75), (5.0, 8.0, 1.5)), groups=(("top", 2, 4), ("all", 0, 12)))


def case(*conditions, gravity=(0.0, 0.0, 0.0)):
    made = []
    for text in conditions:
        kind, _, words = text.partition(": ")
        made.append(
            held_of(words, PART, normal=kind == "symmetry")
            if kind in ("fix", "symmetry")
            else condition_of(kind, words, PART)
        )
    return LoadCase("bend", 1.0, tuple(made), gravity)


@pytest.mark.parametrize(
    ("text", "inside", "outside", "away"),
    [
        ("plane z at 2.5 mm", (9, 9, 2.5), (0, 0, 3), 0.5),
        ("plane x at high", (4, 0, 0), (7, 1, 1), 3),
        ("plane y at low", (4, 0, 0), (7, 1, 1), 1),
        ("box 1 1 1 to 0 3 2 mm", (0.5, 2, 1.5), (0.5, 2, 5), 3),
        ("box 0 0 0 to 1 1 1 cm", (10, 10, 10), (13, 14, 5), 5),
        ("sphere 0 0 1 radius 2 mm", (0, 0, 3), (0, 0, 4), 1),
        ("cylinder z at 1 2 radius 3 mm", (4, 2, 99), (1, 7, -5), 2),
        ("cylinder y at 1 2 radius 3 mm from 4 to 0 mm", (1, 0, 5), (1, 8, 2), 4),
        ("surface", (3, 3, 3), None, None),
        ("group all", (4, 3, 3), (6, 4, 3), 2),
    ],
)
def test_regions_hold_what_they_say(text, inside, outside, away):
    region = region_of(text, PART)
    assert region.distances(np.array([inside], float)) == pytest.approx([0], abs=1e-12)
    if outside is not None:
        assert region.distances(np.array([outside], float)) == pytest.approx([away])


def test_a_second_mesh_is_a_region():
    other = SurfaceMesh(*box_mesh((0.5, 0.5, 0.5), (1.0, 1.0, 1.0)))
    assert region_of("near", PART, other).distances(np.array([[3.0, 0.5, 0.5]])) == pytest.approx([2])
    with pytest.raises(ConfigError, match="another mesh"):
        region_of("near", PART)


@pytest.mark.parametrize(("text", "free"), [("group left on top", ()), ("x z on group left on top", (1,))])
def test_names_of_groups_may_have_any_words(text, free):
    named = SurfaceMesh(PART.vertices, PART.faces, groups=(("left on top", 2, 4),))
    held = held_of(text, named)
    assert held.values == tuple(None if axis in free else 0.0 for axis in range(3))
    assert held.region.triangles.shape == (2, 3, 3)


@pytest.mark.parametrize(
    ("read", "words"),
    [
        (lambda: region_of("plain z at 0", None), "expected 'plane' or"),
        (lambda: region_of("plane z 0 mm", None), "expected 'at'"),
        (lambda: region_of("sphere 0 0 radius 1", None), "expected a number"),
        (lambda: region_of("plane z at .inf", None), "expected"),
        (lambda: region_of("plane z at 0 mm 3", None), "nothing more"),
        (lambda: region_of("group side", PART), "no group 'side'"),
        (lambda: held_of("w on plane z at 0", None), "holds along"),
        (lambda: held_of("sphere 0 0 0 radius 1", None, normal=True), "no plane of symmetry"),
        (lambda: condition_of("force", "0 0 -200 on plane z at 0", None), "is no force"),
        (lambda: condition_of("force", "0 0 -200 MPa on plane z at 0", None), "units are N, kN"),
        (lambda: condition_of("force", "0 0 nan N on plane z at 0", None), "is no number"),
        (lambda: condition_of("force", "0 0 inf N on plane z at 0", None), "is no number"),
        (lambda: condition_of("force", "0 0 -1.1e9 kN on plane z at 0", None), "is more than 1e+12 N"),
        (lambda: condition_of("pressure", "1 2 3 MPa on plane z at 0", None), "is no pressure"),
        (lambda: condition_of("force", "free 0 1 N on plane z at 0", None), "is no number"),
    ],
)
def test_what_is_misspelt_is_refused(read, words):
    with pytest.raises((ConfigError, InputError), match=re.escape(words)):
        read()


def test_faces_cover_the_block():
    faces = exposed_faces(BLOCK)
    counts = [2 * 4 * 3, 2 * 5 * 3, 2 * 5 * 4]
    assert [int((faces.axis == axis).sum()) for axis in range(3)] == counts
    points = BLOCK.points(faces.corners.reshape(-1)).reshape(-1, 4, 3)
    normal = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 1])
    outwards = normal[np.arange(len(normal)), faces.axis] * faces.side
    assert (outwards > 0).all()
    # the divergence theorem: the volume
    volume = (points.mean(1) * normal).sum() / 3
    assert volume == pytest.approx(5 * 8 * 1.5)


def test_loads_have_the_totals_that_they_state():
    found = applied(BLOCK, case("fix: plane x at low", "force: 1 2 -3 kN on plane x at high"), MASS)
    assert found.total == pytest.approx([1000, 2000, -3000])
    loads = found.pulled.dense(found.fixed.shape)
    assert (np.argwhere(loads.any(axis=0))[:, 2] == 5).all()
    # by area: an inner node has four times as much as a corner
    assert loads[0, 1, 1, 5] == pytest.approx(4 * loads[0, 0, 0, 5])
    assert found.fixed.all(axis=0).sum() == 4 * 5
    heavy = applied(BLOCK, case("fix: plane x at low", gravity=(0.0, 0.0, -10.0)), MASS)
    assert heavy.total == pytest.approx([0, 0, -60 * 2e-3 * 10])


def posts(y, x, neck):
    """Posts of 5 x 5 voxels on a plate, and one of 2 x 2 at (y, x) on a neck of so many."""
    solid = np.zeros((20, 20, 20), bool)
    solid[:6] = True
    for j, i in ((0, 0), (0, 15), (15, 0), (15, 15)):
        solid[:, j : j + 5, i : i + 5] = True
    solid[6:19, y : y + neck, x : x + neck] = solid[19, y : y + 2, x : x + 2] = True
    return VoxelBody(solid, (1.0, 0.5, 2.0), (3.0, 0.0, -1.0))


def test_stubs_bear_no_force_and_total_and_moment_stay():
    load = LoadCase("tilt", 1.0, (condition_of("force", "3 -2 5 N on plane z at 39 mm", None),))
    share = np.ones((20, 20, 20), np.float32)
    # faces of the posts, and of the stub: the moment is that of the force in the middle of all
    middle = (100 * np.array([13, 5, 39]) + 4 * np.array([15, 4.5, 39])) / 104
    for neck, loaded in ((1, 4 * 36), (2, 4 * 36 + 9)):
        body = posts(8, 11, neck)
        found = applied(body, load, share)
        forces = found.pulled.dense(found.fixed.shape).reshape(3, -1).T
        nodes = np.flatnonzero(forces.any(1))
        assert len(nodes) == loaded
        assert forces.sum(0) == pytest.approx([3, -2, 5], rel=1e-12)
        moment = np.cross(body.points(nodes), forces[nodes]).sum(0)
        assert moment == pytest.approx(np.cross(middle, [3, -2, 5]), rel=1e-12)
    # more than a twentieth of the face is no stub: the part was made to be loaded there
    body = posts(8, 11, 1)
    body.solid[6:, :5, :5] = body.solid[6:, 15:, 15:] = False
    few = applied(body, load, share)
    assert np.count_nonzero(few.pulled.dense(few.fixed.shape).any(0)) == 2 * 36 + 9
    # points on a line bear no moment about it: then all of them are loaded
    line = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    forces = same_resultant(line, np.ones(3), np.array([True, True, False]), np.array([0, 0, 3.0]))
    assert forces == pytest.approx(np.outer(np.ones(3), [0, 0, 1]))


def test_pressure_pushes_inwards_and_balances_around_a_body():
    found = applied(BLOCK, case("fix: plane x at low", "pressure: 2 MPa on plane z at high"), MASS)
    assert found.total == pytest.approx([0, 0, -2 * 40])
    around = applied(BLOCK, case("fix: x on plane x at low", "pressure: 20 bar on surface"), MASS)
    assert around.total == pytest.approx([0, 0, 0], abs=1e-9)


def test_given_displacements_and_symmetry():
    found = applied(BLOCK, case("symmetry: plane y at low", "displacement: free free -0.1 mm on plane z at high"), MASS)
    assert found.fixed[1, :, 0].all()
    assert not found.fixed[0].any()
    assert (found.moved.dense(found.fixed.shape)[2, -1] == -0.1).all()
    assert not found.fixed[1, :, 1:].any()


@pytest.mark.parametrize(
    ("conditions", "words"),
    [
        (("fix: plane x at low", "force: 1 0 0 N on sphere 50 0 0 radius 1 mm"), "touches nothing"),
        (
            ("fix: plane x at low", "displacement: 0.1 0 0 mm on plane x at low"),
            "move the same place along x by 0 and 0.1",
        ),
        (("fix: plane x at low", "force: 0 0 1 N on plane x at low"), "acts only where the part is held"),
        (("fix: plane x at low", "force: 0 0 0 N on plane x at high"), "has no load"),
    ],
)
def test_conditions_that_contradict_each_other_or_touch_nothing_are_refused(conditions, words):
    with pytest.raises(DesignError, match=re.escape(words)):
        applied(BLOCK, case(*conditions), MASS)


@pytest.mark.parametrize(
    ("conditions", "words"),
    [
        ((), "move along x, move along y, move along z, turn about x, turn about y, turn about z"),
        (("fix: z on plane z at low",), "move along x, move along y, turn about z"),
        (("fix: y z on plane z at low",), "move along x"),
        (("symmetry: plane x at low", "symmetry: plane y at low"), "move along z"),
    ],
)
def test_free_motions_are_named(conditions, words):
    load = case(*conditions, "force: 1 1 1 N on plane x at high")
    with pytest.raises(DesignError, match=re.escape(f"from this: {words}")):
        held_solid(BLOCK, load, applied(BLOCK, load, MASS).fixed, drop=True)


def test_pieces_apart_are_refused_or_left_out():
    solid = np.ones((3, 4, 40), bool)
    solid[:, :, 37] = False  # two layers of 40 hang loose
    body, load = BLOCK._replace(solid=solid), case("fix: plane x at low", "force: 0 0 1 N on plane x at 36 mm")
    fixed = applied(body, load, np.ones(solid.shape, np.float32)).fixed
    with pytest.raises(DesignError, match="in 2 pieces, and 5% of it hangs loose"):
        held_solid(body, load, fixed, drop=False)
    held, loose = held_solid(body, load, fixed, drop=True)
    assert loose == pytest.approx(2 / 39)
    assert not held[:, :, 38:].any()
    assert held[:, :, :37].all()


def test_elements_of_a_mesh_fill_its_volume():
    found = mesh_body(PART, 0.7)
    assert np.prod(found.body.edges) * found.share.sum() == pytest.approx(5 * 8 * 1.5, rel=1e-6)
    assert found.body.origin == pytest.approx((-1, 0, 2))
