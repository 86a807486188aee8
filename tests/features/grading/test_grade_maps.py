"""The family ``grade``: one map from a formula, an image, points and nodes of it, and all that may be wrong."""

from dataclasses import replace

import meshio
import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError, InputError
from sppm_pipeline.features.grading.laws import FormulaLaw
from sppm_pipeline.features.grading.stages.grade_distance import GradeDistance
from sppm_pipeline.features.grading.stages.grade_formula import GradeFormula
from sppm_pipeline.features.grading.stages.grade_image import GradeImage
from sppm_pipeline.features.grading.stages.grade_nodes import GradeNodes
from sppm_pipeline.features.grading.stages.grade_points import GradePoints
from sppm_pipeline.features.grading.stages.grade_table import GradeTable
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import ball_mesh, box_mesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.storage import load_value, save_value
from sppm_pipeline.services.formats import vti
from sppm_pipeline.testing.plain_context import PlainContext

LOW, HIGH = np.array([-4.0, 1.0, 10.0]), np.array([4.0, 7.0, 20.0])
LINEAR = "0.5 + 0.02*x - 0.03*(y - 4) + 0.01*(z - 15)"
CURVED = "0.5 + 0.2*sin(x/3)*cos(y/4)"
INSIDE = np.random.default_rng(3).uniform(LOW, HIGH, (500, 3))


def part():
    return SurfaceMesh(*box_mesh((LOW + HIGH) / 2, HIGH - LOW), name="block")


def made(stage, before=None, mesh=None):
    """What a stage makes, and the context; its options are checked first."""
    context = PlainContext()
    stage.check_options()
    grading = stage.run(context, before, mesh)
    grading.check()
    return grading, context


def formula(text, of="value", **options):
    return made(GradeFormula(of=of, formula=text, **options))[0]


def lengths(*values):
    return tuple(Length(float(v)) for v in values)


def grid(n):
    """Nodes (n, n, n, 3) of a grid through the box."""
    return np.stack(np.meshgrid(*np.linspace(LOW, HIGH, n).T, indexing="ij"), axis=-1)


def hexahedra(n):
    index = np.arange(n**3).reshape(n, n, n)
    low = index[:-1, :-1, :-1].ravel()
    steps = [0, n * n, n * n + n, n, 1, n * n + 1, n * n + n + 1, n + 1]
    return low[:, None] + np.array(steps)


@pytest.fixture
def sampled(tmp_path):
    """A function from a formula and a number of nodes to the maps of its image, points and nodes."""

    def sampled(text, n):
        nodes = grid(n).reshape(-1, 3)
        values = formula(text)["value"].at(nodes)
        h = (HIGH - LOW) / (n - 1)
        image = values.reshape(n, n, n)
        np.save(tmp_path / "a.npy", image)
        # values at points, which the readers takes as the middles of voxels around them
        written = b"".join(
            vti.encode(np.asfortranarray(image.astype(np.float32)), tuple(h), tuple(LOW - h / 2), "value")
        )
        (tmp_path / "a.vti").write_bytes(written)
        rows = np.random.default_rng(0).permutation(np.column_stack([nodes / 10, values]))
        text = "# made for a test\nValue;Z;Y;X\n" + "\n".join(";".join(map(repr, row[::-1].tolist())) for row in rows)
        (tmp_path / "a.csv").write_text(text, encoding="utf-8")
        meshio.write(tmp_path / "a.vtu", meshio.Mesh(nodes / 25.4, [("hexahedron", hexahedra(n))], {"T": values}))
        voxels = {"of": "value", "path": tmp_path / "a.npy", "origin": lengths(*(LOW - h / 2))}
        stages = {
            "vti": GradeImage(of="value", path=tmp_path / "a.vti"),
            "points": GradePoints(of="value", path=tmp_path / "a.csv", unit="cm"),
            "nodes": GradeNodes(of="value", path=tmp_path / "a.vtu", unit="in"),
        }
        if np.ptp(h) < 1e-9:
            stages["npy"] = GradeImage(**voxels, voxel=Length(h[0]))
        return {name: made(stage)[0]["value"] for name, stage in stages.items()}

    return sampled


def test_formula_image_points_and_nodes_of_a_linear_map_are_one(sampled):
    expected = formula(LINEAR)["value"].at(INSIDE)
    for name, found in sampled(LINEAR, 4).items():
        tolerance = 1e-6 if name == "vti" else 1e-12  # which holds float32
        np.testing.assert_allclose(found.at(INSIDE), expected, atol=tolerance, err_msg=name)


def test_data_of_a_curved_map_converge_with_the_square_of_the_spacing(sampled):
    expected = formula(CURVED)["value"].at(INSIDE)
    coarse, fine = sampled(CURVED, 5), sampled(CURVED, 9)
    for name in coarse:
        errors = [np.abs(maps[name].at(INSIDE) - expected).max() for maps in (coarse, fine)]
        # second derivatives of up to .2/9 and .2/16, a spacing of 2 and 1.5: h^2 f'' / 8 for each axis
        assert errors[0] < 0.025, name
        assert errors[0] > 2.5 * errors[1], (name, errors)


def test_points_on_the_surface_and_a_step_outside(sampled):
    corners = grid(2).reshape(-1, 3)
    out = corners + np.sign(corners - (LOW + HIGH) / 2) * 5
    for name, found in sampled(LINEAR, 4).items():
        np.testing.assert_allclose(found.at(corners), formula(LINEAR)["value"].at(corners), atol=1e-6, err_msg=name)
        np.testing.assert_allclose(found.at(out), found.at(corners), atol=1e-6, err_msg=name)


def test_what_lies_outside_may_be_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.arange(8.0).reshape(2, 2, 2))
    stage = GradeImage(of="ct", path=tmp_path / "a.npy", voxel=Length(1.0, "cm"), outside="refuse")
    found = made(stage)[0]["ct"]
    assert found.at([[0, 0, 0], [20, 20, 20]]).tolist() == [0, 7]
    with pytest.raises(DesignError, match=r"the map 'ct' is nan at \(21, 3, 4\) mm, and at 1 of 2 points"):
        found.at([[1, 2, 3], [21, 3, 4]])


def test_data_of_less_than_half_of_the_part_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.arange(8.0).reshape(2, 2, 2))
    low, high = part().lower, part().upper
    half = tuple(Length(float(v), "mm") for v in low)
    edge = float((high - low).min())
    stage = GradeImage(of="ct", path=tmp_path / "a.npy", voxel=Length(edge / 4, "mm"), origin=half)
    with pytest.raises(InputError, match=r"\d\d % of the part's box, .* lie outside of the data") as raised:
        made(stage, mesh=part())
    assert "outside: extend" in raised.value.hint
    found, context = made(replace(stage, outside="extend"), mesh=part())
    assert found["ct"].at([high]).tolist() == [7]
    assert (context.reported["values"], context.reported["lowest"], context.reported["highest"]) == (8, 0, 7)
    assert context.reported["data_box"].endswith(" mm")


def test_images_fit_the_box_of_the_part(tmp_path):
    np.save(tmp_path / "a.npy", np.array([[[10, 20]]], np.uint8))
    stage = GradeImage(of="pore_radius", path=tmp_path / "a.npy", fit=True, measure="um", axes="zyx")
    found = made(stage, mesh=part())[0]["pore_radius"]
    middle = (LOW + HIGH) / 2
    assert found.unit == "mm"
    assert found.range == (0.01, 0.02)
    np.testing.assert_allclose(found.at([LOW, middle, HIGH]), [0.01, 0.015, 0.02])
    np.testing.assert_allclose(
        found.at(middle + np.array([[2, 0, 0], [0, 3, 5]])), [0.02, 0.015]
    )  # zyx: the last axis is x
    with pytest.raises(ConfigError, match="needs a part"):
        made(stage)
    with pytest.raises(ConfigError, match="does not say how large"):
        made(GradeImage(of="ct", path=tmp_path / "a.npy"))


def test_missing_data_are_refused_or_filled(tmp_path):
    np.save(tmp_path / "a.npy", np.array([1, np.nan, 3, 3, 3]).reshape(5, 1, 1))
    (tmp_path / "a.csv").write_text("x,y,z,value\n0,0,0,1\n1,0,0,\n2,0,0,4\n", encoding="utf-8")
    image = {"of": "ct", "path": tmp_path / "a.npy", "voxel": Length(1.0)}
    with pytest.raises(InputError, match=r"1 of 5 voxels of a\.npy"):
        made(GradeImage(**image))
    found = made(GradeImage(**image, missing="fill"))[0]["ct"]
    assert found.at([[1.5, 0, 0]])[0] in (1.0, 3.0)
    points = {"of": "ct", "path": tmp_path / "a.csv", "interpolation": "nearest"}
    with pytest.raises(InputError, match="row 2"):
        made(GradePoints(**points))
    assert made(GradePoints(**points, missing="fill"))[0]["ct"].at([[0.9, 0, 0], [1.1, 0, 0]]).tolist() == [1, 4]
    for stage in (GradeImage(**image, missing="fill"),):
        np.save(tmp_path / "a.npy", np.full((2, 2, 2), np.nan))
        with pytest.raises(InputError, match="no finite number"):
            made(stage)


def test_inverse_distances_are_exact_at_points_and_bounded(tmp_path):
    rng = np.random.default_rng(1)
    points, values = rng.random((40, 3)), rng.random(40)
    np.savetxt(tmp_path / "a.csv", np.column_stack([points, values]), header="x y z value", comments="", fmt="%.17g")
    found = made(GradePoints(of="ct", path=tmp_path / "a.csv", interpolation="idw"))[0]["ct"]
    np.testing.assert_array_equal(found.at(points), values)
    there = rng.random((50, 3))
    distance = np.linalg.norm(there[:, None] - points, axis=2)
    near = np.argsort(distance, axis=1)[:, :8]
    weights = np.take_along_axis(distance, near, axis=1) ** -2.0
    np.testing.assert_allclose(found.at(there), (weights * values[near]).sum(1) / weights.sum(1), rtol=1e-12)


def test_results_of_finite_elements(tmp_path):
    """Components of vectors and tensors, values of elements, other elements, and smoothing."""
    nodes = grid(3).reshape(-1, 3)
    cells = [("hexahedron", hexahedra(3))]
    tensor = np.random.default_rng(2).normal(size=(27, 6))
    full = tensor[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]]
    data = {"S": tensor, "F": full, "U": tensor[:, :3], "T": tensor[:, 0]}
    elements = {"E": [np.arange(8.0)], "one": [np.full(8, 0.7)]}
    meshio.write(tmp_path / "a.vtu", meshio.Mesh(nodes, cells, data, elements))

    def value(array, **options):
        return made(GradeNodes(of="s", path=tmp_path / "a.vtu", array=array, **options))[0]["s"].at(nodes)

    deviator = (
        full.reshape(-1, 3, 3) - np.trace(full.reshape(-1, 3, 3), axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3
    )
    mises = np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2)))
    np.testing.assert_allclose(value("S", component="mises"), mises)
    np.testing.assert_allclose(value("F", component="mises"), mises)
    np.testing.assert_allclose(value("S", component="yz"), tensor[:, 4])
    np.testing.assert_allclose(value("F", component="yz"), tensor[:, 4])
    np.testing.assert_allclose(value("U", component="magnitude"), np.linalg.norm(tensor[:, :3], axis=1))
    np.testing.assert_allclose(value("one"), 0.7)
    # a corner belongs to one element, the middle to tetrahedra of all
    np.testing.assert_allclose(value("E")[[0, -1]], [0, 7])
    np.testing.assert_allclose(value("one", smooth=Length(3.0)), 0.7)
    rough, soft = value("T"), value("T", smooth=Length(2.0))
    assert np.std(soft) < 0.7 * np.std(rough)
    np.testing.assert_allclose(value("T", smooth=Length(1e-3)), rough)
    for array, options, words in (
        ("s", {}, "did you mean 'S'"), (None, {}, "name one by `array`"), ("S", {}, "xx, yy, zz, xy, yz, xz, mises"),
        ("T", {"component": "x"}, "holds numbers"), ("U", {"component": "mises"}, "x, y, z, magnitude"),
    ):  # fmt: skip
        with pytest.raises((InputError, ConfigError)) as caught:
            value(array, **options)
        assert words in str(caught.value), str(caught.value)
    flat = meshio.Mesh(nodes, [("quad", hexahedra(3)[:, :4])], {"T": tensor[:, 0]})
    meshio.write(tmp_path / "a.vtu", flat)
    with pytest.raises(InputError, match="no solid elements"):
        value("T")


@pytest.mark.parametrize("kind", ["wedge", "pyramid", "tetra", "tetra10"])
def test_all_elements_are_filled(tmp_path, kind):
    """Of each kind one element; linear values are exact in it, and its volume is its own."""
    nodes = {
        "wedge": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 2], [1, 0, 2], [0, 1, 2]],
        "pyramid": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 2]],
        "tetra": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "tetra10": [
            [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0], [0, 0, 0.5],
            [0.5, 0, 0.5], [0, 0.5, 0.5],
        ],
    }[kind]  # fmt: skip
    points = np.array(nodes, float)
    values = points @ [1, 2, 3] + 4
    meshio.write(tmp_path / "a.vtk", meshio.Mesh(points, [(kind, np.arange(len(points))[None])], {"T": values}))
    grading = made(GradeNodes(of="t", path=tmp_path / "a.vtk", outside="refuse"))[0]
    weights = np.random.default_rng(0).dirichlet(np.ones(len(points)), 200)
    inside = weights @ points
    np.testing.assert_allclose(grading["t"].at(inside), inside @ [1, 2, 3] + 4)
    with pytest.raises(DesignError):
        grading["t"].at([[0.9, 0.9, 1.9]])


def test_data_that_do_not_meet_the_part_name_both_boxes(tmp_path):
    meshio.write(
        tmp_path / "a.vtu", meshio.Mesh(grid(2).reshape(-1, 3), [("hexahedron", hexahedra(2))], {"T": np.ones(8)})
    )
    assert made(GradeNodes(of="t", path=tmp_path / "a.vtu"), mesh=part())[1].warnings == []
    with pytest.raises(InputError) as caught:
        made(GradeNodes(of="t", path=tmp_path / "a.vtu", unit="m"), mesh=part())
    assert "(-4000, 1000, 10000) to (4000, 7000, 20000) mm" in str(caught.value)
    assert "(-4, 1, 10) to (4, 7, 20) mm" in str(caught.value)
    moved = SurfaceMesh(part().vertices + np.array([4, 0, 0]), part().faces)
    assert "50 %" in made(GradeNodes(of="t", path=tmp_path / "a.vtu"), mesh=moved)[1].warnings[0]


def test_distances(tmp_path):
    ball = SurfaceMesh(*ball_mesh((1.0, 2.0, 3.0), 2.0, 5))
    points = np.random.default_rng(0).uniform(-3, 6, (200, 3))
    away = np.linalg.norm(points - [1, 2, 3], axis=1)
    found = made(GradeDistance(of="depth"), mesh=ball)[0]["depth"].at(points)
    np.testing.assert_allclose(found, 2 - away, atol=2e-3)  # the ball has 20 480 triangles
    open_half = SurfaceMesh(ball.vertices, ball.faces[ball.vertices[ball.faces][:, :, 2].max(axis=1) < 3])
    below = points[:, 2] < 3
    found = made(GradeDistance(of="depth"), mesh=open_half)[0]["depth"].at(points)
    np.testing.assert_allclose(found[below], np.abs(2 - away)[below], atol=0.12)
    assert (found >= 0).all()
    found = made(GradeDistance(of="r", to="point", point=lengths(1, 2, 3)))[0]["r"].at(points)
    np.testing.assert_allclose(found, away)
    line = GradeDistance(of="r", to="line", point=lengths(1, 2, -7), direction=(0.0, 0.0, -9.0))
    np.testing.assert_allclose(made(line)[0]["r"].at(points), np.hypot(points[:, 0] - 1, points[:, 1] - 2))
    with pytest.raises(ConfigError, match="no surface"):
        made(GradeDistance(of="depth"))
    for wrong in ({"to": "line", "point": lengths(0, 0, 0)}, {"to": "point"}, {"direction": (0.0, 0.0, 1.0)},
                  {"to": "line", "point": lengths(0, 0, 0), "direction": (0.0, 0.0, 0.0)}):  # fmt: skip
        with pytest.raises(ConfigError):
            GradeDistance(of="depth", **wrong).check_options()


def test_formulas_know_the_box_the_surface_and_the_cells():
    block = part()
    text = "u + 10*v + 100*w + 1000*distance + a*cell_x"
    grading, _ = made(GradeFormula(of="t", formula=text, constants=(("a", 1e5),)), mesh=block)
    point = LOW + np.array([2, 1.5, 1])
    found = grading.in_cells(2.0, (-5.0, 0.0, 0.0))["t"].at([point])
    np.testing.assert_allclose(found, 0.25 + 10 * 0.25 + 100 * 0.1 + 1000 * 1 + 1e5 * 1.5)
    with pytest.raises(ConfigError, match="counts cells"):
        grading["t"].at([point])
    for text in ("u", "distance"):
        with pytest.raises(ConfigError, match=f"no name '{text}'"):
            formula(text)


def test_later_maps_use_earlier_ones():
    grading = formula("x", of="stress", measure="MPa")
    table = GradeTable(of="porosity", along="stress", values=((0.0, 0.7), (10.0, 0.3)))
    grading = made(table, grading)[0]
    grading = made(GradeFormula(of="scale", formula="1 - porosity/2"), grading)[0]
    at = [[-5, 0, 0], [5, 0, 0], [20, 0, 0]]
    np.testing.assert_allclose(grading["porosity"].at(at), [0.7, 0.5, 0.3])
    np.testing.assert_allclose(grading["scale"].at(at), [0.65, 0.75, 0.85])
    assert grading.names == ("stress", "porosity", "scale")
    assert grading["stress"].unit == "MPa"
    assert grading["porosity"].range == (0.3, 0.7)
    with pytest.raises(ConfigError, match="two maps 'scale'"):
        made(GradeFormula(of="scale", formula="1"), grading)
    with pytest.raises(ConfigError, match="no name 'stres'"):
        made(GradeFormula(of="a", formula="stres"), grading)
    with pytest.raises(ConfigError, match="neither x, y, z nor"):
        made(GradeTable(of="a", along="strain", values=((0.0, 1.0),)), grading)
    with pytest.raises(ConfigError, match="no map 'porosty'"):
        grading["porosty"]
    other = made(GradeFormula(of="other", formula="z"), grading)[0]
    assert other["porosity"].digest() == grading["porosity"].digest() != grading["scale"].digest()
    assert other["porosity"].digest() != made(table, formula("x + 0", of="stress"))[0]["porosity"].digest()


def test_tables_have_steps_lines_and_curves():
    pairs = ((0.0, 0.2), (2.0, 0.6), (5.0, 0.3))
    at = np.array([[-1, 0], [0, 0], [1, 0], [2, 0], [2.75, 0], [5, 0], [9, 0]]) @ [[0, 0, 1], [0, 0, 0]]

    def table(**options):
        return made(GradeTable(of="porosity", values=pairs, **options))[0]["porosity"].at(at)

    assert table(between="steps").tolist() == [0.2, 0.2, 0.2, 0.6, 0.6, 0.3, 0.3]
    np.testing.assert_allclose(table(), [0.2, 0.2, 0.4, 0.6, 0.525, 0.3, 0.3])
    smooth = table(between="smooth")
    np.testing.assert_allclose(smooth[[0, 1, 3, 5, 6]], [0.2, 0.2, 0.6, 0.3, 0.3])
    assert 0.2 < smooth[2] < 0.6
    np.testing.assert_allclose(table(unit="cm"), np.interp(at[:, 2] / 10, [0, 2, 5], [0.2, 0.6, 0.3]))
    cells = made(GradeTable(of="a", along="x", unit="cells", between="steps", values=pairs, measure="N"))[0]
    assert cells.in_cells(20.0, (-60.0, 0, 0))["a"].at([[-59, 0, 0], [-19, 0, 0], [60, 0, 0]]).tolist() == [
        0.2,
        0.6,
        0.3,
    ]
    metric = made(GradeTable(of="tunnel_radius", values=((0.0, 250.0),), measure="um"))[0]
    assert metric["tunnel_radius"].at([[0, 0, 0]]) == [0.25]
    for values in ((), ((0.0, 1.0), (0.0, 2.0)), ((1.0, 1.0), (0.0, 2.0))):
        with pytest.raises(ConfigError, match="values"):
            GradeTable(of="a", values=values).check_options()


def test_values_that_a_parameter_cannot_have_name_the_first_point():
    for of, text, words in (
        ("porosity", "x", r"'porosity', the formula 'x', is 1 at \(1, 2, 3\) mm, and at 2 of 3 points not above 0"),
        ("scale", "1 - x", "is 0 at"), ("weight", "x", r"is 2 at .* not 0 to 1"), ("data", "1/(x - 2)", "is inf at"),
        ("pore_radius", "0 - x", "is -0.5 mm at"),
    ):  # fmt: skip
        with pytest.raises(DesignError, match=words):
            formula(text, of=of)[of].at([[0.5, 0, 0], [1, 2, 3], [2, 2, 2]])
    assert formula("x", of="weight")["weight"].at([[0, 0, 0], [1, 0, 0]]).tolist() == [0, 1]


def test_names_and_units_that_cannot_be():
    for options in (
        {"of": "x"}, {"of": "sin"}, {"of": "2a"}, {"of": "a b"}, {"of": ""}, {"of": "distance"}, {"of": "cell_x"},
        {"of": "porosity", "measure": "mm"}, {"of": "pore_radius", "measure": "kg"},
        {"of": "a", "constants": (("x", 1.0),)},
        {"of": "a", "constants": (("b", 1.0), ("b", 2.0))}, {"of": "a", "formula": "1 +"},
    ):  # fmt: skip
        with pytest.raises(ConfigError):
            GradeFormula(**{"formula": "1", **options}).check_options()
    with pytest.raises(ConfigError, match="is a map, too"):
        made(GradeFormula(of="a", formula="b", constants=(("b", 1.0),)), formula("x", of="b"))


TABLES = {
    "": "is empty", "# nothing\n\n": "is empty", "x,y,z,value\n": "holds no rows", "x,y,z\n1,2,3": "no column 'value'",
    "x,y,z,valve\n1,2,3,4": "did you mean 'valve'", "x,y,x,z,value\n1,2,3,4,5": "2 columns 'x'",
    "x,y,z,value\n1,2,3,4\n1,2,q,4": "at row 2 below line 1", "x,y,z,value\n1,2,3\n": "row 1 below line 1",
    "x" * 70_000: "is it a table",
    "x,y,z,value\nnan,2,3,4": "coordinates that are no finite", "x,y,z,value\n1,2,3,inf\n1,2,4,1": "1 of 2 values",
    "x,y,z,value\n0,0,1,1\n1,0,1,1\n0,1,1,1\n1,1,1,1\n2,1,1,5": "lie in a plane", "\0\1\2": "no column",
}  # fmt: skip


@pytest.mark.parametrize("text", TABLES, ids=range(len(TABLES)))
def test_tables_that_cannot_be_read(tmp_path, text):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        made(GradePoints(of="ct", path=tmp_path / "a.csv"))
    assert TABLES[text] in str(caught.value)
    assert len(str(caught.value)) < 600


def test_samples_at_one_place_are_averaged(tmp_path):
    (tmp_path / "a.csv").write_text(
        "\ufeffX\tY\tZ\tvalue\n0\t0\t0\t1\n0\t0\t0\t3 # again\n\n5\t0\t0\t8\n", encoding="utf-8"
    )
    grading, context = made(GradePoints(of="ct", path=tmp_path / "a.csv", interpolation="nearest"))
    assert grading["ct"].at([[0, 0, 0], [5, 1, 1]]).tolist() == [2, 8]
    assert "1 samples" in context.warnings[0]


def test_gradings_are_kept_as_they_are(tmp_path, sampled):
    maps = sampled(LINEAR, 3)
    laws = [maps[name]._grading.laws[0] for name in maps]
    ball = SurfaceMesh(*ball_mesh((0.0, 0.0, 0.0), 5.0, 1))
    grading = made(GradeFormula(of="d", formula="distance + u"), mesh=ball)[0]
    for law in (*laws, *formula("x", of="value").laws):
        own = Grading((*grading.laws, law), None).in_cells(3.0, (0.0, 1.0, 2.0))
        folder = tmp_path / f"{type(law).__name__}{law.digest()[:8]}"
        folder.mkdir()
        files = save_value(own, folder)
        again = load_value(folder, {file.name: file for file in files})
        assert again.digest() == own.digest()
        for name in own:
            np.testing.assert_array_equal(again[name].at(INSIDE), own[name].at(INSIDE))
    assert isinstance(grading.laws[0], FormulaLaw)
    assert "formula" in str(grading.summary())


def test_values_do_not_depend_on_which_points_are_asked_for(sampled):
    for name, found in sampled(CURVED, 4).items():
        nodes = np.concatenate([grid(7).reshape(-1, 3), INSIDE])
        whole = found.at(nodes)
        np.testing.assert_array_equal(found.at(nodes[::-7]), whole[::-7], err_msg=name)
