"""``sppm plugins``: where stages and executors come from, and what could not be loaded."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace

from sppm_pipeline.cli.arguments import add_plugins, plugins_from

__all__ = ["configure", "execute"]


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_plugins(parser)
    parser.add_argument("--json", action="store_true", help="print as JSON")


def execute(args: Namespace) -> int:
    """List all plugins; those that failed do not stop it."""
    plugins = plugins_from(args, strict=False)
    if args.json:
        print(
            json.dumps(
                [
                    {
                        "name": plugin.name,
                        "distribution": plugin.distribution,
                        "version": plugin.version,
                        "builtin": plugin.builtin,
                        "stages": sorted(plugin.stages),
                        "executors": sorted(plugin.executors),
                        "error": str(plugin.error) if plugin.error else None,
                    }
                    for plugin in plugins.plugins
                ],
                indent=1,
            )
        )
        return 0
    for plugin in plugins.plugins:
        origin = (
            "built in"
            if plugin.builtin
            else f"{plugin.distribution} {plugin.version}"
            if plugin.distribution
            else "file"
        )
        print(f"{plugin.name} ({origin}){': FAILED' if plugin.error else ''}")
        if plugin.error:
            print("  " + str(plugin.error).replace("\n", "\n  "))
        if plugin.stages:
            print(f"  stages: {', '.join(sorted(plugin.stages))}")
        if plugin.executors:
            print(f"  executors: {', '.join(sorted(plugin.executors))}")
    return 0
