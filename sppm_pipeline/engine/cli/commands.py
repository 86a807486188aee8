"""The built-in verbs: those of the engine, and those that features bring by the hook `sppm_commands`."""

from __future__ import annotations

import importlib

from sppm_pipeline.built_in import FEATURES
from sppm_pipeline.hookspecs import Command, hookimpl

VERBS = {
    "run": "run a pipeline, or every row of its sweep",
    "check": "check a configuration and print its wiring, without running it",
    "explain": "say what each stage of a configuration, or one stage, does, and why it would run again",
    "estimate": "estimate memory, disk and time of a run, without running it",
    "stages": "list the stages there are, or describe one",
    "graph": "draw the wiring as text, DOT or Mermaid",
    "schema": "print or write the JSON Schema of configurations, for editors",
    "stubs": "print or write what type checkers and editors know of the stages in Python",
    "plugins": "list plugins, and with --check why some cannot be loaded",
    "verify": "check that a run directory still holds what was written, to the byte",
    "cache": "show, check or shrink what is kept between runs",
    "completion": "print the script that completes verbs, stages and options in a shell",
    "fix": "rewrite former names of stages and options in a configuration",
    "cite": "print what to cite: the program, the paper, and sources of the stages of a configuration",
    "new": "write a first pipeline, one that fills a mesh, or the skeleton of a plugin",
    "doctor": "look at the installation: versions, caches, processors, plugins",
}
"""Verb of the engine -> what it does; features bring theirs by the hook `sppm_commands`."""

_MODULES = {
    **dict.fromkeys(("check", "explain", "estimate", "stages", "graph", "schema"), "describe"),
    **dict.fromkeys(("plugins", "doctor"), "installation"),
    **dict.fromkeys(("verify", "cache"), "kept"),
}
"""Modules that verbs share; each of the others has one of its own."""


def place_of(verb: str) -> tuple[str, str]:
    """Functions that declare the arguments of a verb of the engine, and that execute it, as "module:function"."""
    module = f"sppm_pipeline.engine.cli.{_MODULES.get(verb, verb)}"
    return f"{module}:configure_{verb}", f"{module}:execute_{verb}"


@hookimpl
def sppm_commands() -> dict[str, Command]:
    """All verbs of the engine; no plugin can take one of their names."""
    return {verb: Command(words, *place_of(verb)) for verb, words in VERBS.items()}


def built_in_commands() -> dict[str, Command]:
    """The verbs of the engine and of the features, by the places of their functions; nothing else is imported."""
    found = sppm_commands()
    for module in map(importlib.import_module, FEATURES):
        found |= module.sppm_commands() if hasattr(module, "sppm_commands") else {}
    return found
