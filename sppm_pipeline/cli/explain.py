"""``sppm explain``: what each stage of a configuration does, with its resolved options, and why it would run again."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from sppm_pipeline.cli.arguments import add_cache, add_configuration, cache_of, open_from, plugins_from


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_configuration(parser)
    add_cache(parser)


def execute(args: Namespace) -> int:
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
