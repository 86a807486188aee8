"""``sppm view``: the report of a run directory in the browser, made if it is not that of the present run."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from sppm_pipeline.engine.config.names import REPORT
from sppm_pipeline.features.browser.report import command as report

if TYPE_CHECKING:
    from sppm_pipeline.features.browser.live.serving import LocalHandler


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb: those of ``sppm report``, and how the page is shown."""
    report.configure(parser)
    parser.add_argument(
        "--serve", action="store_true", help="serve the page to this machine only, for a browser at the end of a tunnel"
    )
    parser.add_argument("--port", type=int, default=0, metavar="N", help="port to serve at; any free one if omitted")


def execute(args: Namespace) -> int:
    """Make the report if there is none of this run, and show it."""
    target: Path = args.output or args.directory / REPORT
    if not is_current(args.directory, target) or args.remake:
        report.make_report(args, target)
    if args.serve:
        from sppm_pipeline.features.browser.live.serving import LocalServer

        LocalServer(args.port, handler_of(target)).serve()
    else:
        report.open_in_browser(target)
        print(target)
    return 0


def is_current(directory: Path, target: Path) -> bool:
    """Test whether a page is the report of the run as recorded now."""
    from sppm_pipeline.features.browser.report.records import read_record

    seal = read_record(directory).get("sha256")
    try:
        # the seal of the record stands in the head of the page
        with target.open("rb") as file:
            return f'<meta name="sppm-record" content="{seal}">'.encode() in file.read(4096)
    except OSError:
        return False


def handler_of(target: Path) -> type[LocalHandler]:
    """Answers for one page."""
    from sppm_pipeline.features.browser.live.serving import LocalHandler

    class Handler(LocalHandler):
        def do_GET(self) -> None:
            if (place := self.place()) is not None:
                found = not place.path
                self.answer(200 if found else 404, "text/html", target.read_bytes() if found else b"404\n")

    return Handler
