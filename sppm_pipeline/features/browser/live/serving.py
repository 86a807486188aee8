"""Pages that are served to this machine only, under an address that others can't guess."""

from __future__ import annotations

import hmac
import sys
from argparse import ArgumentParser, Namespace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import SplitResult, urlsplit

from sppm_pipeline.engine.config.names import REPORT
from sppm_pipeline.errors import ResourceError
from sppm_pipeline.features.browser.report import command as report


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

    class Handler(LocalHandler):
        def do_GET(self) -> None:
            if (place := self.place()) is not None:
                found = not place.path
                self.answer(200 if found else 404, "text/html", target.read_bytes() if found else b"404\n")

    return Handler


LOCAL = ("127.0.0.1", "localhost")


class LocalHandler(BaseHTTPRequestHandler):
    """Answer only requests of this machine that have the token in their path."""

    # connections stay open between the many small requests of a slider
    protocol_version = "HTTP/1.1"
    timeout = 60  # seconds; a browser holds connections open, and each takes a thread
    server: LocalServer

    def place(self) -> SplitResult | None:
        """The requested path after the token, and its query; None if the request was refused and answered."""
        try:
            host = self.headers.get("Host", "").rsplit(":", 1)[0]
            origin = urlsplit(self.headers.get("Origin") or "http://localhost").hostname
            token, _, rest = self.path.removeprefix("/").partition("/")
            # a foreign name that resolves to this server is a page that wants to read this one (DNS rebinding)
            known = host in LOCAL and origin in LOCAL
            if known and hmac.compare_digest(token.encode(), self.server.token.encode()):
                return urlsplit(rest)
        except ValueError:  # such as an address with half a bracket
            self.answer(400, "text/plain", b"400 the address or the origin is malformed\n")
            return None
        self.answer(403, "text/plain", b"403 this page is for those who know its address\n")
        return None

    def body(self, limit: int) -> bytes | None:
        """The whole body of a request; None if it was refused and answered."""
        text = self.headers.get("Content-Length", "")
        # more digits than the limit has can't be a smaller number, and very many raise an error
        if not text.isdecimal() or len(text.lstrip("0")) > len(str(limit)) or int(text) > limit:
            status = 413 if text.isdecimal() else 411
            self.answer(status, "text/plain", f"{status} a body of at most {limit} bytes, and its length\n".encode())
            return None
        body = self.rfile.read(int(text))
        if len(body) < int(text):
            self.answer(400, "text/plain", f"400 {len(body)} of {int(text)} bytes have arrived\n".encode())
            return None
        return body

    def answer(self, status: int, kind: str, body: bytes, headers: tuple[tuple[str, str], ...] = ()) -> None:
        """Send a whole answer that no cache keeps, no other page may hold, and whose address is not passed on."""
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind if kind.startswith("application") else f"{kind}; charset=utf-8"),
            ("Content-Length", str(len(body))), ("Cache-Control", "no-store"), ("Referrer-Policy", "no-referrer"),
            ("X-Content-Type-Options", "nosniff"), ("X-Frame-Options", "DENY"), *headers,
        ):  # fmt: skip
            self.send_header(name, value)
        if status >= 400 and self.command == "POST":
            self.close_connection = True  # what was not read of the request must not be taken for the next one
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def version_string(self) -> str:
        """The name of the program without a version."""
        return "sppm"

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: the token would be written down."""


class LocalServer(ThreadingHTTPServer):
    """Server for a browser of this machine, on any free port for 0; `ResourceError` if the port can't be had."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, port: int, handler: type[LocalHandler]) -> None:
        import secrets

        # other users of this machine reach the port as well, but can't guess 128 random bits
        self.token = secrets.token_urlsafe(16)
        try:
            super().__init__(("127.0.0.1", port), handler)
        except (OSError, OverflowError) as error:
            raise ResourceError(f"--port: {port} can't be used: {error}", hint="leave it out for a free one") from error
        self.address = f"http://127.0.0.1:{self.server_port}/{self.token}/"

    def handle_error(self, request: object, client_address: object) -> None:
        """Print what went wrong; a browser that does not wait for an answer is no error."""
        if not isinstance(sys.exception(), (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)  # type: ignore[arg-type]

    def serve(self) -> None:
        """Serve until interrupted."""
        print(f"{self.address} until Ctrl-C", flush=True)
        with self:
            self.serve_forever(poll_interval=0.1)
