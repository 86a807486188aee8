"""Style, texts and files (PDF, SVG or PNG) of charts by matplotlib.

The same data give the same bytes on every run: the style does not depend on a ``matplotlibrc``, fonts are those that
come with matplotlib, and files hold neither dates nor versions. Another version of matplotlib may draw other bytes.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import PurePath
from threading import Lock
from typing import TYPE_CHECKING, Any

from sppm_pipeline.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Distinct with every kind of color vision (Okabe and Ito 2008, "Color Universal Design"), without its yellow, which
is too light for a line on white."""

# No date and no version, so that bytes depend on the data only.
_METADATA: dict[str, dict[str, None]] = {
    "pdf": dict.fromkeys(("Creator", "Producer", "CreationDate")),
    "svg": dict.fromkeys(("Creator", "Date")),
    "png": {"Software": None},
}

_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "mathtext.fontset": "dejavusans",
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.linewidth": 0.7,
    "axes.formatter.use_mathtext": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e7eb",
    "grid.linewidth": 0.6,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "legend.frameon": True,
    "legend.edgecolor": "#e4e7eb",
    "legend.fontsize": 8.5,
    "legend.title_fontsize": 8.5,
    "lines.linewidth": 1.2,
    "lines.markersize": 4.0,
    "savefig.dpi": 200.0,
    "pdf.fonttype": 42,  # TrueType, as publishers ask for
    "svg.hashsalt": "sppm_pipeline",
}

# The style of matplotlib is global to the process, while stages may run in several threads.
_style_lock = Lock()


def check_chart(path: str, **texts: str) -> None:
    """Refuse before any work what could not be drawn.

    Parameters
    ----------
    path : str
        Name of the file; its extension is the format.
    **texts : str
        Options whose values may hold mathematics.

    Raises
    ------
    ConfigError
        If matplotlib is not installed, the extension is none of .pdf, .png and .svg, or the mathematics of a label is
        not valid.
    """
    if find_spec("matplotlib") is None:
        raise ConfigError(
            "charts are drawn by the library matplotlib, which is not installed",
            hint="pip install 'sppm-pipeline[plot]'",
        )
    if PurePath(path).suffix.lower().removeprefix(".") not in _METADATA:
        raise ConfigError(f"a chart is written as .pdf, .png or .svg, not as {path!r}")
    for option, text in texts.items():
        if "$" in text:
            from matplotlib.cbook import is_math_text
            from matplotlib.mathtext import MathTextParser

            try:
                if is_math_text(text):
                    MathTextParser("path").parse(text)
            except ValueError as error:
                raise ConfigError(
                    f"`{option}` is {text!r}, which is not valid mathematics: {str(error).strip().splitlines()[-1]}",
                    hint=r"write for instance '$E_x / E_\mathrm{s}$', and \$ for a dollar sign",
                ) from error


def plain_text(text: str) -> str:
    """A string that is drawn as it is, even if it has dollar signs."""
    return text.replace("$", r"\$")


def number_text(value: float) -> str:
    """Four significant digits as mathematics, without dollar signs."""
    mantissa, _, exponent = f"{value:.4g}".partition("e")
    return rf"{mantissa} \times 10^{{{int(exponent)}}}" if exponent else mantissa


@contextmanager
def styled() -> Iterator[None]:
    """The style of all charts, while a figure is drawn and written."""
    import matplotlib

    with _style_lock, matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


def figure_file(figure: Figure, path: str) -> bytes:
    """The file that a figure becomes, by the extension of its name."""
    extension = PurePath(path).suffix.lower().removeprefix(".")
    data = io.BytesIO()
    figure.savefig(data, format=extension, metadata=_METADATA[extension])
    return data.getvalue()
