"""``sppm plugins``: where stages, executors and verbs come from; with ``--check``, whether they can be loaded."""

from __future__ import annotations

import json
import os
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


ALONE = "SPPM_CHECK_ALONE"
"""Environment variable: this process is the child that checks one plugin."""


def _checked(args: Namespace) -> Iterator[dict[str, Any]]:
    """All plugins as they are after their import; one that hangs or crashes does so in a child of its own."""
    from sppm_pipeline.engine.plan.plugins import Plugin
    from sppm_pipeline.engine.plan.registry import Registry

    broken = {} if os.environ.get(ALONE) else dict(_broken_alone(args))
    installed = [entry for entry in _described(args) if not entry["builtin"] and entry["distribution"]]
    if any(entry["name"] in broken for entry in installed):
        args.allow_plugins = ",".join(entry["name"] for entry in installed if entry["name"] not in broken)
    files, args.plugin = args.plugin, [file for file in args.plugin if str(file) not in broken]
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
    args.plugin = files
    for entry in installed:
        if entry["name"] in broken:
            yield {**entry, "error": broken[entry["name"]]}
    for file in files:
        if str(file) in broken:
            yield {**_entry(Plugin(str(file))), "error": broken[str(file)]}


def _broken_alone(args: Namespace) -> Iterator[tuple[str, str]]:
    """Plugins whose import, hooks or exit handlers end or hang a process, each with what happened."""
    import subprocess
    import sys

    from sppm_pipeline.engine.process.containment import import_seconds

    verb = [sys.executable, "-m", "sppm_pipeline", "plugins", "--check", "--json"]
    for entry in _described(args):
        if entry["builtin"]:
            continue
        name = entry["name"]
        alone = ["--allow-plugins", name] if entry["distribution"] else ["--no-plugins", "--plugin", name]
        try:
            # three limits follow each other: import, hooks, exit handlers; the child's own supervisor names which
            done = subprocess.run(
                [*verb, *alone],
                env={**os.environ, ALONE: "1"},
                capture_output=True,
                text=True,
                errors="replace",
                timeout=3 * import_seconds() + 10,
            )
        except subprocess.TimeoutExpired:
            yield name, f"its check took longer than {3 * import_seconds() + 10:g} s"
            continue
        if done.returncode == 2:  # it is installed for this process only, as in tests; then it is checked here
            continue
        try:
            json.loads(done.stdout)
        except ValueError:
            said = [line for line in done.stderr.splitlines() if line.strip()]
            yield name, "\n".join(said[-3:]) or f"its check ended with exit code {done.returncode}"
            continue
        if done.returncode not in (0, 4) or "took longer than" in done.stderr:
            yield name, "\n".join(done.stderr.splitlines()[-3:]) or f"exit code {done.returncode}"


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
