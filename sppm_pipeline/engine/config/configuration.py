"""The layout of a configuration: which keys there are, and the stage entries with their ids."""

from __future__ import annotations

import dataclasses
import os
import re
import types
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.config.document import Entry, Node, Override, plain, read_yaml
from sppm_pipeline.engine.config.problems import Problems, did_you_mean, shown
from sppm_pipeline.errors import ConfigError, Position

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
    "folder": "folder that relative paths start from; the folder of this file if omitted",
}
MAX_SEED = 2**63 - 1
"""Seeds fit into 64 bits, so that other programs can read a run record."""

_NAME = re.compile(r"\w[\w .+-]{0,99}")
_WORD = re.compile(r"\w[\w.#-]*")


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
    errors: tuple[ConfigError, ...] = ()
    """What is wrong with the top level and does not keep the rest from being looked at; `make_plan` reports it."""

    def base_of(self, where: Position) -> Path:
        """The folder that a relative path written at `where` starts from."""
        return Path.cwd() if isinstance(where, Override) else self.folder


@dataclass(frozen=True)
class StageEntry:
    """One stage of a pipeline or recipe as written, parameters put in.

    Attributes
    ----------
    id : str
    recipe : str or None
        The recipe it belongs to; None in the pipeline itself.
    stage : Node
        Its `value` is the stage's name.
    explicit_id : bool
    options : dict of option name to Entry
    sources, recipes : Node or None
        What `from` and `recipe` say.
    """

    id: str
    recipe: str | None
    stage: Node
    where: Position
    explicit_id: bool
    options: Mapping[str, Entry]
    sources: Node | None
    recipes: Node | None

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


def read_configuration(path: Path) -> Configuration:
    """Read a file and check its top level; see `parse_configuration`."""
    return parse_configuration(read_yaml(path), path, path.parent)


def parse_configuration(root: Node, path: Path, base: str | Path) -> Configuration:
    """Check the top level of a document.

    Parameters
    ----------
    root : Node
    path : Path
        The file, or the name of what was not read from a file.
    base : str or Path
        The folder that the key `folder` is relative to.

    Raises
    ------
    ConfigError
        If the format is another, or params, recipes or the pipeline can't be read, so that the rest would only give
        errors that follow from it.
    """
    problems = Problems()
    if not isinstance(root.value, dict):
        raise ConfigError("a configuration is a map that starts with `sppm: 1`", where=root.where)
    top: dict[str, Entry] = root.value
    for key, entry in top.items():
        if key not in KEYS:
            problems.report(f"unknown key {shown(key)}", entry.where, hint=did_you_mean(key, KEYS))
    known_format = _check_format(top, root.where, problems)
    if "pipeline" not in top:
        problems.report("the key `pipeline` is missing", root.where, hint="add `pipeline:` with a list of stages")
    name = _name(top, path, problems)
    folder = Path(os.path.abspath(Path(base, str(_value(top, "folder", str, "a string", problems, default=".")))))
    seed = _value(top, "seed", int, "an integer, at least 0", problems, default=0)
    if not 0 <= seed <= MAX_SEED:
        problems.report(
            f"`seed` must be an integer, at least 0, at most {MAX_SEED}, got {shown(seed)}", top["seed"].node.where
        )
    params = _value(top, "params", dict, "a map", problems, default={})
    for key, entry in params.items():
        if not key.isidentifier():
            problems.report(f"the parameter name {shown(key)} must consist of letters, digits and _", entry.where)
    recipes = _value(top, "recipes", dict, "a map of recipe names to lists of stages or presets", problems, default={})
    for key, entry in recipes.items():
        if not key.isidentifier():
            problems.report(f"the recipe name {shown(key)} must consist of letters, digits and _", entry.where)
    if "sweep" in top and not isinstance(top["sweep"].node.value, (dict, list)):
        problems.report("`sweep` must be a map of lists or a list of maps", top["sweep"].node.where)
    if "after" in top and "sweep" not in top:
        problems.report("`after` runs after a sweep, but there is no `sweep`", top["after"].where)
    plugins = _value(top, "plugins", list, "a list of Python files", problems, default=[])
    for node in plugins:
        if not isinstance(node.value, str) or not node.value:
            problems.report(f"a plugin is the path of a Python file, got {shown(plain(node))}", node.where)
    if not known_format or not all(
        isinstance(top[key].node.value, (kind, types.NoneType)) if key in top else key != "pipeline"
        for key, kind in (("params", dict), ("recipes", dict), ("pipeline", list))
    ):
        problems.raise_any()
    return Configuration(
        file=path,
        folder=folder,
        name=name,
        seed=seed,
        params=params,
        plugins=tuple(folder / node.value for node in plugins if isinstance(node.value, str) and node.value),
        recipes=recipes,
        pipeline=top["pipeline"].node,
        sweep=top["sweep"].node if "sweep" in top and isinstance(top["sweep"].node.value, (dict, list)) else None,
        after=top["after"].node if "after" in top and "sweep" in top else None,
        errors=tuple(problems.errors),
    )


def _check_format(top: Mapping[str, Entry], where: Position, problems: Problems) -> bool:
    if "sppm" not in top:
        problems.report(
            "the key `sppm` is missing", where, hint="start the file with `sppm: 1`, the version of its format"
        )
        return False
    node = top["sppm"].node
    if node.value != FORMAT or isinstance(node.value, bool):
        problems.report(f"format version {shown(plain(node))} is unknown; this program reads {FORMAT}", node.where)
        return False
    return True


def _name(top: Mapping[str, Entry], path: Path, problems: Problems) -> str:
    if "name" not in top:
        return re.sub(r"[^\w.+-]", "_", path.stem).lstrip(".+-") or "unnamed"
    node = top["name"].node
    if not isinstance(node.value, str) or not _NAME.fullmatch(node.value) or node.value.endswith((".", " ")):
        problems.report(
            f"`name` must be a string of letters, digits, blanks and ._+- of at most 100 characters, got "
            f"{shown(plain(node))}",
            node.where,
        )
    return str(node.value)


def _value(top: Mapping[str, Entry], key: str, kind: type, words: str, problems: Problems, *, default: Any) -> Any:
    """The value of a top-level key; an empty value counts as omitted."""
    if key not in top or top[key].node.value is None:
        return default
    node = top[key].node
    if not isinstance(node.value, kind) or isinstance(node.value, bool):
        problems.report(f"`{key}` must be {words}, got {shown(plain(node))}", node.where)
        return default
    return node.value


def stage_entries(node: Node, recipe: str | None, problems: Problems) -> list[StageEntry]:
    """The entries of a pipeline or of one recipe, with ids given to those that have none."""
    what = f"recipe {recipe!r}" if recipe else "a pipeline"
    if not isinstance(node.value, list) or not node.value:
        problems.report(f"{what} must be a list of at least one stage", node.where)
        return []
    found = [entry for item in node.value if (entry := _stage_entry(item, recipe, problems)) is not None]
    taken: dict[str, Position] = {}
    for entry in found:
        if entry.explicit_id:
            if entry.id in taken:
                problems.report(
                    f"the id {entry.id!r} is used twice; first at {taken[entry.id]}", entry.where, stage=entry.address
                )
            taken.setdefault(entry.id, entry.where)
    result = []
    for entry in found:
        if not entry.explicit_id:
            number, id_ = 1, entry.name
            while id_ in taken:
                number += 1
                id_ = f"{entry.name}#{number}"
            taken[id_] = entry.where
            entry = dataclasses.replace(entry, id=id_)
        result.append(entry)
    return result


def _stage_entry(item: Node, recipe: str | None, problems: Problems) -> StageEntry | None:
    if isinstance(item.value, str):  # a stage without options
        return StageEntry(item.value, recipe, item, item.where, False, {}, None, None)
    if not isinstance(item.value, dict) or "stage" not in item.value:
        problems.report("an entry must be a map with the key `stage`, or the name of a stage", item.where)
        return None
    keys: dict[str, Entry] = item.value
    stage = keys["stage"].node
    if not isinstance(stage.value, str):
        problems.report(f"`stage` must be the name of a stage, got {shown(plain(stage))}", stage.where)
        return None
    explicit = keys["id"].node if "id" in keys else None
    if explicit is not None and not (isinstance(explicit.value, str) and _WORD.fullmatch(explicit.value)):
        problems.report(f"an id consists of letters, digits and ._#-, got {shown(plain(explicit))}", explicit.where)
        explicit = None
    options = {key: entry for key, entry in keys.items() if key not in RESERVED}
    return StageEntry(
        id=explicit.value if explicit else stage.value,
        recipe=recipe,
        stage=stage,
        where=stage.where,
        explicit_id=explicit is not None,
        options=options,
        sources=keys["from"].node if "from" in keys else None,
        recipes=keys["recipe"].node if "recipe" in keys else None,
    )
