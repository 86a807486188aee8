"""Reports in Chromium: nothing is fetched, what is shown is what was computed, and it is all there without scripts."""

import base64
import dataclasses
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.strict_json import json_text, sealed
from sppm_pipeline.features.browser.live.page import ASSETS, head_of, live_page
from sppm_pipeline.features.browser.live.views import view_of
from sppm_pipeline.features.browser.report.build import report_html
from sppm_pipeline.features.browser.report.records import read_record
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.nouns.artifact import Surface, Viewable
from sppm_pipeline.numerics import Grid, cell_centers
from sppm_pipeline.services.elastic.directional import sphere_mesh
from tests.features.browser.conftest import page_of, until

pytestmark = pytest.mark.browser

WIDTH = 360
"""Of pages with a live view: software draws a small picture in a fraction of a second."""


def written(folder: Path, **options) -> Path:
    """The report of a run, beside it."""
    view = next(folder.glob("*.view"), None)
    page = folder / "report.html"
    text = report_html(folder, read_record(folder), view=view.read_bytes() if view else None, **options)
    page.write_text(text, encoding="utf-8", newline="\n")
    return page


SETTLED = "(d => d.passes && d.passes === d.most ? d : null)({...document.getElementById('live-canvas').dataset})"
DRAWN = "n => document.getElementById('layer').dataset.layer === String(n)"


@pytest.fixture(scope="module")
def opened(browser, small_run):
    """The report of the small run in a page, with all that it asked for and said."""
    with page_of(browser, written(small_run).as_uri(), WIDTH) as page:
        until(page, SETTLED, "the live view never settled")
        yield page


def slide(page, name, value):
    page.evaluate(
        "([n, v]) => { const s = document.getElementById(n); s.value = v; s.dispatchEvent(new Event('input')); }",
        [name, str(value)],
    )


def pixels_of(page, canvas):
    """A canvas as (height, width, 4) uint8, premultiplied as it is shown."""
    address = page.evaluate("id => document.getElementById(id).toDataURL('image/png')", canvas)
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(address.split(",")[1]))).convert("RGBA"))


def test_nothing_is_fetched_and_nothing_is_wrong(opened, small_run):
    assert opened.asked == [(small_run / "report.html").as_uri()]
    assert opened.heard == []
    policy = opened.get_attribute("meta[http-equiv=Content-Security-Policy]", "content")
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe-inline" not in policy.split(";")[1]
    assert opened.evaluate("document.documentElement.scrollWidth") <= WIDTH
    assert opened.evaluate("fetch('data:,x').then(() => 'fetched', () => 'refused')") == "refused"


def test_the_live_view_shows_what_the_picture_shows(opened, small_run):
    def cropped(mask):
        rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
        part = Image.fromarray(mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1])
        return np.asarray(part.resize((120, 120), Image.Resampling.NEAREST))

    live = cropped(pixels_of(opened, "live-canvas")[:, :, 3] > 127)
    still = cropped(np.asarray(Image.open(small_run / "part.png").convert("RGBA"))[:, :, 3] > 127)
    assert (live & still).sum() / (live | still).sum() >= 0.97


def porosity_shown(page):
    return float(page.evaluate("document.getElementById('live-readout').dataset.porosity"))


def test_the_porosity_follows_the_level(opened, small_run, part_of_run):
    head = head_of((small_run / "part.view").read_bytes())
    inside = part_of_run.domain.summary()["volume_mm3"]
    for level in (0.12, 0.18, 0.25, 0.33, 0.5):
        cut = dataclasses.replace(part_of_run, base=part_of_run.base.cut_at(level - head["level"]))
        spacing = 1 / 40
        solid = cut.solid(40).sum() * (spacing * head["edge_mm"]) ** 3
        slide(opened, "live-level", (level - head["base"]) / head["top"])
        assert porosity_shown(opened) == pytest.approx(1 - solid / inside, abs=0.003)
    opened.click("#live-design")
    assert porosity_shown(opened) == head["porosity"]


@pytest.fixture(scope="module")
def part_of_run(small_run):
    """The part of the small run, made again in memory."""
    from sppm_pipeline.engine.plan.session import RunRequest, open_session
    from sppm_pipeline.engine.run.memory import run_in_memory

    plan = open_session(RunRequest(str(small_run / "run.json"), distributions=False)).plan()
    return run_in_memory(plan, threads=2, until="fill.implicit").result("fill.implicit")


def test_layers_are_the_files(opened, small_run):
    files = sorted((small_run / "slices").glob("[0-9]*.png"))
    for number in np.random.default_rng(3).choice(len(files), 5, replace=False).tolist():
        slide(opened, "layer-slider", number)
        until(opened, f"({DRAWN})({number})", "the layer is not drawn")
        there = np.asarray(Image.open(files[number]).convert("RGBA"))
        assert (pixels_of(opened, "layer") == there).all()


def test_the_cut_follows_the_layer_and_the_layer_the_cut(opened, small_run):
    manifest = json.loads((small_run / "slices" / "manifest.json").read_text())
    layer, low = manifest["layer_mm"], manifest["origin_mm"][2]
    slide(opened, "layer-slider", 17)
    cut = float(opened.evaluate("document.getElementById('live-canvas').dataset.cut"))
    assert abs(cut - (low + 17.5 * layer)) < layer / 2
    until(opened, SETTLED, "the cut is not drawn")
    slide(opened, "live-cut", 0.5)
    head = head_of((small_run / "part.view").read_bytes())
    shown = int(opened.evaluate("document.getElementById('layer-slider').value"))
    assert abs(low + (shown + 0.5) * layer - (head["origin"][2] + head["size"][2] / 2)) <= layer / 2 + 1e-9


def test_a_click_on_the_chart_shows_the_layer(opened):
    box = opened.locator("#layers-chart").bounding_box()
    opened.evaluate("document.getElementById('layers-chart').scrollIntoView()")
    x0, x1, left, right = (
        float(opened.get_attribute("#layers-chart", f"data-{name}")) for name in ("x0", "x1", "left", "right")
    )
    across = (left + (40 - x0) / (x1 - x0) * (right - left)) / 560 * box["width"]
    opened.click("#layers-chart", position={"x": across, "y": box["height"] / 2})
    assert opened.evaluate("document.getElementById('layer-slider').value") == "40"


def test_the_browser_sums_kernels_as_the_program_does(browser, cell):
    page = browser.new_page()
    for name in ("base.js", "data.js", "kernels.js"):
        page.add_script_tag(path=str(ASSETS / name))
    view = list(view_of(cell))
    shown = page.evaluate(
        """async view => {
          const { head, arrays } = await readView(new Uint8Array(view));
          return [...sumBytes(sumKernels(head, arrays.pores, arrays.tunnels, 32), head.top)];
        }""",
        view,
    )
    page.close()
    wanted = np.rint(255 * np.clip(cell.sums(cell_centers(32)) / (3 * cell.level), 0, 1)).astype(int)
    there = np.array(shown).reshape(32, 32, 32).T
    assert np.abs(there - wanted).max() <= 1


@pytest.mark.parametrize("power", [1, 2, 3, 4])
def test_the_browser_sums_tunnels_of_any_power(browser, power):
    page = browser.new_page()
    page.add_script_tag(path=str(ASSETS / "kernels.js"))
    n, ends, mu = 24, np.array([[0.3, 0.5, 0.5], [0.7, 0.5, 0.4]]), 12 / 0.25**power  # reaches a quarter of the cell
    shown = page.evaluate(
        "([law, tunnels, n]) => [...sumKernels(law, [], tunnels, n)]",
        [{"power": power, "cutoff": 1e-5}, [*ends.ravel().tolist(), mu], n],
    )
    page.close()
    points = np.stack(np.meshgrid(*((np.arange(n) + 0.5) / n,) * 3, indexing="ij"), -1)
    along = ends[1] - ends[0]
    t = np.clip((points - ends[0]) @ along / (along @ along), 0, 1)
    distance = np.linalg.norm(points - ends[0] - t[..., None] * along, axis=-1)
    wanted = np.exp(-mu * distance**power)
    there = np.array(shown).reshape(n, n, n).T
    inside = wanted > 1e-4
    assert np.abs(there - wanted)[inside].max() < 1e-3


def test_the_browser_sums_any_cells_of_a_tiling(browser, free_tiling):
    page = browser.new_page()
    for name in ("base.js", "data.js", "kernels.js"):
        page.add_script_tag(path=str(ASSETS / name))
    low, m, n = (1, 0, -1), 2, 12  # half of it outside
    shown = page.evaluate(
        """async ([view, low, m, n]) => {
          const { head, arrays } = await readView(new Uint8Array(view));
          return [...sumCells(head.explore, arrays, low, m, n)];
        }""",
        [list(view_of(free_tiling, samples=20_000)), low, m, n],
    )
    page.close()
    grid = Grid(tuple(c + 0.5 / n for c in low), (1 / n,) * 3, (m * n,) * 3)
    wanted = free_tiling.kernel_sums(grid, 0, m * n)
    assert wanted.max() > 1
    assert np.abs(np.array(shown).reshape(wanted.shape) - wanted).max() < 1e-3


def test_a_cell_in_a_notebook(browser, cell, tmp_path):
    (tmp_path / "notebook.html").write_text(cell._repr_html_(), encoding="utf-8")
    page = browser.new_page(viewport={"width": 700, "height": 700})
    page.goto((tmp_path / "notebook.html").as_uri())
    frame = page.frames[1]
    until(
        frame,
        "document.getElementById('live-canvas') && document.getElementById('live-canvas').dataset.passes",
        "no frame",
    )
    before = porosity_shown(frame)
    assert before == pytest.approx(1 - cell.solid(64).mean(), abs=1e-9)
    slide(frame, "live-pore", 1.2)
    assert porosity_shown(frame) > before + 0.02
    page.close()


def test_without_webgl_the_picture_stays(browser, small_run):
    context = browser.new_context(viewport={"width": WIDTH, "height": 800}, color_scheme="dark")
    context.add_init_script(
        "const get = HTMLCanvasElement.prototype.getContext;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...rest) "
        "{ return kind === 'webgl2' ? null : get.call(this, kind, ...rest); };"
    )
    page = context.new_page()
    page.goto((small_run / "report.html").as_uri())
    until(page, "!document.getElementById('live-note').hidden", "nobody said so")
    assert page.is_visible("#still img")
    assert not page.is_visible("#live-level")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(20, 24, 29)"
    context.close()


def test_without_scripts_everything_is_there(browser, small_run):
    context = browser.new_context(java_script_enabled=False, viewport={"width": 1000, "height": 800})
    page = context.new_page()
    page.goto((small_run / "report.html").as_uri())
    assert page.is_visible("#still img")
    assert page.is_visible("#layer-still")
    assert page.is_visible(".wiring")
    assert not page.is_visible("#layer-controls")
    for words in ("porosity: layers", "porosity: mesh", "extract.marching_cubes", "all as they were written"):
        assert page.locator(f"text={words}").count() >= 1
    assert page.locator(".stage").count() == len(read_record(small_run)["stages"])
    context.close()


EVIL = '</script><script>window.pwned=1</script><img src=x onerror="window.pwned=1">\u202e' + "long" * 25_000


def test_hostile_names_are_text(browser, copied):
    record = read_record(copied)
    record["name"] = record["params"][EVIL] = EVIL
    record["warnings"] = [EVIL]
    record["config"]["name"] = EVIL
    record["status"], record["error"] = "failed", {
        "kind": EVIL, "message": EVIL, "hint": EVIL, "stage": EVIL, "where": EVIL, "exit_code": 3,
    }  # fmt: skip
    stage = record["stages"][0]
    stage["id"] = stage["stage"] = stage["made"] = EVIL
    stage["summary"] = stage["options"] = {EVIL: EVIL}
    stage["inner"] = [{"id": EVIL, "runs": 1, "seconds": 1.0, "summary": {EVIL: EVIL}}]
    (copied / "run.json").write_text(json_text(sealed(record)), encoding="utf-8")
    page = browser.new_page()
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(written(copied).as_uri())
    assert page.evaluate("window.pwned") is None
    assert len(asked) == 1
    assert EVIL[:60] in page.inner_text("h1")
    assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
    page.close()


def test_the_report_is_usable(opened, usable):
    usable(opened, ["#live-cut", "#live-level"])


def test_a_page_can_be_printed(opened):
    assert len(re.findall(rb"/Type\s*/Page\b", opened.pdf())) >= 1


def test_rows_of_a_sweep_keep_their_words_when_they_are_sorted(browser, tmp_path):
    values = (6.56314e-05, 0.25, -1234567.5, 97, 12345678, 1.5e-12, True, "a b", None, 0.000123456789)
    rows = [{"run": f"{i:04}", "n": i, "e.value": value} for i, value in enumerate(values)]
    runs = [{"run": row["run"], "params": {"n": row["n"]}, "status": "done", "error": None} for row in rows]
    record = {
        "sppm_run": 1, "config": {"name": "rows"}, "name": "rows", "status": "done", "seed": 0, "params": {},
        "file": "rows.yaml", "started": "then", "seconds": 5.0, "threads": 2, "stages": [], "runs": runs,
    }  # fmt: skip
    (tmp_path / "run.json").write_text(json_text(sealed(record)), encoding="utf-8")
    (tmp_path / "sweep.json").write_text(json.dumps(rows), encoding="utf-8")
    page = browser.new_page()
    page.goto(written(tmp_path).as_uri())
    until(page, "!document.getElementById('rows-controls').hidden", "the table has no script")
    shown = (
        "() => [...document.querySelectorAll('#rows tbody tr')].map(r => [...r.cells].slice(1).map(c => c.textContent))"
    )
    plain = page.evaluate(shown)
    assert [row[-1] for row in plain[:3]] == ["6.56314e-05", "0.25", "-1.23457e+06"]
    page.click("#rows th >> nth=1")
    assert page.evaluate(shown) == plain
    page.click("#rows th >> nth=1")
    assert page.evaluate(shown) == plain[::-1]
    page.close()


SWEEP = """
sppm: 1
name: sizes
params: {radius: 0.14, other: it's}
pipeline:
  - {stage: sample.dart_throwing, total: 12, share: 0.55}
  - {stage: connect.mst}
  - {stage: field.gaussian, pore_radius: "${radius}", tunnel_radius: 0.05}
  - {stage: homogenize.voxel, resolution: 8}
  - {stage: write.picture, from: field.gaussian, path: cell.png, image_size: [80, 60], resolution: 8, annotate: false}
sweep:
  radius: [0.12, 0.14, 0.16]
  seed: [1, 2]
"""


def test_a_point_of_a_sweep_leads_to_its_run(browser, tmp_path, capsys, usable):
    (tmp_path / "sizes.yaml").write_text(SWEEP)
    assert main(["run", str(tmp_path / "sizes.yaml"), "-o", str(tmp_path / "run"), "-q", "--report"]) == 0
    capsys.readouterr()
    runs = json.loads((tmp_path / "run" / "sweep.json").read_text())
    page = browser.new_page(viewport={"width": WIDTH, "height": 800})
    heard = []
    page.on("console", lambda message: heard.append(message.text))
    page.on("pageerror", lambda error: heard.append(str(error)))
    page.goto((tmp_path / "run" / "report.html").as_uri())
    until(page, "!document.getElementById('explore').hidden", "no scatter")

    page.select_option("#axis-x", label="radius")
    page.select_option("#axis-y", label="E relative")
    page.select_option("#better-x", "1")
    page.select_option("#better-y", "1")
    data = page.evaluate("({...document.getElementById('scatter').dataset})")
    assert data["points"] == "6"
    pairs = {row["run"]: (row["radius"], row["homogenize.voxel.E_relative"]) for row in runs}
    beaten = {
        a for a in pairs for b in pairs if a != b and all(p <= q for p, q in zip(pairs[a], pairs[b], strict=True))
    }
    assert set(data["pareto"].split()) == set(pairs) - beaten
    page.focus("#scatter")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    run = page.evaluate("document.getElementById('scatter').dataset.picked")
    row = next(row for row in runs if row["run"] == run)
    line = f"sppm run sizes.yaml -p other='it'\\''s' -p radius={row['radius']} --seed {row['seed']} -o picked/{run}"
    assert page.inner_text("#point-command") == page.inner_text("#short-rows") == line
    assert page.is_visible("#point-picture")
    until(page, "document.getElementById('live-canvas').dataset.passes", "no live cell")
    page.fill("#filter-low", "0.13")
    page.click("#filter-add")
    assert page.evaluate("document.getElementById('scatter').dataset.points") == "4"
    assert page.locator("#rows tbody tr").count() == 4
    page.click("#filters button")
    assert page.locator("#rows tbody tr").count() == 6
    page.locator("#scatter").scroll_into_view_if_needed()
    box = page.locator("#scatter").bounding_box()
    page.mouse.move(box["x"] + 40, box["y"] + 5)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + box["height"] - 5, steps=3)
    page.mouse.up()
    assert page.locator("#filters button").count() == 2
    assert page.locator("#rows tbody tr").count() < 6
    usable(page, ["#live-cut"])
    assert heard == []
    page.close()


def test_a_mesh_is_shown_and_cut_open(browser, tmp_path):
    sphere, faces = sphere_mesh(4)
    (tmp_path / "mesh.html").write_text(live_page(view_of(SurfaceMesh(3 * sphere, faces))), encoding="utf-8")
    page = browser.new_page(viewport={"width": WIDTH, "height": 500})
    heard = []
    page.on("pageerror", lambda error: heard.append(str(error)))
    page.goto((tmp_path / "mesh.html").as_uri())
    until(page, SETTLED, "no mesh")
    shown = pixels_of(page, "live-canvas")
    height, width = shown.shape[:2]
    y, x = np.mgrid[:height, :width]
    ball = np.hypot(x - (width - 1) / 2, y - (height - 1) / 2) < 0.46 * min(width, height)
    solid = shown[:, :, 3] > 127
    assert (solid & ball).sum() / (solid | ball).sum() >= 0.98
    assert not (shown[:, :, 0].astype(int) > 1.7 * shown[:, :, 1]).any()  # no inside is seen
    page.evaluate("delete document.getElementById('live-canvas').dataset.passes")
    slide(page, "live-cut", 0.5)
    until(page, SETTLED, "no cut")
    opened = pixels_of(page, "live-canvas")
    assert (opened[:, :, 3] > 127).sum() < 0.85 * solid.sum()
    assert (opened[:, :, 0].astype(int) > 1.7 * opened[:, :, 1]).sum() > 0.1 * solid.sum()
    assert page.inner_text("#live-cut-readout").endswith(" mm")
    assert not page.is_visible("#live-level")
    # the cut is a flat cap: one color from rim to rim, without the bowl behind it
    cap = opened[opened[:, :, 0].astype(int) > 1.7 * opened[:, :, 1]][:, :3].astype(int)
    assert len(cap) > 0.1 * solid.sum()
    assert (np.abs(cap - np.median(cap, axis=0)).max(1) <= 2).mean() > 0.95
    assert heard == []
    page.close()


def test_what_an_open_mesh_shows_of_its_back_is_no_cap(browser, tmp_path):
    sphere, faces = sphere_mesh(4)
    whole, bowl = SurfaceMesh(3 * sphere, faces), SurfaceMesh(3 * sphere, faces[sphere[faces][:, :, 2].max(1) < 0.5])
    assert [head_of(view_of(mesh))["closed"] for mesh in (whole, bowl)] == [True, False]
    (tmp_path / "bowl.html").write_text(live_page(view_of(bowl)), encoding="utf-8")
    page = browser.new_page(viewport={"width": WIDTH, "height": 500})
    page.goto((tmp_path / "bowl.html").as_uri())
    until(page, SETTLED, "no mesh")
    shown = pixels_of(page, "live-canvas")
    back = shown[shown[:, :, 0].astype(int) > 1.7 * shown[:, :, 1]][:, :3].astype(int)
    assert len(back) > 100
    assert np.ptp(back, axis=0).max() > 40  # round
    page.close()


@dataclasses.dataclass(frozen=True)
class Stretched(Viewable):
    """A ball that was stretched to twice its height."""

    def live_view(self):
        ball, faces = sphere_mesh(4)
        return Surface(ball * [1, 1, 2], faces, "a ball", "mm", ball, 50.0)


def test_a_slider_takes_back_what_a_surface_has_moved(browser, tmp_path):
    view = view_of(Stretched())
    (tmp_path / "ball.html").write_text(live_page(view), encoding="utf-8")
    page = browser.new_page(viewport={"width": WIDTH, "height": 500})
    page.goto((tmp_path / "ball.html").as_uri())
    areas, words = {}, []
    for share in (1, 0.5, 0):
        page.evaluate("delete document.getElementById('live-canvas').dataset.passes")
        slide(page, "live-moved", share)
        until(page, SETTLED, "no ball")
        areas[share] = (pixels_of(page, "live-canvas")[:, :, 3] > 127).sum()
        words.append(page.inner_text("#live-moved-readout"))
    page.close()
    assert words == ["50 times", "25 times", "as it was"]
    # the shadow of an ellipsoid with axes 1, 1, c along a direction of height z is pi (c^2 + (1 - c^2) z^2)^(1/2)
    z2 = (4 - (areas[1] / areas[0]) ** 2) / 3
    assert 0 < z2 < 0.9
    assert areas[0.5] / areas[0] == pytest.approx(np.sqrt(2.25 - 1.25 * z2), rel=0.02)
