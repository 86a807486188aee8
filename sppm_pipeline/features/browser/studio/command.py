"""``sppm studio``: design a cell in the browser; what it makes is a configuration file."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    from sppm_pipeline.engine.cli.arguments import add_plugins

    parser.add_argument(
        "start", metavar="FILE", nargs="?", help="configuration to go out from; a built-in cell if omitted"
    )
    parser.add_argument("--no-open", action="store_true", help="only print the address, and open no browser")
    parser.add_argument("--port", type=int, default=0, metavar="N", help="port to serve at; any free one if omitted")
    add_plugins(parser)


def execute(args: Namespace) -> int:
    """Serve the page until interrupted."""
    import webbrowser

    from sppm_pipeline.engine.plan.plugins import allowed_plugins
    from sppm_pipeline.engine.plan.session import RunRequest, find_configuration
    from sppm_pipeline.engine.run.runner import available_threads
    from sppm_pipeline.features.browser.studio.design import START, Design
    from sppm_pipeline.features.browser.studio.server import server_of

    named = Path(args.start) if args.start is not None else None
    request = RunRequest(
        "cell.yaml" if args.start is None else str(find_configuration(args.start)),
        plugins=tuple(args.plugin),
        distributions=not args.no_plugins,
        allowed=allowed_plugins(args.allow_plugins),
        text=START if args.start is None else None,
    )
    # an example of the package is a start, and no file of the user's; nor is the record of a run to be edited
    own = named is not None and named.exists() and named.suffix.lower() in (".yaml", ".yml")
    server = server_of(Design(request, named if own else None, available_threads()), args.port)
    if not args.no_open:
        webbrowser.open(server.address)
    server.serve()
    return 0
