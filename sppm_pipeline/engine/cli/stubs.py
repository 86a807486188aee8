"""``sppm stubs``: what type checkers and editors know of the stages as Python functions."""

from __future__ import annotations

import sysconfig
from argparse import ArgumentParser, Namespace
from pathlib import Path


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument(
        "--plugins",
        action="store_true",
        help="with the stages of installed plugins, as a package of stubs beside the installed packages",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="folder for the package of stubs instead of that one"
    )


def execute(args: Namespace) -> int:
    """Print the stub of the built-in stages, or write a package with those of plugins."""
    from sppm_pipeline.engine.files import write_whole
    from sppm_pipeline.engine.plan.plugins import allowed_plugins, load_plugins
    from sppm_pipeline.engine.plan.registry import Registry
    from sppm_pipeline.engine.plan.stubs import stub_text

    plugins = load_plugins(distributions=args.plugins, allowed=allowed_plugins() if args.plugins else None)
    plugins.raise_broken()
    text = stub_text(Registry(plugins))
    if not args.plugins and args.output is None:
        print(text, end="")
        return 0
    folder = (args.output or Path(sysconfig.get_path("purelib"))) / "sppm_pipeline-stubs"
    (folder / "engine" / "api").mkdir(parents=True, exist_ok=True)
    # partial: whatever is not here is taken from the package itself
    write_whole(folder / "py.typed", "partial\n")
    write_whole(folder / "engine" / "api" / "stages.pyi", text)
    print(folder)
    return 0
