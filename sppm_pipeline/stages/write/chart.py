"""``write.chart``: a chart of a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.data.table import Table
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.families import options
from sppm_pipeline.stage import Context, Stage, option
from sppm_pipeline.stages.write.bars import CHARTS


@dataclass(frozen=True, kw_only=True)
class WriteChart(Stage):
    """Draw one column of a table over another: points, box plots or means of equal x, and a fitted line if requested.

    The table is that of a sweep, or one that a stage makes. Labels and titles may hold mathematics between dollar
    signs. Charts are drawn by matplotlib: ``pip install 'sppm-pipeline[plot]'``.
    """

    name: ClassVar[str] = "write.chart"

    path: str = options.write_path("chart.png", suffixes=CHARTS)
    x: str = option(help="column along the horizontal axis", column=True)
    y: str = option(help="column along the vertical axis", column=True)
    kind: str = option(
        "points",
        help="points, box plots of the values at equal x, or their means with standard deviations as error bars",
        choices=("points", "boxes", "means"),
    )
    error: str = option("", help="column with half lengths of the error bars of points; none if empty", column=True)
    group: str = option("", help="column by whose values the rows are told apart by color; none if empty", column=True)
    family: str = option("", help="text at which a value of `group` ends; the whole value if empty")
    bound: str = option("", help="column that is drawn as a dashed line, say of a bound; none if empty", column=True)
    line: bool = option(False, help="draw the least-squares line through all points and report it")
    log_x: bool = option(False, help="logarithmic horizontal axis; values that are not positive are left out")
    log_y: bool = option(False, help="logarithmic vertical axis; values that are not positive are left out")
    title: str = options.title("", note="above the chart")
    x_label: str = option("", help="text below the horizontal axis; the column's name if empty")
    y_label: str = option("", help="text beside the vertical axis; the column's name if empty")
    group_label: str = option("", help="title of the legend; the name of the column `group` if empty")

    def check_options(self) -> None:
        """A chart that can be drawn, and error bars for points only."""
        from sppm_pipeline.render.charts import check_chart

        texts = {name: getattr(self, name) for name in ("title", "x_label", "y_label", "group_label")}
        check_chart(self.path, **texts)
        if self.error and self.kind != "points":
            raise ConfigError(f"`error` belongs to points, not to {self.kind}", hint="leave out `error` or `kind`")

    def estimate(self, palette: Palette, table: Size) -> Size:
        return Size()

    def run(self, context: Context, table: Table) -> None:
        """Draw the chart."""
        from sppm_pipeline.render.charts import Series, chart, number_text, plain_text

        x, y = table.numbers(self.x), table.numbers(self.y)
        error = table.numbers(self.error) if self.error else np.full(len(x), np.nan)
        groups = table.column(self.group) if self.group else ("",) * len(x)
        if self.family:
            groups = tuple(group.split(self.family)[0] if isinstance(group, str) else group for group in groups)
        shown = np.isfinite(x) & np.isfinite(y) & ((x > 0) | (not self.log_x)) & ((y > 0) | (not self.log_y))
        if shown.sum() < 2:
            raise ConfigError(
                f"columns {self.x!r} and {self.y!r} have fewer than two rows with numbers in both",
                hint="a logarithmic axis takes positive numbers only" if self.log_x or self.log_y else None,
            )
        series = []
        for group in _in_order([group for group, there in zip(groups, shown, strict=True) if there]):
            own = shown & np.array([value == group for value in groups])
            label = plain_text(group) if isinstance(group, str) else f"{group:g}"
            series.append(Series(x[own], y[own], label, self.kind, error[own]))  # type: ignore[arg-type]  # a choice
        if self.bound:
            values = table.numbers(self.bound)
            order = np.argsort(x[shown], kind="stable")
            series.append(Series(x[shown][order], values[shown][order], "bound", "dashed", color="#000000"))
        if self.line:
            slope, intercept, r_squared = _fitted(x[shown], y[shown])
            context.report(slope=slope, intercept=intercept, r_squared=r_squared)
            # enough points to be a curve on logarithmic axes
            along = np.linspace(x[shown].min(), x[shown].max(), 200 if self.log_x or self.log_y else 2)
            sign = "+" if intercept >= 0 else "-"
            label = f"$y = {number_text(slope)} x {sign} {number_text(abs(intercept))}$, $R^2 = {r_squared:.3f}$"
            series.append(Series(along, slope * along + intercept, label, "line", color="#000000"))
        data = chart(
            series, self.path, title=self.title, x_label=self.x_label or plain_text(self.x),
            y_label=self.y_label or plain_text(self.y), legend=self.group_label or plain_text(self.group),
            log_x=self.log_x, log_y=self.log_y,
        )  # fmt: skip
        context.output(self.path).write_bytes(data)


def _fitted(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """Slope and intercept of the least-squares line, and the share of the variance that it explains."""
    from_mean = x - x.mean()
    if not from_mean.any():
        raise ConfigError("a line needs at least two different values of x", hint="leave out `line`")
    slope = float(from_mean @ (y - y.mean()) / (from_mean @ from_mean))
    intercept = float(y.mean() - slope * x.mean())
    total = float(((y - y.mean()) ** 2).sum())
    residuals = y - (slope * x + intercept)
    return slope, intercept, 1.0 - float(residuals @ residuals) / total if total else 1.0


def _in_order(names: Sequence[Any]) -> list[Any]:
    """Each group once: numbers from small to large, then strings as they come; rows without a group belong to none."""
    known = [name for name in dict.fromkeys(names) if name is not None and name == name]
    return sorted((n for n in known if not isinstance(n, str)), key=float) + [n for n in known if isinstance(n, str)]
