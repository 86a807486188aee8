"""Pages that hold their scripts and styles, and a policy that lets a browser run these and fetch nothing."""

from __future__ import annotations

import base64
import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.features.browser.live.data import head_of

if TYPE_CHECKING:
    import jinja2

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
        loader=jinja2.FileSystemLoader([*folders, ASSETS]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def live_page(view: bytes) -> str:
    """A page with nothing but the live view of a view file."""
    script = joined_script(ASSETS / "base.js", *(ASSETS / name for name in LIVE_SCRIPTS))
    return (
        environment()
        .get_template("page.html")
        .render(
            view=head_of(view),
            data=base64.b64encode(view).decode(),
            script=script,
            style=(ASSETS / "live.css").read_text(encoding="utf-8"),
            policy=policy(script),
        )
    )
