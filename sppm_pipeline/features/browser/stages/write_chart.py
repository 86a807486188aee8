"""``write.chart``: a chart of a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, Stage, Table, option, options

if TYPE_CHECKING:
    from sppm_pipeline.services.pictures.charts import Series


@dataclass(frozen=True, kw_only=True)
class WriteChart(Stage):
    """Draw columns of a table over another: points, box plots or means of equal x, and a fitted line if requested.

    Several columns `y` become charts side by side over the same `x`. With `hulls` the region that the points of each
    group reach is shaded, as in charts by which materials are chosen.

    The table is that of a sweep, or one that a stage makes. Labels and titles may hold mathematics between dollar
    signs. Charts are drawn by matplotlib: ``pip install 'sppm-pipeline[plot]'``.
    """

    name: ClassVar[str] = "write.chart"
    libraries: ClassVar[tuple[str, ...]] = ("matplotlib",)

    path: str = options.write_path("chart.png", suffixes=options.CHARTS)
    x: str = option(help="column along the horizontal axis", column=True)
    y: str | tuple[str, ...] = option(help="column along the vertical axis; or several, side by side", column=True)
    kind: str = option(
        "points",
        help="points, box plots of the values at equal x, or their means with standard deviations as error bars",
        choices=("points", "boxes", "means"),
    )
    error: str = option("", help="column with half lengths of the error bars of points; none if empty", column=True)
    group: str = option("", help="column whose values give rows their color; none if empty", column=True)
    family: str = option("", help="text at which a value of `group` ends; the whole value if empty")
    bound: str = option(
        "", help="column that is drawn as a dashed line, for example a bound, or as one for each group if these differ",
        column=True,
    )  # fmt: skip
    hulls: bool = option(False, help="shade the convex hull of the points of each group")
    line: bool = option(False, help="draw the least-squares line through all points and report it")
    log_x: bool = option(False, help="logarithmic horizontal axis; values that are not positive are left out")
    log_y: bool | tuple[bool, ...] = option(
        False, help="logarithmic vertical axis; values that are not positive are left out; or of each of several"
    )
    title: str = options.title("", note="above the chart")
    x_label: str = option("", help="text below the horizontal axis; the column's name if empty")
    y_label: str | tuple[str, ...] = option("", help="text beside the vertical axis; the column's name if empty")
    group_label: str = option("", help="title of the legend; the name of the column `group` if empty")

    def check_options(self) -> None:
        """A chart that can be drawn, and error bars for points only."""
        from sppm_pipeline.services.pictures.chart_style import check_chart

        texts = {name: getattr(self, name) for name in ("title", "x_label", "group_label")}
        labels = {f"y_label[{n}]": text for n, text in enumerate(self.y_label)}
        check_chart(self.path, **texts, **(labels if isinstance(self.y_label, tuple) else {"y_label": self.y_label}))
        if self.error and self.kind != "points":
            raise ConfigError(f"`error` belongs to points, not to {self.kind}", hint="leave out `error` or `kind`")
        count = len(_each(self.y))
        for name in ("y_label", "log_y"):
            if len(_each(getattr(self, name))) not in (1, count):
                raise ConfigError(f"`{name}` has {len(_each(getattr(self, name)))} values for {count} columns `y`")
        if not count or (count > 1 and (self.error or self.bound or self.line)):
            raise ConfigError("`error`, `bound` and `line` belong to a single column `y`", hint="draw it by itself")

    def run(self, context: Context, table: Table) -> None:
        """Draw the charts."""
        from sppm_pipeline.services.pictures.chart_style import plain_text
        from sppm_pipeline.services.pictures.charts import Axis, charts_beside

        columns = _each(self.y)
        logs, labels = _each(self.log_y), _each(self.y_label)
        logs = logs * len(columns) if len(logs) == 1 else logs
        labels = labels if len(labels) == len(columns) else ("",) * len(columns)
        x = table.numbers(self.x)
        values = [table.numbers(y) for y in columns]
        shown = [
            np.isfinite(x) & np.isfinite(y) & ((x > 0) | (not self.log_x)) & ((y > 0) | (not log))
            for y, log in zip(values, logs, strict=True)
        ]
        for y, there in zip(columns, shown, strict=True):
            if there.sum() < 2:
                raise ConfigError(
                    f"columns {self.x!r} and {y!r} have fewer than two rows with numbers in both",
                    hint="a logarithmic axis takes positive numbers only" if self.log_x or any(logs) else None,
                )
        groups = self._groups(table)
        present = _in_order([group for group, there in zip(groups, np.any(shown, axis=0), strict=True) if there])
        panels = []
        for y, there, log, label, column in zip(values, shown, logs, labels, columns, strict=True):
            series = self._series(context, table, x, y, groups, present, there, log)
            panels.append(Axis(series, label or plain_text(column), log))
        data = charts_beside(
            panels, self.path, title=self.title, x_label=self.x_label or plain_text(self.x),
            legend=self.group_label or plain_text(self.group), log_x=self.log_x,
        )  # fmt: skip
        context.output(self.path).write_bytes(data)

    def _groups(self, table: Table) -> tuple[Any, ...]:
        """The group of each row."""
        groups = table.column(self.group) if self.group else ("",) * len(table.numbers(self.x))
        if not self.family:
            return groups
        return tuple(group.split(self.family)[0] if isinstance(group, str) else group for group in groups)

    def _series(
        self, context: Context, table: Table, x: np.ndarray, y: np.ndarray, groups: tuple[Any, ...],
        present: Sequence[Any], shown: np.ndarray, log_y: bool,
    ) -> list[Series]:  # fmt: skip
        """A series for each group, and those of bound and line."""
        from sppm_pipeline.services.pictures.chart_style import number_text, plain_text
        from sppm_pipeline.services.pictures.charts import Series

        error = table.numbers(self.error) if self.error else np.full(len(x), np.nan)
        series = []
        for group in present:
            own = shown & np.array([value == group for value in groups])
            label = plain_text(group) if isinstance(group, str) else f"{group:g}"
            kind: Any = self.kind
            series.append(Series(x[own], y[own], label, kind, error[own], hull=self.hulls))
        if self.bound:
            own = [shown & np.array([value == group for value in groups]) for group in present]
            series += self._bounds(x, table.numbers(self.bound), own, shown)
        if self.line:
            slope, intercept, r_squared = _fitted(x[shown], y[shown])
            context.report(slope=slope, intercept=intercept, r_squared=r_squared)
            # enough points to be a curve on logarithmic axes
            along = np.linspace(x[shown].min(), x[shown].max(), 200 if self.log_x or log_y else 2)
            sign = "+" if intercept >= 0 else "-"
            label = f"$y = {number_text(slope)} x {sign} {number_text(abs(intercept))}$, $R^2 = {r_squared:.3f}$"
            series.append(Series(along, slope * along + intercept, label, "line", color="#000000"))
        return series

    @staticmethod
    def _bounds(x: np.ndarray, bound: np.ndarray, groups: Sequence[np.ndarray], shown: np.ndarray) -> list[Series]:
        """One line if it turns no more often than those of the groups; else theirs, as the bound depends on them."""
        from sppm_pipeline.services.pictures.chart_style import COLORS
        from sppm_pipeline.services.pictures.charts import Series

        # a bound of x alone is one curve; one of each group jumps between them where these are mixed
        whole = _line(x[shown], bound[shown])
        lines = [_line(x[own], bound[own]) for own in groups]
        if len(lines) < 2 or _turns(whole[1]) <= sum(_turns(y) for _, y in lines):
            return [Series(*whole, "bound", "dashed", color="#000000")]
        found = [Series(*line, "", "dashed", color=COLORS[n % len(COLORS)]) for n, line in enumerate(lines)]
        return [*found, Series([], [], "bound, of each", "dashed", color="#000000")]


def _line(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values from left to right, each x once with the mean of what stands there."""
    known = np.isfinite(x) & np.isfinite(y)
    places, number, count = np.unique(x[known], return_inverse=True, return_counts=True)
    return places, np.bincount(number, y[known], len(places)) / count


def _turns(y: np.ndarray) -> int:
    """Number of turning points of a line, rounding aside."""
    steps = np.diff(y)
    steps = steps[np.abs(steps) > 1e-6 * np.ptp(y)] if len(y) else steps
    return int(np.count_nonzero(np.diff(np.sign(steps))))


def _each(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)


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
