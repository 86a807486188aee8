"""What a plan takes from elsewhere is looked at before any work: input files, and columns of a sweep's table."""

import re

import pytest

from sppm_pipeline.engine.plan.session import RunRequest, checked, open_session
from sppm_pipeline.errors import ConfigError


@pytest.fixture
def check(tmp_path):
    def check(text: str, until: str | None = None) -> None:
        file = tmp_path / "config.yaml"
        file.write_text(f"sppm: 1\n{text}", encoding="utf-8")
        checked(open_session(RunRequest(str(file), distributions=False)), until)

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
    assert "did you mean size?" in told
    assert "did you mean part?" in told


def test_only_recipes_that_run_are_looked_at(check):
    inner = "a: [{stage: read.mesh, path: no.stl}]\n  b: [{stage: tune.retry, recipe: a}]"
    part = "{stage: read.primitive, shape: box, size: [9, 9, 9]}"
    check(f"recipes:\n  {inner}\npipeline: [{part}]")
    with pytest.raises(ConfigError, match=r"no file or folder '.*no\.stl'"):
        check(f"recipes:\n  {inner}\npipeline: [{part}, {{stage: tune.retry, recipe: b}}]")
