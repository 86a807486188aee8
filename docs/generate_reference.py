"""Write the reference pages of stages, data types and command line from the program itself.

Usage: ``python docs/generate_reference.py`` writes them, ``--check`` only lists which are stale (exit code 1).

Everything on these pages is declared once, in the code: options beside their stage, ports in the signature of `run`,
arguments in the verb's module, shapes, units and orders in the docstring of a data type. ``yaml.md`` and ``python.md``
there are written by hand and left alone.
"""

from __future__ import annotations

import argparse
import inspect
import re
import sys
from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import sppm_pipeline
from sppm_pipeline import Artifact
from sppm_pipeline.engine.cli.commands import built_in_commands
from sppm_pipeline.engine.cli.main import EXIT_CODES
from sppm_pipeline.engine.config.options import Option, options_of, plain_option, type_words
from sppm_pipeline.engine.plan.describe import stage_data
from sppm_pipeline.engine.plan.plugins import load_plugins
from sppm_pipeline.engine.plan.ports import signature_of
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.stage import FAMILIES, Stage

FOLDER = Path(__file__).resolve().parent / "reference"
PLUGINS = ("sppm-crushing", "sppm-tetrahedra")
"""Distributions in ``plugins/`` whose stages have pages, too."""
BY_HAND = ("yaml.md", "python.md", "python-examples.md")
# fmt: off
PARTS = (
    "Blocks", "Bounds", "Cell", "CellDesign", "CellFrame", "Cloud", "EncodedLayers", "Geometry", "Grid",
    "InteriorBox", "Kernels", "Law", "Length", "Palette", "Piece", "Pieces", "Place", "PoreParameters",
    "Printer", "Solved", "TilingArrays", "VoxelCell",
)
# fmt: on
"""Classes of the public face that data types consist of, or that stages ask for or are handed."""
NOTICE = "<!-- Written by docs/generate_reference.py from the code; edit the code, not this page. -->\n"


def pages() -> dict[str, str]:
    """Text of every generated page by its path below ``docs/reference``."""
    registry = Registry(load_plugins(allowed=PLUGINS))
    result = {"README.md": index_page(registry), "cli.md": cli_page()}
    for name in registry:
        result[f"{name.replace('.', '/', 1)}.md"] = stage_page(registry.get(name), registry)
    types = data_types(registry)
    return result | {f"data/{name}.md": data_page(cls, types, registry) for name, cls in types.items()}


def stale(folder: Path, wanted: Mapping[str, str]) -> list[str]:
    """Pages that are missing, differ, or belong to nothing any more."""
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*.md")} - set(BY_HAND)
    differs = [
        name for name, text in wanted.items() if name in there and (folder / name).read_text(encoding="utf-8") != text
    ]
    return sorted({*differs, *(there ^ set(wanted))})


def index_page(registry: Registry) -> str:
    """Families in the order of a pipeline, each with its stages."""
    lines = [
        "# Reference",
        "",
        NOTICE,
        "* [The YAML file](yaml.md): layout, wiring, parameters, sweeps, recipes, plugins, exit codes",
        "* [The command line](cli.md): every verb with its arguments",
        "* [Python](python.md): pipelines, stages as functions, and what plugins import; "
        "[examples](python-examples.md) of all public names",
        "* [Data](#data): what passes between stages, with shapes, units and the order of axes",
        "* The stages, by family, below. `sppm stages NAME` prints the same in the terminal, for plugins, too.",
        "",
    ]
    for family in [*FAMILIES, *sorted({name.split(".")[0] for name in registry} - set(FAMILIES))]:
        names = [name for name in registry if name.split(".")[0] == family]
        if not names:
            continue
        what = FAMILIES.get(family, "")
        rows = []
        for name in names:
            data = stage_data(registry.get(name), registry)
            takes = ", ".join(f"{p['takes']}{'?' if p['optional'] else ''}" for p in data["ports"]) or "nothing"
            link = f"[`{name}`]({name.replace('.', '/', 1)}.md)"
            rows.append((link, takes, data["makes"], data["purpose"]))
        lines += [f"## {family}", "", f"{what[:1].upper()}{what[1:]}.", ""]
        lines += table(("stage", "takes", "makes", "what it does"), rows)
        lines.append("")
    lines += ["A question mark stands behind an artifact that is used if an earlier stage makes it.", "", "## data", ""]
    rows = [(f"[`{name}`](data/{name}.md)", purpose_of(cls)) for name, cls in data_types(registry).items()]
    lines += table(("type", "what it is"), rows)
    return "\n".join(lines) + "\n"


def stage_page(cls: type[Stage], registry: Registry) -> str:
    """The reference of one stage."""
    data = stage_data(cls, registry)
    lines = [f"# {cls.name}", "", NOTICE, inspect.getdoc(cls) or "", "", "## Ports", ""]
    if data["ports"]:
        rows = [(f"`{p['port']}`", p["takes"], "no" if p["optional"] else "yes") for p in data["ports"]]
        lines += table(("port", "takes", "required"), rows)
    else:
        lines.append("It takes nothing from earlier stages.")
    lines += ["", f"It makes: {data['makes']}.", "", "## Options", ""]
    options = options_of(cls).values()
    if options:
        rows = [
            (
                f"`{option.name}`",
                type_words(option.kind),
                unit_words(option),
                bound_words(option),
                default_words(option),
                option.spec.help,
            )
            for option in options
        ]
        lines += table(("option", "type", "unit", "allowed", "default", "what it says"), rows)
    else:
        lines.append("It has none.")
    source = f"{cls.__module__.replace('.', '/')}.py"
    if plugin := registry.owner(cls.name).distribution:
        source = f"plugins/{plugin}/{source}"
        lines += ["", f"It is part of the plugin [{plugin}](../../../plugins/{plugin}/README.md)."]
    lines += ["", f"Source: [`{source}`](../../../{source}). [All stages](../README.md)"]
    return "\n".join(lines) + "\n"


def data_types(registry: Registry) -> dict[str, type]:
    """Artifacts of the public face that stages make or take, and what they consist of, by name."""
    used: set[type] = set()
    for name in registry:
        signature = signature_of(registry.get(name))
        used.update(signature.makes, *(port.types for port in signature.ports if not port.is_recipe))
    plugins = [import_module(name.replace("-", "_")) for name in PLUGINS]
    faces = (sppm_pipeline, sppm_pipeline.nouns, sppm_pipeline.numerics, *plugins)
    public = {name: getattr(face, name) for face in reversed(faces) for name in face.__all__}
    names = {cls.__name__ for cls in used} & set(public)
    return {name: public[name] for name in sorted(names | set(PARTS), key=str.lower)}


def data_page(cls: type, types: Mapping[str, type], registry: Registry) -> str:
    """The reference of a data type: what it holds, in which shape, unit and order, and who makes and takes it."""
    text, sections = sections_of(cls)
    lines = [f"# {cls.__name__}", "", NOTICE, text, ""]
    if "Attributes" in sections:
        lines += [
            "## Attributes",
            "",
            *table(("attribute", "type, shape, unit", "what it is"), sections["Attributes"]),
            "",
        ]
    known = {name for name, *_ in sections.get("Attributes", ())}
    bases = [base for base in types.values() if base in cls.__mro__[1:]]
    methods, properties = [], []
    for name, member in vars(cls).items():
        shared = name in vars(Artifact) and name != "picture"  # pictures differ from class to class
        if name.startswith("_") or name in known or shared or not sections_of(member)[0]:
            continue
        if isinstance(member, (property, cached_property)):
            properties.append((f"`{name}`", purpose_of(member)))
        elif callable(member) or isinstance(member, classmethod):
            methods += method_rows(cls, name)
    if properties:
        lines += ["## Properties", "", *table(("property", "what it is"), properties), ""]
    if methods:
        lines += ["## Methods", "", *table(("method, argument", "type, shape, unit", "what it is"), methods), ""]
    for base in bases:
        lines += [f"It is a [`{base.__name__}`]({base.__name__}.md) and has all that is said there.", ""]
    if issubclass(cls, Artifact) and cls.__name__ not in PARTS:
        # a stage that passes on what it was given makes nothing
        made = linked(registry, lambda found: not found.as_port and any(issubclass(one, cls) for one in found.makes))
        lines += [f"Made by: {made}.", ""]
        own = set(cls.__mro__) - {Artifact, object}  # bases that have no page of their own among them
        taken = linked(registry, lambda found: any(own & set(port.types) for port in found.ports))
        lines += [f"Taken by: {taken}.", ""]
        lines += ["Every artifact has `summary()`, `digest()` and `check()`; arrays are read-only.", ""]
    return "\n".join(lines).rstrip() + "\n\n[All data types](../README.md#data)\n"


def method_rows(cls: type, name: str) -> list[tuple[str, str, str]]:
    """A method and, on lines of their own, its arguments as far as its docstring describes them."""
    arguments = [
        f"{parameter.name}=" if parameter.default is not parameter.empty else str(parameter).partition(":")[0]
        for parameter in inspect.signature(getattr(cls, name)).parameters.values()
        if parameter.name != "self"
    ]
    _, sections = sections_of(getattr(cls, name))
    rows = [(f"**`{name}({', '.join(arguments)})`**", "", purpose_of(getattr(cls, name)))]
    for section in ("Parameters", "Returns"):
        rows += [(f"{argument}", kind, what) for argument, kind, what in sections.get(section, ())]
    return rows


def linked(registry: Registry, wanted: Any) -> str:
    """Links to the stages whose signature is wanted."""
    names = [name for name in registry if wanted(signature_of(registry.get(name)))]
    return ", ".join(f"[`{name}`](../{name.replace('.', '/', 1)}.md)" for name in names) or "no built-in stage"


def sections_of(thing: Any) -> tuple[str, dict[str, list[tuple[str, str, str]]]]:
    """The text of a numpydoc docstring, and its sections as rows of (name, type, description)."""
    own = inspect.cleandoc(thing.__doc__) if getattr(thing, "__doc__", None) else ""
    text, *parts = re.split(r"^(\w+)\n-{4,}\n", own, flags=re.MULTILINE)
    sections = {}
    for title, body in zip(parts[::2], parts[1::2], strict=True):
        rows = []
        for entry in re.split(r"\n(?=\S)", body.strip("\n")):
            head, _, rest = entry.partition("\n")
            name, _, kind = head.partition(" : ")
            rows.append((f"`{name}`", kind, " ".join(rest.split())))
        sections[title] = rows
    return text.strip(), sections


def purpose_of(thing: Any) -> str:
    """The first paragraph of a docstring on one line."""
    return " ".join(sections_of(thing)[0].partition("\n\n")[0].split())


def cli_page() -> str:
    """Every verb with its arguments, and the exit codes."""
    lines = ["# The command line", "", NOTICE, "`sppm VERB --help` prints the same.", ""]
    verbs = {verb: command.help for verb, command in built_in_commands().items()}
    lines += table(("verb", "what it does"), [(f"[`sppm {verb}`](#sppm-{verb})", what) for verb, what in verbs.items()])
    for verb, what in verbs.items():
        lines += ["", f"## sppm {verb}", "", f"{what[:1].upper()}{what[1:]}.", ""]
        lines += table(("argument", "what it says"), list(arguments_of(verb)))
    lines += ["", "## Exit codes", ""]
    codes = EXIT_CODES.partition(":")[2].replace("\n", " ").split(";")
    split = [code.strip() for code in codes]
    rows = []
    for code in split:
        numbers = re.match(r"[\d, ]+", code)  # "129, 130, 143 interrupted" is one meaning of three numbers
        assert numbers is not None
        rows.append((numbers[0].strip(), code[numbers.end() :]))
    lines += table(("code", "meaning"), rows)
    return "\n".join(lines) + "\n"


def arguments_of(verb: str) -> Iterator[tuple[str, str]]:
    """Arguments of a verb as written, and their help.

    They are read from the parser and not from its help text, whose layout changes with the version of Python.
    """
    parser = argparse.ArgumentParser(prog=f"sppm {verb}", add_help=False)
    module, _, function = str(built_in_commands()[verb].configure).partition(":")
    getattr(import_module(module), function)(parser)
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    for action in parser._actions:
        shown = action.metavar if isinstance(action.metavar, str) else "|".join(map(str, action.choices or ()))
        shown = shown or action.dest.upper()
        if action.option_strings:
            value = "" if action.nargs == 0 else f" {shown}"
            written = ", ".join(f"`{flag}{value}`" for flag in action.option_strings)
        else:
            written = f"`[{shown}]`" if action.nargs == "?" else f"`{shown}`"
        yield written, action.help or ""


def unit_words(option: Option) -> str:
    """The unit of a bare number."""
    return option.spec.unit or ""


def bound_words(option: Option) -> str:
    """Choices or bounds."""
    spec = option.spec
    if spec.choices:
        return ", ".join(f"`{choice}`" for choice in spec.choices)
    if spec.suffixes:
        return ", ".join("a folder" if suffix == "/" else f"`{suffix}`" for suffix in spec.suffixes)
    bounds = ((spec.minimum, "≥"), (spec.above, ">"), (spec.maximum, "≤"), (spec.below, "<"))
    return ", ".join(f"{sign} {bound:g}" for bound, sign in bounds if bound is not None)


def default_words(option: Option) -> str:
    """The default as YAML has it; options that may be left out without one have none."""
    if option.required:
        return "**required**"
    value = plain_option(option.default)
    if value is None:
        return "none"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return "`''`" if value == "" else f"`{value}`"


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """Lines of a Markdown table."""

    def line(cells: tuple[str, ...]) -> str:
        return "| " + " | ".join(cell_text(cell) for cell in cells) + " |"

    return [line(head), "|" + "---|" * len(head), *(line(row) for row in rows)]


def cell_text(text: str) -> str:
    """Text that neither ends its cell nor is taken for HTML; what stands between backticks keeps its angle brackets."""
    parts = text.replace("\n", " ").replace("|", "\\|").split("`")
    return "`".join(part if i % 2 else part.replace("<", "&lt;") for i, part in enumerate(parts))


def main() -> int:
    """Write the pages, or say which are stale."""
    wanted = pages()
    old = stale(FOLDER, wanted)
    if "--check" in sys.argv[1:]:
        print("\n".join(old) or "all pages are up to date")
        return 1 if old else 0
    for name in old:
        path = FOLDER / name
        if name not in wanted:
            path.unlink()
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(wanted[name], encoding="utf-8")
    print(f"{len(wanted)} pages, {len(old)} of them changed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
