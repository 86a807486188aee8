"""Text in pictures, in the font that Pillow carries along, so that a picture looks the same on every machine."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont, ImageFont

# The font has the letters and signs of ASCII and little more; what it lacks is spelt out, not shown as empty boxes.
_SPELT = {
    "α": "alpha", "β": "beta", "γ": "gamma", "δ": "delta", "ε": "epsilon", "θ": "theta", "κ": "kappa", "λ": "lambda",
    "μ": "u", "µ": "u", "ν": "nu", "ξ": "xi", "ρ": "rho", "σ": "sigma", "φ": "phi", "ω": "omega", "−": "-", "–": "-",
    "—": "-", "×": "x", "²": "^2", "³": "^3", "≤": "<=", "≥": ">=", "≈": "~", "…": "...",
}  # fmt: skip


@lru_cache(maxsize=32)
def font(size: int) -> FreeTypeFont | ImageFont:
    """The font at a size in pixels."""
    from PIL import ImageFont as fonts  # only pictures with text need Pillow

    return fonts.load_default(size)


def printable(text: str) -> str:
    """`text` with Greek letters and signs that the font lacks spelt out."""
    return "".join(_SPELT.get(letter, letter) for letter in text)


def text_width(text: str, size: int) -> int:
    """Width of a line of text in pixels, rounded up."""
    return int(-(-font(size).getlength(printable(text)) // 1))
