"""``sppm stages``, ``schema``, ``explain`` and ``graph``: stages and configurations in words and diagrams."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.cli.arguments import (
    add_cache,
    add_configuration,
    add_plugins,
    cache_of,
    open_from,
    plugins_from,
)

if TYPE_CHECKING:
    from sppm_pipeline.engine.plan.registry import Registry


def configure_stages(parser: ArgumentParser) -> None:
    """Arguments of ``sppm stages``."""
    parser.add_argument(
        "name", nargs="?", metavar="NAME", help="a stage or preset, or a family to list only its stages"
    )
    add_plugins(parser)
    parser.add_argument("--json", action="store_true", help="print as JSON")


def execute_stages(args: Namespace) -> int:
    """List, or describe."""
    from sppm_pipeline.engine.plan.describe import preset_list, preset_text, stage_data, stage_list, stage_text
    from sppm_pipeline.engine.plan.registry import Registry

    registry = Registry(plugins_from(args))
    if args.name is None or any(name.split(".")[0] == args.name for name in registry):
        names = [name for name in registry if args.name in (None, name.split(".")[0])]
        if args.json:
            print(json.dumps([_stage_or_error(name, registry) for name in names], indent=1))
        else:
            print(stage_list(registry, names) + (preset_list(registry) if args.name is None else ""), end="")
        return 0
    if args.name in registry.presets and not args.json:
        print(preset_text(args.name, registry), end="")
        return 0
    cls = registry.get(args.name)
    print(json.dumps(stage_data(cls, registry), indent=1) if args.json else stage_text(cls, registry).rstrip("\n"))
    return 0


def _stage_or_error(name: str, registry: Registry) -> dict[str, Any]:
    """The stage, or why it can't be described; one broken plugin does not hide the others."""
    from sppm_pipeline.engine.plan.describe import stage_data
    from sppm_pipeline.errors import PluginError

    try:
        return stage_data(registry.get(name), registry)
    except PluginError as error:
        return {"name": name, "from": str(registry.owner(name)), "error": error.message}


def configure_schema(parser: ArgumentParser) -> None:
    """Arguments of ``sppm schema``."""
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="file to write; printed if omitted")
    add_plugins(parser)


def execute_schema(args: Namespace) -> int:
    """Print or write the schema."""
    from sppm_pipeline.engine.files import write_whole
    from sppm_pipeline.engine.plan.registry import Registry
    from sppm_pipeline.engine.plan.schema import configuration_schema

    text = json.dumps(configuration_schema(Registry(plugins_from(args))), indent=1, ensure_ascii=False)
    if args.output is None:
        print(text)
    else:
        write_whole(args.output, f"{text}\n")
        line = f"# yaml-language-server: $schema={args.output.name}"
        print(f"{args.output}\nnext: begin configurations beside it with\n{line}")
    return 0


def configure_explain(parser: ArgumentParser) -> None:
    """Arguments of ``sppm explain``."""
    add_configuration(parser)
    add_cache(parser)


def execute_explain(args: Namespace) -> int:
    """Explain a file if there is one of that name, else a stage."""
    from sppm_pipeline.engine.plan.describe import explain_plan, stage_text
    from sppm_pipeline.engine.plan.registry import Registry

    if not Path(args.file).exists():
        registry = Registry(plugins_from(args))
        if args.file in registry:
            print(stage_text(registry.get(args.file), registry), end="")
            return 0
    session = open_from(args)
    plan = session.plan()
    cache = cache_of(args)
    reasons = None
    if cache is not None and session.configuration.sweep is None:
        from sppm_pipeline.engine.cache.housekeeping import open_store
        from sppm_pipeline.engine.cache.session import reasons_of

        reasons = reasons_of(plan, open_store(cache), str(session.configuration.file.absolute()))
    print(explain_plan(plan, reasons), end="")
    return 0


def configure_graph(parser: ArgumentParser) -> None:
    """Arguments of ``sppm graph``."""
    add_configuration(parser)
    parser.add_argument("-f", "--format", choices=("text", "dot", "mermaid"), default="text", help="text if omitted")


def execute_graph(args: Namespace) -> int:
    """Print the graph."""
    from sppm_pipeline.engine.plan.describe import dot_graph, mermaid_graph, wiring_text

    draw = {"text": wiring_text, "dot": dot_graph, "mermaid": mermaid_graph}[args.format]
    print(draw(open_from(args).plan()), end="")
    return 0
