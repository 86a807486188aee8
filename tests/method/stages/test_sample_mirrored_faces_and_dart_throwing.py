"""Face pores and interior pores together: no two pores of any neighbors come closer than the spacing."""

import itertools

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.tiling.lattice import meetings, tile_fresh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.testing.plain_context import PlainContext


def least_distance(a, b=None):
    d = np.linalg.norm(a[:, None] - (a if b is None else b)[None], axis=2)
    if b is None:
        np.fill_diagonal(d, np.inf)
    return d.min(initial=np.inf)


def both(palette=None, seed=1, face=None, interior=None):
    context = PlainContext(seed, palette=palette)
    faces = MirroredFaces(**(face or {"count": 12, "spacing": Length(0.17)})).run(context, None)
    faces.check()
    pores = DartThrowing(**(interior or {"count": 14})).run(context, faces)
    pores.check()
    return pores


def unit(axis):
    return np.eye(3)[axis]


@pytest.mark.parametrize("way", ["homogeneous", "paper"])
@pytest.mark.parametrize("colors", [(1, 1, 1), (2, 2, 2), (3, 3, 3), (20, 20, 20), (2, 3, 1)])
def test_no_cell_and_no_pair_of_neighbors_violates_the_spacing(colors, way):
    spacing = 0.17
    pores = both(Palette(2, colors), face={"count": 12, "spacing": Length(spacing), "faces_margin": way})
    on_edges = len(pores.around_edges())
    assert on_edges > 6 if way == "homogeneous" else on_edges == 0
    eps = 1e-12
    faces = {(a, k): pores.of_piece(pores.face_piece(a, k)) for a in range(3) for k in range(colors[a])}
    for (axis, _), own in faces.items():
        # a pattern repeated in its plane, beside any color of the same axis
        if max(colors) == 1:
            shifts = [
                u * unit((axis + 1) % 3) + v * unit((axis + 2) % 3) for u, v in itertools.product((-1, 0, 1), repeat=2)
            ]
            assert (
                min(least_distance(own, own + s) if s.any() else least_distance(own) for s in shifts) >= spacing - eps
            )
            continue
        assert least_distance(own) >= spacing - eps
        for k in range(colors[axis]):
            for u, v in itertools.product((-1, 0, 1), repeat=2):
                shift = u * unit((axis + 1) % 3) + v * unit((axis + 2) % 3)
                if shift.any():
                    assert least_distance(own, faces[axis, k] + shift) >= spacing - eps
    every_face = np.concatenate([f + s * unit(a) for (a, _), f in faces.items() for s in (0, 1)])
    for (a, k), (b, m) in itertools.combinations(faces, 2):
        if a != b:
            for shift in itertools.product((-1, 0, 1), repeat=3):
                assert least_distance(faces[a, k], faces[b, m] + np.array(shift)) >= spacing - eps
    interiors = [pores.of_piece(t) for t in range(2)]
    for own in interiors:
        assert len(own) == 14
        assert least_distance(own) >= spacing - eps
        assert least_distance(own, every_face) >= spacing - eps
    for shift in itertools.product((-1, 0, 1), repeat=3):
        for own, other in itertools.product(interiors, repeat=2) if any(shift) else ():
            assert least_distance(own, other + np.array(shift)) >= spacing - eps
        for own in interiors:  # faces of the cells around, also of those that touch along an edge
            assert least_distance(own, every_face + np.array(shift)) >= spacing - eps


def test_a_small_gap_still_keeps_clear_of_the_faces_met():
    """In a palette with meetings, an interior looks at its own six faces only, on the right side."""
    interior, planes = tile_fresh(np.ones((2, 2, 2), bool))
    colors = tuple(int(f.max()) + 1 for f in planes)
    palette = Palette(8, colors, meetings(interior, planes))
    pores = both(palette, interior={"count": 16, "spacing": Length(0.17), "gap": Length(0.02)})
    for t, axis, side, color in palette.all_meetings():
        around = pores.of_piece(pores.face_piece(axis, color)) + side * unit(axis)
        assert least_distance(pores.of_piece(t), around) >= 0.17 - 1e-12
    # faces that are not met do not matter: with all of them as obstacles nothing would fit
    unmet = [
        least_distance(pores.of_piece(t), pores.of_piece(pores.face_piece(0, k)))
        for t in range(8)
        for k in range(colors[0])
    ]
    assert min(unmet) < 0.17


def test_a_full_cell_keeps_clear_of_the_face_pores_beside_it():
    """The single pattern of an axis goes on beyond the edges of the cell, where no face of the cell itself lies."""
    for seed in range(4):
        interior = {"spacing": Length(0.17), "share": 1.0}
        face = {"count": 40, "spacing": Length(0.17), "faces_margin": "paper"}
        pores = both(seed=seed, face=face, interior=interior)
        faces = np.concatenate([pores.of_piece(1 + a) + s * unit(a) for a in range(3) for s in (0, 1)])
        for shift in itertools.product((-1, 0, 1), repeat=3):
            assert least_distance(pores.of_piece(0), faces + np.array(shift)) >= 0.17 - 1e-12


def test_faces_may_be_ignored_if_the_user_says_so():
    near = both(interior={"count": 25, "spacing": Length(0.15), "gap": Length(0.01), "clear_faces": False})
    on_face = np.concatenate([near.of_piece(p) for p in (1, 2, 3)])
    assert least_distance(near.of_piece(0), on_face) < 0.15
    assert near.spacing is None


def test_the_recorded_spacing_is_what_all_pores_keep():
    tighter = both(interior={"count": 20, "spacing": Length(0.12)})
    assert tighter.spacing == pytest.approx(0.12)
    wider = both(interior={"count": 5, "spacing": Length(0.25)})
    assert wider.spacing == pytest.approx(0.17)
    assert least_distance(wider.of_piece(0)) >= 0.25


def test_without_face_pores_the_cell_is_a_torus():
    pores = DartThrowing(count=40, spacing=Length(0.2)).run(PlainContext(2), None)
    for shift in itertools.product((-1, 0, 1), repeat=3):
        other = pores.centers + np.array(shift)
        assert (least_distance(pores.centers, other) if any(shift) else least_distance(pores.centers)) >= 0.2 - 1e-12
    assert pores.spacing == 0.2


@pytest.mark.parametrize("way", ["homogeneous", "paper"])
@pytest.mark.parametrize(
    ("face", "interior", "total"),
    [
        ({"total": 60, "share": 0.5}, {"total": 60}, 60),
        ({"total": 60, "spacing": Length(0.18)}, {"total": 60}, 60),
        ({"count": 17, "share": 0.4}, {"count": 11}, 28),
        ({"count": 18, "spacing": Length(0.15)}, {"total": 50}, 50),
        ({"count": 0, "spacing": Length(0.15)}, {"total": 20}, 20),
        ({"count": 0, "share": 0.5}, {"total": 20, "spacing": Length(0.2)}, 20),
        ({"total": 2, "spacing": Length(0.2)}, {"total": 2}, 2),
    ],
)
def test_counts_are_met(face, interior, total, way):
    pores = both(face={**face, "faces_margin": way}, interior=interior)
    assert pores.summary()["pores_per_cell"] == total
    assert len(pores.centers) == total


def test_the_split_leaves_room_on_faces_and_inside():
    """At half the packing limit both are drawn at once, without a second attempt by luck."""
    for total in (40, 200):
        faces = MirroredFaces(total=total, share=0.5, faces_margin="paper").run(PlainContext(1), None)
        on_faces = len(faces.centers)
        # a torus has as many pores in a slab of the thickness of one spacing as its three faces take
        assert 0.5 < on_faces / (total * (1 - (1 - faces.spacing) ** 3)) < 1.5
        assert len(DartThrowing(total=total).run(PlainContext(1), faces).centers) == total


@pytest.mark.parametrize("share", [0.3, 0.8, 1.0])
def test_a_share_fills_up(share):
    context = PlainContext(1)
    DartThrowing(spacing=Length(0.15), share=share).run(context, None)
    assert context.reported["interior_packing_share"] == pytest.approx(share, abs=0.06)


@pytest.mark.parametrize("total", [1, 7, 30])
def test_a_number_and_a_share_make_a_spacing(total):
    pores = DartThrowing(count=total, share=0.5).run(PlainContext(1), None)
    assert len(pores.centers) == total


def test_nothing_is_left_for_the_interior():
    assert len(both(interior={"total": 12}).of_piece(0)) == 0
    assert len(both(interior={"count": 0, "share": 0.5}).of_piece(0)) == 0


def test_lengths_follow_the_edge():
    def drawn(edge, unit, factor):
        face = {"count": 12, "spacing": Length(0.17 * factor, unit), "edge": edge}
        return both(face=face, interior={"count": 14, "gap": Length(0.2 * factor, unit)})

    plain = drawn(None, None, 1)
    assert np.allclose(drawn(Length(2), "cell", 1).centers, plain.centers, atol=1e-12)
    physical = drawn(Length(7.5, "mm"), "mm", 7.5)
    assert np.allclose(physical.centers, plain.centers, atol=1e-12)
    assert (physical.cell.edge, physical.cell.physical) == (7.5, True)
    assert np.allclose(drawn(Length(0.75, "cm"), "um", 7500).centers, plain.centers, atol=1e-12)


def test_mm_without_a_size_is_refused():
    with pytest.raises(ConfigError, match="physical"):
        both(face={"count": 12, "spacing": Length(1, "mm")})


@pytest.mark.parametrize(
    "options",
    [
        {"count": 9, "total": 20, "spacing": Length(0.2)},
        {"count": 9},
        {"spacing": Length(0.2)},
        {"count": 9, "spacing": Length(0.2), "share": 0.5},
        {},
    ],
)
def test_faces_want_two_of_three(options):
    with pytest.raises(ConfigError):
        MirroredFaces(**options).check_options()


@pytest.mark.parametrize(
    "options",
    [
        {"count": 9, "total": 20},
        {"spacing": Length(0.2)},
        {"count": 9, "spacing": Length(0.2), "share": 0.5},
    ],
)
def test_darts_refuse_contradictions(options):
    with pytest.raises(ConfigError):
        DartThrowing(**options).check_options()


def test_a_number_of_darts_alone_is_half_packed():
    alone = DartThrowing(total=66).run(PlainContext(3), None)
    halved = DartThrowing(total=66, share=0.5).run(PlainContext(3), None)
    assert np.array_equal(alone.centers, halved.centers)


def test_what_cannot_be_is_said():
    with pytest.raises(DesignError, match="fit"):
        both(face={"count": 300, "spacing": Length(0.17)})
    with pytest.raises(DesignError, match=r"only|fit"):
        both(interior={"count": 900})
    with pytest.raises(DesignError, match="gap"):
        both(interior={"count": 3, "gap": Length(0.5)})
    with pytest.raises(DesignError, match="half a cell"):
        both(face={"total": 2, "share": 1.0})
    with pytest.raises(ConfigError, match="spacing is missing"):
        DartThrowing(share=0.5).run(PlainContext(), None)
    stage = MirroredFaces(count=3, spacing=Length(0.2))
    faces = stage.run(PlainContext(), None)
    with pytest.raises(ConfigError, match="carry pores already"):
        stage.run(PlainContext(), faces)
    with pytest.raises(DesignError, match="edge"):
        both(interior={"count": 3, "edge": Length(2)})


@pytest.mark.parametrize("colors", [1, 2, 20])
def test_margins(colors):
    palette, paper = Palette(1, (colors,) * 3), {"faces_margin": "paper"}
    pores = both(palette, face={"count": 6, "spacing": Length(0.15), **paper, "margin": Length(0.2)})
    for axis in range(3):
        pattern = pores.of_piece(pores.face_piece(axis, 0))
        others = np.delete(pattern, axis, axis=1)
        assert 0.2 <= others.min() <= others.max() <= 0.8
    for wrong in (0.5, 0.9) if colors == 1 else (0.0, 0.07, 0.5):
        with pytest.raises(ConfigError, match="margin"):
            both(palette, face={"count": 6, "spacing": Length(0.15), **paper, "margin": Length(wrong)})


@pytest.mark.parametrize("way", ["homogeneous", "paper"])
def test_a_count_of_face_pores_is_scattered_where_there_are_no_faces(way):
    from sppm_pipeline.nouns.palette import Blocks

    blocks = Blocks(np.ones((2, 2, 2), bool), periodic=True)
    palette = Palette(8, (0, 0, 0), blocks=blocks)
    faces = MirroredFaces(count=12, share=0.4, faces_margin=way)
    pores = faces.run(PlainContext(1, palette=palette), None)
    assert len(pores.centers) == 12 * 8


def test_a_margin_belongs_to_the_paper_s_way():
    with pytest.raises(ConfigError, match="faces_margin: paper"):
        MirroredFaces(count=6, spacing=Length(0.15), margin=Length(0.2)).check_options()


@pytest.mark.parametrize("way", ["homogeneous", "paper"])
def test_a_big_spacing_leaves_no_face(way):
    face = {"count": 3, "spacing": Length(0.8), "faces_margin": way}
    with pytest.raises((DesignError, ConfigError)):
        both(Palette(1, (20, 20, 20)), face=face, interior={"count": 0})


def test_interiors_do_not_depend_on_how_many_there_are():
    few, many = (both(Palette(k, (2, 2, 2))) for k in (2, 5))
    assert np.array_equal(few.of_piece(1), many.of_piece(1))
