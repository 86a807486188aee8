"""The configurations in ``examples/`` run through the program, and every stage has one."""

import json
from pathlib import Path

import pytest
from sppm_structures import sppm_stages

from sppm_pipeline.engine.cli.main import main

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "examples").glob("*.yaml"))


def test_every_stage_has_an_example():
    text = "".join(path.read_text(encoding="utf-8") for path in EXAMPLES)
    for stage in sppm_stages():
        assert f"stage: {stage}" in text


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run(path, tmp_path):
    coarse = ["-p", "resolution=32", "-s", "slice.field.pixel=0.8 mm", "-s", "read.primitive.size=[12 mm, 12 mm, 8 mm]"]
    text = path.read_text(encoding="utf-8")
    if "image_size" in text:
        coarse += ["-s", "write.picture.image_size=[140, 90]"]
    coarse += ["-s", f"{'fill.implicit' if 'fill.implicit' in text else 'slice.field'}.islands=keep"]
    if "tune.porosity" in text:
        coarse += ["-s", "tune.porosity.tolerance=0.01"]
    folder = tmp_path / "run"
    assert main(["run", str(path), "-o", str(folder), "-q", "--audit", "warn", *coarse]) == 0
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    assert record["status"] == "done"
    layers = sorted((folder / "slices").glob("*.png"))
    assert len(layers) >= 10
    assert any(layer.stat().st_size > 100 for layer in layers)
