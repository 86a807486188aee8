"""The layout of a configuration: which keys there are, and the stage entries with their ids."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.config.document import Entry, Node, Override, as_node, plain
from sppm_pipeline.engine.config.problems import Problems, raise_problems, shown
from sppm_pipeline.errors import ConfigError, Position, did_you_mean
from sppm_pipeline.hookspecs import Preset

FORMAT = 1
"""Version of the file format: the value of the key `sppm`."""

RESERVED = ("stage", "id", "from", "recipe")
"""Keys of a stage entry that are no options."""

KEYS = {
    "sppm": "version of the file format, 1",
    "name": "name of the design; the default run directory is runs/<name>",
    "seed": "integer from which all random numbers are drawn",
    "params": "values that stand in for ${name}",
    "plugins": "Python files with further stages, relative to this file",
    "recipes": "named lists of stages that other stages repeat, or presets with their parameters",
    "pipeline": "list of stages",
    "sweep": "lists of values for params and seed (a grid), or a list of maps (a table)",
    "after": "list of stages that run once after a sweep and may use its table",
    "audit": "fail (default) or warn: what becomes of a run whose results contradict each other or what was asked for",
    "folder": "folder that relative paths start from; the folder of this file if omitted",
    "notes": "map for people and other programs; nothing of it enters a run",
}
AUDITS = ("fail", "warn")

MAX_SEED = 2**63 - 1
"""Seeds fit into 64 bits, so that other programs can read a run record."""

_NAME = re.compile(r"\w[\w .+-]{0,99}")
_WORD = re.compile(r"\w[\w.#-]*")


def checked_seed(value: Any, where: Position | None = None) -> int:
    """A seed, if it is one; NumPy's integers are."""
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MAX_SEED:
        raise ConfigError(f"a seed is an integer, at least 0, at most {MAX_SEED}, got {shown(value)}", where=where)
    return value


@dataclass(frozen=True)
class Configuration:
    """A configuration file before parameters are put in; nodes keep their positions."""

    file: Path
    folder: Path
    name: str
    seed: int
    params: Mapping[str, Entry]
    plugins: tuple[Path, ...]
    recipes: Mapping[str, Entry]
    pipeline: Node
    sweep: Node | None
    after: Node | None
    audit: str = "fail"

    def base_of(self, where: Position) -> Path:
        """The folder that a relative path written at `where` starts from."""
        return Path.cwd() if isinstance(where, Override) else self.folder


@dataclass(frozen=True)
class StageEntry:
    """One stage of a pipeline or recipe as written, parameters put in."""

    id: str
    recipe: str | None  # the recipe it belongs to; None in the pipeline itself
    stage: Node  # its `value` is the stage's name
    where: Position
    explicit_id: bool
    options: Mapping[str, Entry]
    sources: Node | None  # what `from` says
    recipes: Node | None  # what `recipe` says

    @property
    def name(self) -> str:
        """The stage's name, ``family.name``."""
        return str(self.stage.value)

    @property
    def address(self) -> str:
        """The id, with the recipe in front: how `-s` and error messages name the stage."""
        return f"{self.recipe}.{self.id}" if self.recipe else self.id

    def with_option(self, name: str, entry: Entry) -> StageEntry:
        """The same entry with one option replaced."""
        return dataclasses.replace(self, options={**self.options, name: entry})


def parse_configuration(root: Node, path: Path, base: str | Path) -> tuple[Configuration, Problems]:
    """The top level of a document, and what is wrong with it; `base` is the folder that the key `folder` is relative
    to.

    Raises `ConfigError` if the format is another, or params, recipes or the pipeline can't be read, so that the rest
    would only give errors that follow from it.
    """
    if not isinstance(root.value, dict):
        raise ConfigError("a configuration is a map that starts with `sppm: 1`", where=root.where)
    top: dict[str, Entry] = root.value
    problems: Problems = []
    readable = True

    def refuse(message: str, where: Position, hint: str | None = None) -> None:
        problems.append(ConfigError(message, where=where, hint=hint))

    def value_of(key: str, kind: type, words: str, default: Any) -> Any:
        """The value of a key; an empty value counts as omitted."""
        node = top[key].node if key in top else None
        if node is None or node.value is None:
            return default
        if isinstance(node.value, kind) and not isinstance(node.value, bool):
            return node.value
        refuse(f"`{key}` must be {words}, got {shown(plain(node))}", node.where)
        nonlocal readable
        readable = readable and key not in ("params", "recipes")
        return default

    for key, entry in top.items():
        if key not in KEYS:
            refuse(f"unknown key {shown(key)}", entry.where, did_you_mean(key, KEYS))
    version = top["sppm"].node if "sppm" in top else None
    if version is None:
        refuse("the key `sppm` is missing", root.where, "start the file with `sppm: 1`, the version of its format")
    elif version.value != FORMAT or isinstance(version.value, bool):
        refuse(f"format version {shown(plain(version))} is unknown; this program reads {FORMAT}", version.where)
    if "pipeline" not in top:
        refuse("the key `pipeline` is missing", root.where, "add `pipeline:` with a list of stages")
    name = re.sub(r"[^\w.+-]", "_", path.stem).lstrip(".+-") or "unnamed"
    if "name" in top:
        node, name = top["name"].node, str(top["name"].node.value)
        if not isinstance(node.value, str) or not _NAME.fullmatch(name) or name.endswith((".", " ")):
            refuse(
                "`name` must be a string of letters, digits, blanks and ._+- of at most 100 characters, got "
                f"{shown(plain(node))}",
                node.where,
            )
    folder = Path(os.path.abspath(Path(base, str(value_of("folder", str, "a string", ".")))))
    audit = value_of("audit", str, "`fail` or `warn`", "fail")
    if audit not in AUDITS:
        refuse(f"`audit` must be {' or '.join(AUDITS)}, got {shown(audit)}", top["audit"].node.where)
    seed = value_of("seed", int, "an integer, at least 0", 0)
    if not 0 <= seed <= MAX_SEED:
        refuse(f"`seed` must be an integer, at least 0, at most {MAX_SEED}, got {shown(seed)}", top["seed"].node.where)
    params = value_of("params", dict, "a map", {})
    recipes = value_of("recipes", dict, "a map of recipe names to lists of stages or presets", {})
    for what, named in (("parameter", params), ("recipe", recipes)):
        for key, entry in named.items():
            if not key.isidentifier():
                refuse(f"the {what} name {shown(key)} must consist of letters, digits and _", entry.where)
    sweep = top["sweep"].node if "sweep" in top else None
    if sweep is not None and not isinstance(sweep.value, (dict, list)):
        refuse("`sweep` must be a map of lists or a list of maps", sweep.where)
        sweep = None
    if "after" in top and "sweep" not in top:
        refuse("`after` runs after a sweep, but there is no `sweep`", top["after"].where)
    value_of("notes", dict, "a map", {})
    plugins = []
    for node in value_of("plugins", list, "a list of Python files", []):
        if isinstance(node.value, str) and node.value:
            plugins.append(folder / node.value)
        else:
            refuse(f"a plugin is the path of a Python file, got {shown(plain(node))}", node.where)
    known = version is not None and version.value == FORMAT and not isinstance(version.value, bool)
    if not (known and readable and "pipeline" in top and isinstance(top["pipeline"].node.value, (list, type(None)))):
        raise_problems(problems)
    return (
        Configuration(
            file=path,
            folder=folder,
            name=name,
            seed=seed,
            params=params,
            plugins=tuple(plugins),
            recipes=recipes,
            pipeline=top["pipeline"].node,
            sweep=sweep,
            after=top["after"].node if "after" in top and "sweep" in top else None,
            audit=audit,
        ),
        problems,
    )


def stage_entries(node: Node, recipe: str | None) -> tuple[list[StageEntry], Problems]:
    """The entries of a pipeline or of one recipe, with ids given to those that have none."""
    if not isinstance(node.value, list) or not node.value:
        what = f"recipe {recipe!r}" if recipe else "a pipeline"
        return [], [ConfigError(f"{what} must be a list of at least one stage", where=node.where)]
    problems: Problems = []
    found = []
    for item in node.value:
        entry, wrong = _stage_entry(item, recipe)
        problems += wrong
        found += [entry] if entry is not None else []
    taken: dict[str, Position] = {}
    for entry in found:
        if entry.explicit_id:
            if entry.id in taken:
                message = f"the id {entry.id!r} is used twice; first at {taken[entry.id]}"
                problems.append(ConfigError(message, where=entry.where, stage=entry.address))
            taken.setdefault(entry.id, entry.where)
    for place, entry in enumerate(found):
        if not entry.explicit_id:
            number, id_ = 1, entry.name
            while id_ in taken:
                number += 1
                id_ = f"{entry.name}#{number}"
            taken[id_] = entry.where
            found[place] = dataclasses.replace(entry, id=id_)
    return found, problems


def _stage_entry(item: Node, recipe: str | None) -> tuple[StageEntry | None, Problems]:
    if isinstance(item.value, str):  # a stage without options
        return StageEntry(item.value, recipe, item, item.where, False, {}, None, None), []
    if not isinstance(item.value, dict) or "stage" not in item.value:
        message = "an entry must be a map with the key `stage`, or the name of a stage"
        return None, [ConfigError(message, where=item.where)]
    keys: dict[str, Entry] = item.value
    stage = keys["stage"].node
    if not isinstance(stage.value, str):
        message = f"`stage` must be the name of a stage, got {shown(plain(stage))}"
        return None, [ConfigError(message, where=stage.where)]
    problems: Problems = []
    explicit = keys["id"].node if "id" in keys else None
    if explicit is not None and not (isinstance(explicit.value, str) and _WORD.fullmatch(explicit.value)):
        message = f"an id consists of letters, digits and ._#-, got {shown(plain(explicit))}"
        problems.append(ConfigError(message, where=explicit.where))
        explicit = None
    entry = StageEntry(
        id=explicit.value if explicit else stage.value,
        recipe=recipe,
        stage=stage,
        where=stage.where,
        explicit_id=explicit is not None,
        options={key: entry for key, entry in keys.items() if key not in RESERVED},
        sources=keys["from"].node if "from" in keys else None,
        recipes=keys["recipe"].node if "recipe" in keys else None,
    )
    return entry, problems


KEY = "preset"
"""Key of a recipe that is a preset and not a list of stages."""

_PARAM = re.compile(r"\$\{(\w+)\}")


def expanded(node: Node, presets: Mapping[str, Preset]) -> tuple[Node | None, Problems]:
    """The list of stages that a recipe of the form ``{preset: NAME, param: value, ...}`` means; others as they are.

    None if there is no preset of this name.
    """
    if not isinstance(node.value, dict) or KEY not in node.value:
        return node, []
    given = dict(node.value)
    named = given.pop(KEY).node
    if not isinstance(named.value, str) or named.value not in presets:
        hint = did_you_mean(str(named.value), presets)
        return None, [ConfigError(f"there is no preset {shown(plain(named))}", where=named.where, hint=hint)]
    preset = presets[named.value]
    problems: Problems = [
        ConfigError(
            f"the preset {named.value!r} has no parameter {shown(name)}",
            where=entry.where,
            hint=did_you_mean(name, preset.params),
        )
        for name, entry in given.items()
        if name not in preset.params
    ]
    return stages_of(preset, node.where, {name: entry.node for name, entry in given.items()}), problems


def stages_of(preset: Preset, where: Position, given: Mapping[str, Node] | None = None) -> Node:
    """The stages of a preset, all of them at `where`; a parameter that is None takes its option away."""
    values = {name: as_node(value, where) for name, value in preset.params.items()} | dict(given or {})

    def put_in(value: Any) -> Node:
        if isinstance(value, (list, tuple)):
            return Node([put_in(item) for item in value], where)
        if isinstance(value, Mapping):
            nodes = {key: put_in(item) for key, item in value.items()}
            # a parameter of None leaves the option to its default
            return Node({key: Entry(node.where, node) for key, node in nodes.items() if node.value is not None}, where)
        match = _PARAM.fullmatch(value) if isinstance(value, str) else None
        return values[match[1]] if match else Node(value, where)

    return put_in(preset.stages)
