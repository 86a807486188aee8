"""``write.bars``: bars of several columns of a table, a row for each run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import ConfigError, Context, Stage, Table, option, options
from sppm_pipeline.nouns.table import check_columns

MAX_ROWS = 200
"""Maximum number of rows of a chart of readable size."""


@dataclass(frozen=True, kw_only=True)
class WriteBars(Stage):
    """Draw several columns of a table as panels of bars, one row for each row of the table.

    Each panel has a scale of its own, from zero, and the numbers stand beside the bars; where a run has no number there
    is a dash. Headings and the title may hold mathematics between dollar signs. Charts are drawn by matplotlib:
    ``pip install 'sppm-pipeline[plot]'``.
    """

    name: ClassVar[str] = "write.bars"
    libraries: ClassVar[tuple[str, ...]] = ("matplotlib",)

    path: str = options.write_path("bars.png", suffixes=options.CHARTS)
    label: str = options.label("run")
    columns: tuple[str, ...] = options.columns(note="that are drawn")
    headings: tuple[str, ...] = options.headings(())
    sort: str = options.sort("")
    descending: bool = options.descending(False)
    mark: tuple[str, ...] = option((), help="names of rows that are drawn in another color")
    title: str = options.title("", note="above the chart")

    def check_options(self) -> None:
        """Columns, a heading for each, and a chart that can be drawn."""
        from sppm_pipeline.services.pictures.chart_style import check_chart

        check_columns(self.columns, self.headings)
        check_chart(self.path, title=self.title, **{f"headings[{n}]": text for n, text in enumerate(self.headings)})

    def run(self, context: Context, table: Table) -> None:
        """Draw the panels."""
        from sppm_pipeline.services.pictures.bar_chart import Panel, bars
        from sppm_pipeline.services.pictures.chart_style import plain_text

        if not 0 < table.rows <= MAX_ROWS:
            raise ConfigError(f"the table has {table.rows} rows; bars can be drawn of 1 to {MAX_ROWS}")
        rows = table.order(self.sort, descending=self.descending) if self.sort else list(range(table.rows))
        names = table.texts(self.label)
        unknown = [name for name in self.mark if name not in names]
        if unknown:
            raise ConfigError(f"no row of column {self.label!r} is called {unknown[0]!r}", hint=f"there are {names}")
        headings = self.headings or tuple(plain_text(column) for column in self.columns)
        panels = [Panel(head, table.numbers(name)[rows]) for name, head in zip(self.columns, headings, strict=True)]
        marked = [place for place, row in enumerate(rows) if names[row] in self.mark]
        data = bars([names[row] for row in rows], panels, self.path, title=self.title, marked=marked)
        context.output(self.path).write_bytes(data)
