"""Names of outputs end as their stages can write them, or are refused before the run, all at once."""

import pytest

from sppm_pipeline.engine.config.names import fits_suffix
from sppm_pipeline.engine.config.options import options_of, parse_typed
from sppm_pipeline.errors import SppmError
from sppm_pipeline.features.files.stages.write_mesh import WriteMesh
from sppm_pipeline.method.stages.write_png import WritePng

WRONG = """
pipeline:
  - {stage: read.primitive, shape: box, size: [2, 2, 2]}
  - {stage: write.mesh, id: one, path: part.step}
  - {stage: write.stl, id: two, path: part.ply}
  - {stage: write.picture, id: three, path: x.svg}
  - {stage: slice.mesh, pixel: 0.5}
  - {stage: write.png, id: four, path: slices.zip}
  - {stage: write.graph, id: five, path: graph.gml}
"""


def test_wrong_endings_are_all_found_before_the_run(run_yaml, tmp_path):
    with pytest.raises(SppmError) as caught:
        run_yaml(WRONG)
    told = str(caught.value)
    for words in (
        "ends in .stl, .ply, .obj, .off, .3mf or .glb, got 'part.step'",
        "write.stl writes .stl, and `path` is 'part.ply'",
        "ends in .png, got 'x.svg'",
        "expected the name of a folder, got 'slices.zip'",
        "ends in .graphml or .json, got 'graph.gml'",
    ):
        assert words in told
    assert "say `stage: write.mesh`" in told


@pytest.mark.parametrize("path", ["part.STL", "deep/part.3mf", "a.b.ply"])
def test_endings_in_any_case_and_folder_are_taken(path):
    assert parse_typed(options_of(WriteMesh)["path"], path, None) == path


@pytest.mark.parametrize("path", ["part", "part.", "stl", ".stl", "part.stl/x", "part.stl.gz"])
def test_endings_that_are_none_are_refused(path):
    with pytest.raises(ValueError, match=r"name that ends in \.stl|begins with a blank or ends in a dot"):
        parse_typed(options_of(WriteMesh)["path"], path, None)


def test_a_folder_has_no_ending_of_a_file_but_may_have_a_number():
    for path in ("slices", "v1.25", "batch.2026-11", "a.zip/slices"):
        assert parse_typed(options_of(WritePng)["path"], path, None) == path
    for path in ("slices.zip", "slices.PNG", "deep/layers.sl1"):
        assert not fits_suffix(path, ("/",))
    assert fits_suffix("anything.at.all", ())


def test_former_names_take_the_endings_of_their_format(run_yaml):
    run_yaml("""
pipeline:
  - {stage: read.primitive, shape: box, size: [2, 2, 2]}
  - {stage: write.stl, path: A.STL}
""")
