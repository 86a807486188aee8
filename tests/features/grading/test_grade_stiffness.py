"""``grade.stiffness``: from wished moduli to porosities by a curve, and back to the moduli of what was made."""

import csv

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError, InputError
from sppm_pipeline.features.grading.laws import FormulaLaw
from sppm_pipeline.features.grading.numerics.curve import stiffness_curve
from sppm_pipeline.features.grading.stages.check_local_porosity import CheckLocalPorosity
from sppm_pipeline.features.grading.stages.grade_stiffness import GradeStiffness
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.method.fields.formula import FormulaField
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.storage import load_value, save_value
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

PAIRS = ((0.3, 0.5), (0.5, 0.2), (0.7, 0.04))


def wished(text):
    return Grading((FormulaLaw("stiffness", "MPa", text, (), (), None, None),))


def graded(text, **options):
    stage = GradeStiffness(**({"values": PAIRS} | options))
    stage.check_options()
    context = PlainContext()
    made = stage.run(context, wished(text), None)
    made.check()
    return made, context.reported


def test_moduli_of_the_cells_give_their_porosities_and_others_lie_between():
    made, reported = graded("x", young=1000.0)
    at = np.array([[500.0, 0, 0], [200, 0, 0], [40, 0, 0], [100, 0, 0]])
    porosity = made["porosity"].at(at)
    assert porosity[:3] == pytest.approx([0.3, 0.5, 0.7], abs=1e-9)
    assert 0.5 < porosity[3] < 0.7
    assert made["porosity"].range == (0.3, 0.7)
    assert (reported["modulus_min"], reported["modulus_max"], reported["cells"]) == (
        pytest.approx(40), pytest.approx(500), 3,
    )  # fmt: skip
    # the curve back, and to a file and back
    assert made.law("porosity").curve.modulus(porosity) == pytest.approx(at[:, 0], rel=1e-9)


def test_a_modulus_beyond_the_curve_is_refused_with_its_place(tmp_path):
    made, _ = graded("where(x < 3, 0.1, 0.7)")
    with pytest.raises(DesignError, match=r"'stiffness' asks for a modulus of 0.7 at \(4, 1, 2\) mm, and at 1 of 2"):
        made["porosity"].at([[1.0, 0, 0], [4.0, 1, 2]])
    files = save_value(made, tmp_path)
    again = load_value(tmp_path, {file.name: file for file in files})
    assert again["porosity"].at([[1.0, 0, 0]]) == pytest.approx(made["porosity"].at([[1.0, 0, 0]]))


CELL = (
    DartThrowing(total=14, share=0.5),
    BoundedDegreeSubgraph(degree=(3, 5), mode="greedy"),
    GaussianField(pore_radius=Length(0.17), tunnel_radius=Length(0.07)),
)


def by_recipe(context, **options):
    stage = GradeStiffness(**({"porosities": (0.4, 0.6), "trials": 2, "resolution": 12, "young": 1000.0} | options))
    stage.check_options()
    return stage.run(context, wished("100 + x"), None, recipe_of(*CELL))


def test_a_recipe_makes_the_curve_itself_from_cells_of_more_and_fewer_pores():
    context = PlainContext(3)
    made = by_recipe(context)
    made.check()
    curve = made.law("porosity").curve
    assert curve.porosities[0] < 0.4 < 0.6 < curve.porosities[-1]
    assert (np.diff(curve.moduli) < 0).all()
    assert made.digest() == by_recipe(PlainContext(3)).digest() != by_recipe(PlainContext(4)).digest()
    assert context.reported["cells"] >= 4
    # another cell of it, as a user would homogenize it
    cell = recipe_of(*CELL).run(PlainContext(8))
    found = HomogenizeVoxel(resolution=12).stiffness_of(PlainContext(), cell).summary()
    modulus = curve.modulus(np.array([found["porosity"]]))[0]
    assert modulus == pytest.approx(1000 * found["isotropic"]["E"], rel=0.2)
    # below the Hashin-Shtrikman bound of an isotropic porous material of nearly this Poisson's ratio
    assert (curve.moduli < 1000 * (1 - curve.porosities) / (1 + curve.porosities)).all()


def test_one_source_of_the_curve_is_asked_for():
    with pytest.raises(ConfigError, match="there are 2"):
        by_recipe(PlainContext(3), values=PAIRS)
    with pytest.raises(ConfigError, match="there is none"):
        GradeStiffness().run(PlainContext(), wished("1"), None)
    with pytest.raises(ConfigError, match="should rise"):
        by_recipe(PlainContext(), porosities=(0.6, 0.4))
    with pytest.raises(ConfigError, match="no map 'stiff"):
        by_recipe(PlainContext(), wanted="stiffnes")


def test_cells_that_scatter_are_averaged_to_a_curve_that_falls():
    rng = np.random.default_rng(3)
    porosity = rng.uniform(0.3, 0.8, 300)
    moduli = (1 - porosity) ** 2.5 * np.exp(rng.normal(0, 0.15, 300))
    curve = stiffness_curve(porosity, moduli)
    assert (np.diff(curve.moduli) < 0).all()
    assert (np.diff(curve.porosities) > 0).all()
    p = np.linspace(curve.porosities[0], curve.porosities[-1], 30)
    assert np.abs(curve.modulus(p) / (1 - p) ** 2.5 - 1).max() < 0.12
    assert curve.deviation == pytest.approx(0.15, abs=0.02)
    assert np.isnan(curve.modulus(np.array([0.1, 0.95]))).all()
    with pytest.raises(DesignError, match="does not fall"):
        stiffness_curve(np.array([0.3, 0.5]), np.array([1.0, 2.0]))


def test_a_sweep_is_read_and_what_cannot_be_used_is_told(tmp_path):
    path = tmp_path / "sweep.csv"
    path.write_text(
        "run,status,elastic.porosity,elastic.E\na,done,0.3,0.5\nb,failed,,\nc,done,0.7,0.04\nd,done,0.5,0.2\n"
    )
    columns = ("elastic.porosity", "elastic.E")
    made, reported = graded("0.2 + 0*x", values=(), path=path, columns=columns)
    assert reported["cells"] == 3
    assert made["porosity"].at([[0.0, 0, 0]]) == pytest.approx([0.5])
    for options, kind, words in (
        ({"path": path}, ConfigError, "either a file"), ({"values": ()}, ConfigError, "there is none"),
        ({"values": (), "path": path, "columns": ("a",)}, ConfigError, "it takes two"),
        ({"values": (), "poisson": 0.49995}, ConfigError, "voxels lock"),
        ({"values": ((1.2, 3.0), (0.3, 4.0))}, InputError, "porosity 1.2 has the modulus 3"),
        ({"values": ((0.3, 4.0),)}, InputError, "1 cells are no curve"),
        ({"wanted": "stifness"}, ConfigError, "no map 'stifness'"),
    ):  # fmt: skip
        with pytest.raises(kind, match=words):
            graded("x", **options)


class Half(FormulaField):
    """Solid below z = 0.5 in every cell, void above."""

    def evaluate(self, x, y, z):
        return np.mod(z, 1.0) - 0.5 + 0 * x * y


def test_the_check_tells_the_modulus_of_what_was_made(tmp_path):
    made, _ = graded("0.2 + 0.1*step(2, x)")  # porosities of 0.5, and of less in the second cell
    context = PlainContext(directory=tmp_path)
    CheckLocalPorosity(resolution=16, path="out").run(context, Half(edge=2.0, region=(2, 1, 1)), made)
    rows = list(csv.DictReader((tmp_path / "out" / "cells.csv").read_text().splitlines()))
    assert [float(row["modulus"]) for row in rows] == pytest.approx([0.2, 0.2], rel=1e-5)
    assert [float(row["modulus_target"]) for row in rows] == pytest.approx([0.2, 0.3], rel=0.02)
    assert context.reported["modulus_error_max"] == pytest.approx(1 / 3, rel=0.03)
    assert {"stiffness.vti", "stiffness.png"} <= {p.name for p in (tmp_path / "out").iterdir()}
