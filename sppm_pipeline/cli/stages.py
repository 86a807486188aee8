"""``sppm stages``: the stages there are, or the reference of one."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING, Any

from sppm_pipeline.cli.arguments import add_plugins, plugins_from

if TYPE_CHECKING:
    from sppm_pipeline.engine.plan.registry import Registry


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("name", nargs="?", metavar="NAME", help="a stage, or a family to list only its stages")
    add_plugins(parser)
    parser.add_argument("--json", action="store_true", help="print as JSON")


def execute(args: Namespace) -> int:
    """List, or describe."""
    from sppm_pipeline.engine.plan.describe import stage_data, stage_list, stage_text
    from sppm_pipeline.engine.plan.registry import Registry

    registry = Registry(plugins_from(args))
    if args.name is None or any(name.split(".")[0] == args.name for name in registry):
        names = [name for name in registry if args.name in (None, name.split(".")[0])]
        if args.json:
            print(json.dumps([_data(name, registry) for name in names], indent=1))
        else:
            print(stage_list(registry, names), end="")
        return 0
    cls = registry.get(args.name)
    print(json.dumps(stage_data(cls, registry), indent=1) if args.json else stage_text(cls, registry).rstrip("\n"))
    return 0


def _data(name: str, registry: Registry) -> dict[str, Any]:
    """The stage, or why it can't be described; one broken plugin does not hide the others."""
    from sppm_pipeline.engine.plan.describe import stage_data
    from sppm_pipeline.errors import PluginError

    try:
        return stage_data(registry.get(name), registry)
    except PluginError as error:
        return {"name": name, "from": str(registry.owner(name)), "error": error.message}
