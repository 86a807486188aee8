"""``sppm doctor``: is this installation fit to work?"""

from __future__ import annotations

import json
import os
import platform
import sys
import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from sppm_pipeline.engine.cli.arguments import add_plugins, plugins_from

Finding = tuple[bool, str, str]
"""True if all is well, what was looked at, what was found."""


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_plugins(parser)
    parser.add_argument("--json", action="store_true", help="print as JSON")
    parser.add_argument("--kernels", action="store_true", help="compile the kernels of common pipelines first")


def execute(args: Namespace) -> int:
    """Print the findings; 1 if something is wrong."""
    failed = _compile() if args.kernels else []
    findings = [*_python(), *_packages(), *_machine(), *_kernel_cache(), *failed, *_plugins(args)]
    if args.json:
        print(json.dumps([{"ok": ok, "what": what, "found": found} for ok, what, found in findings], indent=1))
    else:
        width = max(len(what) for _, what, _ in findings)
        for ok, what, found in findings:
            print(f"{'ok  ' if ok else 'BAD '} {what:{width}s}  {found}")
    return 0 if all(ok for ok, _, _ in findings) else 1


def _compile() -> list[Finding]:
    """Compile what is not kept yet, on all processors; the kernels that could not be."""
    from sppm_pipeline.engine.cli.kernels import CompileAhead
    from sppm_pipeline.engine.cli.progress import ProgressLines
    from sppm_pipeline.engine.plan.kernels import listed_kernels, missing
    from sppm_pipeline.engine.run.runner import available_threads

    if not (kernels := missing(listed_kernels())):
        return []
    failed: list[Finding] = []
    ahead = CompileAhead(
        kernels, available_threads(), {}, lambda place, why: failed.append((False, "kernel", f"{place}: {why}"))
    )
    lines = ProgressLines(sys.stderr) if sys.stderr is not None else None
    try:
        ahead.wait(None, lines.compiling if lines else lambda done, total, share: None)
    finally:
        ahead.close()
        if lines:
            lines.close()
    return failed


def _python() -> Iterator[Finding]:
    yield sys.version_info >= (3, 11), "Python", f"{platform.python_version()} ({platform.python_implementation()})"


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
    from sppm_pipeline.services.jit.machine_code import reason_unavailable

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


def _writable(folder: Path) -> tuple[bool, str]:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True, "writable"
    except OSError as error:
        return False, f"not writable ({error.strerror})"


def _plugins(args: Namespace) -> Iterator[Finding]:
    """Every plugin, and every one of its stages, imported."""
    from sppm_pipeline.engine.cli.plugins import findings_of
    from sppm_pipeline.engine.plan.registry import Registry

    plugins = plugins_from(args, strict=False)
    registry = Registry(plugins)
    for plugin in plugins.plugins:
        bad = findings_of(plugin, registry)
        counts = f"{len(plugin.stages)} stages, {len(plugin.executors)} executors"
        yield not bad, f"plugin {plugin.name}", "; ".join(bad) if bad else counts
