"""``sppm graph``: the wiring of a configuration as text, DOT or Mermaid."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from sppm_pipeline.cli.arguments import add_configuration, open_from


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_configuration(parser)
    parser.add_argument("-f", "--format", choices=("text", "dot", "mermaid"), default="text", help="text if omitted")


def execute(args: Namespace) -> int:
    """Print the graph."""
    from sppm_pipeline.engine.plan.describe import dot_graph, mermaid_graph, wiring_text

    draw = {"text": wiring_text, "dot": dot_graph, "mermaid": mermaid_graph}[args.format]
    print(draw(open_from(args).plan()), end="")
    return 0
