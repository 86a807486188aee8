"""Pages that are served to this machine only, under an address that others can't guess."""

from __future__ import annotations

import hmac
import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit

from sppm_pipeline.errors import ResourceError

LOCAL = ("127.0.0.1", "localhost")


class LocalHandler(BaseHTTPRequestHandler):
    """Answers only to requests of this machine that have the token in their path."""

    protocol_version = "HTTP/1.1"
    timeout = 60  # seconds; a browser holds connections open, and each takes a thread
    server: LocalServer

    def place(self) -> str | None:
        """What is asked for behind the token; None if that is refused, which has then been said."""
        host = self.headers.get("Host", "").rsplit(":", 1)[0]
        origin = urlsplit(self.headers.get("Origin") or "http://localhost").hostname
        token, _, rest = self.path.removeprefix("/").partition("/")
        # a foreign name that leads here is a page that wants to read this one (DNS rebinding)
        if (
            host not in LOCAL
            or origin not in LOCAL
            or not hmac.compare_digest(token.encode(), self.server.token.encode())
        ):
            self.answer(403, "text/plain", b"403 this page is for those who know its address\n")
            return None
        return rest

    def answer(self, status: int, kind: str, body: bytes, headers: tuple[tuple[str, str], ...] = ()) -> None:
        """Send a whole answer that no cache keeps, no other page may hold, and whose address is not passed on."""
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind if kind.startswith("application") else f"{kind}; charset=utf-8"),
            ("Content-Length", str(len(body))),
            ("Cache-Control", "no-store"),
            ("Referrer-Policy", "no-referrer"),
            ("X-Content-Type-Options", "nosniff"),
            ("X-Frame-Options", "DENY"),
            *headers,
        ):
            self.send_header(name, value)
        if status >= 400 and self.command == "POST":
            self.close_connection = True  # what was not read of the request must not be taken for the next one
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def version_string(self) -> str:
        """Whose pages these are, and no more."""
        return "sppm"

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: the token would be written down."""


class LocalServer(ThreadingHTTPServer):
    """A server of this machine for a browser of this machine.

    Parameters
    ----------
    port : int
        0 for any that is free.
    handler : type of LocalHandler

    Attributes
    ----------
    token : str
    address : str

    Raises
    ------
    ResourceError
        If the port can't be had.
    """

    daemon_threads = True
    block_on_close = False

    def __init__(self, port: int, handler: type[LocalHandler]) -> None:
        import secrets

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
