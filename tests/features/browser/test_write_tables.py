"""What the stages of `after` make of a table: short tables, bars, sheets of the runs' pictures, charts with groups."""

from __future__ import annotations

import csv
import hashlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.browser.stages.write_bars import WriteBars
from sppm_pipeline.features.browser.stages.write_chart import WriteChart
from sppm_pipeline.features.browser.stages.write_sheet import WriteSheet
from sppm_pipeline.features.browser.stages.write_table import WriteTable
from sppm_pipeline.nouns.table import RunFile, Table
from sppm_pipeline.testing.plain_context import PlainContext

COLUMNS = {
    "run": ("0000", "0001", "0002"),
    "name": ("octet", "a|b", "gyroid"),
    "E": (0.123456, None, 0.5),
    "n": (3, 4, 5),
}


def run(stage, table, tmp_path):
    context = PlainContext(directory=tmp_path)
    stage.check_options()
    stage.run(context, table)
    return (tmp_path / stage.path).read_bytes(), context


def test_a_markdown_table(tmp_path):
    stage = WriteTable(columns=("name", "E", "n"), headings=("structure", "E / E_s", "n"), sort="E", descending=True)
    text = run(stage, Table(COLUMNS), tmp_path)[0].decode()
    assert text == (
        "| structure | E / E_s | n |\n| --- | ---: | ---: |\n"
        "| gyroid | 0.5 | 5 |\n| octet | 0.123 | 3 |\n| a\\|b |  | 4 |\n"
    )


def test_a_csv_table(tmp_path):
    stage = WriteTable(path="t.csv", columns=("name", "E"), digits=6)
    rows = list(csv.reader(run(stage, Table(COLUMNS), tmp_path)[0].decode().splitlines()))
    assert rows == [["name", "E"], ["octet", "0.123456"], ["a|b", ""], ["gyroid", "0.5"]]


@pytest.mark.parametrize(
    ("stage", "words"),
    [
        (WriteBars(columns=("a",), headings=("$x",), path="a.gif"), "not as 'a.gif'"),
        (WriteBars(columns=("a",), headings=(r"$\x_$",)), r"`headings\[0\]` is"),
        (WriteChart(x="x", y="y", y_label="$_$"), "`y_label` is"),
        (WriteChart(x="x", y="y", kind="boxes", error="e"), "`error` belongs to points"),
        (WriteTable(columns=()), "no column"),
        (WriteTable(columns=("a",), headings=("x", "y")), "2 headings for 1"),
        (WriteBars(columns=()), "no column"),
    ],
)
def test_options_that_do_not_fit(stage, words):
    with pytest.raises(ConfigError, match=words):
        stage.check_options()


def test_bars_follow_the_order_and_the_mark(tmp_path):
    def pixels(**options):
        data, _ = run(WriteBars(label="name", columns=("E", "n"), **options), Table(COLUMNS), tmp_path)
        with Image.open(tmp_path / "bars.png") as image:
            return np.asarray(image.convert("RGB")).copy(), data

    plain, data = pixels()
    assert pixels()[1] == data
    assert not np.array_equal(pixels(sort="E")[0], plain)
    orange = (0xD5, 0x5E, 0x00)
    assert ((pixels(mark=("gyroid",))[0] == orange).all(axis=2)).sum() > 100
    assert not ((plain == orange).all(axis=2)).any()
    with pytest.raises(ConfigError, match="called 'gyriod'"):
        pixels(mark=("gyriod",))
    with pytest.raises(ConfigError, match="no column 'x'"):
        run(WriteBars(columns=("x",)), Table(COLUMNS), tmp_path)
    with pytest.raises(ConfigError, match="0 rows"):
        run(WriteBars(columns=("E",)), Table({"run": (), "E": ()}), tmp_path)


@pytest.fixture
def pictures(tmp_path):
    """A table whose first and last runs wrote a picture."""
    files: list[RunFile | None] = []
    for number, color in enumerate([(200, 10, 10), None, (10, 10, 200)]):
        path = tmp_path / "runs" / str(number) / "cell.png"
        path.parent.mkdir(parents=True)
        if color is not None:
            Image.new("RGB", (400, 200), color).save(path)
        files.append(RunFile(str(path), hashlib.sha256(path.read_bytes()).hexdigest()) if color else None)
    return Table(COLUMNS, {"cell.png": tuple(files)})


def test_a_sheet_of_the_pictures_of_all_runs(pictures, tmp_path):
    stage = WriteSheet(picture="cell.png", label="name", per_row=2, width=100)
    data, context = run(stage, pictures, tmp_path)
    with Image.open(tmp_path / "sheet.png") as image:
        shown = np.asarray(image)
    for color in ((200, 10, 10), (10, 10, 200)):
        assert (shown == color).all(axis=2).sum() == 100 * 50
    assert context.reported == {"pictures": 2}
    assert context.warnings == ["1 runs wrote no 'cell.png': a|b"]
    assert run(stage, pictures, tmp_path)[0] == data


def test_sheets_of_what_is_not_there(pictures, tmp_path):
    with pytest.raises(ConfigError, match=r"no run wrote a picture 'cel.png'") as caught:
        run(WriteSheet(picture="cel.png"), pictures, tmp_path)
    assert "cell.png" in caught.value.hint
    first = Path(pictures.files["cell.png"][0].path)
    first.write_bytes(b"no picture")
    with pytest.raises(InputError, match="changed since its run"):
        run(WriteSheet(picture="cell.png"), pictures, tmp_path)
    bad = RunFile(str(first), hashlib.sha256(b"no picture").hexdigest())
    with pytest.raises(InputError, match="is no picture"):
        run(WriteSheet(picture="cell.png"), Table(COLUMNS, {"cell.png": (bad, None, None)}), tmp_path)
    first.unlink()
    with pytest.raises(InputError, match="cannot read"):
        run(WriteSheet(picture="cell.png"), pictures, tmp_path)


def test_charts_take_groups_error_bars_and_logarithmic_axes(tmp_path):
    table = Table({"x": (1, 2, 3, 4), "y": (1.0, 10.0, 100.0, 1000.0), "g": ("b", "a", "b", None), "k": (2, 1, 2, 1)})
    seen = set()
    for options in (
        {}, {"group": "g"}, {"group": "k"}, {"group": "k", "group_label": "$k$"}, {"error": "x"}, {"kind": "means"},
        {"log_y": True}, {"log_x": True, "group": "g"}, {"x_label": r"$\nu_{xy}$"}, {"bound": "x"},
        {"hulls": True}, {"y": ("y", "x"), "log_y": (True, False)}, {"y": ("y", "x"), "y_label": ("a", "b")},
    ):  # fmt: skip
        stage = WriteChart(**({"x": "x", "y": "y"} | options))
        seen.add(run(stage, table, tmp_path)[0])
    # the last once more
    assert run(stage, table, tmp_path)[0] in seen
    assert len(seen) == 13
    for wrong, words in (
        ({"log_y": (True, False)}, "`log_y` has 2 values for 1"), ({"y": ("y", "x"), "line": True}, "single column"),
        ({"y": ("y", "x"), "y_label": ("a", "b", "c")}, "`y_label` has 3 values for 2"),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=words):
            WriteChart(**({"x": "x", "y": "y"} | wrong)).check_options()
    for extension, start in (("pdf", b"%PDF"), ("svg", b"<?xml")):
        assert run(WriteChart(x="x", y="y", path=f"a.{extension}"), table, tmp_path)[0].startswith(start)
        assert run(WriteBars(columns=("y",), label="g", path=f"b.{extension}"), table, tmp_path)[0].startswith(start)


def bound_lines(x, bound, groups, monkeypatch, tmp_path):
    shown = []
    monkeypatch.setattr(
        "sppm_pipeline.services.pictures.charts.charts_beside", lambda panels, *a, **k: shown.append(panels) or b""
    )
    table = Table({"x": tuple(x), "y": (1.0,) * len(x), "b": tuple(bound), "g": tuple(groups)})
    run(WriteChart(x="x", y="y", bound="b", group="g"), table, tmp_path)
    return [one for one in shown[0][0].series if one.kind == "dashed"]


def test_a_bound_is_one_line_unless_the_groups_differ(monkeypatch, tmp_path):
    x = np.array([0.4, 0.1, 0.3, 0.2, 0.3])
    (line,) = bound_lines(x, 1 - x**2, "ababa", monkeypatch, tmp_path)
    assert np.allclose((line.x, line.y), ([0.1, 0.2, 0.3, 0.4], 1 - np.array([0.1, 0.2, 0.3, 0.4]) ** 2))
    # of rows at one x the mean: draws whose bound varies a little
    (line,) = bound_lines([1, 1, 2, 2], [3.0, 5.0, 7.0, 9.0], "aabb", monkeypatch, tmp_path)
    assert (line.x.tolist(), line.y.tolist()) == ([1, 2], [4, 8])
    # rows without a group have a bound as well
    (line,) = bound_lines([2, 1], [3.0, 5.0], [None, None], monkeypatch, tmp_path)
    assert (line.x.tolist(), line.y.tolist()) == ([1, 2], [5, 3])
    # another bound of each group, where a single line would go up and down
    lines = bound_lines([1, 2, 3, 4, 5, 6], [1.0, 9.0, 2.0, 8.0, 3.0, 7.0], "ababab", monkeypatch, tmp_path)
    assert [(list(one.x), list(one.y)) for one in lines[:2]] == [([1, 3, 5], [1, 2, 3]), ([2, 4, 6], [9, 8, 7])]
    assert lines[0].color != lines[1].color
    assert [one.label for one in lines] == ["", "", "bound, of each"]


def test_a_family_is_what_a_name_begins_with(tmp_path):
    names, families = ("walls_a", "walls_b", "gyroid"), ("walls", "walls", "gyroid")
    values = {"x": (1, 2, 3), "y": (3.0, 2.0, 1.0)}
    grouped = run(WriteChart(x="x", y="y", group="g", family="_"), Table({**values, "g": names}), tmp_path)[0]
    plain = Table({**values, "g": families})
    assert grouped == run(WriteChart(x="x", y="y", group="g", family="_"), plain, tmp_path)[0]
    assert grouped == run(WriteChart(x="x", y="y", group="g"), plain, tmp_path)[0]


def test_lines_may_fall_and_need_two_values_of_x(tmp_path):
    table = Table({"x": (1, 2, 3), "y": (3.0, 2.0, 1.0), "one": (1, 1, 1), "minus": (-1, -2, 3)})
    reported = run(WriteChart(x="x", y="y", line=True), table, tmp_path)[1].reported
    assert reported == pytest.approx({"slope": -1, "intercept": 4, "r_squared": 1})
    assert run(WriteChart(x="x", y="one", line=True), table, tmp_path)[1].reported["r_squared"] == 1
    with pytest.raises(ConfigError, match="two different values of x"):
        run(WriteChart(x="one", y="y", line=True), table, tmp_path)
    with pytest.raises(ConfigError, match="fewer than two rows") as caught:
        run(WriteChart(x="x", y="minus", log_y=True), table, tmp_path)
    assert "positive" in caught.value.hint
