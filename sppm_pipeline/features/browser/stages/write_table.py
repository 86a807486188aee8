"""``write.table``: chosen columns of a table, under chosen headings."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import Any, ClassVar

from sppm_pipeline import Context, Stage, Table, option, options
from sppm_pipeline.method.families.file_writer import extension_of
from sppm_pipeline.nouns.table import check_columns


@dataclass(frozen=True, kw_only=True)
class WriteTable(Stage):
    """Write chosen columns of a table as Markdown or CSV, with rounded numbers.

    The table of a sweep has a column for every number of every stage, ``sweep.csv`` holds them all; this makes the
    short one that is read.
    """

    name: ClassVar[str] = "write.table"

    path: str = options.write_path("table.md", suffixes=(".md", ".csv"))
    columns: tuple[str, ...] = options.columns()
    headings: tuple[str, ...] = options.headings(())
    digits: int = option(3, help="significant digits of numbers", minimum=1, maximum=17)
    sort: str = options.sort("")
    descending: bool = options.descending(False)

    def check_options(self) -> None:
        """Columns, and a heading for each."""
        check_columns(self.columns, self.headings)

    def run(self, context: Context, table: Table) -> None:
        """Write the rows."""
        rows = table.order(self.sort, descending=self.descending) if self.sort else list(range(table.rows))
        columns = [table.column(name) for name in self.columns]
        headings = list(self.headings or self.columns)
        body = [[self._text(column[row]) for column in columns] for row in rows]
        if extension_of(self.path) == ".csv":
            text = io.StringIO()
            csv.writer(text, lineterminator="\n").writerows([headings, *body])
            written = text.getvalue()
        else:
            right = [all(not isinstance(value, str) for value in column) for column in columns]
            lines = [headings, ["---:" if one else "---" for one in right], *body]
            written = "".join(f"| {' | '.join(_cell(word) for word in line)} |\n" for line in lines)
        context.output(self.path).write_text(written, encoding="utf-8", newline="")

    def _text(self, value: Any) -> str:
        if value is None:
            return ""
        return f"{value:.{self.digits}g}" if isinstance(value, float) else str(value)


def _cell(text: str) -> str:
    """Escape a string so that it stays in its cell of a Markdown table."""
    return " ".join(text.replace("|", "\\|").split())
