"""``sppm explain``: what each stage of a configuration does, with its resolved options; or one stage."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from sppm_pipeline.cli.arguments import add_configuration, open_from, plugins_from

__all__ = ["configure", "execute"]


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_configuration(parser)


def execute(args: Namespace) -> int:
    """Explain a file if there is one of that name, else a stage."""
    from sppm_pipeline.engine.describe import explain_plan, stage_text
    from sppm_pipeline.engine.registry import Registry

    if not Path(args.file).exists():
        registry = Registry(plugins_from(args))
        if args.file in registry:
            print(stage_text(registry.get(args.file), registry), end="")
            return 0
    print(explain_plan(open_from(args).plan()), end="")
    return 0
