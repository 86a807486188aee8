"""The schema and the texts about stages."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from sppm_pipeline.built_in import BUILTINS
from sppm_pipeline.engine.config.options import options_of
from sppm_pipeline.engine.plan.describe import (
    explain_plan,
    purpose_in_source,
    purpose_of,
    stage_data,
    stage_list,
    stage_text,
)
from sppm_pipeline.engine.plan.plugins import load_plugins
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.plan.schema import configuration_schema
from tests.built_in import BUILT_IN
from tests.synthetic import Varied


@pytest.fixture(scope="module")
def registry():
    return Registry(load_plugins(["tests.synthetic"], distributions=False))


def test_the_schema_covers_every_stage_and_option(registry):
    schema = configuration_schema(registry)
    json.dumps(schema, allow_nan=False)
    assert set(schema["$defs"]) == {"stage", *registry}
    options = schema["$defs"]["read.varied"]["properties"]
    assert set(options) == {"stage", "id", *options_of(Varied)}
    param = options["flag"]["anyOf"][-1]
    assert param["type"] == "string"
    assert options["whole"]["anyOf"][0] == {"type": "integer", "minimum": 0, "maximum": 10}
    assert options["number"]["anyOf"][0] == {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1}
    assert options["word"]["anyOf"][0] == {"enum": ["one", "two", "three"]}
    assert options["length"]["description"] == "a length [mm]"
    assert options["length"]["default"] == 1.0
    assert options["length"]["anyOf"][1]["type"] == "string"
    assert options["pair"]["anyOf"][0]["minItems"] == 2
    assert options["maybe"]["anyOf"][1] == {"type": "null"}
    assert len(options["either"]["anyOf"]) == 3
    assert schema["$defs"]["read.number"]["required"] == ["stage", "value"]
    assert "recipe" in schema["$defs"]["tune.repeat"]["required"]
    assert schema["$defs"]["read.number"]["additionalProperties"] is False


def test_references_say_everything_about_an_option(registry):
    text = stage_text(Varied, registry)
    for words in (
        "An option of each type",
        "makes   Text",
        "length: a length in mm, above 0, at most 100; default 1.0",
        "word: one of one, two, three; default one",
        "flag: true or false; default false",
        "maybe: an integer; default none",
    ):
        assert words in text
    assert "value: a number, at least -1e+06, at most 1e+06; required" in stage_text(
        registry.get("read.number"), registry
    )


def test_data_of_every_stage_is_json(registry):
    for name in registry:
        data = stage_data(registry.get(name), registry)
        assert json.loads(json.dumps(data, allow_nan=False))["name"] == name
        assert data["purpose"] == purpose_of(registry.get(name)) != ""


def test_the_list_has_a_line_for_every_stage(registry):
    lines = stage_list(registry, list(registry)).splitlines()
    assert [line.split()[0] for line in lines if line.startswith("  ")] == list(registry)
    assert "read: a file or a primitive becomes an artifact" in lines


def test_a_plan_is_explained_with_options_inputs_and_seeds(work):
    text = explain_plan(
        work.plan(
            "seed: 5\nparams: {c: 2}\nrecipes: {r: [{stage: sample.random, count: '${c}'}]}\n"
            "pipeline: [{stage: tune.repeat, id: best, recipe: r}, field.scale]\n"
        )
    )
    for words in (
        "seed 5",
        "c = 2",
        "'<stage>/r@<attempt>/sample.random'",
        "count = 2\n",
        "best (tune.repeat): Run a recipe until",
        "recipe: recipe r",
        "attempts = 20 (default)",
        "number: best",
    ):
        assert words in text


def test_what_built_in_stages_are_for_is_read_in_their_sources():
    registry = Registry(load_plugins(BUILTINS, distributions=False))
    for name in BUILT_IN:
        assert purpose_in_source(name, registry) == purpose_of(registry.get(name)) != ""
    listing = "import sys; from sppm_pipeline.engine.cli.main import main; main(['stages', '--no-plugins']); "
    code = f"{listing}print(*(m for m in sys.modules if m.count('.') == 3 and m.startswith('sppm_pipeline.method.')))"
    out = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert out.splitlines()[-1] == ""
    assert "  tune.retry" in out
