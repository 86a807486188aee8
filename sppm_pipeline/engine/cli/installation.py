"""``sppm plugins`` and ``doctor``: where stages, executors and verbs come from, and whether all is fit to work."""

from __future__ import annotations

import io
import json
import os
import platform
import sys
import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.cli.arguments import add_plugins, plugins_from


def configure_plugins(parser: ArgumentParser) -> None:
    add_plugins(parser)
    parser.add_argument(
        "--check", action="store_true", help="import every plugin and every one of its stages; 4 if one is broken"
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")


def execute_plugins(args: Namespace) -> int:
    """List all plugins; without ``--check`` none is imported."""
    found = list(_checked(args) if args.check else _described(args))
    if args.json:
        print(json.dumps(found, indent=1))
    else:
        for plugin in found:
            _print_plugin(plugin)
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
        yield _described_plugin(plugin)


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
            **_described_plugin(plugin),
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
            yield {**_described_plugin(Plugin(str(file))), "error": broken[str(file)]}


def _broken_alone(args: Namespace) -> Iterator[tuple[str, str]]:
    """Plugins whose import, hooks or exit handlers end or hang a process, each with what happened."""
    import subprocess

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


def _described_plugin(plugin: Any) -> dict[str, Any]:
    return {
        "name": plugin.name,
        "distribution": plugin.distribution,
        "version": plugin.version,
        "target": plugin.target,
        "builtin": plugin.builtin,
        "error": None,
    }


def _print_plugin(plugin: dict[str, Any]) -> None:
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


Finding = tuple[bool, str, str]
"""True if all is well, what was looked at, what was found."""


def configure_doctor(parser: ArgumentParser) -> None:
    add_plugins(parser)
    parser.add_argument("--json", action="store_true", help="print as JSON")
    parser.add_argument("--kernels", action="store_true", help="compile the kernels of common pipelines first")


def execute_doctor(args: Namespace) -> int:
    """Print the findings; 1 if something is wrong."""
    failed = _compile() if args.kernels else []
    version = f"{platform.python_version()} ({platform.python_implementation()})"
    python = (sys.version_info >= (3, 11), "Python", version)
    findings = [python, *_packages(), *_machine(), *_kernel_cache(), *failed, *_plugin_findings(args)]
    if args.json:
        print(json.dumps([{"ok": ok, "what": what, "found": found} for ok, what, found in findings], indent=1))
    else:
        width = max(len(what) for _, what, _ in findings)
        for ok, what, found in findings:
            print(f"{'ok  ' if ok else 'BAD '} {what:{width}s}  {found}")
    return 0 if all(ok for ok, _, _ in findings) else 1


def _compile() -> list[Finding]:
    """Compile what is not kept yet, on all processors; the kernels that could not be."""
    from sppm_pipeline.engine.cli.kernels import compile_apart
    from sppm_pipeline.engine.cli.progress import ProgressLines
    from sppm_pipeline.engine.plan.kernels import listed_kernels, missing
    from sppm_pipeline.engine.run.runner import available_threads

    failed: list[Finding] = []

    class Lines(ProgressLines):
        def not_compiled(self, place: str, why: str) -> None:
            failed.append((False, "kernel", f"{place}: {why}"))

    if kernels := missing(listed_kernels()):
        lines = Lines(sys.stderr or io.StringIO())
        compile_apart(kernels, lines, available_threads())
        lines.close()
    return failed


def _packages() -> Iterator[Finding]:
    """The program and what it declares to need."""
    try:
        yield True, "sppm-pipeline", metadata.version("sppm-pipeline")
        declared = metadata.requires("sppm-pipeline") or []
    except metadata.PackageNotFoundError:
        yield False, "sppm-pipeline", "not installed, running from a folder; install it with `pip install -e .`"
        declared = []
    for requirement in declared:
        spec, _, marker = requirement.partition(";")
        if "extra" in marker:
            continue
        name = spec.split(">")[0].split("=")[0].split("<")[0].split("[")[0].strip()
        try:
            yield _at_least(metadata.version(name), spec), name, f"{metadata.version(name)} (needed: {spec.strip()})"
        except metadata.PackageNotFoundError:
            yield False, name, f"not installed (needed: {spec.strip()})"


def _at_least(version: str, spec: str) -> bool:
    """True if `version` meets the lower bound in a requirement such as ``numpy>=1.26``."""
    lower = spec.partition(">=")[2].split(",")[0].strip()

    def numbers(text: str) -> tuple[int, ...]:
        return tuple(int(part) for part in text.split(".") if part.isdecimal())

    return not lower or numbers(version) >= numbers(lower)


def _machine() -> Iterator[Finding]:
    from sppm_pipeline.engine.run.runner import available_threads

    yield True, "processors", f"{available_threads()} of {os.cpu_count()} usable, {platform.machine()}"
    yield _writable(Path(tempfile.gettempdir()))[0], "temporary folder", tempfile.gettempdir()


def _kernel_cache() -> Iterator[Finding]:
    """Folder of compiled kernels and its state."""
    from sppm_pipeline.engine.plan.kernels import listed_kernels, missing
    from sppm_pipeline.services.jit.kernel_cache import kernel_cache_root, passed_over
    from sppm_pipeline.services.jit.machine_code import reason_unavailable, target

    folder = kernel_cache_root()
    writable, found = _writable(folder)
    kernels = sum(1 for _ in folder.rglob("*.nbi"))
    state = f"{kernels} kernels compiled" if kernels else "empty"
    listed = listed_kernels()
    if left := missing(listed):
        state += f"; {len(left)} of {len(listed)} that are common are not, which `sppm doctor --kernels` compiles"
    if why := reason_unavailable():
        state += f"; Numba starts them ({why}), which takes longer"
    for place, reason in passed_over().items():
        state += f"; {place} is not used: {reason}"
    yield writable, "kernel cache", f"{folder}: {found}, {state}"
    yield True, "kernels for", target()
    yield from _shipped_kernels()


def _shipped_kernels() -> Iterator[Finding]:
    """Machine code that was installed, each file looked at."""
    from sppm_pipeline.services.jit import machine_code

    if folder := machine_code.shipped():
        files = list(Path(folder).glob("*.code"))
        for file in files:
            machine_code.read(str(file))
        yield True, "sppm-kernels", f"{folder}: {len(files)} kernels"
    for place, reason in machine_code.refused.items():
        yield False, "sppm-kernels", f"{place} is not used: {reason}"


def _writable(folder: Path) -> tuple[bool, str]:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True, "writable"
    except OSError as error:
        return False, f"not writable ({error.strerror})"


def _plugin_findings(args: Namespace) -> Iterator[Finding]:
    """Every plugin, and every one of its stages, imported."""
    from sppm_pipeline.engine.plan.registry import Registry

    plugins = plugins_from(args, strict=False)
    registry = Registry(plugins)
    for plugin in plugins.plugins:
        bad = findings_of(plugin, registry)
        counts = f"{len(plugin.stages)} stages, {len(plugin.executors)} executors"
        yield not bad, f"plugin {plugin.name}", "; ".join(bad) if bad else counts
