"""``write.chart``: a diagram of a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.data.table import Table
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.stage import Context, Stage, option


@dataclass(frozen=True, kw_only=True)
class WriteChart(Stage):
    """Draw one column of a table over another: as points, as boxes for equal x, with a fitted line if wished.

    The table is that of a sweep, or one that a stage makes.
    """

    name: ClassVar[str] = "write.chart"

    path: str = option("chart.png", help="picture to write", output=True)
    x: str = option(help="column along the axis")
    y: str = option(help="column upward")
    kind: str = option("points", help="how the values are shown", choices=("points", "boxes"))
    group: str = option("", help="column whose values are told apart by color; none if empty")
    line: bool = option(False, help="draw the least-squares line through all points and report it")
    log_x: bool = option(False, help="logarithmic axis of x; what is not positive is left out")
    log_y: bool = option(False, help="logarithmic axis of y; what is not positive is left out")
    title: str = option("", help="text above the diagram")
    x_label: str = option("", help="text below the axis; the column's name if empty")
    y_label: str = option("", help="text beside the axis; the column's name if empty")

    def estimate(self, palette: Palette, table: Size) -> Size:
        return Size()

    def run(self, context: Context, table: Table) -> None:
        """Draw the diagram."""
        from PIL import Image

        from sppm_pipeline.numerics.porosity.line import fit_line
        from sppm_pipeline.render.charts import chart
        from sppm_pipeline.render.series import Boxes, Line, Points

        x, y = table.numbers(self.x), table.numbers(self.y)
        names = list(table.column(self.group)) if self.group else [""] * len(x)
        good = np.isfinite(x) & np.isfinite(y)
        x, y, names = x[good], y[good], [name for name, there in zip(names, good, strict=True) if there]
        if len(x) < 2:
            raise ConfigError(f"columns {self.x!r} and {self.y!r} have fewer than two rows with numbers in both")
        shown: list[Boxes | Line | Points] = []
        for group in _in_order(names):
            own = np.array([name == group for name in names])
            own_x, own_y = x[own], y[own]
            label = _group_text(self.group, group)
            if self.kind == "boxes":
                places = np.unique(own_x)
                shown.append(Boxes(places, [own_y[own_x == place] for place in places], label=label))
            else:
                shown.append(Points(own_x, own_y, label=label))
        if self.line:
            line = fit_line(x, y)
            ends = np.array([x.min(), x.max()])
            label = f"{line.slope:.4g} n + {line.intercept:.4g}, R2 = {line.r_squared:.3f}"
            shown.append(Line(ends, line.slope * ends + line.intercept, label=label))
            context.report(slope=line.slope, intercept=line.intercept, r_squared=line.r_squared)
        picture = chart(shown, title=self.title, x_label=self.x_label or self.x, y_label=self.y_label or self.y,
                        x_log=self.log_x, y_log=self.log_y)  # fmt: skip
        Image.fromarray(picture).save(context.output(self.path))


def _in_order(names: Sequence[Any]) -> list[Any]:
    """Each group once: numbers from small to large, then texts as they come; rows without a group belong to none."""
    known = [name for name in dict.fromkeys(names) if name is not None and name == name]
    return sorted((n for n in known if not isinstance(n, str)), key=float) + [n for n in known if isinstance(n, str)]


def _group_text(column: str, group: Any) -> str:
    """How the legend names a group."""
    return group if isinstance(group, str) else f"{column} = {group:g}"
