"""A new physics in one folder outside of the package shows up wherever results are shown, without an edit elsewhere."""

import json
import re
from pathlib import Path

import pytest

from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.plan.plugins import import_file, load_plugins
from sppm_pipeline.features.browser.live.page import head_of
from sppm_pipeline.features.browser.live.views import view_of
from sppm_pipeline.nouns.viewers import viewer_of

PLUGIN = Path(__file__).with_name("dielectric") / "dielectric.py"
RUN = """
sppm: 1
name: laminate
pipeline:
  - {stage: homogenize.laminate, id: eps, share: 0.25}
  - {stage: write.view, path: eps.view}
"""
SWEEP = """
sppm: 1
params: {share: 0.5}
pipeline:
  - {stage: homogenize.laminate, id: eps, share: "${share}"}
sweep: {share: [0.25, 0.5, 0.75]}
after:
  - {stage: write.table, path: eps.md, columns: [share, COLUMN, eps.anisotropy]}
"""


def sppm(*words):
    return main([*map(str, words), "--plugin", str(PLUGIN)])


@pytest.fixture
def run(tmp_path, capsys):
    (tmp_path / "laminate.yaml").write_text(RUN, encoding="utf-8")
    assert sppm("run", tmp_path / "laminate.yaml", "-o", tmp_path / "run", "--no-cache", "--report") == 0
    return tmp_path / "run", capsys.readouterr().out


def test_it_stands_in_the_record_and_in_the_headline(run):
    folder, said = run
    summary = json.loads((folder / "run.json").read_bytes())["stages"][0]["summary"]
    across = 1 / (0.25 / 4 + 0.75)
    assert list(summary) == ["relative", "share", "spread", "anisotropy"]
    assert summary["relative"] == pytest.approx([1.75, 1.75, across])
    assert "relative 1.75 1.75 1.231 +- 1.5, relative3 1.23077, in plane over across 1.42188" in said


def test_it_stands_in_the_report(run):
    html = (run[0] / "report.html").read_text(encoding="utf-8")
    box = re.search(r'label">permittivity x, y, z</span><strong>([^<]*)</strong><span[^>]*><bdi>([^<]*)<', html)
    assert box.groups() == ("1.75, 1.75, 1.23", "± 1.5, eps")
    assert "permittivity over direction</text>" in html
    section = html[html.index("Laminates &lt;of&gt; the run") :]
    assert re.match(r"[^§]*?Mixed exactly[^§]*?laminate 1[^§]*?\[1.75, 1.75, 1.23077\][^§]*?<circle", section)
    assert 'id="data-view"' in html


def test_a_report_of_its_run_shows_it_only_with_the_plugin(run):
    target = run[0] / "report.html"
    assert main(["report", str(run[0]), "--no-cache", "--no-plugins"]) == 0
    assert "Laminates" not in target.read_text(encoding="utf-8")
    assert sppm("report", run[0], "--no-cache", "--no-plugins") == 0
    assert "Laminates" in target.read_text(encoding="utf-8")


def test_it_has_a_live_view_and_a_picture(run):
    head = head_of((run[0] / "eps.view").read_bytes())
    assert (head["title"], head["unit"], head["closed"]) == ("permittivity", "of vacuum's", True)
    report = import_file(PLUGIN).HomogenizeLaminate(share=0.25).run(None)
    assert report._repr_png_().startswith(b"\x89PNG")
    assert "<th>anisotropy</th><td>1.42188</td>" in report._repr_html_()


def test_it_has_columns_in_the_table_of_a_sweep(tmp_path, capsys):
    config = tmp_path / "sweep.yaml"
    config.write_text(SWEEP.replace("COLUMN", "eps.relative.3"), encoding="utf-8")
    assert sppm("run", config, "-o", tmp_path / "run", "--no-cache") == 0
    rows = (tmp_path / "run" / "eps.md").read_text(encoding="utf-8").splitlines()
    assert [float(cell) for cell in rows[3].split("|")[1:-1]] == [0.5, 1.6, 1.56]
    config.write_text(SWEEP.replace("COLUMN", "eps.relativ.3"), encoding="utf-8")
    assert sppm("check", config) == 2
    assert "did you mean 'eps.relative.3'" in capsys.readouterr().err


def test_it_stands_in_the_reference(capsys):
    assert sppm("stages") == 0
    assert "homogenize.laminate" in capsys.readouterr().out
    assert sppm("stages", "homogenize.laminate") == 0
    said = capsys.readouterr().out
    assert "makes   PermittivityReport" in said
    assert "fraction of the first phase" in said


def test_a_section_that_fails_says_so(run, tmp_path):
    broken = tmp_path / "broken.py"
    broken.write_text(
        "import sppm_pipeline as sppm\n\n@sppm.hookimpl\ndef sppm_report_sections(record):\n    raise KeyError('no')\n"
    )
    assert main(["report", str(run[0]), "--no-cache", "--no-plugins", "--plugin", str(broken)]) == 0
    assert "sppm_report_sections raised KeyError" in (run[0] / "report.html").read_text(encoding="utf-8")


def test_a_plugin_may_show_what_is_not_its_own(tmp_path):
    """By the hook `sppm_live_views`; the viewer of a type is that of the nearest type it derives from."""
    plugin = import_file(PLUGIN)
    shown = type("Shown", (plugin.PermittivityReport,), {})
    viewer = tmp_path / "viewer.py"
    viewer.write_text(
        "import sppm_pipeline as sppm\n\n"
        "def view(what, samples, threads):\n    return b'its own'\n\n"
        "def png(what):\n    return b'drawn'\n\n"
        "@sppm.hookimpl\ndef sppm_live_views():\n"
        f"    return {{'{shown.__module__}:Shown': sppm.nouns.Viewer(view, f'{{__name__}}:png')}}\n"
    )
    load_plugins(files=[viewer], distributions=False).raise_broken()
    report = plugin.HomogenizeLaminate(share=0.25).run(None)
    other = type("Finer", (shown,), {})(report.relative, report.share, report.spread)
    assert (view_of(other), other._repr_png_()) == (b"its own", b"drawn")
    assert viewer_of(plugin.PermittivityReport) is None
    assert head_of(view_of(report))["kind"] == "mesh"
