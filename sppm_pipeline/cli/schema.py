"""``sppm schema``: the JSON Schema of configurations, with the stages that are installed."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace

from sppm_pipeline.cli.arguments import add_plugins, plugins_from


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_plugins(parser)


def execute(args: Namespace) -> int:
    """Print the schema."""
    from sppm_pipeline.engine.plan.registry import Registry
    from sppm_pipeline.engine.plan.schema import configuration_schema

    print(json.dumps(configuration_schema(Registry(plugins_from(args))), indent=1, ensure_ascii=False))
    return 0
