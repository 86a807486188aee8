"""The studio's page: controls of a design, what it shows, and its text."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.cli.new import DESIGNS
from sppm_pipeline.features.browser.live.page import (
    ASSETS,
    LIVE_SCRIPTS,
    environment,
    joined_script,
    json_block,
    policy,
)
from sppm_pipeline.features.browser.studio.controls import Control
from sppm_pipeline.features.browser.studio.design import Design
from sppm_pipeline.features.browser.studio.parts import MESHES
from sppm_pipeline.nouns import cards

HERE = Path(__file__).parent

ROLES = {
    "design.sizes.strut": "struts", "design.sizes.pore": "pores", "field.gaussian.tunnel_radius": "radius of tunnels",
    "field.gaussian.pore_radius": "radius of pores", "tile.scattered.cell": "cell size",
    "tile.scattered.porosity": "porosity of the infill", "fill.implicit.skin": "skin thickness",
    "fix.drains.diameter": "drain holes",
}  # fmt: skip
"""What stands first on the page of a part, as far as the file has it, and how it is called: struts and pores first."""


def studio_page(
    design: Design, begun: tuple[str, str] | None = None, alone: tuple[list[Control], Mapping[str, Any]] | None = None
) -> tuple[str, str]:
    """The page, and the policy under which it may be shown: it fetches from its own server only.

    Of a part that a mesh has begun, `begun` are the kind of design and the printer. A page that stands `alone` fetches
    nothing: it has these controls, and knows where they stand in its text.
    """
    names = ("part.js", "studio.js", "find.js") if alone is None else ("part.js", "cell.js", "alone.js", "studio.js")
    script = joined_script(
        ASSETS / "base.js", *(ASSETS / name for name in LIVE_SCRIPTS), *(HERE / "assets" / name for name in names)
    )
    rules = policy(script) if alone else f"{policy(script)}; connect-src 'self'"
    style = "".join(file.read_text(encoding="utf-8") for file in (ASSETS / "live.css", HERE / "assets" / "studio.css"))
    groups = {
        name: {group: [c for c in controls if c.group == group] for group in dict.fromkeys(c.group for c in controls)}
        for name, controls in (design.controls if alone is None else {design.targets[0].name: alone[0]}).items()
    }
    file = "" if design.file is None else str(design.file)
    said = {"file": file, "name": design.name, "part": design.is_part}
    page = environment(HERE / "templates").get_template("studio.html").render(
        name=design.name, groups=groups, targets=[*groups], file=file,
        yaml=design.text, script=script, style=style, policy=rules,
        data=json_block(said | ({"alone": alone[1]} if alone else {})), part=design.is_part,
        roles=ROLES, meshes=",".join(MESHES), designs=DESIGNS if begun else (),
        kind=begun[0] if begun else "", printer=begun[1] if begun else "",
        printers=sorted(cards().printers), alone=alone is not None,
    )  # fmt: skip
    return page, rules
