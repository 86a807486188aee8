"""Stiffness against theory: a frame of beams, bounds, thin walls. tests/test_configs.py compares structures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sppm_structures.graphs import LATTICES
from sppm_structures.struts import Struts
from sppm_structures.tpms import Tpms

from sppm_pipeline.built_in import BUILTINS
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.errors import ConfigErrors
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.method.stages.tune_porosity import TunePorosity
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

ROOT = Path(__file__).resolve().parents[3]
NU = 0.3


def beam(axis, radius):
    """Stiffness of a round Timoshenko beam with E = 1 between two nodes of six freedoms each, in global axes."""
    length = np.linalg.norm(axis)
    area, moment = np.pi * radius**2, np.pi * radius**4 / 4
    shear = 1 / (2 * (1 + NU))
    phi = 12 * moment / (6 * (1 + NU) / (7 + 6 * NU) * shear * area * length**2)
    k = np.zeros((12, 12))
    for row, value in ((0, area / length), (3, 2 * moment * shear / length)):
        k[np.ix_([row, row + 6], [row, row + 6])] = value * np.array([[1, -1], [-1, 1]])
    for across, turn, sign in ((1, 5, 1), (2, 4, -1)):
        a = sign * 6 * length
        same, other = (4 + phi) * length**2, (2 - phi) * length**2
        block = np.array([[12, a, -12, a], [a, same, -a, other], [-12, -a, 12, -a], [a, other, -a, same]])
        rows = [across, turn, across + 6, turn + 6]
        k[np.ix_(rows, rows)] = moment / (length**3 * (1 + phi)) * block
    x = axis / length
    y = np.cross(np.eye(3)[np.argmin(np.abs(x))], x)
    y /= np.linalg.norm(y)
    turned = np.kron(np.eye(4), np.array([x, y, np.cross(x, y)]))
    return turned.T @ k @ turned


def frame(lattice, radius):
    """Effective stiffness of a periodic frame with rigid joints, and its density without regard to joints."""
    graph = LATTICES[lattice]()
    numbers: dict[tuple[float, ...], int] = {}
    ends = [
        [numbers.setdefault(tuple(np.round(p % 1, 6) % 1), len(numbers)) for p in points]
        for points in (graph.starts, graph.ends)
    ]
    strains = np.zeros((6, 3, 3))
    for m, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]):
        strains[m, i, j] += 0.5
        strains[m, j, i] += 0.5
    size = 6 * len(numbers)
    stiffness, load, affine = np.zeros((size, size)), np.zeros((size, 6)), np.zeros((6, 6))
    axes = graph.ends - graph.starts
    for first, second, axis in zip(*ends, axes, strict=True):
        k, jump = beam(axis, radius), np.zeros((12, 6))
        jump[6:9] = (strains @ axis).T
        freedoms = np.r_[6 * first : 6 * first + 6, 6 * second : 6 * second + 6]
        np.add.at(stiffness, (freedoms[:, None], freedoms[None]), k)
        np.add.at(load, freedoms, -(k @ jump))
        affine += jump.T @ k @ jump
    c = affine - load.T @ np.linalg.lstsq(stiffness, load, rcond=1e-13)[0]
    return c, np.pi * radius**2 * np.linalg.norm(axes, axis=1).sum()


def voxels(field, n):
    """Effective stiffness and density on n^3 voxels."""
    report = HomogenizeVoxel(resolution=n).run(PlainContext(), field)
    return np.asarray(report.stiffness), 1 - report.porosity


def young(c):
    return 1 / np.linalg.inv(c)[0, 0]


def test_the_slender_octet_frame_is_that_of_deshpande_fleck_and_ashby():
    c, density = frame("octet", 0.001)
    assert (c[0, 0] / density, c[0, 1] / density, c[3, 3] / density) == pytest.approx((1 / 6, 1 / 12, 1 / 12), rel=1e-3)
    assert young(c) / density == pytest.approx(1 / 9, rel=1e-3)


def test_the_slender_kelvin_frame_bends():
    c, density = frame("kelvin", 0.001)
    assert young(c) / density**2 == pytest.approx(0.600, abs=0.001)
    assert (c[0, 0] + 2 * c[0, 1]) / 3 / density == pytest.approx(1 / 9, rel=1e-3)
    assert 2 * c[3, 3] / (c[0, 0] - c[0, 1]) == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(
    ("lattice", "radii", "n", "excess"),
    [("simple_cubic", (0.05, 0.07), 96, 0.07), ("octet", (0.035, 0.05, 0.07), 64, 0.1)],
)
def test_voxels_tend_to_the_frame_from_above(lattice, radii, n, excess):
    """Joints have a size and stiffen; their share falls with the radius."""
    over = []
    for (
        radius
    ) in radii:  # from 4.5 voxels across, along the grid from 9.6: fewer represent the section of a strut badly
        field = Struts(lattice=lattice, radius=Length(radius), blend=Length(0.0)).run(PlainContext())
        over.append(young(voxels(field, n)[0]) / young(frame(lattice, radius)[0]) - 1)
    assert over == sorted(over)
    assert 0 < over[0] < excess


def test_thin_walls_on_minimal_surfaces_reach_the_bulk_modulus_of_membranes():
    """A uniform tension is in balance where the mean curvature is zero: K = 2 rho E / (9 (1 - nu))."""
    limit = 2 / (9 * (1 - NU))
    for surface, low in (("gyroid", 0.97), ("schwarz_p", 0.9)):
        recipe = recipe_of(Tpms(surface=surface, form="sheet"))
        field = TunePorosity(target=0.94, resolution=48, tolerance=0.002).run(PlainContext(), recipe)
        c, density = voxels(field, 88)
        assert low < (c[0, 0] + 2 * c[0, 1]) / 3 / density / limit < 1.02


def test_all_structures_are_compared():
    session = open_session(RunRequest(str(ROOT / "configs" / "compare_structures.yaml"), BUILTINS, ()))
    listed = [node.value for node in session.configuration.sweep.value["structure"].node.value]
    assert listed == list(session.configuration.recipes)


@pytest.mark.parametrize("name", ["compare_structures.yaml", "crush_structures.yaml", "published_curves.yaml"])
def test_without_this_plugin_the_missing_stages_are_named(name):
    request = RunRequest(str(ROOT / "configs" / name), BUILTINS, (), False)
    with pytest.raises(ConfigErrors, match=r"there is no stage 'field\.(tpms|struts)'"):
        open_session(request).plan()
    assert "pip install ./plugins/sppm-structures" in (ROOT / "configs" / name).read_text(encoding="utf-8")
