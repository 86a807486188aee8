"""Reports of runs of all kinds: what they say, how large they are, and that they are the same text every time."""

import base64
import contextlib
import gzip
import json
import re

import numpy as np
import pytest

from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.plan.plugins import load_plugins
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.engine.run.memory import run_in_memory
from sppm_pipeline.engine.run.verification import verify_run
from sppm_pipeline.engine.strict_json import json_text, sealed
from sppm_pipeline.errors import InputError
from sppm_pipeline.features.browser.live.page import MAGIC, encode_view, head_of
from sppm_pipeline.features.browser.live.views import clustered, view_of
from sppm_pipeline.features.browser.report.boxes import boxes, chart_svg, duration, line_chart, porosities, ticks
from sppm_pipeline.features.browser.report.build import report_html, wiring_svg
from sppm_pipeline.features.browser.report.command import fitted, live_view
from sppm_pipeline.features.browser.report.layers import layers_of, outputs_of, stored_layers, view_of_layers
from sppm_pipeline.features.browser.report.records import read_record
from sppm_pipeline.features.browser.report.sweeps import sweep_context
from sppm_pipeline.features.flow.permeability import PermeabilityReport
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.nouns.report import Curve
from sppm_pipeline.services.elastic.directional import sphere_mesh

BUILT_IN = Registry(load_plugins(distributions=False))


def report(folder, **options):
    return report_html(folder, read_record(folder), **options)


def shown(html):
    """The text of a page without its tags, scripts and styles."""
    return re.sub(r"<[^>]*>", " ", re.sub(r"<(script|style).*?</\1>", "", html, flags=re.S))


def changed(folder, **entries):
    record = read_record(folder) | entries
    (folder / "run.json").write_text(json_text(sealed(record)), encoding="utf-8")


def test_the_command_writes_a_page_that_is_no_part_of_the_run(copied, capsys):
    assert main(["report", str(copied), "--no-cache"]) == 0
    first = (copied / "report.html").read_bytes()
    assert f"{len(first) / 1e6:.2f} MB" in capsys.readouterr().out
    assert b'id="data-view"' in first
    assert verify_run(copied)[0] == []
    assert main(["report", str(copied), "--no-cache"]) == 0
    assert (copied / "report.html").read_bytes() == first
    assert main(["report", str(copied), "-o", str(copied.parent / "bare.html"), "--no-view"]) == 0
    assert b'id="data-view"' not in (copied.parent / "bare.html").read_bytes()


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [(["--max-size", "1kB"], 2, "200 kB"), (["--max-size", "many"], 2, "expected a size"), ([], 3, "no run")],
)
def test_what_can_not_be_done_is_said(tmp_path, capsys, words, code, said):
    assert main(["report", str(tmp_path), *words]) == code
    assert said in capsys.readouterr().err


def test_a_page_of_its_run_is_current(copied):
    from sppm_pipeline.features.browser.live.serving import is_current

    page = copied / "report.html"
    assert not is_current(copied, page)
    page.write_text(report(copied), encoding="utf-8")
    assert is_current(copied, page)
    changed(copied, seed=6)
    assert not is_current(copied, page)


def test_the_page_is_served_to_this_machine_only(copied):
    import http.client
    import threading

    from sppm_pipeline.features.browser.live.serving import LocalServer, handler_of

    (copied / "report.html").write_text("the page", encoding="utf-8")
    with LocalServer(0, handler_of(copied / "report.html")) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()

        def asked(path, host):
            connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
            with contextlib.closing(connection):
                connection.request("GET", path, headers={"Host": host})
                answer = connection.getresponse()
                return answer.status, answer.read()

        assert asked(f"/{server.token}/", f"localhost:{server.server_port}") == (200, b"the page")
        assert asked("/other/", "127.0.0.1")[0] == 403
        assert asked(f"/{server.token}/", "evil.example")[0] == 403
        assert asked(f"/{server.token}/other", "127.0.0.1")[0] == 404
        server.shutdown()


def test_a_changed_file_is_shown_in_red(copied):
    assert 'class="verdict good"' in report(copied)
    data = bytearray((copied / "part.stl").read_bytes())
    data[200] ^= 1
    (copied / "part.stl").write_bytes(data)
    html = report(copied)
    assert '<p class="verdict bad">' in html
    assert '<li class="bad"><b>changed</b> <bdi>part.stl</bdi>' in html


def test_runs_that_failed_have_a_report(copied):
    record = read_record(copied)
    error = {"kind": "DesignError", "message": "it does not fit", "hint": "make it smaller", "stage": "slice.field",
             "where": "small.yaml:9:3", "exit_code": 3}  # fmt: skip
    changed(copied, status="failed", error=error, stages=record["stages"][:8])
    text = shown(report(copied))
    for words in ("it does not fit", "make it smaller", "small.yaml:9:3", "exit code 3"):
        assert words in text
    html = report(copied)
    assert html.count('<details class="stage failed">') == 1
    assert html.count('<details class="stage missing">') == len(record["stages"]) - 9
    changed(copied, status="interrupted", error=None)
    assert "The run is interrupted" in shown(report(copied))


def test_a_record_of_somebody_else_is_refused(copied):
    record = read_record(copied)
    record["stages"][2]["summary"] = "none"
    with pytest.raises(InputError, match="not as this program writes them"):
        report_html(copied, record)
    (copied / "run.json").write_text("[]")
    with pytest.raises(InputError, match="no record"):
        read_record(copied)


def test_files_outside_of_the_run_are_not_shown(copied):
    (copied.parent / "secret.png").write_bytes((copied / "part.png").read_bytes())
    outputs = [{"path": "../secret.png"}, {"path": str(copied.parent / "secret.png")}, {"path": "part.png"}]
    assert outputs_of(copied, [{"outputs": outputs}]) == outputs[2:]


def test_layers_are_thinned_to_their_room(small_run):
    stored = stored_layers(small_run, read_record(small_run)["stages"], BUILT_IN)
    every = layers_of(*stored, 10**9)
    files = sorted((small_run / "slices").glob("[0-9]*.png"))
    assert every.files == [file.read_bytes() for file in files]
    assert every.numbers == list(range(64))
    written = next(s for s in read_record(small_run)["stages"] if s["id"] == "write.png")
    assert every.solid_mm2.sum() * every.layer_mm == pytest.approx(written["summary"]["solid_volume_mm3"], rel=1e-9)
    some = layers_of(*stored, sum(map(len, every.files)) // 3)
    assert sum(map(len, some.files)) <= sum(map(len, every.files)) // 3
    assert np.ptp(np.diff(some.numbers)) == 0
    assert "layers are shown, evenly spread" in report(small_run, max_bytes=20_000)


def test_layers_stand_for_a_part_of_which_nothing_else_is_left(small_run):
    _, stored = stored_layers(small_run, read_record(small_run)["stages"], BUILT_IN)
    head, field = opened_view(view_of_layers(stored))
    assert head["shape"] == [stored.size[0] + 2, stored.size[1] + 2, stored.layers + 2]  # none is left out
    inside = field.reshape(head["shape"][::-1])[1:-1, 1:-1, 1:-1]
    for k in (5, 40):
        assert np.array_equal(255 - inside[k], stored.image(k)[::-1])
    assert field.min() == 0
    assert inside.size < field.size
    assert np.allclose(np.add(head["origin"], np.array(head["size"]) / head["shape"]), stored.origin_mm)


def opened_view(data):
    """Head and field of a view file of samples."""
    head = head_of(data)
    (blob,) = head["blobs"]
    packed = data[len(data) - blob["bytes"] :]
    return head, np.cumsum(np.frombuffer(gzip.decompress(packed), np.uint8), dtype=np.uint8)


def test_a_view_gets_as_many_samples_as_there_is_room(small_run):
    part = open_run_part(small_run)
    whole, said = fitted(part, 150_000, 2**40, 2)
    assert said == ""
    some, said = fitted(part, 150_000, len(whole) // 2, 2)
    assert 0.2 * len(whole) < len(some) <= len(whole) // 2
    assert f"takes {len(whole) / 1e6:.1f} MB; it is shown with `--max-size 1MB`" in said
    assert fitted(part, 150_000, 500, 2)[0] is None


def open_run_part(folder):
    session = open_session(RunRequest(str(folder / "run.json"), distributions=False))
    return run_in_memory(session.plan(), threads=2, until="fill.implicit").result("fill.implicit")


def test_the_view_is_taken_from_the_run_itself(tmp_path, monkeypatch, capsys):
    """Without a cache, and with stages that no report would run again."""
    (tmp_path / "cell.yaml").write_text(CELL)
    monkeypatch.setitem(live_view.__kwdefaults__, "quick", -1.0)
    words = [str(tmp_path / "cell.yaml"), "-o", str(tmp_path / "run"), "--no-cache", "-q"]
    assert main(["run", *words, "--report"]) == 0
    assert 'id="data-view"' in (tmp_path / "run" / "report.html").read_text()
    assert main(["report", str(tmp_path / "run"), "--no-cache"]) == 0
    text = (tmp_path / "run" / "report.html").read_text()
    assert 'id="data-view"' not in text
    assert "is not in the cache; `sppm report --remake`" in text
    capsys.readouterr()


CELL = """
sppm: 1
pipeline:
  - {stage: sample.dart_throwing, total: 12, share: 0.55}
  - {stage: connect.mst}
  - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.05}
"""

PRINTED = """
sppm: 1
recipes:
  cell:
    - {stage: sample.dart_throwing, total: 12, share: 0.55}
    - {stage: connect.mst}
    - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.05}
pipeline:
  - {stage: read.primitive, shape: box, size: [5 mm, 5 mm, 3 mm]}
  - {stage: tile.scattered, recipe: cell, cell: 4 mm, porosity: 0.7}
  - {stage: fill.implicit, skin: 0.4 mm}
  - {stage: slice.field, printer: elegoo_mars_4, layer: 0.2 mm}
  - {stage: check.print, resin: generic_gray, pictures: 2}
  - {stage: write.goo, path: part.goo}
"""


def test_the_section_of_a_print(tmp_path, capsys):
    (tmp_path / "part.yaml").write_text(PRINTED)
    assert main(["run", str(tmp_path / "part.yaml"), "-o", str(tmp_path / "run"), "-q", "--report"]) == 0
    html = (tmp_path / "run" / "report.html").read_text()
    text = " ".join(shown(html).split())
    numbers = {stage["id"]: stage["summary"] for stage in read_record(tmp_path / "run")["stages"]}
    check, goo = numbers["check.print"], numbers["write.goo"]
    assert f"Print {check['verdict']}" in text
    assert text.index("Print ") < text.index("The structure")
    assert f"resin {goo['resin_ml']:.3g} ml, {goo['resin_g']:.3g} g generic_gray" in text
    assert f"largest cup {check['largest_cup_mm2']:.6g} mm²" in text
    assert "print/marked.png" in text
    assert f"porosity of the infill: layers {100 * goo['infill_porosity']:.2f} %" in text
    assert f"porosity of the part: layers {100 * (1 - goo['solid_volume_mm3'] / 75):.2f} %" in text
    assert f"{goo['layers']} layers of" in text
    assert 'id="data-layers"' in html
    assert str(tmp_path) not in html
    assert "audit: passed" in text
    capsys.readouterr()


def test_differences_of_porosity(small_run):
    record = read_record(small_run)
    found = {what: value for what, value, _ in porosities(record["stages"], None)}
    domain = record["stages"][4]["summary"]["volume_mm3"]
    numbers = {stage["id"]: stage["summary"] for stage in record["stages"]}
    assert found["layers"] == 1 - numbers["write.png"]["solid_volume_mm3"] / domain
    assert found["mesh"] == 1 - numbers["extract.marching_cubes"]["volume_mm3"] / domain
    view = head_of((small_run / "part.view").read_bytes())
    found = {what: value for what, value, _ in porosities(record["stages"], view)}
    assert found["field"] == pytest.approx(found["layers"], abs=0.003)
    stages = [
        {"id": "tune", "stage": "tune.porosity", "options": {"target": 0.5}, "summary": {"porosity": 0.5009}},
        {"id": "fill", "stage": "fill.implicit", "made": "Part", "summary": {"domain": {"volume_mm3": 100.0}}},
        {"id": "png", "stage": "write.png", "summary": {"solid_volume_mm3": 49.0, "layers": 3}},
        {"id": "mesh", "stage": "extract.x", "made": "SurfaceMesh", "summary": {"volume_mm3": 49.8}},
    ]
    made = {box.label: box for box in boxes({"seconds": 61.0, "threads": 2}, stages, None, {})}
    assert made["porosity: layers"].value == "51.00 %"
    assert made["porosity: layers"].note.startswith("+1.00 to wanted, +0.91 to field, +0.80 to mesh")
    assert made["porosity: layers"].bad
    assert not made["porosity: wanted"].bad
    assert made["time"].value == "1 min 1 s"
    assert [duration(s) for s in (0.01234, 3599.7, 7300, None)] == ["0.0123 s", "1 h 0 min", "2 h 1 min", "–"]


def test_a_chart_puts_values_where_they_belong():
    svg = line_chart([Curve([0, 5, 10], [0, np.nan, 2.0])], "x", "y", id_="c")
    assert 'd="M62.0 206.0M527.4 20.7"' not in svg  # NaN interrupts the curve
    places = re.search(r'class="s0" d="M([\d.]+) ([\d.]+)M([\d.]+) ([\d.]+)"', svg)
    x0, y0, x1, y1 = map(float, places.groups())
    low, high = (float(re.search(f'data-x{i}="([^"]+)"', svg)[1]) for i in range(2))
    assert x0 == pytest.approx(62 + (0 - low) / (high - low) * (546 - 62), abs=0.06)
    assert x1 == pytest.approx(62 + (10 - low) / (high - low) * (546 - 62), abs=0.06)
    assert y0 == 206.0 > y1 > 14
    assert line_chart([Curve([1.0], [np.nan])], "x", "y") == ""
    assert "<b>" not in line_chart([Curve([1, 2], [1, 2])], "<b>", "y")


@pytest.mark.parametrize(("low", "high", "found"), [(0, 1, [0, 0.2, 0.4, 0.6, 0.8, 1]), (-3, 7, [-2, 0, 2, 4, 6])])
def test_ticks_are_round(low, high, found):
    assert ticks(low, high) == pytest.approx(found)


def test_the_modulus_of_a_laminate_over_directions():
    stiffness = np.linalg.inv(np.diag([1 / 3.0, 1 / 3.0, 1.0, 5.0, 5.0, 5.0]))
    (chart,) = StiffnessReport.report_charts({"C": stiffness.tolist(), "unit": "MPa"})
    svg = chart_svg(chart)
    assert "Young&#x27;s modulus over direction, MPa</text>" in svg
    xy, yz, _ = re.findall(r'class="s\d" d="(M[^"]+)"', svg)[:3]
    radii = [np.hypot(*(np.array(p, float) - 160)) for p in re.findall(r"([\d.]+) ([\d.]+)", yz)]
    assert radii[0] == pytest.approx(118, abs=0.1)
    assert radii[45] == pytest.approx(118 / 3, abs=0.1)
    xy_radii = [np.hypot(*(np.array(p, float) - 160)) for p in re.findall(r"([\d.]+) ([\d.]+)", xy)]
    # along (1, 1, 0): 1 / E = (1/3 + 1/3 + 5) / 4
    assert xy_radii[23] == pytest.approx(118 * (4 / (1 / 3 + 1 / 3 + 5)) / 3, rel=0.02)
    assert StiffnessReport.report_charts({"C": np.zeros((6, 6)).tolist()}) == []
    assert StiffnessReport.report_charts({}) == []


def test_wiring_has_a_box_for_each_stage_and_a_line_for_each_input():
    def stage(id_, *sources, **more):
        inputs = {f"p{i}": source for i, source in enumerate(sources)}
        return {"id": id_, "stage": id_, "state": "done", "inputs": inputs, "recipes": {}} | more

    svg = wiring_svg([stage("a"), stage("b<i>"), stage("c", "a", "b<i>"), stage("d", "c", recipes={"recipe": "cell"})])
    assert svg.count("<rect") == 4
    assert svg.count('class="wire"') == 3
    assert "<i>" not in svg
    assert "recipe cell" in svg
    rows = re.findall(r'<rect x="[^"]+" y="(\d+)"', svg)
    a, b, c, d = map(int, rows)
    assert a == b < c < d
    assert wiring_svg([]) == ""


def test_ten_thousand_rows_fit(tmp_path):
    count = 10_000
    rng = np.random.default_rng(1)
    rows = [
        {"run": f"{i:05}", "omega": 20 + i % 50, **{f"e.n{j}": v for j, v in enumerate(rng.random(12).tolist())}}
        for i in range(count)
    ]
    runs = [{"run": f"{i:05}", "params": {"omega": 20 + i % 50}, "status": "done", "error": None} for i in range(count)]
    runs[3] |= {"status": "failed", "error": {"message": "no draw was <accepted>"}}
    record = {
        "sppm_run": 1, "config": {"name": "rows"}, "name": "rows", "status": "failed", "seed": 0, "params": {},
        "file": "rows.yaml", "started": "then", "seconds": 5.0, "threads": 2, "stages": [], "runs": runs,
    }  # fmt: skip
    (tmp_path / "run.json").write_text(json_text(sealed(record)), encoding="utf-8")
    (tmp_path / "sweep.json").write_text(json.dumps(rows), encoding="utf-8")
    (tmp_path / "runs" / "00000").mkdir(parents=True)
    (tmp_path / "runs" / "00000" / "report.html").write_text("x")
    html = report(tmp_path)
    assert len(html.encode()) <= 5_000_000
    assert html.count("<tr>") == 201
    assert "no draw was &lt;accepted&gt;" in html
    assert '<a href="runs/00000/report.html">' in html
    head = json.loads(re.search(r'id="head-rows">(.*?)</script>', html)[1])
    assert len(head["axes"]) == 13
    assert head["names"][head["first"][0]] == "omega"
    packed = re.search(r'id="data-rows">([^<]+)<', html)[1]
    assert len(json.loads(gzip.decompress(base64.b64decode(packed)))) == count


def test_columns_of_a_sweep_have_words_units_and_no_tuned_target(tmp_path):
    rows = [
        {"run": f"{i:04}", "p": 0.5 + 0.1 * i, "tune.porosity.porosity": 0.5001 + 0.1 * i, "h.voxel.E.1": 1.0 / (i + 1),
         "check.print.largest_cup_mm2": i, "flow.k": 3.0 * i}
        for i in range(4)
    ]  # fmt: skip
    runs = [{"run": row["run"], "params": {"p": row["p"]}, "status": "done", "error": None} for row in rows]
    table = {
        "id": "t",
        "stage": "write.table",
        "options": {"columns": ["run", "flow.k"], "headings": ["run", "k"]},
    }
    record = {"runs": runs, "stages": [table], "params": {"p": 1, "q": "a b"}, "seed": 4, "file": "x/rows.yaml"}
    (tmp_path / "sweep.json").write_text(json.dumps(rows), encoding="utf-8")
    columns = [{"titles": "flow.k", "schema:unitText": "mm2"}]
    (tmp_path / "sweep.csv-metadata.json").write_text(json.dumps({"tableSchema": {"columns": columns}}))
    head = json.loads(sweep_context(tmp_path, record, {"0002": b"ab", "0003": b"cde"})["head"])
    assert head["names"][:3] == ["run", "p", "flow.k"]
    labels = dict(zip(head["names"], zip(head["words"], head["units"], strict=True), strict=True))
    assert labels["flow.k"] == ("k", "mm2")
    assert labels["check.print.largest_cup_mm2"] == ("largest cup", "mm²")
    assert labels["h.voxel.E.1"][0] == "voxel E 1"
    assert [head["names"][n] for n in head["axes"]] == ["p", "flow.k", "h.voxel.E.1", "check.print.largest_cup_mm2"]
    assert [head["names"][n] for n in head["first"]] == ["p", "flow.k"]
    assert head["views"] == [["0002", 0, 2], ["0003", 2, 5]]
    assert (head["base"], head["file"]) == ({"q": "a b"}, "rows.yaml")


def arrays_of(data):
    """The arrays of a view file, flat, as the page's script unpacks them."""
    place, found = data.find(b"\n", len(MAGIC)) + 1, {}
    for blob in head_of(data)["blobs"]:
        kind = {"u8": "u1", "u16": "<u2", "u32": "<u4", "f32": "<f4"}[blob["type"]]
        flat = np.frombuffer(gzip.decompress(data[place : place + blob["bytes"]]), kind)
        assert flat.size == blob["count"]
        found[blob["name"]] = np.cumsum(flat, dtype=flat.dtype) if blob["delta"] else flat
        place += blob["bytes"]
    return found


def test_a_view_file_holds_what_it_was_given():
    arrays = {"a": np.arange(300).astype(np.uint8).reshape(3, 100), "b": np.array([1.5, -2.25], np.float32)}
    data = encode_view({"kind": "x"}, arrays)
    assert head_of(data)["kind"] == "x"
    there = arrays_of(data)
    assert (there["a"] == arrays["a"].ravel()).all()
    assert (there["b"] == arrays["b"]).all()
    assert encode_view({"kind": "x"}, arrays) == data
    for broken in (data[:-1], b"x" + data, data[:20], b"sppmview 1\n[]\n"):
        with pytest.raises(InputError, match="no view file"):
            head_of(broken)


def test_views_of_cells_tiles_and_fields(cell, wang, wang_tiling):
    head = head_of(view_of(cell))
    assert (head["kind"], head["pores"], head["tunnels"]) == ("kernels", [21], [40])
    assert head["porosity"] == pytest.approx(1 - cell.solid(64).mean(), abs=1e-12)
    tiles = head_of(view_of(wang))
    assert len(tiles["pores"]) == 8
    assert tiles["tile_porosity"] == list(wang.porosity)
    view = view_of(wang_tiling, samples=60_000)
    sampled, arrays = head_of(view), arrays_of(view)
    assert sampled["explore"]["interiors"] == 8
    assert (arrays["interior"] == wang_tiling.arrays.interior.ravel()).all()
    assert head_of(view_of(cell))["explore"] is None
    nx, ny, nz = sampled["shape"]
    assert nx * ny * nz <= 60_000
    assert nx / 4 == ny / 3 == nz / 3
    n = nx // 4
    sums = wang_tiling.sample(n) + wang_tiling.solid_below
    wanted = np.rint(255 * np.clip(sums / (3 * wang_tiling.solid_below), 0, 1))
    assert (wanted == arrays["field"].reshape(nz, ny, nx).T).all()


def test_a_mesh_in_a_view_keeps_its_shape():
    sphere, faces = sphere_mesh(4)
    ball = SurfaceMesh(np.array([3.0, 2.0, 1.0]) * sphere, faces, name="egg")
    head, arrays = head_of(view_of(ball)), arrays_of(view_of(ball))
    assert (head["kind"], head["title"], head["unit"], head["shown"]) == ("mesh", "egg", "mm", len(faces))

    def volume(points, triangles):
        a, b, c = (points[triangles[:, i]] for i in range(3))
        return np.einsum("ij,ij->", np.cross(a, b), c) / 6

    points = head["origin"] + arrays["vertices"].reshape(3, -1).T * (max(head["size"]) / 65535)
    triangles = arrays["faces"].reshape(3, -1).T.astype(int)
    whole = volume(ball.vertices, ball.faces)
    assert volume(points, triangles) == pytest.approx(whole, rel=1e-4)  # half a step is 5e-5 mm
    for most in (2000, 300):
        fewer, kept = clustered(ball.vertices, ball.faces, most)
        assert most / 3 < len(kept) <= most
        edges = np.sort(np.concatenate([kept[:, [0, 1]], kept[:, [1, 2]], kept[:, [2, 0]]]), axis=1)
        assert (np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all()  # closed
        assert volume(fewer, kept) == pytest.approx(whole, rel=30 / most)
    assert view_of(ball) == view_of(ball)


def test_a_stiffness_is_shown_by_its_modulus():
    stiffness = np.diag([2.0, 2, 2, 0.5, 0.5, 0.5])  # no Poisson's ratio: E is 2 along the axes
    view = view_of(StiffnessReport(stiffness, ((1.0, 2.0, 0.0),), "exact", unit="GPa"))
    assert head_of(view)["unit"] == "GPa"
    assert head_of(view)["size"] == pytest.approx([4, 4, 4], rel=0.01)


def test_a_run_without_a_field_shows_its_mesh(tmp_path, capsys):
    (tmp_path / "box.yaml").write_text(
        "sppm: 1\npipeline:\n  - {stage: read.primitive, shape: ball, size: [4 mm, 4 mm, 4 mm]}\n"
        "  - {stage: write.mesh, path: ball.stl}\n"
    )
    folder = str(tmp_path / "run")
    assert main(["run", str(tmp_path / "box.yaml"), "-o", folder, "--no-cache", "--report"]) == 0
    html = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    view = base64.b64decode(re.search(r'id="data-view">([^<]+)<', html)[1])
    assert head_of(view)["kind"] == "mesh"
    assert "triangles; coordinates have 16 bits" in html
    assert 'id="live-level"' not in html


def test_stiffness_and_permeability_stand_at_the_top():
    def found(made, **summary):
        stages = [{"id": "x", "stage": "homogenize.x", "made": made.__name__, "summary": summary, "options": {}}]
        return {box.label: (box.value, box.note) for box in boxes({"seconds": 1.0}, stages, None, {"x": made})}

    stiff = found(StiffnessReport, E=[293.74, 287.9, 213.6], unit="MPa", E_error=[23.7, 20.3, 20.2])
    assert stiff["Young's modulus x, y, z"] == ("294, 288, 214 MPa", "± 24 MPa, x")
    assert found(StiffnessReport, E=[0.25, 0.0, None]).keys() == {"time"}
    assert found(StiffnessReport, E=[]).keys() == {"time"}
    assert found(StiffnessReport, E=[0.25, 0.0, 0.1])["Young's modulus x, y, z"] == ("0.25, 0, 0.1", "x")
    flow = found(PermeabilityReport, k_mean=7.54e-4, darcy_mean=19097.4, error_relative=0.25)
    assert flow["permeability"] == ("1.91e+04 darcy", "± 25 %, x")
    assert found(PermeabilityReport, k_mean=7.54e-4)["permeability"] == ("0.000754 cell²", "x")


def test_pixels_that_are_square_have_one_size():
    stages = [{"id": "s", "stage": "slice.field", "summary": {"pixel_mm": [0.05, 0.05]}, "options": {}}]
    assert ("pixel", "0.05 mm") in [box[:2] for box in boxes({}, stages, None, {})]
    stages[0]["summary"]["pixel_mm"] = [0.019, 0.024]
    assert ("pixel", "0.019 x 0.024 mm") in [box[:2] for box in boxes({}, stages, None, {})]
    stages[0]["summary"]["pixel_mm"] = [[0.05], [0.05]]  # of a plugin, which may call anything so
    assert ("pixel", "[[0.05], [0.05]] mm") in [box[:2] for box in boxes({}, stages, None, {})]


def test_columns_that_sweeps_are_run_for_come_first():
    from sppm_pipeline.features.browser.report.sweeps import _rank

    names = [
        "tune.porosity.level",
        "tune.porosity.porosity",
        "elastic.E.1",
        "tune.porosity.pores",
        "h.voxel.E_relative",
    ]
    assert sorted(names, key=_rank)[:3] == ["tune.porosity.porosity", "h.voxel.E_relative", "elastic.E.1"]
