"""``sppm view``: the report of a run directory in the browser, made if it is not that of the present run."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from sppm_pipeline.cli import report
from sppm_pipeline.engine.config.names import REPORT


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
        serve(target, args.port)
    else:
        report.open_in_browser(target)
        print(target)
    return 0


def is_current(directory: Path, target: Path) -> bool:
    """Whether a page is the report of the run as it is recorded now."""
    from sppm_pipeline.report.build import read_record

    seal = read_record(directory).get("sha256")
    try:
        with target.open("rb") as file:
            return f'<meta name="sppm-record" content="{seal}">'.encode() in file.read(4096)
    except OSError:
        return False


def serve(target: Path, port: int) -> None:
    """Serve one page to this machine until interrupted, under an address that others can't guess.

    Raises
    ------
    ResourceError
        If the port can't be had.
    """
    import secrets

    from sppm_pipeline.errors import ResourceError

    token = secrets.token_urlsafe(16)
    try:
        server = ThreadingHTTPServer(("127.0.0.1", port), handler_of(target, token))
    except (OSError, OverflowError) as error:
        raise ResourceError(f"--port: {port} can't be used: {error}", hint="leave it out for a free one") from error
    print(f"http://127.0.0.1:{server.server_port}/{token}/ until Ctrl-C", flush=True)
    with server:
        server.serve_forever()


def handler_of(target: Path, token: str) -> type[BaseHTTPRequestHandler]:
    """Answers for one page: the token must be in the path, and the host that was asked for must be this machine."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            host = self.headers.get("Host", "").rsplit(":", 1)[0]
            # a foreign name that leads here is a page that wants to read this one (DNS rebinding)
            if host not in ("127.0.0.1", "localhost") or self.path != f"/{token}/":
                self.send_error(403)
                return
            data = target.read_bytes()
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(data)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, format: str, *args: object) -> None:
            """Nothing: the token would be written down."""

    return Handler
