"""Pages that hold their scripts and styles, and a policy that lets a browser run these and fetch nothing.

View files: a line of JSON and packed arrays, which ``write.view`` writes and the live view reads.

``sppmview 1``, a line end, one line of JSON, a line end, and the blobs one after the other. The head's `blobs` lists
name, bytes, type (``u8``, ``u16``, ``u32`` or ``f32``), count of numbers and whether each number is the difference to
the one before. Each blob is gzip without name and time, so that equal data are equal files.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError

if TYPE_CHECKING:
    import jinja2

MAGIC = b"sppmview 1\n"
SUFFIX = ".view"
VIEW_SHARE = 0.75
"""Share of a report that the live view may take, a heuristic; layers and pictures get the rest."""

MAX_HEAD = 2**22
"""Bytes of a head that are read."""

_TYPES: dict[str, np.dtype[Any]] = {
    "u8": np.dtype("uint8"), "u16": np.dtype("<u2"), "u32": np.dtype("<u4"), "f32": np.dtype("<f4"),
}  # fmt: skip


def encode_view(head: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """A view file of a JSON-ready head and arrays of uint8, uint16, uint32 or floats."""
    blobs, listed = [], []
    for name, array in arrays.items():
        kind = f"u{8 * array.dtype.itemsize}" if array.dtype.kind == "u" else "f32"
        flat = np.ascontiguousarray(array, _TYPES[kind]).reshape(-1)
        # differences along the last axis are small in a smooth field, and small numbers pack well
        delta = kind != "f32"
        data = np.diff(flat, prepend=flat.dtype.type(0)).tobytes() if delta else flat.tobytes()
        blobs.append(gzip.compress(data, compresslevel=9, mtime=0))
        listed.append({"name": name, "bytes": len(blobs[-1]), "type": kind, "count": flat.size, "delta": delta})
    text = json.dumps({**head, "blobs": listed}, separators=(",", ":"), allow_nan=False)
    return b"".join([MAGIC, text.encode(), b"\n", *blobs])


def head_of(data: bytes) -> dict[str, Any]:
    """The head of a view file; `InputError` if it is none."""
    end = data.find(b"\n", len(MAGIC), len(MAGIC) + MAX_HEAD)
    try:
        if not data.startswith(MAGIC) or end < 0:
            raise ValueError("it does not begin as one")
        head = json.loads(data[len(MAGIC) : end])
        if not isinstance(head, dict) or sum(blob["bytes"] for blob in head["blobs"]) != len(data) - end - 1:
            raise ValueError("its blobs are not as long as it says")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"this is no view file: {error}", hint="write one with `write.view`") from error
    return head


def room_of_view(max_bytes: int) -> int:
    """Bytes that a view file may take in a report of at most so many."""
    return int(VIEW_SHARE * 0.75 * max_bytes)


def wanted(size: int) -> str:
    """The size of a view file, and the limit with which a report shows it."""
    return f"{size / 1e6:.1f} MB; it is shown with `--max-size {math.ceil(size / (VIEW_SHARE * 0.75e6))}MB`"


ASSETS = Path(__file__).with_name("assets")

LIVE_SCRIPTS = ("data.js", "kernels.js", "camera.js", "shader.js", "view.js", "meshview.js", "live.js")
"""Scripts of the live view behind ``base.js``, each before those that use it."""


def joined_script(*files: Path) -> str:
    """Classic scripts as one, with names of their own: ``(() => {...})()``; indentation and lines of comment go."""
    lines = [line.strip() for file in files for line in file.read_text(encoding="utf-8").splitlines()]
    kept = [line for line in lines if line and not line.startswith("//")]
    return '(() => {\n"use strict";\n' + "\n".join(kept) + "\n})();\n"


def policy(script: str) -> str:
    """The content security policy of a page whose only script is this: nothing is fetched, nothing else is run."""
    # a digest, and no 'unsafe-inline': a script in the text of a record would not run
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def json_block(value: Any) -> str:
    """JSON that may stand in a ``<script type="application/json">``: nothing in it ends the element."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    # "</script>" in a name would end the element; U+2028 and U+2029 end lines in older JavaScript
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def environment(*folders: Path) -> jinja2.Environment:
    """Templates of these folders and of the live view; what is put in is text unless a template says otherwise."""
    import jinja2

    return jinja2.Environment(
        loader=jinja2.FileSystemLoader([*folders, ASSETS]), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip


def live_page(view: bytes, framed: bool = False) -> str:
    """A page with nothing but the live view of a view file; if `framed`, other data may come from around it."""
    own = ("frame.js",) if framed else ()
    script = joined_script(ASSETS / "base.js", *(ASSETS / name for name in (*LIVE_SCRIPTS, *own)))
    return (
        environment()
        .get_template("page.html")
        .render(
            view=head_of(view), data=base64.b64encode(view).decode(), script=script,
            style=(ASSETS / "live.css").read_text(encoding="utf-8"), policy=policy(script),
        )
    )  # fmt: skip
