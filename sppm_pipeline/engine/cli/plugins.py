"""``sppm plugins``: where stages, executors and verbs come from; with ``--check``, whether they can be loaded."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from typing import Any

from sppm_pipeline.engine.cli.arguments import add_plugins, plugins_from


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_plugins(parser)
    parser.add_argument(
        "--check", action="store_true", help="import every plugin and every one of its stages; 4 if one is broken"
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")


def execute(args: Namespace) -> int:
    """List all plugins; without ``--check`` none is imported."""
    found = list(_checked(args) if args.check else _described(args))
    if args.json:
        print(json.dumps(found, indent=1))
    else:
        for plugin in found:
            _print(plugin)
        if not args.check:
            print("nothing was imported; --check imports every plugin and lists its stages")
    return 4 if any(plugin["error"] for plugin in found) else 0


def _described(args: Namespace) -> Iterator[dict[str, Any]]:
    """Entries from metadata, without running any code of a plugin."""
    from sppm_pipeline.built_in import BUILTINS
    from sppm_pipeline.engine.plan.plugins import Plugin, allowed_plugins, installed_plugins

    plugins = [Plugin(module, builtin=True) for module in BUILTINS]
    if not args.no_plugins:
        plugins += [plugin for plugin, _ in installed_plugins(allowed_plugins(args.allow_plugins))]
    plugins += [Plugin(str(path)) for path in args.plugin]
    for plugin in plugins:
        yield _entry(plugin)


def _checked(args: Namespace) -> Iterator[dict[str, Any]]:
    from sppm_pipeline.engine.plan.registry import Registry

    plugins = plugins_from(args, strict=False)
    registry = Registry(plugins)
    for plugin in plugins.plugins:
        yield {
            **_entry(plugin),
            "stages": sorted(plugin.stages),
            "executors": sorted(plugin.executors),
            "commands": sorted(plugin.commands),
            "error": "\n".join(findings_of(plugin, registry)) or None,
        }


def findings_of(plugin: Any, registry: Any) -> list[str]:
    """Errors of a plugin and of each of its stages."""
    from sppm_pipeline.errors import SppmError

    found = [str(plugin.error)] if plugin.error else []
    for name in plugin.stages:
        try:
            registry.get(name)
        except SppmError as error:
            found.append(str(error))
    return found


def _entry(plugin: Any) -> dict[str, Any]:
    return {
        "name": plugin.name,
        "distribution": plugin.distribution,
        "version": plugin.version,
        "target": plugin.target,
        "builtin": plugin.builtin,
        "error": None,
    }


def _print(plugin: dict[str, Any]) -> None:
    if plugin["builtin"]:
        origin = "built in"
    elif plugin["distribution"]:
        origin = f"{plugin['distribution']} {plugin['version']}" + (f", {plugin['target']}" if plugin["target"] else "")
    else:
        origin = "file"
    print(f"{plugin['name']} ({origin}){': FAILED' if plugin['error'] else ''}")
    if plugin["error"]:
        print("  " + plugin["error"].replace("\n", "\n  "))
    for kind in ("stages", "executors", "commands"):
        if plugin.get(kind):
            print(f"  {kind}: {', '.join(plugin[kind])}")
