"""Draw the badge of the share of lines that tests reach.

Usage: python .ci/badge.py COVERAGE.json BADGE.svg, of what `coverage json` wrote
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

COLORS = ((90, "#3f8f3f"), (75, "#8a8a1f"), (0, "#b04a2f"))
"""From which percentage on; white letters keep a contrast of 3 to each."""


def badge(percent: float) -> str:
    """An SVG picture."""
    color = next(color for least, color in COLORS if percent >= least)
    text = f"{int(percent)} %"  # not rounded up
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" width="110" height="20" role="img" '
        f'aria-label="coverage: {text}"><rect width="70" height="20" fill="#555"/>'
        f'<rect x="70" width="40" height="20" fill="{color}"/>'
        '<g fill="#fff" font-family="sans-serif" font-size="11" text-anchor="middle">'
        f'<text x="35" y="14">coverage</text><text x="90" y="14">{text}</text></g></svg>\n'
    )


def main() -> None:
    source, target = map(Path, sys.argv[1:])
    percent = json.loads(source.read_text(encoding="utf-8"))["totals"]["percent_covered"]
    target.write_text(badge(percent), encoding="utf-8")
    print(f"{percent:.1f} % of lines")


if __name__ == "__main__":
    main()
