"""Pages that hold their scripts and styles, and a policy that lets a browser run these and fetch nothing."""

from __future__ import annotations

import base64
import hashlib
import json
from pathlib import Path
from typing import Any

ASSETS = Path(__file__).with_name("assets")

LIVE_SCRIPTS = ("data.js", "kernels.js", "camera.js", "shader.js", "view.js", "live.js")
"""Scripts of the live view behind ``base.js``, each before those that use it."""


def joined_script(*files: Path) -> str:
    """Classic scripts as one, with names of their own: ``(() => {...})()``."""
    parts = [file.read_text(encoding="utf-8") for file in files]
    return '(() => {\n"use strict";\n' + "\n".join(parts) + "})();\n"


def policy(script: str) -> str:
    """The content security policy of a page whose only script is this: nothing is fetched, nothing else is run."""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def json_block(value: Any) -> str:
    """JSON that may stand in a ``<script type="application/json">``: nothing in it ends the element."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
