"""The wiring of a run as SVG: a box for each stage, a line for each artifact that passes."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any

BOX, HIGH, GAP, DOWN = 190, 40, 18, 34
"""Width and height of a box, and the gaps beside and below it; choices."""

LONGEST = 24
"""Characters of a name that fit into a box."""


def wiring_svg(stages: Sequence[Mapping[str, Any]]) -> str:
    """Boxes in rows by the longest way from a stage without inputs; empty for no stages. Of each stage, in order,
    `id`, `stage`, `state` ("done", "kept", "failed" or "missing"), `inputs` (port -> id) and `recipes` are taken.
    """
    if not stages:
        return ""
    rank: dict[str, int] = {}
    for stage in stages:
        sources = [rank[s] for s in stage["inputs"].values() if s in rank]
        # below all that it takes something from, so that lines lead down
        rank[stage["id"]] = max(sources, default=-1) + 1
    rows: dict[int, list[Mapping[str, Any]]] = {}
    for stage in stages:
        rows.setdefault(rank[stage["id"]], []).append(stage)
    most = max(len(row) for row in rows.values())
    width = most * (BOX + GAP) + GAP
    place = {
        stage["id"]: (width / 2 + (column - (len(row) - 1) / 2) * (BOX + GAP), GAP + r * (HIGH + DOWN))
        for r, row in rows.items()
        for column, stage in enumerate(row)
    }
    height = GAP + (max(rows) + 1) * (HIGH + DOWN)
    parts = []
    for stage in stages:
        x, y = place[stage["id"]]
        for source in stage["inputs"].values():
            if source in place:
                a, b = place[source]
                bend = (y - b - HIGH) / 2
                parts.append(
                    f'<path class="wire" d="M{a:.1f} {b + HIGH}C{a:.1f} {b + HIGH + bend:.1f} {x:.1f} '
                    f'{y - bend:.1f} {x:.1f} {y}"/>'
                )
    for stage in stages:
        x, y = place[stage["id"]]
        recipes = ", ".join(str(name) for name in stage["recipes"].values())
        below = stage["stage"] if stage["stage"] != stage["id"] else f"recipe {recipes}" if recipes else ""
        title = f"{stage['id']} ({stage['stage']}): {stage['state']}"
        parts.append(
            f'<g class="{stage["state"]}"><title>{html.escape(title)}</title>'
            f'<rect x="{x - BOX / 2:.1f}" y="{y}" width="{BOX}" height="{HIGH}" rx="6"/>'
            f'<text x="{x:.1f}" y="{y + (17 if below else 25)}" text-anchor="middle">{_cut(stage["id"])}</text>'
            + (
                f'<text class="minor" x="{x:.1f}" y="{y + 32}" text-anchor="middle">{_cut(below)}</text>'
                if below
                else ""
            )
            + "</g>"
        )
    return (
        f'<svg class="wiring" viewBox="0 0 {width} {height}" style="max-width:{width}px" role="img" '
        f'aria-label="wiring of {len(stages)} stages">{"".join(parts)}</svg>'
    )


def _cut(text: str) -> str:
    return html.escape(text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…")
