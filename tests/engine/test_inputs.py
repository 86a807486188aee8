"""What a plan takes from elsewhere is looked at before any work: input files, and columns of a sweep's table."""

import os
import re

import pytest

from sppm_pipeline.engine.plan.checking import checked
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.errors import ConfigError


@pytest.fixture
def check(tmp_path):
    def check(text: str, until: str | None = None, plugins: tuple[str, ...] = ()) -> None:
        file = tmp_path / "config.yaml"
        file.write_text(f"sppm: 1\n{text}", encoding="utf-8")
        checked(open_session(RunRequest(str(file), plugins=plugins, distributions=False)), until)

    return check


TWO = """
pipeline:
  - {stage: read.primitive, shape: box, size: [20, 20, 20]}
  - {stage: read.mesh, path: prat.stl}
  - {stage: read.mesh, id: other, path: nowhere/part.stl}
"""


def test_files_that_are_not_there_are_all_found(check, tmp_path):
    (tmp_path / "part.stl").write_bytes(b"")
    with pytest.raises(ConfigError) as caught:
        check(TWO)
    told = str(caught.value)
    assert re.search(r"config.yaml:5:\d+.*there is no file or folder '.*prat.stl'", told)
    assert "part.stl" in told.split("prat.stl", 1)[1]
    assert re.search(r"config.yaml:6:\d+.*there is no file or folder '.*part.stl'", told)
    check(TWO, until="read.primitive")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes in folders")
def test_a_pipe_is_not_waited_for(check, tmp_path):
    os.mkfifo(tmp_path / "part.stl")
    with pytest.raises(ConfigError, match=r"part.stl' is a pipe or a device"):
        check("pipeline: [{stage: read.mesh, path: part.stl}]")


def test_files_of_a_sweep_and_of_recipes_are_looked_at(check, tmp_path):
    (tmp_path / "a.stl").write_bytes(b"")
    sweep = "params: {part: a.stl}\nsweep: {part: [a.stl, b.stl]}\npipeline: [{stage: read.mesh, path: '${part}'}]"
    with pytest.raises(ConfigError, match=r"no file or folder '.*b\.stl'"):
        check(sweep)
    (tmp_path / "b.stl").write_bytes(b"")
    check(sweep)


SWEEP = """
params: {size: 2}
sweep: {size: [2, 3]}
pipeline:
  - {stage: read.primitive, id: part, shape: torus, size: [3, 3, '${size}']}
after:
  - {stage: write.table, columns: [run, size, part.volume_mm3, status%s]}
  - {stage: write.table, id: second, path: b.md, columns: [run], sort: '%s'}
"""


def test_columns_that_no_run_makes_are_found_before_the_sweep(check):
    check(SWEEP % ("", "part.size_mm.1"))
    with pytest.raises(ConfigError) as caught:
        check(SWEEP % (", sise, prat.volume_mm3", "porosity"))
    told = str(caught.value)
    for column in ("'sise'", "'prat.volume_mm3'", "'porosity'"):
        assert f"the table has no column {column}" in told
    assert "did you mean 'size'" in told
    assert "did you mean 'part.volume_mm3'" in told


NUMBERS = """
params: {size: 2, which: a}
sweep: {size: [2, 3]%s}
recipes:
  a: [{stage: sample.dart_throwing, total: 5}, {stage: connect.mst}, {stage: field.walls}]
  b: [{stage: sample.dart_throwing, total: 5}, {stage: connect.mst}, {stage: field.gaussian, omega: 30, mu: 30}]
pipeline:
  - {stage: tune.retry, id: cell, recipe: '${which}'}
  - {stage: extract.voxels, resolution: 8}
  - {stage: homogenize.voxel, id: elastic, grids: 2, from: cell}
after:
  - {stage: write.chart, x: elastic.porosity, y: %s, bound: elastic.bounds.hashin_shtrikman_young.2, group: %s}
"""


@pytest.mark.parametrize(
    ("column", "hint"),
    [
        ("elastic.E", "did you mean 'elastic.E.1'"),
        ("elastic.E.4", "did you mean 'elastic.E."),
        ("elastic.porsity", "did you mean 'elastic.porosity'"),
        ("elastic.isotropic.e", "did you mean 'elastic.isotropic.E'"),
        ("elastic.qqqqqqqqqqqqqqqqqqqqqqqqqqq", "numbers of elastic: C.1.1, C.1.2"),
    ],
)
def test_numbers_that_a_stage_does_not_report_are_found_before_the_sweep(check, column, hint):
    with pytest.raises(ConfigError, match=re.escape(f"the table has no column '{column}'")) as caught:
        check(NUMBERS % ("", column, "size"))
    assert hint in str(caught.value)


def test_numbers_that_a_stage_reports_are_columns(check):
    for known in ("elastic.C.6.1", "elastic.nu.xy", "elastic.solver.unknowns"):
        check(NUMBERS % ("", known, "extract.voxels.phases.1"))


def test_numbers_of_whatever_recipe_a_row_chooses_are_columns(check):
    with pytest.raises(ConfigError, match=r"no column 'cell\.omega'"):
        check(NUMBERS % ("", "cell.thickness", "cell.omega"))
    with pytest.raises(ConfigError, match=r"no column 'cell\.levels'"):
        check(NUMBERS % (", which: [a, b]", "cell.attempts", "cell.levels"))
    check(NUMBERS.replace("which: a", "which: b") % (", which: [b, a]", "cell.thickness", "cell.level"))


FURTHER = '''
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.stage import Context
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel

@dataclass(frozen=True, kw_only=True)
class Further(HomogenizeVoxel):
    """Report more."""
    name: ClassVar[str] = "homogenize.further"
    %s
    def run(self, context: Context, source: ScalarField) -> StiffnessReport:
        context.report(damping=1.0)
        return self.stiffness_of(context, source)
'''


def test_numbers_of_plugins_are_refused_only_if_they_declare_them(check, tmp_path):
    text = NUMBERS.replace("homogenize.voxel", "homogenize.further")
    plugin = tmp_path / "further.py"
    plugin.write_text(FURTHER % "", encoding="utf-8")
    check(text % ("", "elastic.damping", "elastic.anything"), plugins=(str(plugin),))
    plugin.write_text(FURTHER % "reported: ClassVar[tuple[str, ...]] = ('damping',)", encoding="utf-8")
    check(text % ("", "elastic.damping", "elastic.E.1"), plugins=(str(plugin),))
    with pytest.raises(ConfigError, match=r"no column 'elastic\.anything'"):
        check(text % ("", "elastic.damping", "elastic.anything"), plugins=(str(plugin),))


def test_only_recipes_that_run_are_looked_at(check):
    inner = "a: [{stage: read.mesh, path: no.stl}]\n  b: [{stage: tune.retry, recipe: a}]"
    part = "{stage: read.primitive, shape: box, size: [9, 9, 9]}"
    check(f"recipes:\n  {inner}\npipeline: [{part}]")
    with pytest.raises(ConfigError, match=r"no file or folder '.*no\.stl'"):
        check(f"recipes:\n  {inner}\npipeline: [{part}, {{stage: tune.retry, recipe: b}}]")


SHEET = """
params: {size: 2}
sweep: {size: [2, 3]}
pipeline:
  - {stage: read.primitive, id: part, shape: torus, size: [3, 3, '${size}']}
  - {stage: slice.mesh, pixel: 0.5 mm}
  - {stage: write.png, path: layers, sheet: 4}
after:
  - {stage: write.sheet, picture: %s}
"""


def test_a_picture_that_no_run_writes_is_found_before_the_sweep(check):
    check(SHEET % "layers-overview.png")
    with pytest.raises(ConfigError, match=r"config.yaml:10:\d+.*no run writes a file 'picture.png'"):
        check(SHEET % "picture.png")


def test_files_of_plugins_may_have_any_name(check, tmp_path):
    plugin = tmp_path / "further.py"
    plugin.write_text(FURTHER % "", encoding="utf-8")
    text = NUMBERS.replace("homogenize.voxel", "homogenize.further") % ("", "elastic.damping", "size")
    check(text + "  - {stage: write.sheet, picture: any.png}\n", plugins=(str(plugin),))
