"""Densities that suit a load: gradients by differences, an independent search of the same problem, refusals."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve

from sppm_pipeline import ConfigError, DesignError, SurfaceMesh
from sppm_pipeline.features.parts.bodies import SharedBody, VoxelBody
from sppm_pipeline.features.parts.density_law import DensityLaw, cubic_mean, density_law, solid_constants
from sppm_pipeline.features.parts.stages import optimize_density
from sppm_pipeline.features.parts.stages.optimize_density import ConeFilter, OptimizeDensity, Problem, principal
from sppm_pipeline.method.nouns.conditions import LoadCase, LoadCases, condition_of, held_of
from sppm_pipeline.method.nouns.maps import Place
from sppm_pipeline.method.part.primitive_meshes import box_mesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.elastic.loaded import brick_strains, packed, unpacked
from sppm_pipeline.services.elastic.voigt import from_lame, lame
from sppm_pipeline.testing.plain_context import PlainContext

YOUNG, POISSON = 1000.0, 0.3


def square_law():
    """Young's modulus with the square of the density, as bending struts have it."""
    density = np.linspace(0.15, 0.85, 6)
    young = YOUNG * density**2
    return density_law(
        np.column_stack([density, density]),
        np.array([[from_lame(*lame(e, POISSON))] * 2 for e in young]), YOUNG, POISSON, cubic=True,
    )  # fmt: skip


def beam(nx=24, ny=2, nz=8, h=0.5):
    """Elements and mesh of a beam from the origin."""
    size = h * np.array([nx, ny, nz])
    body = VoxelBody(np.ones((nz, ny, nx), bool), (h, h, h), (0.0, 0.0, 0.0))
    return SharedBody(body, np.ones((nz, ny, nx), np.float32)), SurfaceMesh(*box_mesh(size / 2, size))


def cases_of(mesh, *loads, gravity=(0.0, 0.0, 0.0)):
    held = (held_of("plane x at low", mesh),)
    return LoadCases(tuple(
        LoadCase(f"case {n}", 1.0 + n, (*held, condition_of("force", text, mesh)), gravity)
        for n, text in enumerate(loads)
    ))  # fmt: skip


DOWN = "0 0 -5 N on box 11.5 0 0 to 12 1 1 mm"


def stage(**options):
    made = OptimizeDensity(
        **({"mean_density": 0.4, "density": (0.15, 0.85), "young": YOUNG, "poisson": POISSON} | options)
    )
    made.check_options()
    return made


@pytest.mark.parametrize("gravity", [(0.0, 0.0, 0.0), (3e4, 0.0, -5e4)])
def test_gradients_are_those_of_differences(gravity):
    """Two cases, a skin, a filter; by central differences, to 1e-5."""
    shared, mesh = beam(10, 3, 4)
    cases = cases_of(mesh, "1 2 -5 N on plane x at high", "0 -3 0 N on plane x at high", gravity=gravity)
    rng = np.random.default_rng(1)
    count = shared.body.solid.size
    skin, design = 0.3 * rng.random(count), 0.3 + 0.3 * rng.random(count)
    search = stage(solid_density=1.2, solver_tolerance=1e-10)
    problem, cone = Problem(search, square_law(), shared, skin, cases, np.float64), ConeFilter(
        shared.body.solid, shared.body.edges, 1.1
    )  # fmt: skip

    def compliance(x):
        problem._starts.clear()
        return problem.solved(PlainContext(), cone.mean(x)).compliance

    gain = cone.back(problem.solved(PlainContext(), cone.mean(design)).gain)
    for _ in range(3):
        way = rng.standard_normal(count)
        slope = (compliance(design + 2e-5 * way) - compliance(design - 2e-5 * way)) / 4e-5
        assert slope == pytest.approx(-gain @ way, rel=1e-5)


def test_compliance_of_the_search_is_as_exact_as_the_energy(monkeypatch):
    """Displacements that are a hundredth too large change it by a ten thousandth."""
    shared, mesh = beam(10, 3, 4)
    skin, density = np.zeros(shared.body.solid.size), np.full(shared.body.solid.size, 0.4)
    search, solver = stage(solver_tolerance=1e-10), optimize_density.solved
    problem = Problem(search, square_law(), shared, skin, cases_of(mesh, "0 0 -5 N on plane x at high"), np.float64)
    exact = problem.solved(PlainContext(), density).compliance

    def too_large(*args, **options):
        found = solver(*args, **options)
        return found._replace(displacement=found.displacement * 1.01)

    monkeypatch.setattr(optimize_density, "solved", too_large)
    assert 1 - problem.solved(PlainContext(), density).compliance / exact == pytest.approx(1e-4, rel=0.01)


def independent_search(law, shared, loads, fixed, radius, mean, bounds, steps):
    """Plain optimality criteria with an assembled matrix and a filter written as one; returns compliances."""
    body = shared.body
    nodes = np.arange(np.prod(body.nodes)).reshape(body.nodes)
    places = np.argwhere(body.solid)
    ends = np.array([[a >> 2, a >> 1 & 1, a & 1] for a in range(8)])
    corners = np.array([nodes[tuple((places + end).T)] for end in ends]).T
    unknowns = (corners[:, :, None] + nodes.size * np.arange(3)).reshape(len(places), 24)
    strains, weights = brick_strains(body.edges)
    distance = np.linalg.norm((places[:, None] - places) * np.array(body.edges[::-1]), axis=2)
    cone = np.maximum(radius - distance, 0)
    cone /= cone.sum(axis=1, keepdims=True)
    free = np.flatnonzero(~fixed.reshape(-1))
    rows, columns = np.repeat(unknowns, 24, axis=1).reshape(-1), np.tile(unknowns, (1, 24)).reshape(-1)

    def bricks(constants):
        return np.einsum("m,mai,nab,mbj->nij", weights, strains, unpacked(constants), strains, optimize=True)

    x, history = np.full(len(places), mean), []
    for _ in range(steps):
        density = cone @ x
        matrix = csr_matrix((bricks(law.at(density)).reshape(-1), (rows, columns)))
        u = np.zeros(loads.size)
        u[free] = spsolve(matrix[free][:, free].tocsc(), loads.reshape(-1)[free])
        history.append(float(loads.reshape(-1) @ u))
        own = u[unknowns]
        gain = cone.T @ np.einsum("ni,nij,nj->n", own, bricks(law.slope_at(density)), own)
        low, high = 1e-9, 1e9
        while high / low > 1 + 1e-10:
            middle = np.sqrt(low * high)
            made = x * np.sqrt(gain / cone.sum(axis=0) / middle)
            new = np.clip(made, np.maximum(bounds[0], x - 0.2), np.minimum(bounds[1], x + 0.2))
            low, high = (middle, high) if (cone @ new).mean() > mean else (low, middle)
        x = new
    return history


@pytest.mark.parametrize("half_mbb", [False, True])
def test_search_is_as_good_as_an_independent_one(half_mbb):
    """A cantilever, and half of a beam on two supports: within 3 %, much stiffer than uniform, mass within 0.1 %."""
    shared, mesh = beam()
    if half_mbb:
        held = (
            held_of("plane x at low", mesh, normal=True), held_of("z on box 11.5 0 0 to 12 1 0.5 mm", mesh),
            held_of("plane y at low", mesh, normal=True),
        )  # fmt: skip
        load = condition_of("force", "0 0 -5 N on box 0 0 3.5 to 0.5 1 4 mm", mesh)
        cases = LoadCases((LoadCase("mbb", 1.0, (*held, load)),))
    else:
        cases = cases_of(mesh, DOWN)
    search, law = stage(updates=25), square_law()
    problem = Problem(search, law, shared, np.zeros(shared.body.solid.size), cases)
    bounds = search._bounds(mesh, shared)
    cone = ConeFilter(shared.body.solid, shared.body.edges, 1.0)
    density, history = search._search(PlainContext(), problem, bounds, cone)
    ready = problem._ready[0].applied
    other = independent_search(
        law, shared, ready.pulled.dense(ready.fixed.shape), ready.fixed, 1.0, 0.4, search.density, 26
    )
    assert history[0] == pytest.approx(other[0], rel=1e-4)
    assert history[-1] == pytest.approx(other[-1], rel=0.03)
    assert history[0] / history[-1] > 1.4
    assert problem.mass(density) == pytest.approx(0.4 * problem.full, rel=1e-3)
    assert density.min() >= 0.15 - 1e-9
    assert density.max() <= 0.85 + 1e-9


def test_least_mass_at_a_deflection_keeps_it():
    shared, mesh = beam()
    cases, law = cases_of(mesh, DOWN), square_law()
    uniform = Problem(stage(), law, shared, np.zeros(384), cases)
    bend = uniform.solved(PlainContext(), np.full(384, 0.4)).compliance / uniform.force
    search = stage(mean_density=None, deflection=Length(bend, "mm"), updates=40)
    problem = Problem(search, law, shared, np.zeros(384), cases)
    cone = ConeFilter(shared.body.solid, shared.body.edges, 1.0)
    density, history = search._search(PlainContext(), problem, search._bounds(mesh, shared), cone)
    assert history[-1] / problem.force == pytest.approx(bend, rel=0.01)
    assert problem.mass(density) < 0.85 * 0.4 * problem.full
    stiff = stage(mean_density=None, deflection=Length(bend / 100, "mm"), updates=5)
    with pytest.raises(DesignError, match="at the largest densities"):
        stiff._search(PlainContext(), problem, search._bounds(mesh, shared), cone)


def test_regions_are_kept_and_masses_out_of_reach_refused():
    shared, mesh = beam()
    search = stage(solid=("box 11 0 0 to 12 1 4 mm",), empty=("sphere 6 0.5 2 radius 1 mm",))
    low, high = search._bounds(mesh, shared)
    assert (low == 0.85).sum() == 2 * 2 * 8
    assert (high == 0.15).sum() > 8
    problem = Problem(search, square_law(), shared, np.zeros(384), cases_of(mesh, DOWN))
    with pytest.raises(DesignError, match="weighs"):
        stage(mean_density=0.9)._mass_target(
            problem, (low, high), ConeFilter(shared.body.solid, shared.body.edges, 1.0)
        )
    with pytest.raises(DesignError, match="no element lies"):
        stage(solid=("sphere 60 0 0 radius 1 mm",))._bounds(mesh, shared)


def test_wrong_units_are_refused_before_the_search():
    shared, mesh = beam()
    problem = Problem(stage(), square_law(), shared, np.zeros(384), cases_of(mesh, DOWN.replace("-5", "-1e9")))
    cone = ConeFilter(shared.body.solid, shared.body.edges, 1.0)
    with pytest.raises(DesignError, match="are forces in N"):
        stage()._search(PlainContext(), problem, stage()._bounds(mesh, shared), cone)


def test_regions_kept_solid_and_empty_may_not_meet():
    shared, mesh = beam()
    overlap = {"solid": ("box 0 0 0 to 4 1 4 mm", "box 8 0 0 to 12 1 4 mm"), "empty": ("box 3 0 0 to 5 1 4 mm",)}
    with pytest.raises(
        DesignError, match=r"'box 0 0 0 to 4 1 4 mm' is kept solid and 'box 3 .* both are at \(3.25, 0.25, 0.25\)"
    ):
        stage(**overlap)._bounds(mesh, shared)
    low, _ = stage(solid=("box 0 0 0 to 4 1 4 mm", "box 3 0 0 to 5 1 4 mm"))._bounds(mesh, shared)
    assert (low == 0.85).sum() == 10 * 2 * 8


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"mean_density": None}, "is the target, not none"),
        ({"mass": 2.0, "solid_density": 1.0}, "not mass, mean_density"),
        ({"mean_density": None, "mass": 2.0}, "density of the solid"),
        ({"density": (0.5, 0.4)}, "should rise"),
        ({"solid": ("bowl 1 2",)}, "expected 'plane'"),
    ],
)
def test_options_that_contradict_each_other_are_refused(options, words):
    with pytest.raises(ConfigError, match=words):
        stage(**options)


def test_the_map_has_the_densities_where_the_elements_are():
    from sppm_pipeline.features.parts.stages.optimize_density import _map

    shared, _ = beam(4, 2, 2)
    density = np.linspace(0.2, 0.8, 16)
    law = _map(shared, "porosity", 1 - density)
    from sppm_pipeline.method.nouns.maps import Grading

    grading = Grading().added(law)
    from sppm_pipeline.features.parts.material import middles_of

    middles = middles_of(shared)
    assert Place(grading, middles).values("porosity") == pytest.approx(1 - density)
    assert grading["porosity"].at([[-5.0, 0.25, 0.25]]) == pytest.approx([0.8])


def test_the_filter_is_a_mean_and_its_transpose_is_exact():
    rng = np.random.default_rng(0)
    solid = rng.random((5, 6, 7)) < 0.7
    cone = ConeFilter(solid, (1.0, 0.5, 2.0), 2.2)
    a, b = rng.random((2, solid.sum()))
    assert cone.mean(np.full(solid.sum(), 0.3)) == pytest.approx(0.3)
    assert cone.mean(a) @ b == pytest.approx(a @ cone.back(b), rel=1e-12)


def test_the_law_goes_through_its_cells_and_ends_in_the_solid():
    law = square_law()
    found = unpacked(law.at(np.array([0.15, 0.43, 1.0])))
    for density, matrix in zip((0.15, 0.43, 1.0), found, strict=True):
        assert matrix == pytest.approx(
            from_lame(*lame(YOUNG * density**2, POISSON)), rel=0.01 if density == 0.43 else 1e-9
        )
    x = np.linspace(0.2, 0.8, 7)
    assert law.slope_at(x) == pytest.approx((law.at(x + 1e-6) - law.at(x - 1e-6)) / 2e-6, rel=1e-4, abs=1e-3)
    with pytest.raises(DesignError, match=r"measured from 0\.15"):
        law.check_range(np.array([0.05, 0.5]), "the part")
    stiff = solid_constants(YOUNG, POISSON)
    assert law.constants[:, -1] == pytest.approx(stiff)
    falling = np.array([[from_lame(*lame(e, POISSON))] for e in (3.0, 2.0, 1.0)])
    with pytest.raises(DesignError, match="does not grow"):
        density_law(np.array([[0.2], [0.4], [0.6]]), falling, YOUNG, POISSON, cubic=False)


def test_mean_over_a_cube_has_three_constants_and_keeps_isotropy():
    root = np.random.default_rng(2).standard_normal((6, 6))
    mean = cubic_mean(root @ root.T)
    assert len(np.unique(np.round(packed(mean), 12))) == 4  # with zero
    assert cubic_mean(mean) == pytest.approx(mean)
    same = from_lame(2.0, 3.0)
    assert cubic_mean(same) == pytest.approx(same)
    assert isinstance(square_law(), DensityLaw)


def test_pores_stretch_along_the_largest_principal_stress():
    """A beam in bending is pulled and pressed along its axis, whatever the sign; a bar in shear at 45 degrees."""
    shared, mesh = beam()
    problem = Problem(stage(), square_law(), shared, np.zeros(24 * 2 * 8), cases_of(mesh, DOWN))
    problem.solved(PlainContext(), np.full(24 * 2 * 8, 0.4))
    cone = ConeFilter(shared.body.solid, shared.body.edges, 1.0)
    stretch, direction = principal(problem.squared_stresses(), cone, 2.5)
    assert stretch.min() >= 1
    assert stretch.max() == 2.5
    outer = np.abs(direction.reshape(8, 2, 24, 3)[[0, 7], :, 4:12])
    assert outer[..., 0].min() > 0.97
    shear = np.zeros((384, 3, 3))
    shear[:, 0, 2] = shear[:, 2, 0] = 1.0
    shear[:, 1, 1] = 0.25
    shear[:, 0, 0] = shear[:, 2, 2] = 3.0
    stretch, direction = principal(shear @ shear, cone, 5.0)
    assert np.abs(direction) == pytest.approx(np.tile(np.sqrt([0.5, 0, 0.5]), (384, 1)), abs=1e-9)
    assert stretch == pytest.approx(np.sqrt(4 / 2))
