"""One word, one meaning, one unit: options of one name say the same in all stages, those of the plugins here included.

The shared sentence of an option is the text of its help before the first semicolon; what follows is the stage's own.
"""

from __future__ import annotations

import ast
import re
import typing
from collections import defaultdict
from pathlib import Path

import pytest

from sppm_pipeline.built_in import BUILTINS
from sppm_pipeline.engine.config.options import options_of
from sppm_pipeline.engine.plan.plugins import load_plugins
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.method.families import options
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.stage import OptionSpec

REPOSITORY = Path(__file__).parents[1]

UNITS = {
    "edge": "samplers take it without a unit, too: then it is a scale of the recipe's lengths and no physical size"
}
SENTENCES = {
    "path": "the direction, to read or to write, is that of the stage",
    "of": "says whose property the stage makes: that of a phase, or a parameter of the design",
    "faces": "says what the stage does with the faces that cells share: what lies on them, or what they are held at",
    "sides": "what is done at the sides of a body that is crushed, or what lies beyond those of a cell",
    "values": "what stands in an image, or in a table",
    "density": "a share of solid, or the bounds of what a structure may have",
    "material": "the look of a solid in a picture, or its name in a file for another program",
    "diameter": "of holes that are drilled, or of beams",
    "copies": "how many there are, or how a file holds them",
    "mass": "of a specimen that was tested, or the target of a part",
    "yield_stress": "a number where one linear solution is scaled, a table where the solid is followed beyond it",
}
"""Names that have several units or sentences, and why."""


def declared(registry):
    """Options of all registered stages by name: (stage, spec) pairs."""
    found = defaultdict(list)
    for stage in registry:
        for name, option in options_of(registry.get(stage)).items():
            found[name].append((stage, option))
    return found


@pytest.fixture(scope="module")
def words():
    return declared(Registry(load_plugins(BUILTINS, files=[], distributions=True)))


def several(words, what):
    """Names with more than one value of `what`, and the stages of each."""
    found = {}
    for name, uses in words.items():
        values = defaultdict(list)
        for stage, option in uses:
            values[what(option)].append(stage)
        if len(values) > 1:
            found[name] = dict(values)
    return found


def sentence(option):
    return option.spec.help.split(";")[0]


def test_options_of_one_name_have_one_sentence(words):
    found = several(words, sentence)
    assert found.keys() == SENTENCES.keys(), found


def test_options_of_one_name_have_one_unit(words):
    found = several(words, lambda option: option.spec.unit)
    assert found.keys() == UNITS.keys(), found


def test_lengths_without_a_unit_are_millimeters_or_fractions_of_the_cell_size(words):
    units = {
        option.spec.unit
        for uses in words.values()
        for _, option in uses
        if Length in (option.kind, *typing.get_args(option.kind)) and option.spec.unit is not None
    }
    # fTetWild measures in diagonals of the bounding box, which needs no cell
    assert units - {"diagonals of the box"} == {"mm", "cell size"}


def test_helps_use_standard_words(words):
    """No former name of a unit or type is left in what users read."""
    dialect = re.compile(
        r"cell (edge|length)s?\b|whole number|a text\b|\bfewest\b|\bwished\b|\bshares? of\b.*\bas a share"
    )
    found = {
        f"{stage}.{name}": option.spec.help
        for name, uses in words.items()
        for stage, option in uses
        if dialect.search(f"{option.spec.help} {option.spec.unit}")
    }
    assert not found


def test_every_shared_declaration_has_several_users():
    """A declaration that one stage uses belongs to that stage."""
    shared = {name for name, value in vars(options).items() if callable(value) and value.__module__ == options.__name__}
    used = defaultdict(set)
    for folder in ("sppm_pipeline", "plugins"):
        for path in (REPOSITORY / folder).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            for node in ast.walk(ast.parse(text)) if "options." in text else ():
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "options":
                    used[node.attr].add(path)
    alone = {name for name in shared - {"_shared", "option"} if len(used[name]) < 2}
    assert not alone


def test_a_note_follows_the_shared_sentence():
    field = options.resolution(16, note="of the test", maximum=99)
    spec = field.metadata["option"]
    assert spec == OptionSpec("voxels along an edge of the cell; of the test", unit="voxels", minimum=2, maximum=99), (
        spec
    )
    assert field.default == 16
    assert options.resolution(8).metadata["option"].help == "voxels along an edge of the cell"
