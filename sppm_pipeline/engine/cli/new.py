"""``sppm new``: a first pipeline, one that fills a mesh, or the skeleton of a plugin that works and is tested."""

from __future__ import annotations

import json
import keyword
import os
import re
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import NamedTuple

from sppm_pipeline.engine.files import packaged_folder
from sppm_pipeline.errors import ConfigError

SCHEMA = "sppm.schema.json"
"""Name of the schema beside new pipelines, by which editors check and complete them."""

TEMPLATES = packaged_folder() / "examples" / "new"
"""Folder of the templates, with names to be replaced: ``pipeline.yaml``, what all plugins share, and a folder for each
kind."""

DESIGNS = tuple(sorted(path.stem for path in (TEMPLATES / "designs").glob("*.yaml")))
"""What a mesh may be made to, by templates that lack only the layers."""


class Kind(NamedTuple):
    """A kind of plugin."""

    family: str  # of the stage
    place: str  # module and class of the stage
    purpose: str  # what the example does


KINDS = {
    "sampler": Kind("sample", "jittered_grid:JitteredGrid", "pores on a jittered grid"),
    "field": Kind("field", "gyroid_sheet:GyroidSheet", "a wall along the gyroid"),
    "writer": Kind("write", "openscad:WriteOpenScad", "meshes as OpenSCAD source"),
    "reader": Kind("read", "pore_list:ReadPores", "pores from a list of their centers"),
    "check": Kind("check", "dead_ends:CheckDeadEnds", "pores that only one tunnel reaches"),
    "grader": Kind("grade", "radial:GradeRadial", "parameters that change with the distance from an axis"),
    "layers": Kind("write", "portable_bitmap:WriteBitmaps", "layers as portable bitmaps"),
    "homogenizer": Kind("homogenize", "density_law:DensityLaw", "stiffness from the density alone"),
}
FORMER_KINDS = ("connector", "tiler", "executor")
PLUGINS_PAGE = "docs/explanation/architecture.md#plugins-without-a-template"


def configure_new(parser: ArgumentParser) -> None:
    parser.add_argument(
        "what", choices=("pipeline", "plugin", *DESIGNS), help="what to write; all but the first two fill a mesh"
    )
    parser.add_argument("name", metavar="NAME", help="name of the design or of the distribution; or the mesh to fill")
    parser.add_argument("--printer", metavar="NAME", help="printer to slice for; PNG layers if omitted")
    parser.add_argument(
        "--kind",
        choices=(*KINDS, *FORMER_KINDS),
        metavar="KIND",
        help=f"what the plugin is: {', '.join(KINDS)}; sampler if omitted",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", default=Path(), help="folder to write into; here")


def execute_new(args: Namespace) -> int:
    """Write it."""
    if args.what in DESIGNS:
        return _design(args.what, Path(args.name), args.printer, args.output)
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", args.name):
        raise ConfigError(f"a name consists of letters, digits, _ and - and starts with a letter, got {args.name!r}")
    if args.kind in FORMER_KINDS:
        raise ConfigError(
            f"there is no template of a plugin with a {args.kind}", hint=f"{PLUGINS_PAGE} says how to write one"
        )
    if args.what == "plugin":
        return _plugin(args.name, args.kind or "sampler", args.output)
    if args.kind:
        raise ConfigError("a pipeline has no kind", hint=f"try: sppm new plugin {args.name} --kind {args.kind}")
    return _pipeline(args.name, args.output)


def _pipeline(name: str, folder: Path) -> int:
    from sppm_pipeline.engine.plan.plugins import allowed_plugins, load_plugins
    from sppm_pipeline.engine.plan.registry import Registry
    from sppm_pipeline.engine.plan.schema import configuration_schema

    path, schema = folder / f"{name}.yaml", folder / SCHEMA
    _write(path, (TEMPLATES / "pipeline.yaml").read_text(encoding="utf-8").replace("my_design", name))
    if not schema.exists():
        _write(
            schema,
            json.dumps(
                configuration_schema(Registry(load_plugins(allowed=allowed_plugins(None)))),
                indent=1,
                ensure_ascii=False,
            )
            + "\n",
        )
    print(f"{path}\nnext: sppm check {path}, then sppm run {path}; editors complete options by {schema}")
    return 0


CAD = (".step", ".stp", ".iges", ".igs")
"""Endings of files that `read.cad` reads, a stage of a plugin."""


def _design(kind: str, mesh: Path, printer: str | None, folder: Path) -> int:
    if not mesh.is_file():
        raise ConfigError(f"{str(mesh)!r} is no file", hint=f"give the mesh to fill: sppm new {kind} my.stl")
    name = design_name(mesh, kind)
    path = folder / f"{name}.yaml"
    _write(path, design_text(kind, Path(os.path.relpath(mesh, folder)), name, printer))
    print(f"{path}\nnext: sppm check {path}, then sppm run {path}")
    return 0


def design_name(mesh: Path, kind: str) -> str:
    """The name of what a mesh is made to."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", f"{mesh.stem}_{kind}")


def design_text(kind: str, mesh: Path, name: str, printer: str | None) -> str:
    """The configuration of one of `DESIGNS` for a mesh, as its path is to be written, with layers for a printer."""
    from sppm_pipeline.nouns import cards

    sliced, write = "pixel: 0.05 mm", "write.png, path: slices"
    if printer is not None:
        card = cards().printers.get(printer)
        if card is None:
            raise ConfigError(f"there is no printer {printer!r}", hint="`sppm printers` lists them")
        ending = {"nanodlp": "zip"}.get(card.format, card.format)
        sliced, write = f"printer: {printer}, layer: 0.05 mm", f"write.{card.format}, path: {name}.{ending}"
    names = {"my_design": name, '"my_part"': json.dumps(mesh.as_posix(), ensure_ascii=False)}
    if mesh.suffix.lower() in CAD:
        names["read.mesh"] = "read.cad"
    text = (TEMPLATES / "designs" / f"{kind}.yaml").read_text(encoding="utf-8")
    text = re.sub("|".join(map(re.escape, names)), lambda found: names[found[0]], text)
    return f"{text}  - {{stage: slice.field, {sliced}}}\n  - {{stage: check.print}}\n  - {{stage: {write}}}\n"


def _plugin(name: str, kind: str, folder: Path) -> int:
    distribution = name.lower().replace("_", "-")
    package = distribution.replace("-", "_")
    if keyword.iskeyword(package) or package in ("sppm", "sppm_pipeline"):
        raise ConfigError(f"{name!r} can't be the name of a Python package of yours", hint=f"try sppm-{distribution}")
    root = folder / distribution
    if root.exists():
        raise ConfigError(f"{str(root)!r} exists already; nothing is overwritten")
    family, place, purpose = KINDS[kind]
    module, _, cls = place.partition(":")
    word = package.removeprefix("sppm_")
    names = {
        "my-plugin": distribution, "my_plugin": package, "my_family": family, "my_word": word,
        "my_module": module, "MyClass": cls, "my_purpose": purpose, "my_kind": kind,
    }  # fmt: skip
    pattern = re.compile("|".join(names))
    for file, template in _files(kind).items():
        filled = pattern.sub(lambda found: names[found[0]], template.read_text(encoding="utf-8"))
        _write(root / file.replace("my_plugin", package), filled)
    print(f"{root}\nnext: pip install -e '{root}[test]', then sppm stages {family}.{word}, and pytest {root}")
    return 0


def _files(kind: str) -> dict[str, Path]:
    """Templates of a plugin by their place in it; those of the kind come before what all share."""
    folders = [TEMPLATES / "plugin", TEMPLATES / kind]
    return {
        path.relative_to(folder).as_posix(): path
        for folder in folders
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix != ".pyc"
    }


def _write(path: Path, text: str) -> None:
    if path.exists():
        raise ConfigError(f"{str(path)!r} exists already; nothing is overwritten")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
