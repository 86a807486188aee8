"""The live view as a widget of notebooks, with sliders that call Python."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from sppm_pipeline.errors import ConfigError, ResourceError, SppmError
from sppm_pipeline.features.browser.live.page import ASSETS, live_page
from sppm_pipeline.features.browser.live.views import view_of
from sppm_pipeline.nouns.artifact import Artifact

SAMPLES = 400_000
"""Samples of a field that the browser does not sum itself: half a megabyte, which follows a slider."""


def show(what: Artifact | Callable[..., Artifact], **sliders: tuple[float, ...]) -> Any:
    """Show a structure live in a notebook: a widget that turns and is cut open.

    Needs the extra ``sppm-pipeline[notebook]``::

        sppm.show(cell)
        sppm.show(lambda radius, count: make_cell(radius, count), radius=(0.10, 0.16), count=(20, 80))

    Parameters
    ----------
    what : Artifact or function
        A field, a tile set, a part, a mesh or whatever else has a live view; or a function that makes one of the
        values of the sliders, which is called again when they have been moved.
    **sliders : (low, high) or (low, high, value)
        An argument of the function and its range, of integers if both ends are; it begins in the middle if no value is
        given.

    Returns
    -------
    widget : anywidget.AnyWidget
        Its traits `level` and `porosity` are those that the reader has set in the view, `values` those of the sliders,
        and `message` the last error of the function.

    Raises
    ------
    ConfigError
        Sliders without a function, or that are no ranges.
    ResourceError
        The library anywidget is not installed.
    """
    try:
        anywidget, traits = import_module("anywidget"), import_module("traitlets")
    except ImportError as error:
        raise ResourceError(
            "widgets of notebooks need the library anywidget, which is not installed",
            hint="pip install 'sppm-pipeline[notebook]'",
        ) from error
    if sliders and isinstance(what, Artifact):
        raise ConfigError("sliders are arguments of a function", hint="hand over a function that makes what is shown")
    listed: list[list[Any]] = []
    for name, (low, high, *given) in sliders.items():
        if not low < high or not all(low <= value <= high for value in given) or len(given) > 1:
            raise ConfigError(f"`{name}` is {sliders[name]}", hint="a slider is (low, high) or (low, high, value)")
        whole = isinstance(low, int) and isinstance(high, int)
        middle = (low + high) // 2 if whole else (low + high) / 2
        listed.append([name, low, high, given[0] if given else middle, int(whole)])

    def made(values: dict[str, Any]) -> bytes:
        numbers = {name: int(values[name]) if whole else float(values[name]) for name, *_, whole in listed}
        return view_of(what if isinstance(what, Artifact) else what(**numbers), samples=SAMPLES)

    values = {name: value for name, _, _, value, _ in listed}
    first = made(values)
    members = {
        "_esm": (ASSETS / "notebook.js").read_text(encoding="utf-8"), "page": traits.Unicode().tag(sync=True),
        "view": traits.Bytes().tag(sync=True), "sliders": traits.List().tag(sync=True),
        "values": traits.Dict().tag(sync=True), "message": traits.Unicode().tag(sync=True),
        "level": traits.Float(None, allow_none=True).tag(sync=True),
        "porosity": traits.Float(None, allow_none=True).tag(sync=True),
    }  # fmt: skip
    widget = type("LiveView", (anywidget.AnyWidget,), members)(
        page=live_page(first, framed=True), view=first, sliders=listed, values=values
    )

    def renew(change: Any) -> None:
        try:
            widget.view, widget.message = made(change["new"]), ""
        except SppmError as error:  # the last picture stays
            widget.message = error.message

    widget.observe(renew, "values")
    return widget
