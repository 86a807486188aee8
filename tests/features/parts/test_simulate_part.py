"""Simulated parts: resolved against homogenized, numbers that must balance, files, and what is refused."""

from dataclasses import dataclass, replace
from itertools import product

import meshio
import numpy as np
import pytest
from PIL import Image

from sppm_pipeline import ConfigError, DesignError, Length, SurfaceMesh
from sppm_pipeline.engine.plan.estimate import cost
from sppm_pipeline.features.parts import material, stubs
from sppm_pipeline.features.parts.bodies import VoxelBody, field_body
from sppm_pipeline.features.parts.density_law import SHARES, yield_factor
from sppm_pipeline.features.parts.material import Model, simulated
from sppm_pipeline.features.parts.stages.load_case import AddLoadCase
from sppm_pipeline.features.parts.stages.simulate_part import SimulatePart
from sppm_pipeline.features.stiffness.numerics.elasticity import stiffness
from sppm_pipeline.method.fields.formula import FormulaField
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.method.porosity.fractions import stiff_share
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.nouns.size import ONE, CellDesign, Geometry, Size
from sppm_pipeline.services.elastic.loaded import packed
from sppm_pipeline.services.elastic.voigt import lame
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

YOUNG, POISSON, CELL = 1000.0, 0.3, 2.0
SIZE = np.array([8.0, 4.0, 4.0])
BLOCK = SurfaceMesh(*box_mesh(SIZE / 2, SIZE))
LAM, MU = lame(YOUNG, POISSON)


@dataclass(frozen=True, eq=False)
class Frame(FormulaField):
    """Bars along x, y and z, half as wide as the cell, which meet in its middle."""

    def evaluate(self, x, y, z):
        x, y, z = (np.abs(v % 1 - 0.5) for v in (x, y, z))
        return np.minimum(np.minimum(np.maximum(x, y), np.maximum(y, z)), np.maximum(z, x)) - 0.3


@pytest.fixture(scope="module")
def part():
    return Part(Frame(edge=CELL, region=(4, 2, 2)), BLOCK)


def loaded(*forces, block=BLOCK):
    cases = None
    for number, text in enumerate(forces):
        stage = AddLoadCase(case=f"case {number}", force=(text,), fix=("plane x at low",))
        stage.check_options()
        cases = stage.run(PlainContext(), block, cases)
    return cases


def run(stage, *args, directory=None):
    stage.check_options()
    context = PlainContext(directory=directory)
    made = stage.run(context, *args)
    made.check()
    return made, context


def resolved(cells, n):
    """A beam of cells, and the stiffness of one of them on the same voxels."""
    shared = field_body(Frame(edge=CELL, region=cells), n, 1, binary=False)
    bears = stiff_share(shared.share)
    cell = (MU * bears[:n, :n, :n]).astype(np.float64)
    found = stiffness(cell * LAM / MU, cell, tolerance=1e-6).stiffness
    body = shared.body._replace(solid=bears > 0)
    return Model(body, (bears * MU).astype(np.float32), LAM / MU, shared.share), found


def solve(model, cases):
    return simulated(
        PlainContext(), model, cases, drop=True, tolerance=1e-6, iterations=500, yield_stress=None, has_mass=True
    )[0]


def test_resolved_and_homogenized_beams_agree():
    """The full stiffness of a cell, elements of a quarter cell: within 10 % in pull, and in bending from four cells
    across on; the gap of thinner beams, whose bars lie nearer to the middle than a continuum would, falls."""
    gaps = []
    for across in (2, 3, 4):
        cells = (2 * across, across, across)
        size = CELL * np.array(cells)
        model, constants = resolved(cells, 8)
        forces = "3 0 0 N on plane x at high", "0 0 -1 N on plane x at high"
        cases = loaded(*forces, block=SurfaceMesh(*box_mesh(size / 2, size)))
        fine = solve(model, cases)
        h = CELL / 4
        nx, ny, nz = (size / h).astype(int)
        body = VoxelBody(np.ones((nz, ny, nx), bool), (h, h, h), (0.0, 0.0, 0.0))
        same = np.broadcast_to(packed(constants)[:, None, None, None], (21, nz, ny, nx)).astype(np.float32)
        ones = np.ones((nz, ny, nx), np.float32)
        coarse = solve(Model(body, same, 1.0, ones, ones), cases)
        pull, bend = (fine.cases[name]["compliance"] / coarse.cases[name]["compliance"] - 1 for name in fine.cases)
        assert abs(pull) < 0.1
        gaps.append(bend)
        for name in fine.cases:
            assert fine.cases[name]["reaction"] == pytest.approx(coarse.cases[name]["reaction"], abs=0.01)
    assert 0.25 > gaps[0] > gaps[1] > gaps[2] > 0
    assert gaps[2] < 0.1


def test_a_resolved_part_balances_and_is_written(part, tmp_path):
    cases = loaded("3 0 0 N on plane x at high", "0 0 -1 N on plane x at high")
    stage = SimulatePart(
        resolution=8, young=YOUNG, poisson=POISSON, solid_density=2.0, yield_stress=50.0, mesh="part.vtu",
        deformed="part.png", image_size=(200, 160), grids=1,
    )  # fmt: skip
    made, context = run(stage, cases, part, BLOCK, None, directory=tmp_path)
    assert made.way == "resolved"
    assert made.cases["case 0"]["reaction"] == pytest.approx([-3, 0, 0], abs=0.01)
    assert made.cases["case 1"]["reaction"] == pytest.approx([0, 0, 1], abs=0.01)
    share = float((Frame().sample(40) < 0).mean())
    assert made.mass == pytest.approx(2.0 * 0.128 * share, rel=0.02)
    assert made.safety == pytest.approx(50 / made.stress)
    assert made.compliance == pytest.approx(sum(one["compliance"] for one in made.cases.values()))
    assert not context.warnings
    mesh = meshio.read(tmp_path / "part.vtu")
    assert len(mesh.cells[0].data) == made.elements
    moved = np.abs(mesh.cell_data["displacement x case 0"][0])
    assert 0.9 * made.cases["case 0"]["deflection"] < moved.max() < 1.1 * made.cases["case 0"]["deflection"]
    with Image.open(tmp_path / "part.png") as picture:
        assert len(np.unique(np.asarray(picture).reshape(-1, 3), axis=0)) > 20
    assert made.picture().shape[2] == 3
    surface = made.live_view()
    assert surface.faces.max() < len(made.points)
    assert (surface.still == made.points).all()
    assert surface.magnified == made.magnification
    # what hangs by an edge of a voxel does not fly out of the picture
    flying = replace(made, moved=np.where(np.arange(len(made.points))[None, :, None] == 3, 1e6, made.moved))
    assert np.abs(flying.shown(0) - made.points).max() <= 1.001 * made.magnification * made.deflection
    assert np.abs(made.shown(0) - made.points - made.magnification * made.moved[0]).mean() < 1e-3 * made.deflection


def test_a_part_is_as_stiff_as_without_its_stubs(monkeypatch):
    """A stub in the middle of the face: loaded, it adds its own compliance and iterations, but neither with its force
    on the rest of the face, where the part is as stiff as without it, up to rounding."""
    solid = np.zeros((20, 20, 20), bool)
    solid[:12] = True
    for y, x in product((0, 15), (0, 15)):
        solid[:, y : y + 5, x : x + 5] = True
    bare, moduli = solid.copy(), np.full(solid.shape, MU, np.float32)
    solid[12:19, 9, 9] = solid[19, 9:11, 9:11] = True
    block = SurfaceMesh(*box_mesh((10.0, 10.0, 10.0), (20.0, 20.0, 20.0)))
    stage = AddLoadCase(force=("0 0.1 -1 N on plane z at high",), fix=("plane z at low",))
    cases, found = stage.run(PlainContext(), block, None), []
    for body, slender in ((solid, 3.0), (bare, 3.0), (solid, np.inf)):
        monkeypatch.setattr(stubs, "SLENDER", slender)
        voxels = VoxelBody(body, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
        found.append(solve(Model(voxels, moduli * body, LAM / MU, body.astype(np.float32)), cases).cases["load"])
    made, without, loaded = found
    assert made["compliance"] == pytest.approx(without["compliance"], rel=1e-4)
    assert made["compliance"] < 0.7 * loaded["compliance"]
    assert made["iterations"] < loaded["iterations"]
    assert made["reaction"] == pytest.approx(loaded["reaction"], abs=1e-3)


def test_a_solid_block_is_pulled_as_a_bar():
    """Without contraction the compliance of a bar is L / (E A), resolved and homogenized."""
    solid = Part(
        type("Solid", (Frame,), {"evaluate": lambda self, x, y, z: np.full(1, -1.0)})(edge=CELL, region=(4, 2, 2)),
        BLOCK,
    )
    made, _ = run(
        SimulatePart(resolution=4, young=YOUNG, poisson=0.0), loaded("3 0 0 N on plane x at high"), solid, None, None
    )
    assert made.compliance == pytest.approx(9 * 8 / (YOUNG * 16), rel=1e-3)
    assert made.stress == pytest.approx(3 / 16, rel=0.01)
    assert made.mass is None
    assert made.safety is None


@pytest.mark.parametrize("skin", [0.0, 0.3])
def test_voxels_of_a_part_have_its_mass_on_any_grid(skin):
    """The least of the fields of structure, skin and domain has kinks, beside which its slopes are those of none."""
    ball = SurfaceMesh(*ball_mesh((4.0, 3.1, 2.0), 3.1))
    body = Part(Frame(edge=CELL, region=(4, 4, 2)), ball, skin_mm=skin)
    exact = field_body(body, 60, 1, binary=True)
    volume = exact.share.sum(dtype=float) * np.prod(exact.body.edges)
    for n, error in ((8, 0.012), (16, 0.004)):
        found = field_body(body, n, 1, binary=False)
        assert found.share.sum(dtype=float) * np.prod(found.body.edges) == pytest.approx(volume, rel=error)


def test_memory_is_estimated():
    """Bytes that resolved parts took beyond what was there before; between what it takes and a third more."""
    shapes = {
        "cube": Geometry(box=(8, 8, 8), volume=512, envelope=384, porosity=0.7, surface=7.775),
        "bracket": Geometry(box=(15, 3, 6), volume=270, envelope=326, porosity=0.5, surface=10.04),
        "pad": Geometry(box=(15, 13, 3), volume=457.6, envelope=437, porosity=0.576, surface=8.22),
    }
    measured = (("cube", 16, 433e6), ("cube", 32, 1254e6), ("bracket", 16, 328e6), ("pad", 14, 432e6))
    for shape, resolution, taken in measured:
        field = Size(geometry=shapes[shape])
        size = SimulatePart(resolution=resolution, young=YOUNG).estimate(ONE, Size(cells=3), field, None, None)
        assert size.voxels == pytest.approx(3 * np.prod(shapes[shape].box) * resolution**3)
        assert taken <= cost("simulate.part", size.units()).memory < 1.3 * taken


def test_estimates_count_cases_and_elements():
    part = Size(geometry=Geometry(edge_mm=2.0, box=(8, 4, 4)))
    one = AddLoadCase(force=("1 0 0 N on surface",)).estimate(ONE, part, None)
    two = AddLoadCase(force=("1 0 0 N on surface",)).estimate(ONE, part, one)
    assert (one.cells, two.cells) == (1, 2)
    assert one.samples == 27 * 48 * 24 * 24
    law = Size(design=CellDesign(edge_mm=4.0), geometry=Geometry())
    size = SimulatePart(young=YOUNG, law_resolution=16, trials=2).estimate(
        ONE, two, None, part, None, lambda palette, repeats: law
    )  # elements of 2 mm in 16 x 8 x 8 mm
    assert (size.nodes, size.voxels, size.resident) == (8 * 4 * 4, 2 * 128, 16**3)
    larger = SimulatePart(young=YOUNG, law_resolution=16, trials=2, element=Length(4.0, "mm"))
    assert larger.estimate(ONE, two, None, part, None, lambda palette, repeats: law).nodes == 4 * 2 * 2


def test_coarse_voxels_are_extrapolated_with_an_error_bar(part):
    cases = loaded("3 0 0 N on plane x at high", "0 0 -1 N on plane x at high")
    fine, _ = run(SimulatePart(resolution=40, young=YOUNG, grids=1), cases, part, BLOCK, None)
    raw, _ = run(SimulatePart(resolution=12, young=YOUNG, grids=1), cases, part, BLOCK, None)
    made, _ = run(SimulatePart(resolution=12, young=YOUNG), cases, part, BLOCK, None)
    assert raw.error is None
    assert abs(made.compliance / fine.compliance - 1) < 0.7 * abs(raw.compliance / fine.compliance - 1)
    for name, one in made.cases.items():
        assert abs(made.cases[name]["compliance"] / fine.cases[name]["compliance"] - 1) < made.error < 0.3
        assert one["reaction"] == raw.cases[name]["reaction"]


def test_wrong_units_and_missing_inputs_are_refused(part):
    stage = SimulatePart(resolution=4, young=YOUNG)
    with pytest.raises(DesignError, match="are forces in N"):
        run(stage, loaded("1e9 0 0 N on plane x at high"), part, BLOCK, None)
    with pytest.raises(ConfigError, match="neither a structure nor a `recipe`"):
        run(stage, loaded("1 0 0 N on plane x at high"), None, BLOCK, None)
    _, context = run(stage, loaded("20 0 -50 N on plane x at high"), part, BLOCK, None)
    assert any("linear elasticity" in text for text in context.warnings)


def test_cases_follow_each_other():
    first = AddLoadCase(case="down", fix=("plane x at low",), force=("0 0 -1 N on plane x at high",))
    second = AddLoadCase(case="up", weight=2.0, force=("0 0 1 N on plane x at high",))
    cases = second.run(PlainContext(), BLOCK, first.run(PlainContext(), BLOCK, None))
    cases.check()
    assert [case.name for case in cases.cases] == ["down", "up"]
    assert cases.cases[1].held == cases.cases[0].held
    with pytest.raises(ConfigError, match="two cases 'down'"):
        first.run(PlainContext(), BLOCK, cases)
    with pytest.raises(ConfigError, match="has no load"):
        AddLoadCase(fix=("plane x at low",)).check_options()
    with pytest.raises(DesignError, match="nothing keeps the part"):
        second.run(PlainContext(), BLOCK, None)


def test_conditions_are_drawn(tmp_path):
    stage = AddLoadCase(
        fix=("plane z at low",), force=("0 0 -1 N on plane x at high",), pressure=("1 MPa on plane z at high",),
        path="conditions.png", image_size=(300, 240),
    )  # fmt: skip
    stage.run(PlainContext(directory=tmp_path), BLOCK, None)
    with Image.open(tmp_path / "conditions.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3).astype(int)
    red = (pixels[:, 0] > 120) & (pixels[:, 1] < 70)
    orange = (pixels[:, 0] > 180) & (np.abs(pixels[:, 1] - 145) < 60) & (pixels[:, 2] < 90)
    assert red.sum() > 500
    assert orange.sum() > 500


def test_a_share_of_the_solid_yields_at_the_factor():
    """Of elements whose onsets and stresses differ, against the shares by interpolation one by one."""
    onset = np.outer(np.array([0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.8]), [1.0, 0.5])
    one = np.array([1.0, 0.0])
    # alone, the first yields by 0.1 % at the stress measured for that share; the second counts as solid that does not
    assert yield_factor(2 * one, onset, one) == pytest.approx(0.125)
    assert yield_factor(np.array([2.0, 1.0]), onset, np.ones(2)) == pytest.approx(0.125)
    half = np.interp(np.log(0.002), np.log(SHARES), np.log(onset[:, 0]))
    assert yield_factor(2 * one, onset, np.ones(2)) == pytest.approx(np.exp(half) / 2)
    assert yield_factor(one, np.ones((len(SHARES), 2)), np.ones(2)) == pytest.approx(1.0)  # solid all through


def test_a_homogenized_part_has_a_safety_factor():
    """Strength over stress, whatever the unit: well below that of a solid bar."""
    recipe = recipe_of(
        DartThrowing(total=14, share=0.5), BoundedDegreeSubgraph(degree=(3, 5), mode="greedy"),
        GaussianField(pore_radius=Length(0.17), tunnel_radius=Length(0.07)),
    )  # fmt: skip
    stage = SimulatePart(
        young=YOUNG, poisson=POISSON, porosity=0.5, density=(0.4, 0.6), trials=1, law_resolution=12,
        cell=Length(CELL, "mm"), yield_stress=30.0,
    )  # fmt: skip
    cases = loaded("3 0 0 N on plane x at high")
    made, _ = run(stage, cases, None, BLOCK, None, recipe)
    solid = 30.0 / (3 / 16)
    assert 0.03 * solid < made.safety < 0.5 * solid
    twice, _ = run(replace(stage, yield_stress=60.0), cases, None, BLOCK, None, recipe)
    assert twice.safety == pytest.approx(2 * made.safety, rel=1e-6)
    assert run(replace(stage, yield_stress=None), cases, None, BLOCK, None, recipe)[0].safety is None


def test_compliance_is_as_exact_as_the_energy(monkeypatch):
    """Displacements that are a hundredth too large change it by a ten thousandth."""
    cases = loaded("0 0 -1 N on plane x at high")
    model, _ = resolved((4, 2, 2), 8)
    exact = solve(model, cases)
    solver = material.solved

    def too_large(*args, **options):
        found = solver(*args, **options)
        return found._replace(displacement=found.displacement * np.float32(1.01))

    monkeypatch.setattr(material, "solved", too_large)
    ratio = solve(model, cases).compliance / exact.compliance
    assert 1 - ratio == pytest.approx(1e-4, rel=0.05)
