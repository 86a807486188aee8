"""What the terminal says of a run: the numbers that a stage is run for, with units and error bars."""

import pytest

from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.cli.run import headline_text
from sppm_pipeline.stage import Headline

SUMMARY = {
    "unit": "MPa", "E": [371.04, 369.5, 370.0], "E_error": [3.21, 2.9, 3.0], "nu": {"xy": 0.25, "yx": None},
    "C": [[512.25, 101.5], [101.5, 510.0]], "error": [[4.0, 1.0], [1.0, 5.0]], "porosity": 0.5123456789,
}  # fmt: skip


@pytest.mark.parametrize(
    ("headline", "text"),
    [
        (Headline("E", unit="{unit}", error="E_error"), "E 371 369.5 370 +- 3.2 MPa"),
        (Headline("C.1.2", "C12", "{unit}", "error.1.2"), "C12 101.5 +- 1 MPa"),
        (Headline("nu"), "nu xy 0.25 yx -"),
        (Headline("porosity"), "porosity 0.512346"),
        (Headline("G", unit="{unit}"), ""),
        (Headline("C.0.1"), ""),
        (Headline("C.1.3"), ""),
        (Headline("porosity", error="none"), "porosity 0.512346"),
    ],
)
def test_a_headline(headline, text):
    assert headline_text(headline, SUMMARY) == text
    assert headline_text(headline, {name: value for name, value in SUMMARY.items() if name == "unit"}) == ""


def test_what_one_asked_for_is_said(tmp_path, capsys):
    (tmp_path / "cube.yaml").write_text(
        """
sppm: 1
name: cube
pipeline:
  - {stage: read.primitive, shape: box, size: [4 mm, 4 mm, 2 mm]}
  - {stage: slice.mesh, pixel: 0.5 mm, layer: 0.5 mm}
  - {stage: write.png, path: slices, sheet: 0}
"""
    )
    assert main(["run", str(tmp_path / "cube.yaml"), "--no-cache", "-o", str(tmp_path / "run")]) == 0
    assert "layers 4, solid volume 32 mm^3, bytes" in capsys.readouterr().out


def test_a_stiffness_is_said_with_unit_and_error_bar(tmp_path, capsys):
    (tmp_path / "cell.yaml").write_text(
        """
sppm: 1
name: cell
pipeline:
  - {stage: sample.elimination, count: 5}
  - {stage: connect.mst}
  - {stage: field.gaussian, pore_radius: 0.2, tunnel_radius: 0.1}
  - {stage: homogenize.voxel, resolution: 12, grids: 2, young: 1000, stress_unit: MPa, solver_tolerance: 0.01}
"""
    )
    assert main(["run", str(tmp_path / "cell.yaml"), "--no-cache", "-o", str(tmp_path / "run")]) == 0
    words = " ".join(capsys.readouterr().out.split())
    for name in ("E", "G", "C11", "C12", "C44"):
        after = words.partition(f" {name} ")[2].partition(",")[0]
        assert "+-" in after, name
        assert after.endswith("MPa"), name
    assert "nu xy 0." in words
