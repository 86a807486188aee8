"""``sppm cite``: what to cite for results of the program, or of one configuration."""

from __future__ import annotations

import textwrap
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator

from sppm_pipeline.engine.cli.arguments import add_configuration, open_from

# [doi]
PAPER_DOI = ""
# [/doi]

PAPER = "Z. Wang, L. Tian, X. Liu, A. Sharf, L. Lu: Stochastic Porous Microstructures. Preprint, arXiv."


def configure_cite(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_configuration(parser)
    next(action for action in parser._actions if action.dest == "file").nargs = "?"


def execute_cite(args: Namespace) -> int:
    """Print the program, the paper, then the sources of the stages that are used and their plugins."""
    for number, text in enumerate(dict.fromkeys(_texts(args)), 1):
        print(textwrap.fill(text, 100, initial_indent=f"[{number}] ", subsequent_indent="    "))
    return 0


def _texts(args: Namespace) -> Iterator[str]:
    import sppm_pipeline
    from sppm_pipeline.engine.plan.installed import distributions, metadata_of

    found = distributions().get("sppm-pipeline")
    lines = metadata_of(found).splitlines() if found else []
    address = next((line.split(", ", 1)[1] for line in lines if line.startswith("Project-URL: Repository, ")), "")
    program = f"The sppm_pipeline authors: sppm_pipeline, version {sppm_pipeline.__version__}. Software, BSD-3-Clause."
    yield f"{program} {address}".rstrip()
    yield PAPER + (f" https://doi.org/{PAPER_DOI}" if PAPER_DOI else "")
    if args.file is None:
        return
    plan = open_from(args).plan()
    steps = [step for group in (plan.steps, *plan.recipes.values(), plan.after) for step in group]
    for step in steps:
        for source in type(step.stage).sources:
            yield f"{step.stage.name}: {source}"
    for step in steps:
        if not step.owner.builtin:
            yield f"{step.stage.name} is supplied by {step.owner}; see its own documentation for how to cite it."
