"""The studio's server: the page, cells and numbers as the page asks for them, and the file when it is saved."""

from __future__ import annotations

import json
import os
import re
import struct
import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import parse_qs, quote

from sppm_pipeline.engine.cli.new import DESIGNS
from sppm_pipeline.engine.plan.session import RunRequest, find_configuration
from sppm_pipeline.errors import ConfigError, InputError, SppmError, did_you_mean
from sppm_pipeline.features.browser.live.serving import LocalHandler, LocalServer
from sppm_pipeline.features.browser.studio.controls import places, with_values
from sppm_pipeline.features.browser.studio.design import START, Changed, Design, Superseded
from sppm_pipeline.features.browser.studio.page import studio_page
from sppm_pipeline.features.browser.studio.parts import KIND, MESHES, begun, scratch_of


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    from sppm_pipeline.engine.cli.arguments import add_plugins

    parser.add_argument(
        "start", metavar="FILE", nargs="?",
        help="configuration to go out from, or mesh or CAD file of a part to fill; a built-in cell if omitted",
    )  # fmt: skip
    parser.add_argument(
        "--design", metavar="NAME", help=f"what a mesh is made to: {', '.join(DESIGNS)}; {KIND} if omitted"
    )
    parser.add_argument("--printer", metavar="NAME", help="printer of a part; PNG layers if omitted")
    parser.add_argument(
        "--static", metavar="PAGE", type=Path,
        help="write a page that draws cells of one form without a server, as docs sites have it, and end",
    )  # fmt: skip
    parser.add_argument("--no-open", action="store_true", help="only print the address, and open no browser")
    parser.add_argument("--port", type=int, default=0, metavar="N", help="port to serve at; any free one if omitted")
    add_plugins(parser)


def execute(args: Namespace) -> int:
    """Serve the page until interrupted."""
    import webbrowser

    from sppm_pipeline.engine.plan.plugins import allowed_plugins
    from sppm_pipeline.engine.run.runner import available_threads

    if args.static is not None:
        from sppm_pipeline.engine.files import write_whole
        from sppm_pipeline.features.browser.studio.alone import alone_page

        if args.start is not None or args.design or args.printer:
            raise ConfigError("--static writes a page for cells of one form", hint="sppm studio --static studio.html")
        args.static.parent.mkdir(parents=True, exist_ok=True)
        write_whole(args.static, alone_page())
        return 0
    named = Path(args.start) if args.start is not None else None
    mesh = named if named is not None and named.suffix.lower() in MESHES else None
    if mesh is None and (args.design or args.printer):
        raise ConfigError(
            "--design and --printer say what a mesh is made to", hint="sppm studio part.stl --design cage"
        )
    if mesh is not None and not mesh.is_file():
        raise ConfigError(f"{str(mesh)!r} is no file", hint="give the mesh to fill: sppm studio my.stl")
    request = RunRequest(
        "cell.yaml", plugins=tuple(args.plugin), distributions=not args.no_plugins,
        allowed=allowed_plugins(args.allow_plugins), text=START,
    )  # fmt: skip
    studio = Studio(request, available_threads())
    if mesh is not None:
        studio.begin(mesh, args.design or KIND, args.printer)
    elif named is not None:
        # an example of the package is a start, and no file of the user's; nor is the record of a run to be edited
        own = named.exists() and named.suffix.lower() in (".yaml", ".yml")
        studio.show(replace(request, file=str(find_configuration(args.start)), text=None), named if own else None)
    server = server_of(studio, args.port)
    if not args.no_open:
        webbrowser.open(server.address)
    server.serve()
    return 0


MAX_BODY, MAX_MESH = 1_000_000, 2**28
"""Bytes of a request that are read, and of a mesh that is dropped onto the page."""

CHARTED = 80
"""Designs of the atlas on the chart, evenly of all families: few enough to tell points apart."""

TYPES = {".html": "text/html", ".png": "image/png", ".stl": "model/stl"}


class Studio:
    """The design on the page, which another may take the place of; begins with that of the request's text."""

    def __init__(self, request: RunRequest, threads: int) -> None:
        self.request, self.threads = request, threads
        self.mesh: Path | None = None
        self.kind, self.printer = KIND, ""
        self._dropped = scratch_of(self)
        self._shown: tuple[Design, str, str] | None = None

    @property
    def shown(self) -> tuple[Design, str, str]:
        """The design, its page, and the policy of that."""
        if self._shown is None:
            self.show(self.request, None)
        assert self._shown is not None
        return self._shown

    def hold(self, design: Design) -> None:
        """Put a design that is there already on the page."""
        begun = None if self.mesh is None else (self.kind, self.printer)
        self._shown = (design, *studio_page(design, begun))

    def show(self, request: RunRequest, file: Path | None, *, fresh: bool = False) -> None:
        """Put another design in the place of the one on the page; `SppmError` if it can't be read."""
        self.hold(Design(request, file, self.threads, fresh=fresh))

    def begin(self, mesh: Path, kind: str, printer: str | None, changes: Mapping[str, Any] | None = None) -> None:
        """Begin with a part to fill; with changes, those that the new text has a place for are made in it.

        The configuration lies in the current folder, and one that is there already is read.
        """
        if kind not in DESIGNS:
            raise ConfigError(f"there is no design {kind!r}", hint=did_you_mean(kind, DESIGNS))
        dropped = mesh.is_relative_to(self._dropped)
        folder = mesh.parent if dropped else Path()
        request, file = begun(Path(os.path.relpath(mesh, folder)), kind, printer, self.request, folder)
        again = file.is_file() and changes is None
        if again:
            request = replace(request, text=None)
        elif changes:
            known = places(request.text or "")
            kept = {key: value for key, value in changes.items() if key in known}
            request = replace(request, text=with_values(request.text or "", kept))
        self.mesh, self.kind, self.printer = mesh, kind, printer or ""
        self.show(request, None if dropped else file, fresh=not again)

    def found(self, asked: Mapping[str, str]) -> list[Any]:
        """Designs that meet the conditions of a request, by all that find some."""
        return self.shown[0].found(asked.get("conditions", ""), asked.get("cell") or None, CHARTED)

    def take(self, asked: Mapping[str, str]) -> None:
        """Put one of the designs that were found on the page."""
        designs, number = self.found(asked), asked.get("number", "")
        if not (number.isdecimal() and int(number) < len(designs)):
            raise InputError(f"{number!r} is none of the {len(designs)} designs", hint="find them again")
        text = designs[int(number)].configuration("found")
        self.mesh = None
        self.show(replace(self.request, file="found.yaml", text=text), None, fresh=True)

    def drop(self, name: str, body: bytes) -> None:
        """Begin with a mesh that was dropped onto the page: one in the current folder if it is the same, or a copy."""
        name = re.sub(r"[^\w.() -]+", "_", PurePosixPath(name.replace("\\", "/")).name)
        if PurePosixPath(name).suffix.lower() not in MESHES or name.startswith("."):
            raise InputError(f"{name!r} is no mesh", hint=f"files that can be filled end in {', '.join(MESHES)}")
        here = Path(name)
        if not (here.is_file() and here.stat().st_size == len(body) and here.read_bytes() == body):
            here = Path(tempfile.mkdtemp(dir=self._dropped)) / name
            here.write_bytes(body)
        self.begin(here, self.kind, self.printer or None)


def server_of(shown: Design | Studio, port: int = 0) -> LocalServer:
    """A server of the page for a design; `ResourceError` if the port can't be had."""
    if isinstance(shown, Studio):
        studio = shown
        _ = studio.shown  # what is wrong with it is said before there is a server
    else:
        studio = Studio(shown.request, shown.threads)
        studio.hold(shown)

    class Handler(LocalHandler):
        def do_GET(self) -> None:
            place = self.place()
            if place is None:
                return
            _, page, rules = studio.shown
            asked = {key: values[0] for key, values in parse_qs(place.query, keep_blank_values=True).items()}
            if not place.path:
                self.answer(200, "text/html", page.encode(), (("Content-Security-Policy", rules),))
            elif place.path == "find":
                try:
                    self._json(200, {"designs": [one._asdict() for one in studio.found(asked)]})
                except SppmError as error:
                    self._refused(error, {})
            elif place.path in ("cell", "numbers", "run", "file"):
                changes = self._changes(_decoded(asked.get("changes", "{}")))
                if changes is not None:
                    self._made(place.path, changes, asked)
            else:
                self.answer(404, "text/plain", b"404\n")

        def do_POST(self) -> None:
            place = self.place()
            if place is None:
                return
            if place.path == "open":
                self._opened(parse_qs(place.query))
                return
            if place.path != "save":
                self.answer(404, "text/plain", b"404 there is `save` and `open`\n")
                return
            design = studio.shown[0]
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

        def _opened(self, query: Mapping[str, list[str]]) -> None:
            """Another design on the page: found, of a mesh in the body, or of the same one if that is empty."""
            body = self.body(MAX_MESH)
            if body is None:
                return
            asked = {key: values[0] for key, values in query.items()}
            try:
                if "conditions" in asked:
                    studio.take(asked)
                elif body and "name" in asked:
                    studio.drop(asked["name"], body)
                elif studio.mesh is not None:
                    changes = _decoded(asked.get("changes", "{}"))
                    studio.begin(
                        studio.mesh, asked.get("design", KIND), asked.get("printer") or None,
                        changes if isinstance(changes, dict) else {},
                    )  # fmt: skip
                else:
                    raise InputError("no mesh was dropped", hint="drop an STL, 3MF or STEP file onto the page")
            except SppmError as error:
                self._refused(error, {})
            else:
                self._json(200, {"opened": studio.shown[0].name})

        def _made(self, path: str, changes: dict[str, Any], asked: Mapping[str, str]) -> None:
            design, target = studio.shown[0], asked.get("target", "")
            try:
                if path == "numbers":
                    self._json(200, design.numbers(changes, target))
                elif path == "run":
                    self._json(200, design.run(changes, long=bool(asked.get("long"))))
                elif path == "file":
                    name, data = design.file_of(changes, target, asked.get("what", ""))
                    said = f"attachment; filename*=UTF-8''{quote(name)}"
                    kind = TYPES.get(PurePosixPath(name).suffix, "application/octet-stream")
                    self.answer(200, kind, data, (("Content-Disposition", said),))
                else:
                    said_, view = design.cell(changes, target, quick=bool(asked.get("quick")))
                    # one answer for both: the length of the numbers in four bytes, these, and the view file
                    head = json.dumps(said_, allow_nan=False).encode()
                    self.answer(200, "application/octet-stream", struct.pack("<I", len(head)) + head + view)
            # the page has asked again meanwhile, and ignores this answer
            except Superseded:
                self._json(409, {"errors": [], "superseded": True})
            except SppmError as error:
                self._refused(error, changes)

        def _refused(self, error: SppmError, changes: dict[str, Any]) -> None:
            self._json(409 if isinstance(error, Changed) else 422, {"errors": studio.shown[0].faults(error, changes)})

        def _json(self, status: int, value: Any) -> None:
            self.answer(status, "application/json", json.dumps(value, allow_nan=False).encode())

    return LocalServer(port, Handler)


def _decoded(text: str | bytes) -> Any:
    """The value of a JSON text; None if it is none."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None
