"""Charts: what is drawn where, what the files hold, and that their bytes depend on nothing but the data."""

from __future__ import annotations

import io
import itertools
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.services.pictures import bar_chart, chart_style, charts
from sppm_pipeline.services.pictures.bar_chart import Panel, bars
from sppm_pipeline.services.pictures.chart_style import COLORS, check_chart, number_text, plain_text
from sppm_pipeline.services.pictures.charts import Axis, Series, chart, charts_beside

X = np.array([1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, np.nan, 3.0])
Y = np.array([1.0, 2.0, 3.0, 6.0, 2.0, 4.0, 9.0, 5.0, np.inf])
NAMES = ["one", "two", "three"]


@pytest.fixture
def figure_of(monkeypatch):
    """Function from the arguments of a drawing function to the figure, in place of the file."""
    for module in (charts, bar_chart):
        monkeypatch.setattr(module, "figure_file", lambda figure, path: figure)
    return lambda draw, *arguments, **options: draw(*arguments, "a.png", **options)


def test_points_and_lines_are_where_the_data_are(figure_of):
    axes = figure_of(
        chart, [Series(X, Y), Series([0, 1], [2, 3], kind="line"), Series([0, 1], [2, 3], kind="dashed")]
    ).axes[0]
    points, line, dashed = axes.lines
    kept = np.isfinite(points.get_xdata()) & np.isfinite(points.get_ydata())
    assert points.get_xdata()[kept].tolist() == X[:7].tolist()
    assert points.get_ydata()[kept].tolist() == Y[:7].tolist()
    assert [one.get_linestyle() for one in (points, line, dashed)] == ["None", "-", "--"]
    assert [one.get_color() for one in (points, line, dashed)] == list(COLORS[:3])


def test_error_bars_have_the_length_of_the_error(figure_of):
    axes = figure_of(chart, [Series([1, 2, 3], [5, 6, 7], error=[0.5, np.nan, 2])]).axes[0]
    lengths = [segment[1, 1] - segment[0, 1] for segment in axes.collections[0].get_segments() if len(segment)]
    assert [length for length in lengths if np.isfinite(length)] == [1.0, 4.0]


def test_means_of_equal_x_with_their_standard_deviation(figure_of):
    axes = figure_of(chart, [Series(X, Y, kind="means")]).axes[0]
    assert axes.lines[0].get_xdata().tolist() == [1, 2]
    assert axes.lines[0].get_ydata().tolist() == [3, 5]
    segments = axes.collections[0].get_segments()
    found = [(segment[1, 1] - segment[0, 1]) / 2 for segment in segments]
    assert found == pytest.approx([np.std([1, 2, 3, 6], ddof=1), np.std([2, 4, 9], ddof=1)])


@pytest.mark.parametrize("log_x", [False, True])
def test_boxes_of_several_series_stand_side_by_side(figure_of, log_x):
    x = np.repeat([10.0, 20.0, 40.0], 5)
    y = np.tile([1.0, 2.0, 3.0, 4.0, 30.0], 3)
    axes = figure_of(chart, [Series(x, y, kind="boxes"), Series(x, y, kind="boxes")], log_x=log_x).axes[0]
    boxes = [patch.get_path().get_extents() for patch in axes.patches]
    assert len(boxes) == 6
    assert all((box.y0, box.y1) == (2, 4) for box in boxes)  # the quartiles
    sides = sorted((box.x0, box.x1) for box in boxes)
    assert all(first[1] < second[0] for first, second in itertools.pairwise(sides))
    for place, (left, right) in zip((10, 20, 40), zip(sides[::2], sides[1::2], strict=True), strict=True):
        assert left[1] < place < right[0]
    outliers = [line for line in axes.lines if line.get_marker() == "o"]
    assert [line.get_ydata().tolist() for line in outliers] == [[30.0]] * 6
    if not log_x:
        assert axes.get_xticks().tolist() == [10, 20, 40]


def test_logarithmic_axes_leave_out_what_is_not_positive(figure_of):
    axes = figure_of(chart, [Series([-1, 0, 1, 10], [1, 1, 0, 5])], log_x=True, log_y=True).axes[0]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    kept = np.isfinite(axes.lines[0].get_xdata()) & np.isfinite(axes.lines[0].get_ydata())
    assert kept.tolist() == [False, False, False, True]


def test_legends_have_a_title_and_all_names_in_order(figure_of):
    few = [Series([1], [1], "b"), Series([1, 2], [1, 2], "a", "line"), Series([1, 2], [1, 2], "", "line")]
    legend = figure_of(chart, few, legend=r"$\omega$").axes[0].get_legend()
    assert legend.get_title().get_text() == r"$\omega$"
    assert [text.get_text() for text in legend.get_texts()] == ["b", "a"]
    figure = figure_of(chart, [Series([1], [1], f"series {n}") for n in range(9)])
    assert figure.axes[0].get_legend() is None
    assert len(figure.legends[0].get_texts()) == 9
    looks = {(line.get_color(), line.get_marker()) for line in figure.axes[0].lines}
    assert len(looks) == 9


def test_bars_are_as_long_as_their_values(figure_of):
    figure = figure_of(bars, NAMES, [Panel("a", [4, -2, np.nan]), Panel("$b$", [1e6, 2e6, np.inf])], marked=[1])
    assert len(figure.axes) == 2
    first, second = figure.axes
    assert [bar.get_width() for bar in first.containers[0]] == [4, -2, 0]
    assert [bar.get_width() for bar in second.containers[0]] == [1e6, 2e6, 0]
    assert [text.get_text() for text in first.texts] == ["4", "-2", "–"]
    assert [text.get_text() for text in second.texts] == ["1e+06", "2e+06", "–"]
    assert [text.get_text() for text in first.get_yticklabels()] == NAMES
    bottom, top = first.get_ylim()
    assert bottom > top  # the first row is the highest
    from matplotlib.colors import to_hex

    assert [to_hex(bar.get_facecolor()) for bar in first.containers[0]] == [COLORS[0], COLORS[1], COLORS[0]]


def drawings():
    yield chart, [Series(X, Y, "a", "boxes"), Series(X, Y, "b", "means"), Series([1, 2], [1, 2], "$c^2$", "line")]
    yield bars, NAMES, [Panel(r"$\nu_{xy}$", [4, -2, np.nan]), Panel("b", [1, 2, 3])]


@pytest.mark.parametrize(("extension", "start"), [("png", b"\x89PNG"), ("PDF", b"%PDF"), ("svg", b"<?xml")])
@pytest.mark.parametrize("drawing", list(drawings()), ids=["chart", "bars"])
def test_files_are_the_same_each_time_and_hold_no_date_or_version(drawing, extension, start):
    import matplotlib

    draw, *arguments = drawing
    first, second = (draw(*arguments, f"a.{extension}", title="Title") for _ in range(2))
    assert first == second
    assert first.startswith(start)
    assert matplotlib.__version__.encode() not in first
    assert b"CreationDate" not in first
    assert b"dc:date" not in first
    if extension == "png":
        with Image.open(io.BytesIO(first)) as image:
            assert len(np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0)) > 20
            assert image.info.keys() == {"dpi"}
    elif extension == "PDF":
        assert b"DejaVuSans" in first


def test_a_style_of_the_user_changes_nothing_and_is_left_alone(tmp_path):
    import matplotlib

    arguments = [Series(X, Y, "a"), Series([1, 2], [1, 2], "b", "line")], "a.svg"
    plain = chart(*arguments, title="T")
    with matplotlib.rc_context({"font.size": 20, "axes.facecolor": "red", "lines.linewidth": 9, "svg.hashsalt": None}):
        assert chart(*arguments, title="T") == plain
        assert matplotlib.rcParams["font.size"] == 20
        assert matplotlib.rcParams["svg.hashsalt"] is None
    settings = tmp_path / "matplotlibrc"
    settings.write_text(
        "font.size: 20\naxes.facecolor: red\nsavefig.bbox: tight\nsvg.fonttype: none\nsavefig.pad_inches: 2\n"
    )
    code = (
        "import sys; from sppm_pipeline.services.pictures.charts import *; nan, inf = float('nan'), float('inf')\n"
        f"series = [Series({X.tolist()}, {Y.tolist()}, 'a'), Series([1, 2], [1, 2], 'b', 'line')]\n"
        "sys.stdout.buffer.write(chart(series, 'a.svg', title='T'))"
    )
    environment = {"MATPLOTLIBRC": str(settings), "MPLBACKEND": "pdf", "HOME": str(tmp_path), "PATH": ""}
    environment["XDG_CACHE_HOME"] = str(Path(matplotlib.get_cachedir()).parent)  # its list of fonts takes seconds
    found = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, check=True, timeout=600)
    assert found.stdout == plain


def test_threads_do_not_disturb_each_other():
    arguments = [Series(X, Y, "a")], "a.png"
    alone = chart(*arguments)
    made: list[bytes] = []
    threads = [threading.Thread(target=lambda: made.append(chart(*arguments))) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert made == [alone] * 3


def test_text_without_mathematics_is_drawn_as_it_is(figure_of):
    assert plain_text("5 $ to 6 $") == r"5 \$ to 6 \$"
    figure = figure_of(bars, ["a$_2$"], [Panel("x", [1])])
    assert figure.axes[0].get_yticklabels()[0].get_text() == r"a\$_2\$"
    assert number_text(0.25) == "0.25"
    assert number_text(-1.25e-7) == r"-1.25 \times 10^{-7}"
    chart([Series([1], [1], f"${number_text(1e-9)}$")], "a.png")  # and is valid


def test_what_cannot_be_drawn_is_refused_beforehand(monkeypatch):
    check_chart("deep/a.SVG", title=r"$E_x / E_\mathrm{s}$", x_label="5 $", y_label=r"\$ and \$")
    with pytest.raises(ConfigError, match=r"\.pdf, \.png or \.svg, not as 'a.jpg'"):
        check_chart("a.jpg")
    with pytest.raises(ConfigError, match=r"`title` is .*\\nosuch.*not valid mathematics") as caught:
        check_chart("a.png", title=r"$\nosuch_x$")
    assert "mathrm" in caught.value.hint
    monkeypatch.setattr(chart_style, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match="matplotlib, which is not installed") as caught:
        check_chart("a.png")
    assert caught.value.hint == "pip install 'sppm-pipeline[plot]'"


def test_wrong_arguments():
    with pytest.raises(ValueError, match="have shapes"):
        chart([Series([1, 2], [1])], "a.png")
    with pytest.raises(ValueError, match="have shapes"):
        chart([Series([1, 2], [1, 2], error=[1])], "a.png")
    with pytest.raises(DesignError, match="0 rows"):
        bars([], [Panel("a", [])], "a.png")
    with pytest.raises(DesignError, match="0 measures"):
        bars(NAMES, [], "a.png")
    with pytest.raises(ValueError, match="3 rows"):
        bars(NAMES, [Panel("a", [1, 2])], "a.png")


def test_charts_of_nothing_and_of_one_value():
    for series in (
        [],
        [Series([], [])],
        [Series([3], [3], "a")],
        [Series([np.nan], [1], "a", "boxes")],
        [Series([3], [3], kind="boxes")],
    ):
        assert chart(series, "a.png").startswith(b"\x89PNG")


def test_means_over_many_places_are_a_line_in_a_band():
    rng = np.random.default_rng(1)
    x = np.repeat(np.arange(40.0), 9)
    y = x + 3 * rng.standard_normal(x.size)
    many, few = (chart([Series(x[x < end], y[x < end], kind="means")], "c.svg").decode() for end in (40.0, 20.0))
    assert "FillBetween" in many
    assert "FillBetween" not in few
    assert few.count("<use") > many.count("<use") + 10  # no markers
    constant = chart([Series(x, x, kind="means")], "c.svg").decode()
    assert constant != many


def test_charts_side_by_side_have_their_own_axes_one_legend_and_hulls(figure_of):
    x, y = [1.0, 10.0, 10.0, 100.0, 10.0, np.nan], [1.0, 10.0, 100.0, 10.0, 50.0, 2.0]
    hulled = Series(x, y, "a", hull=True)
    panels = [Axis([hulled, Series([], [], "b", hull=True)], "first", True), Axis([hulled], "second", False)]
    figure = figure_of(charts_beside, panels, x_label="x", log_x=True, size=(3.0, 2.0))
    assert figure.get_size_inches().tolist() == [6.0, 2.0]
    left, right = figure.axes
    assert [axes.get_yscale() for axes in (left, right)] == ["log", "linear"]
    assert [axes.get_ylabel() for axes in (left, right)] == ["first", "second"]
    assert [len(axes.patches) for axes in (left, right)] == [2, 1]
    # (10, 10) lies on the edge from (1, 1) to (100, 10) of the plain chart, and inside that of the logarithms
    corners = {tuple(corner) for corner in left.patches[0].get_xy().tolist()}
    assert corners == {(1.0, 1.0), (100.0, 10.0), (10.0, 100.0)}
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["a"]


def test_hulls_go_once_around():
    x = np.array([0.0, 1, 1, 0, 0.5, 0.5, 1, np.nan])
    y = np.array([0.0, 0, 1, 1, 0.5, 0.0, 0.5, 3])
    assert sorted(charts._hull(x, y)) == [0, 1, 2, 3]
    assert charts._hull(x[:1], y[:1]) == []
    assert sorted(charts._hull(x[:2], y[:2])) == [0, 1]
