"""``design.stiffness``: tensors of a known family, a member of the real one, what is refused, and how it is laid."""

from pathlib import Path

import numpy as np
import pytest

import sppm_pipeline as sppm
from sppm_pipeline.errors import ConfigError, DesignError, InputError
from sppm_pipeline.features.design.numerics.tensor_fit import Fit, interval, orthotropic, stretch_of, turned
from sppm_pipeline.features.design.stages.design_stiffness import DesignStiffness, stiffness_over_struts
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.services.elastic.voigt import engineering_constants, isotropic, mandel, rotated
from sppm_pipeline.services.local_thickness import limit_sizes, local_thickness

pytestmark = pytest.mark.filterwarnings("ignore:homogenize.voxel")  # coarse grids
TURN = turned(np.array([0.4, -0.7, 0.3]))
QUICK = {"search_draws": 1, "draws": 3, "resolution": 24, "seed": 5, "recipe": [
    sppm.step.sample.hyperuniform(total=20), sppm.step.connect.mbdst(mode="greedy"),
    sppm.step.field.walls(struts=0.3, tunnel_radius=0.08),
]}  # fmt: skip


def family(x):
    """An orthotropic stiffness: softened by the dial, and stiffened along each axis by the stretch."""
    s = stretch_of(x[-2:])
    c = isotropic(0.3 * np.exp(-1.5 * x[0]), 0.28 - 0.1 * x[0])
    scale = np.concatenate([s, [(s[1] * s[2]) ** 0.5, (s[0] * s[2]) ** 0.5, (s[0] * s[1]) ** 0.5]])
    return c * np.outer(scale, scale) ** 0.8


@pytest.mark.parametrize("x", [(0.2, 0.3, 0.9), (0.6, 0.05, 0.5), (0.35, 0.5, 0.5)])
def test_a_member_of_a_family_is_found_whatever_its_rotation(x):
    target = rotated(family(np.array(x)), TURN)
    fit = Fit(target, np.ones(6), (0.0,), (0.9,))
    start = fit.first([((dial,), family(np.array([dial, 0, 0]))) for dial in (0.0, 0.45, 0.9)])
    found, c = fit.run(family, start)
    for _ in range(3):
        found = fit.corrected(found, c)
        c = family(found)
    made = fit.design(found, c)
    assert made.distance < 0.003
    assert np.prod(made.stretch) == pytest.approx(1)
    back = rotated(c, made.rotation)
    assert np.linalg.norm(mandel(back - target)) == pytest.approx(
        made.distance * np.linalg.norm(mandel(target)), abs=1e-9
    )


def test_what_has_no_planes_of_symmetry_is_left_over():
    """The distance is never below the part that no orthotropic tensor has."""
    target = family(np.array([0.3, 0.3, 0.8]))
    target[0, 5] = target[5, 0] = 0.02
    fit = Fit(target, np.ones(6), (0.0,), (0.9,))
    found, c = fit.run(family, fit.first([((0.3,), family(np.array([0.3, 0, 0])))]))
    made = fit.design(found, c)
    own = rotated(target, made.rotation.T)
    floor = np.linalg.norm(mandel(own - orthotropic(own))) / np.linalg.norm(mandel(own))
    assert 0 < floor <= made.distance


def test_weights_decide_what_is_met():
    """With shear rows of no weight, a target of another shear modulus is met in the rest."""
    target = family(np.array([0.3, 0.2, 0.6]))
    target[3:, 3:] *= 3
    x = np.array([0.3, 0.2, 0.6])
    fit = Fit(target, np.array([1.0, 1, 1, 0, 0, 0]), (0.0,), (0.9,))
    assert np.linalg.norm(fit.residual(family(x), np.eye(3))) < 1e-12
    assert np.linalg.norm(Fit(target, np.ones(6), (0.0,), (0.9,)).residual(family(x), np.eye(3))) > 0.1


def test_the_interval_holds_a_further_draw_as_often_as_it_says():
    rng = np.random.default_rng(3)
    draws = rng.normal(2.0, 0.1, (4000, 9, 6, 6))
    inside = []
    for sample in draws:
        mean, _, half = interval(sample[:8])
        inside.append(np.abs(sample[8] - mean) <= half)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.005)


@pytest.fixture(scope="module")
def member():
    """Mean stiffness of three stretched cells, turned."""
    made = []
    for draw in range(3):
        cell = QUICK["recipe"]
        design = sppm.tune.porosity(target=0.7, recipe=cell, seed=50 + draw)
        made.append(sppm.homogenize.voxel(design, resolution=24, stretch=(0.75, 0.95, 1.4)).stiffness)
    return rotated(orthotropic(np.mean(made, 0)), TURN)


@pytest.fixture(scope="module")
def found(member, tmp_path_factory):
    path = tmp_path_factory.mktemp("target") / "target.csv"
    np.savetxt(path, member, delimiter=",")
    return sppm.design.stiffness(target=path, porosity=0.7, **QUICK)


def test_a_member_of_the_walls_is_found_from_other_draws(found, member):
    assert found.distance < 0.06
    assert found.floor < 0.02
    assert found.options[0][0] == "struts"
    difference = np.linalg.norm(mandel(found.stiffness - member)) / np.linalg.norm(mandel(member))
    assert difference == pytest.approx(found.distance, rel=1e-6)
    assert (found.draw_error >= found.mean_error).all()


def test_the_thinnest_strut_sets_the_size_of_the_cell(found, member, tmp_path):
    """Further cells, sampled as they are stretched, have struts of at least that thickness: the bound holds."""
    np.savetxt(tmp_path / "target.csv", member, delimiter=",")
    sized = sppm.design.stiffness(target=tmp_path / "target.csv", porosity=0.7, min_strut="0.3 mm", **QUICK)
    assert sized.stiffness == pytest.approx(found.stiffness)
    assert found.edge_mm is None
    walls = sppm.step.field.walls(struts=dict(sized.options)["struts"], tunnel_radius=0.08)
    cells = [sppm.tune.porosity(target=0.7, recipe=[*QUICK["recipe"][:2], walls], seed=90 + k) for k in range(3)]

    def thickness(cell, voxels, stretch):
        n = np.round(voxels * stretch).astype(int)
        grid = sppm.numerics.Grid(tuple(0.5 / n), tuple(1 / n), tuple(map(int, n)))
        return local_thickness(np.ascontiguousarray(cell.solid(grid).T).view(np.uint8)).ravel()

    means = []
    for stretch in (sized.stretch, np.ones(3)):
        fine, coarse = (np.concatenate([thickness(cell, n, stretch) for cell in cells]) for n in (48, 24))
        means.append(sized.edge_mm * limit_sizes(fine, coarse, (1 / 48, 1 / 24)).mean)
    assert 0.28 < means[0] < means[1]
    assert means[1] == pytest.approx(0.3 / sized.stretch.min(), rel=0.15)  # as coarse as the design is


def test_the_atlas_knows_where_to_start():
    """By measured walls, softer with more struts; of other recipes and porosities nothing is said."""

    def known(porosity=0.72, radius=0.06, joined="connect.mbdst"):
        stages = {"sample.dart_throwing": {"total": 60}, joined: {}, "field.walls": {"tunnel_radius": radius}}
        return stiffness_over_struts(stages, porosity)

    rows = known()
    assert (np.diff([young for _, young, _ in rows]) < 0).all()
    cell = sppm.cell("dialed", porosity=0.72, seed=3, struts=0.3)
    measured = sppm.homogenize.voxel(cell, resolution=40).summary()["E_relative"]
    assert {round(s, 3): e for s, e, _ in rows}[0.3] == pytest.approx(measured, rel=0.25)
    assert known(porosity=0.95) == known(radius=0.3) == known(joined="connect.mst") == []


def test_what_lies_beyond_is_refused_with_the_nearest():
    with pytest.raises(DesignError, match=r"away from what the recipe reaches.*nearest is struts") as caught:
        sppm.design.stiffness(E=0.9, nu=0.1, porosity=0.7, **QUICK)
    assert "'struts' ends there" in caught.value.hint


def test_the_target_may_be_what_was_measured_before():
    """Its stiffness, its porosity and its solid, unless a porosity is given."""
    cell = sppm.cell("dialed", porosity=0.6, seed=5, struts=0.2)
    measured = sppm.homogenize.voxel(cell, resolution=24, young=1400.0, poisson=0.35)
    design = sppm.design.stiffness(measured=measured, **{**QUICK, "vary": (), "low": (), "high": ()}, max_distance=1.0)
    assert design.target == pytest.approx(measured.stiffness)
    assert design.porosity == measured.porosity == pytest.approx(0.6, abs=0.01)
    stated = DesignStiffness(porosity=0.7)._like(measured)[0]
    assert (stated.porosity, stated.young, stated.poisson) == (0.7, 1400.0, 0.35)


@pytest.mark.parametrize(
    ("phases", "stiffness", "message"),
    [
        (None, None, "neither `target` nor `E` is given"),
        (((0.3, 1.0, 0.3), (0.3, 2.0, 0.3), (0.4, 0.0, 0.0)), np.eye(6), "2 solid phases"),
        (((0.4, 1.0, 0.3), (0.6, 0.0, 0.0)), np.diag([1.0, 1, 0, 1, 1, 1]), "no stiffness in some direction"),
    ],
)
def test_what_was_measured_before_must_be_a_target(phases, stiffness, message):
    measured = None if phases is None else StiffnessReport(stiffness, phases, "by hand")
    with pytest.raises((ConfigError, DesignError), match=message):
        DesignStiffness()._like(measured)


def test_moduli_become_a_tensor():
    stage = DesignStiffness(E=(0.03, 0.04, 0.06), nu=(0.2, 0.15, 0.25), G=(0.02, 0.015, 0.012), porosity=0.7, young=2.0)
    constants = engineering_constants(2.0 * stage.wanted())
    assert constants["E"] == pytest.approx([0.03, 0.04, 0.06])
    assert constants["G"] == pytest.approx([0.02, 0.015, 0.012])
    assert [constants["nu"][k] for k in ((1, 2), (0, 2), (0, 1))] == pytest.approx([0.2, 0.15, 0.25])
    assert DesignStiffness(E=0.05, nu=0.3, porosity=0.7).wanted() == pytest.approx(isotropic(0.05, 0.3))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target": Path("c.csv"), "E": 0.1}, "both are given"),
        ({"nu": 0.2}, "belong to `E`"),
        ({"E": 0.1}, "`E` needs `nu`"),
        ({"E": (0.1, 0.2, 0.3), "nu": 0.2}, "`G` is missing"),
        ({"E": (0.01, 0.2, 0.3), "nu": 0.9, "G": 0.1}, "energy would be negative"),
        ({"E": 0.1, "nu": 0.2, "porosity": None}, "either `porosity` or `max_density`"),
        ({"E": 0.1, "nu": 0.2, "low": (0.0, 0.1)}, "`low` has 2"),
        ({"E": 0.1, "nu": 0.2, "low": (0.9,), "high": (0.1,)}, "should rise"),
        ({"E": 0.1, "nu": 0.2, "row_weights": (1.0,)}, "it takes six"),
    ],
)
def test_options_that_contradict_each_other_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        DesignStiffness(**{"porosity": 0.7, **options}).check_options()


@pytest.mark.parametrize("text", ["1,2\n3,4", "abc", ",".join(["0"] * 6) + "\n" + "\n".join([",".join("010000")] * 5)])
def test_a_file_that_holds_no_stiffness_is_refused(tmp_path, text):
    (tmp_path / "c.csv").write_text(text)
    with pytest.raises(InputError, match=r"c\.csv"):
        DesignStiffness(target=tmp_path / "c.csv", porosity=0.7).wanted()


def test_a_quarter_of_a_turn_of_what_is_laid_turns_its_stiffness():
    """`warp.affine` turns as the tensor of a design is turned: exact for a quarter of a turn, voxel by voxel."""
    cell = sppm.tune.porosity(target=0.7, recipe=[*QUICK["recipe"]], seed=2)
    laid = sppm.tile.periodic(cell, cell="3 mm", cells=(1, 1, 1))
    image = sppm.warp.affine(laid, turn=(0, 0, 90), resolution=96).voxels(24)
    plain = laid.voxels(24)
    # x goes to y, and y to -x
    expected = np.rot90(plain.to_numpy(), 1, (0, 1))
    assert (image.to_numpy() != expected).mean() < 0.002
    of = [
        sppm.homogenize.voxel(sppm.Voxels.from_array(v, periodic=True)).stiffness for v in (plain.to_numpy(), expected)
    ]
    quarter = turned(np.array([0, 0, np.pi / 2]))
    assert of[1] == pytest.approx(rotated(of[0], quarter), abs=2e-3 * of[0].max())


def test_a_design_is_laid_stretched_and_turned(found):
    """Values at points of the part are those of the plain cell at the places that they came from."""
    cell = sppm.tune.porosity(target=0.7, recipe=[*QUICK["recipe"]], seed=2)
    laid = sppm.tile.periodic(cell, cell="3 mm", cells=(2, 2, 2))
    part = sppm.read.primitive(shape="box", size=("4 mm", "5 mm", "6 mm"))
    made = sppm.warp.affine(laid, part, found, resolution=128)
    grid = made._grid(6)
    values = made.sample(grid)
    points = np.stack(np.meshgrid(*(grid.axis(a) for a in range(3)), indexing="ij"), -1) * made.edge_mm + made.origin_mm
    middle = (np.asarray(part.lower) + part.upper) / 2
    back = (points.reshape(-1, 3) - middle) @ np.linalg.inv(found.rotation * found.stretch).T / 3.0 + 1.0
    solid = [bool(cell.solid(sppm.numerics.Grid(tuple(p % 1), (1.0,) * 3, (1, 1, 1)))[0, 0, 0]) for p in back[::7]]
    assert np.mean((values.ravel()[::7] < 0) == solid) > 0.97
    assert made.cells[0] * made.edge_mm >= 4
