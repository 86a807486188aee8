"""Connectivity, porosity and residual periodicity."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from scipy import ndimage

from sppm_pipeline.engine.plan.checking import declared_numbers
from sppm_pipeline.engine.run.sweep_table import numbers_of
from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.connectivity.islands import keep_largest
from sppm_pipeline.method.fields.scalar_field import CleanedField, RepeatedField, ScalarField
from sppm_pipeline.method.stages.check_connectivity import CheckConnectivity
from sppm_pipeline.method.stages.check_porosity import CheckPorosity
from sppm_pipeline.method.stages.check_residual_periodicity import CheckResidualPeriodicity
from sppm_pipeline.method.stages.check_tiling import CheckTiling
from sppm_pipeline.services.grid import cell_centers, cell_nodes
from sppm_pipeline.stage import Rejected
from sppm_pipeline.testing.plain_context import PlainContext


@pytest.fixture(scope="module")
def loose(recipe):
    """A cell with islands: so much void that the solid falls apart."""
    return recipe().run(PlainContext(5)).with_level(0.02)


@dataclass(frozen=True, eq=False)
class Ball(ScalarField):
    """A solid ball in the middle of a periodic cell."""

    cells: ClassVar = (1, 1, 1)
    periodic: ClassVar = True

    def sample_layers(self, grid, start, stop, threads=1):
        grid = grid.layers(start, stop)
        x, y, z = (np.mod(grid.axis(axis), 1.0) - 0.5 for axis in range(3))
        return (np.sqrt(x[:, None, None] ** 2 + y[:, None] ** 2 + z**2) - 0.3).astype(np.float32)


def floating_share(field, n):
    solid = field.solid(cell_centers(n))
    return 1 - keep_largest(solid, (True,) * 3).sum() / solid.sum()


def test_components_are_those_of_scipy_where_nothing_wraps(wang_tiling):
    context = PlainContext()
    CheckConnectivity(resolution=8, islands="keep").run(context, wang_tiling)
    declared = declared_numbers(CheckConnectivity, True, ())
    assert set(numbers_of([{"id": "c", "summary": context.reported}])) == {
        f"c.{place}"
        for place in declared - {"islands_at_surface"}  # with `islands: reject` only
    }
    solid = wang_tiling.solid(cell_centers(8, wang_tiling.cells))
    for phase, mask in (("solid", solid > 0), ("void", solid == 0)):
        labels, count = ndimage.label(mask)
        sizes = np.bincount(labels.ravel())[1:]
        assert context.reported[f"{phase}_components"] == count
        assert context.reported[f"{phase}_removed_share"] == pytest.approx(1 - sizes.max() / sizes.sum())
    assert context.reported["porosity"] == pytest.approx(1 - solid.mean())


def test_islands_are_gone_on_every_grid_and_the_cell_stays_periodic(loose):
    context = PlainContext()
    clean = CheckConnectivity(resolution=32, islands="remove").run(context, loose)
    assert isinstance(clean, CleanedField)
    assert context.reported["solid_components"] > 1
    assert floating_share(clean, 32) == 0
    for n in (24, 41, 50):
        assert floating_share(loose, n) > 0.01
        assert floating_share(clean, n) < 0.003
    values = clean.sample(cell_nodes(20))
    for axis in range(3):
        assert np.array_equal(np.take(values, 0, axis), np.take(values, -1, axis))


def test_what_is_kept_is_left_as_it_was(loose):
    clean = CheckConnectivity(resolution=32, islands="remove").run(PlainContext(), loose)
    grid = cell_centers(32)
    before, after = loose.sample(grid), clean.sample(grid)
    kept = keep_largest((before < 0).view(np.uint8), (True,) * 3).view(bool)
    assert np.array_equal((after < 0), kept)
    changed = before != after
    assert np.array_equal(after[changed], -before[changed])
    assert (before[changed] < 0).all()
    assert clean.summary() == loose.summary()


def test_no_islands_no_change(cell):
    dense = cell.with_level(0.9)
    assert CheckConnectivity(resolution=16).run(PlainContext(), dense) is dense


def test_much_solid_is_removed_only_if_asked_for(loose):
    """By default removal of 10 % of the solid rejects the cell, in words that say what the porosity would become."""
    apart = RepeatedField(Ball(), (2, 1, 1), None)
    context = PlainContext()
    with pytest.raises(Rejected, match=r"50\.00% of the solid is disconnected"):
        CheckConnectivity(resolution=16).run(context, apart)
    context = PlainContext()
    clean = CheckConnectivity(resolution=32).run(context, loose)
    share = context.reported["solid_removed_share"]
    assert 0.01 < share < 0.1
    before, after = (context.reported[name] for name in ("porosity", "porosity_without_islands"))
    assert after - before == pytest.approx(share * (1 - before))
    assert after == pytest.approx(1 - clean.solid(cell_centers(32)).mean())
    assert f"{share:.2%}" in context.warnings[0]
    assert f"{after:.4f}" in context.warnings[0]


def test_keep_only_reports(loose):
    context = PlainContext()
    assert CheckConnectivity(resolution=32, islands="keep").run(context, loose) is loose
    assert context.reported["solid_components"] > 1


def test_reject_follows_the_paper(loose, cell):
    """Labels that do not wrap; a piece that has to go and touches the surface of the cell rejects it."""
    with pytest.raises(Rejected, match="islands lie at the surface"):
        CheckConnectivity(resolution=24, islands="reject").run(PlainContext(), loose)
    CheckConnectivity(resolution=24, islands="reject").run(PlainContext(), cell.with_level(0.9))


def test_bicontinuous(cell):
    with pytest.raises(Rejected, match="run through"):
        CheckConnectivity(resolution=16, bicontinuous=True).run(PlainContext(), cell.with_level(0.999))
    CheckConnectivity(resolution=24, bicontinuous=True).run(PlainContext(), cell)


def test_porosity_is_that_of_the_voxels(wang_tiling):
    context = PlainContext()
    CheckPorosity(resolution=10).run(context, wang_tiling)
    expected = 1 - wang_tiling.solid(cell_centers(10, wang_tiling.cells)).mean()
    assert context.reported["porosity"] == pytest.approx(expected, abs=1e-12)
    for bounds in ({"minimum": expected + 0.01}, {"maximum": expected - 0.01}):
        with pytest.raises(Rejected, match="accepted are"):
            CheckPorosity(resolution=10, **bounds).run(PlainContext(), wang_tiling)


def test_folded_shares_are_reported_and_drawn(wang_tiling, tmp_path):
    from PIL import Image

    pictures = []
    for path in ("folded.png", "again.png", None):
        context = PlainContext(directory=tmp_path)
        CheckResidualPeriodicity(resolution=8, path=path).run(context, wang_tiling)
        report = context.reported
        assert min(report[f"folded_{place}"] for place in ("corner", "edge", "face", "center")) >= 0
        assert report["folded_deviation"] > report["folded_expected"] > 0
        if path:
            pictures.append((tmp_path / path).read_bytes())
            with Image.open(tmp_path / path) as picture:
                assert len(picture.getcolors(10**6)) > 20
    assert pictures[0] == pictures[1]
    assert len(list(tmp_path.iterdir())) == 2


def test_residual_periodicity_needs_a_full_box_of_several_cells(cell, wang, ball):
    from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
    from sppm_pipeline.method.stages.tile_wang_3color import WangTiling
    from sppm_pipeline.nouns.length import Length

    lone = PeriodicTiling(cells=(1, 1, 1)).run(PlainContext(), cell, None)
    with pytest.raises(DesignError, match="two cells"):
        CheckResidualPeriodicity().run(PlainContext(), lone)
    part = WangTiling(cell=Length(1, "mm")).run(PlainContext(), wang, ball)
    with pytest.raises(DesignError, match="full box"):
        CheckResidualPeriodicity().run(PlainContext(), part)


def tiling_report(tiling, **options):
    context = PlainContext()
    CheckTiling(**options).run(context, tiling)
    return context.reported


def test_a_tiling_by_the_papers_rules(wang_tiling):
    report = tiling_report(wang_tiling)
    nx, ny, nz = wang_tiling.cells
    c = wang_tiling.tileset.palette_colors
    assert report["rule1_violations"] == 0
    assert report["interiors"] == len(np.unique(wang_tiling.arrays.interior)) > 1
    assert report["entropy_per_cell"] == pytest.approx((nx * ny + ny * nz + nz * nx) * np.log2(c) / (nx * ny * nz))
    assert 0 < report["interior_entropy"] <= np.log2(c**3)
    assert 0 <= report["alike_across_faces"] < 1
    assert 0 < report["rule2_fraction"] <= 1


def test_one_tile_everywhere_is_alike_everywhere(wang_tiling):
    arrays = wang_tiling.arrays
    same = replace(
        wang_tiling,
        arrays=arrays._replace(
            interior=np.zeros_like(arrays.interior), faces=tuple(np.zeros_like(f) for f in arrays.faces)
        ),
    )
    report = tiling_report(same)
    assert report["rule1_violations"] == 0
    assert [report[f"alike_across_{where}"] for where in ("faces", "edges", "corners")] == [1.0, 1.0, 1.0]
    assert (report["rule2_score"], report["rule2_fraction"], report["interior_entropy"]) == (0.0, 0.0, 0.0)
    assert (report["interiors"], report["colors"]) == (1, [1, 1, 1])


def test_a_tiling_that_breaks_rule_1_is_refused_with_its_number_of_faces(wang_tiling):
    arrays = wang_tiling.arrays
    wrong = arrays.faces[1].copy()
    wrong[1, 2, 1] = 1 - min(1, wrong[1, 2, 1])  # another color than that of the cells on both sides
    broken = replace(wang_tiling, arrays=arrays._replace(faces=(arrays.faces[0], wrong, arrays.faces[2])))
    with pytest.raises(DesignError, match="at 0, 2 and 0 faces across x, y and z; allowed are 0"):
        CheckTiling().run(PlainContext(), broken)
    assert tiling_report(broken, violations=2)["rule1_violations"] == 2


def test_a_tiling_of_fresh_cells_has_no_entropy_of_a_rule(wang_tiling):
    fresh = replace(wang_tiling, tileset=replace(wang_tiling.tileset, kind="fresh"))
    assert "entropy_per_cell" not in tiling_report(fresh)
