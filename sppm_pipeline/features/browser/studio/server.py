"""The studio's server: the page, cells and numbers as the page asks for them, and the file when it is saved."""

from __future__ import annotations

import json
import struct
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from sppm_pipeline.errors import SppmError
from sppm_pipeline.features.browser.live.page import (
    ASSETS,
    LIVE_SCRIPTS,
    environment,
    joined_script,
    json_block,
    policy,
)
from sppm_pipeline.features.browser.live.serving import LocalHandler, LocalServer
from sppm_pipeline.features.browser.studio.design import START, Changed, Design, Superseded


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

    named = Path(args.start) if args.start is not None else None
    request = RunRequest(
        "cell.yaml" if args.start is None else str(find_configuration(args.start)), plugins=tuple(args.plugin),
        distributions=not args.no_plugins, allowed=allowed_plugins(args.allow_plugins),
        text=START if args.start is None else None,
    )  # fmt: skip
    # an example of the package is a start, and no file of the user's; nor is the record of a run to be edited
    own = named is not None and named.exists() and named.suffix.lower() in (".yaml", ".yml")
    server = server_of(Design(request, named if own else None, available_threads()), args.port)
    if not args.no_open:
        webbrowser.open(server.address)
    server.serve()
    return 0


HERE = Path(__file__).parent

MAX_BODY = 1_000_000
"""Bytes of a request that are read."""


def studio_page(design: Design) -> tuple[str, str]:
    """The page, and the policy under which it may be shown: it fetches from its own server only."""
    script = joined_script(ASSETS / "base.js", *(ASSETS / name for name in LIVE_SCRIPTS), HERE / "assets" / "studio.js")
    rules = f"{policy(script)}; connect-src 'self'"
    style = "".join(file.read_text(encoding="utf-8") for file in (ASSETS / "live.css", HERE / "assets" / "studio.css"))
    groups = {
        name: {group: [c for c in controls if c.group == group] for group in dict.fromkeys(c.group for c in controls)}
        for name, controls in design.controls.items()
    }
    file = "" if design.file is None else str(design.file)
    page = environment(HERE / "templates").get_template("studio.html").render(
        name=design.name, groups=groups, targets=[target.name for target in design.targets], file=file,
        yaml=design.text, script=script, style=style, policy=rules,
        data=json_block({"file": file, "name": design.name}),
    )  # fmt: skip
    return page, rules


def server_of(design: Design, port: int = 0) -> LocalServer:
    """A server of the page for a design; `ResourceError` if the port can't be had."""
    page, rules = studio_page(design)

    class Handler(LocalHandler):
        def do_GET(self) -> None:
            place = self.place()
            if place is None:
                return
            if not place.path:
                self.answer(200, "text/html", page.encode(), (("Content-Security-Policy", rules),))
            elif place.path in ("cell", "numbers"):
                query = parse_qs(place.query, keep_blank_values=True)
                changes = self._changes(_decoded(query.get("changes", ["{}"])[0]))
                if changes is not None:
                    self._made(place.path, changes, query.get("target", [""])[0])
            else:
                self.answer(404, "text/plain", b"404\n")

        def do_POST(self) -> None:
            place = self.place()
            if place is None:
                return
            if place.path != "save":
                self.answer(404, "text/plain", b"404 there is only `save`\n")
                return
            body = self.body(MAX_BODY)
            if body is None:
                return
            asked = _decoded(body)
            asked = asked if isinstance(asked, dict) else {}
            changes = self._changes(asked.get("changes"))
            if changes is None:
                return
            try:
                design.save(changes, anyway=asked.get("anyway") is True)
            except SppmError as error:
                self._refused(error, changes)
            else:
                self._json(200, {"saved": str(design.file)})

        def _changes(self, value: Any) -> dict[str, Any] | None:
            """The changes of a request; None if it states none, which was answered then."""
            # no changes at all are an empty object: whatever else comes is a broken request, and the text that the page
            # began with must not replace the file
            if isinstance(value, dict):
                return value
            fault = {"key": "", "stage": "", "hint": "reload the page", "message": "the request states no changes"}
            self._json(400, {"errors": [fault]})
            return None

        def _made(self, path: str, changes: dict[str, Any], target: str) -> None:
            try:
                if path == "numbers":
                    self._json(200, design.numbers(changes, target))
                    return
                said, view = design.cell(changes, target)
            # the page has asked again meanwhile, and ignores this answer
            except Superseded:
                self._json(409, {"errors": [], "superseded": True})
            except SppmError as error:
                self._refused(error, changes)
            else:
                # one answer for both: the length of the numbers in four bytes, these, and the view file
                head = json.dumps(said, allow_nan=False).encode()
                self.answer(200, "application/octet-stream", struct.pack("<I", len(head)) + head + view)

        def _refused(self, error: SppmError, changes: dict[str, Any]) -> None:
            self._json(409 if isinstance(error, Changed) else 422, {"errors": design.faults(error, changes)})

        def _json(self, status: int, value: Any) -> None:
            self.answer(status, "application/json", json.dumps(value, allow_nan=False).encode())

    return LocalServer(port, Handler)


def _decoded(text: str | bytes) -> Any:
    """The value of a JSON text; None if it is none."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None
