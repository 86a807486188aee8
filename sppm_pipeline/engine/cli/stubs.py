"""``sppm stubs``: what type checkers and editors know of the stages as Python functions."""

from __future__ import annotations

import inspect
import keyword
import sysconfig
import types
import typing
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.config.options import Option, options_of
from sppm_pipeline.engine.plan.describe import option_words
from sppm_pipeline.engine.plan.ports import Port, signature_of
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.stage import FAMILIES, Stage


def configure_stubs(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--plugins",
        action="store_true",
        help="with the stages of installed plugins, as a package of stubs beside the installed packages",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="folder for the package of stubs instead of that one"
    )


def execute_stubs(args: Namespace) -> int:
    """Print the stub of the built-in stages, or write a package with those of plugins."""
    from sppm_pipeline.engine.files import write_whole
    from sppm_pipeline.engine.plan.plugins import allowed_plugins, load_plugins

    plugins = load_plugins(distributions=args.plugins, allowed=allowed_plugins() if args.plugins else None)
    plugins.raise_broken()
    text = stub_text(Registry(plugins))
    if not args.plugins and args.output is None:
        print(text, end="")
        return 0
    folder = (args.output or Path(sysconfig.get_path("purelib"))) / "sppm_pipeline-stubs"
    (folder / "engine" / "api").mkdir(parents=True, exist_ok=True)
    # partial: whatever is not here is taken from the package itself
    write_whole(folder / "py.typed", "partial\n")
    write_whole(folder / "engine" / "api" / "stages.pyi", text)
    print(folder)
    return 0


HEAD = """\
# Written by `sppm stubs`, from the options and ports of the stages.
# mypy: disable-error-code="overload-overlap"
# pyright: reportOverlappingOverload=false
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Never, TypeAlias, TypedDict, overload

from sppm_pipeline.engine.api.bound_stage import BoundStage
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.stage import Stage
"""
ALIASES = """
_Step: TypeAlias = BoundStage[Any, Any] | Stage | Artifact | Mapping[str, Any] | str
_Recipe: TypeAlias = Sequence[_Step] | Mapping[str, Any] | str
_Sources: TypeAlias = str | Sequence[str] | Mapping[str, Any]
"""


def stub_text(registry: Registry) -> str:
    """The stub of the module that holds the families; stages that can't be loaded are left out."""
    imported: dict[str, set[str]] = {}
    families: dict[str, list[str]] = {}
    for name in registry.sound():
        family, _, word = name.partition(".")
        if word.isidentifier() and not keyword.iskeyword(word) and family.isidentifier():
            families.setdefault(family, []).extend(_stage_lines(registry.get(name), word, imported))
    lines = [HEAD.rstrip()]
    for module, names in sorted(imported.items()):
        lines.append(f"from {module} import {', '.join(sorted(names))}")
    lines.append(ALIASES.rstrip())
    for family, body in families.items():
        lines += ["", f"class _{family.title()}:", f"    {_literal(f'Stages of the family {family}.')}", *body]
        if family == "check":
            check = "def __call__(self, config: Any, *, params: Mapping[str, Any] | None = None, "
            lines.append(f"    {check}set: Mapping[str, Any] | None = None) -> tuple[str, ...]: ...")
    lines += ["", "class CellOptions(TypedDict, total=False):", *_cell_options(registry)]
    # of a family that plugins alone fill, nothing is known here
    kinds = {family: f"_{family.title()}" if family in families else "Any" for family in [*families, *FAMILIES]}
    lines += ["", "class _Steps:", *(f"    {family}: {kind}" for family, kind in kinds.items()), "", "step: _Steps"]
    lines += [f"{family}: {kind}" for family, kind in kinds.items()]
    return "\n".join(lines) + "\n"


def _cell_options(registry: Registry) -> Iterator[str]:
    """What `sppm.cell` takes besides: parameters of presets, options of their stages, and those of tuning."""
    types_of: dict[str, dict[str, None]] = {}
    for preset in registry.presets.values():
        for entry in [*preset.stages, {"stage": "tune.porosity"}]:
            for option in options_of(registry.get(entry["stage"])).values():
                # a parameter has the type of the option that it stands for
                named = [name for name in preset.params if entry.get(option.name) == f"${{{name}}}"]
                for name in {option.name, *named}:
                    types_of.setdefault(name, {})[_option_type(option.kind, option)] = None
    for name in sorted(types_of.keys() - {"target"}):
        yield f"    {name}: {' | '.join(types_of[name])}"


def _stage_lines(cls: type[Stage], word: str, imported: dict[str, set[str]]) -> Iterator[str]:
    signature = signature_of(cls)
    ports = [port for port in signature.ports if not port.is_recipe]
    taken = " | ".join(dict.fromkeys(_port_type(port, imported) for port in ports)) or "Never"
    made = signature.makes or ((cls.returns,) if cls.returns is not None else ())
    makes = " | ".join(_named(one, imported) for one in made)
    if not makes:
        writes = any(option.spec.output for option in options_of(cls).values())
        makes = "Any" if signature.as_recipe else "list[Path]" if writes else "dict[str, Any]"
    declared = options_of(cls).values()
    options = [f"{o.name}: {_option_type(o.kind, o)}{'' if o.required else ' = ...'}" for o in declared]
    recipes = [port for port in signature.ports if port.is_recipe]
    recipe = ["recipe: _Recipe | None = ..."] if recipes else []
    step = f"BoundStage[{taken}, {makes}]"
    needs = any(not port.optional for port in ports)
    draws = cls.is_random or bool(recipes and not recipes[0].optional)
    named = [f"{port.name}: {_port_type(port, imported)} | None = ..." for port in ports]
    artifacts = (
        f"*artifacts: {' | '.join(dict.fromkeys(_named(t, imported) for p in ports for t in p.types))}"
        if ports
        else "*"
    )
    seed = "seed: int" if draws and not needs else "seed: int | None = ..."
    of_run = [seed, "threads: int | None = ...", "output: str | Path | None = ..."]
    of_step = ["id: str | None = ...", "sources: _Sources | None = ..."]
    if not (needs or draws):
        of_step[0] = "id: str"
    run = f"def {word}(self, {', '.join([artifacts, *named, *recipe, *of_run, *options])}) -> {makes}: "
    later = f"def {word}(self, {', '.join(['*', *recipe, *of_step, *options])}) -> {step}: "
    # the first that fits counts: what is given artifacts or a seed runs, else it is a step
    first, second = (later, run) if needs else (run, later)
    yield "    @overload"
    yield f"    {first}{_literal(_doc(cls))}"
    yield "    @overload"
    yield f"    {second}..."


def _doc(cls: type[Stage]) -> str:
    options = options_of(cls).values()
    lines = [f"{option.name}: {option_words(option)}. {option.spec.help}\n" for option in options]
    return "\n".join([inspect.getdoc(cls) or "", "", *lines]).strip()


def _literal(text: str) -> str:
    # always in double quotes, as formatters have it
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'


def _named(kind: type, imported: dict[str, set[str]]) -> str:
    if kind is object:
        return "Any"
    imported.setdefault(kind.__module__, set()).add(kind.__qualname__)
    return kind.__qualname__


def _port_type(port: Port, imported: dict[str, set[str]]) -> str:
    words = " | ".join(_named(one, imported) for one in port.types)
    return f"{words} | Sequence[{words}]" if port.many else words


def _option_type(kind: Any, option: Option) -> str:
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return " | ".join(dict.fromkeys(_option_type(member, option) for member in typing.get_args(kind)))
    if typing.get_origin(kind) is tuple:
        elements = [one for one in typing.get_args(kind) if one is not Ellipsis]
        return f"Sequence[{' | '.join(dict.fromkeys(_option_type(one, option) for one in elements))}]"
    if kind is str and option.spec.choices:
        return f"Literal[{', '.join(map(_literal, option.spec.choices))}]"
    return _TYPES[kind]


_TYPES = {
    bool: "bool", int: "int", float: "float", str: "str", Path: "str | Path", Length: "float | str | Length",
    types.NoneType: "None",
}  # fmt: skip
