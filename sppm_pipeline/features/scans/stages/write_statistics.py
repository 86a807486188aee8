"""``write.statistics``: the curves of a structure's statistics as a table and a chart."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import ClassVar

from sppm_pipeline import Context, Stage, option, options
from sppm_pipeline.features.scans.statistics_report import CURVES, StatisticsReport


@dataclass(frozen=True, kw_only=True)
class WriteStatistics(Stage):
    """Draw one kind of curve of `measure.statistics`, and write all of them.

    Beside the chart stands a file of the same name that ends in ``.csv``, with the columns curve, distance (or length),
    value and error bar. Charts are drawn by matplotlib: ``pip install 'sppm-pipeline[plot]'``.
    """

    name: ClassVar[str] = "write.statistics"
    libraries: ClassVar[tuple[str, ...]] = ("matplotlib",)

    path: str = options.write_path("statistics.png", suffixes=options.CHARTS)
    curve: str = option("S2", help="curves that are drawn", choices=tuple(CURVES))
    title: str = options.title("", note="above the chart")

    def check_options(self) -> None:
        """A chart that can be drawn."""
        from sppm_pipeline.pictures import check_chart

        check_chart(self.path, title=self.title)

    def run(self, context: Context, report: StatisticsReport) -> None:
        """Draw and write."""
        from sppm_pipeline.pictures import Series, chart

        found = {phase: report.curves[f"{phase}.{self.curve}"] for phase in ("solid", "void")}
        series = [Series(curve[:, 0], curve[:, 1], phase, "line") for phase, curve in found.items()]
        unit = report.unit if report.unit == "mm" else "cell sizes"
        words = CURVES[self.curve]
        picture = chart(series, self.path, title=self.title, x_label=f"length / {unit}", y_label=words)
        context.output(self.path).write_bytes(picture)
        lines = ["curve,distance,value,error"]
        for name, rows in report.curves.items():
            lines += [f"{name}," + ",".join(f"{value:.8g}" for value in row) for row in rows]
        stem = str(PurePosixPath(self.path).with_suffix(".csv"))
        context.output(stem).write_text("\n".join(lines) + "\n", encoding="ascii")
