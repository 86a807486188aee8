"""Every configuration that comes with the program runs, at a low resolution, and gives what its comment promises."""

import functools
import importlib.util
import io
import json
import weakref
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks import digests, kernel_list
from sppm_pipeline.engine.plan.kernels import kernels_of, listed_kernels
from sppm_pipeline.features.files.formats.detect import decode_mesh
from sppm_pipeline.method.part import primitive_meshes
from sppm_pipeline.services.formats import ply
from sppm_pipeline.services.mesh.measures import measure_surface

UNDECLARED = {"crush"}
"""Examples with a stage that reports more numbers than it declares: up to six frames are columns, one by one."""


def outputs(folder):
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def small(run_in, tmp_path_factory):
    """Runs a configuration or an example at a low resolution, once for all tests: the record and the run directory."""

    @functools.cache
    def run(name):
        scratch = tmp_path_factory.mktemp(name.replace("/", "_"))
        path, wanted = digests.small(name, scratch)
        return run_in(
            scratch, path, p=wanted.params, s=wanted.options, plugins=wanted.plugins, declared=name not in UNDECLARED
        )

    return run


def check_layers(folder, porous_share=None):
    manifest = json.loads((folder / "manifest.json").read_text())
    files = sorted(folder.glob("*.png"))
    assert len(files) == manifest["layers"]
    solid = 0
    for file in files:
        with Image.open(file) as image:
            assert image.size == (manifest["width_px"], manifest["height_px"])
            solid += int(np.asarray(image).astype(bool).sum())
    assert solid == manifest["solid_voxels"] > 0
    return manifest


def test_cell(small, summary):
    record, folder = small("cell")
    assert summary(record, "tune.porosity")["porosity"] == pytest.approx(0.5, abs=0.005)
    assert summary(record, "check.connectivity")["porosity"] == pytest.approx(0.5, abs=0.02)
    assert all(summary(record, "check.connectivity")["solid_wraps"])
    assert {"graph.graphml", "cell.png", "cell.ply", "run.json"} <= outputs(folder)
    vertices, faces = decode_mesh((folder / "cell.ply").read_bytes(), "cell.ply")
    found = measure_surface(vertices, faces)
    assert found.edges.closed
    assert found.volume == pytest.approx(0.5, abs=0.03)


def test_quickstart(small, summary):
    record, folder = small("quickstart")
    assert summary(record, "tile.scattered")["filled_cells"] > 10
    check_knot(record, folder, summary, rel=0.35)  # two cells across the tube


class Gone:
    pass


def test_the_kernels_that_the_quickstart_calls_are_compiled_ahead(tmp_path):
    """Called by a stage -> listed for it, for these types, in such pipelines; else run benchmarks/kernel_list.py."""
    gone = weakref.proxy(Gone())  # libraries leave such ones behind: nobody may ask them for their class
    called, calls = kernel_list.listed(["quickstart"], tmp_path)
    assert type(gone) is weakref.ProxyType
    assert len(called) > 40
    assert all("_add_tunnels_linear" in text for text in calls.unlisted)  # made for each profile
    listed = {k.place: k for k in kernels_of(set(called[0]["with"]), listed_kernels())}
    for call in called:
        kernel = listed[call["kernel"]]
        assert set(call["stages"]) <= set(kernel.stages), kernel.place
        for signature in call["signatures"]:
            assert signature in kernel.signatures, kernel.place


def test_printer(small, summary):
    record, folder = small("printer")
    written = summary(record, "write.goo")
    assert (written["printer"], written["layers"], written["verified_on_hardware"]) == ("elegoo_saturn_4", 10, False)
    assert 0.1 < written["resin_ml"] / (np.pi * 0.6**2 * 0.05) < 0.6
    assert written["print_time_s"] == pytest.approx(5 * (25 + 8.5) + 5 * (2.5 + 8.5))
    assert (folder / "puck.goo").stat().st_size > 195_477 + 10 * 70
    with Image.open(folder / "puck-overview.png") as sheet:
        assert sheet.size[0] > 500


def test_wang_part(small, summary):
    record, folder = small("wang_part")
    assert summary(record, "tileset.wang_3color")["porosity"] == pytest.approx(0.7, abs=0.02)
    assert "tiles.png" in outputs(folder)
    check_knot(record, folder, summary, rel=0.35)  # two cells across the tube


def check_knot(record, folder, summary, rel):
    manifest = check_layers(folder / "slices")
    assert (manifest["width_px"], manifest["layers"]) == (48, 24)
    volume = summary(record, "read.primitive")["volume_mm3"]
    cut = manifest["solid_volume_mm3"] / (1 - manifest["removed_share"])  # on this grid, whole struts are islands
    assert cut == pytest.approx(0.3 * volume, rel=rel)
    vertices, faces = decode_mesh((folder / "part.stl").read_bytes(), "part.stl")
    assert measure_surface(vertices, faces).edges.bounds_solid
    assert {"part.png", "slices-overview.png"} <= outputs(folder)


def test_bunny(small, summary):
    record, folder = small("bunny")
    size = summary(record, "read.mesh")["size_mm"]
    assert size[2] == pytest.approx(12)
    manifest = check_layers(folder / "slices")
    assert manifest["layers"] in (16, 17)
    assert manifest["pixel_mm"] == pytest.approx([0.75, 0.75])
    assert manifest["width_px"] * 0.75 == pytest.approx(size[0], abs=1.5)


def test_scattered(small, summary):
    record, folder = small("scattered")
    assert summary(record, "tile.scattered")["filled_cells"] == 4
    assert summary(record, "check.connectivity")["porosity"] == pytest.approx(0.7, abs=0.03)
    assert summary(record, "check.connectivity")["void_wraps"] == [True, True, True]
    manifest = check_layers(folder / "slices")
    assert (manifest["width_px"], manifest["layers"]) == (20, 10)
    assert {"box.stl", "box.png"} <= outputs(folder)


def test_scattered_part(small, summary):
    record, folder = small("scattered_part")
    manifest = check_layers(folder / "slices")
    assert manifest["layers"] == 24
    assert summary(record, "tile.scattered")["filled_cells"] > 4
    assert "part.png" in outputs(folder)


def test_graded_bar(small, summary):
    record, folder = small("graded_bar")
    assert summary(record, "check.local_porosity")["cell_error_max"] < 0.004
    assert summary(record, "tune.local_porosity")["cells_at_bound"] == 0
    assert summary(record, "check.connectivity")["graph_parts"] == 1
    rows = (folder / "porosity" / "cells.csv").read_text().splitlines()
    assert [row.split(",")[7] for row in rows[1:]] == [f"{p:.6f}" for p in (0.75, 0.65, 0.55, 0.45, 0.35, 0.25)]
    assert {"bar.png", "porosity/section.png", "porosity/scatter.png", "porosity/porosity.vti"} <= outputs(folder)


def test_how_random(small):
    _, folder = small("how_random")
    (row,) = json.loads((folder / "sweep.json").read_text())
    assert row["status"] == "done"
    assert row["repeated.bragg_share"] == pytest.approx(1, abs=1e-3)
    assert min(row["paper.folded_corner"], row["paper.folded_edge"]) > 0.4
    assert row["scattered.bragg_share"] < row["fresh.bragg_share"] < row["wang.bragg_share"]
    assert {f"{name}.png" for name in ("paper", "wang", "scattered")} <= {Path(p).name for p in outputs(folder)}


def test_tileset_27(small, summary):
    record, folder = small("tileset_27")
    tiles = summary(record, "tileset.wang_3color")
    assert tiles["interiors"] == 27
    assert tiles["colors"] == [3, 3, 3]
    assert tiles["porosity"] == pytest.approx(0.55, abs=0.01)
    assert 0 < summary(record, "check.residual_periodicity")["bragg_share"] < 1
    assert {"tiles.png", "assembly.png"} <= outputs(folder)


def test_periodic_vs_stochastic(small, summary):
    record, folder = small("periodic_vs_stochastic")
    assert [run["status"] for run in record["runs"]] == ["done", "done"]
    for row in json.loads((folder / "sweep.json").read_text()):
        assert row["repeated_order.bragg_share"] == pytest.approx(1, abs=1e-3)
        assert row["stochastic_order.bragg_share"] < 0.9
        assert row["check.connectivity.porosity"] == pytest.approx(0.55, abs=0.06)


def test_porosity_map(small, summary):
    record, folder = small("porosity_map")
    rows = json.loads((folder / "sweep.json").read_text())
    assert len(rows) == 9
    assert all(row["status"] == "done" for row in rows)
    mean = [np.mean([r["check.porosity.porosity"] for r in rows if r["pores"] == n]) for n in (20, 60, 100)]
    assert mean[0] < mean[1] < mean[2]
    assert 0.1 < mean[0] < 0.3
    assert 0.6 < mean[2] < 0.9
    assert summary(record, "write.chart")["r_squared"] > 0.95
    assert "porosity_map.png" in outputs(folder)


def test_table_mesh_free(small):
    record, folder = small("table_mesh_free")
    assert record["runs"][0]["status"] == "done"
    manifest = check_layers(next(folder.glob("runs/*/slices")))
    assert (manifest["width_px"], manifest["height_px"], manifest["layers"]) == (8, 16, 24)


def test_stiffness_map(small):
    _, folder = small("stiffness_map")
    few, many = json.loads((folder / "sweep.json").read_text())
    assert few["status"] == many["status"] == "done"
    # more pores take solid away, and stiffness more than in proportion
    assert few["elastic.porosity"] == pytest.approx(0.3, abs=0.03)
    assert many["elastic.porosity"] == pytest.approx(0.6, abs=0.03)
    assert few["elastic.porosity"] < many["elastic.porosity"]
    for row in (few, many):
        assert 0 < row["elastic.E_relative"] < 1 - row["elastic.porosity"]
    assert few["elastic.E_relative"] > many["elastic.E_relative"]
    assert {"young.png", "poisson.png", "deviation.png", "deviation_invariant.png"} <= outputs(folder)


def test_representative_volume(small, summary):
    record, folder = small("representative_volume")
    assert {"young.png", "poisson.png", "deviation.png"} <= outputs(folder)
    sizes = summary(record, "elastic")["sizes"]
    assert set(sizes) == {"1", "2"}
    for found in sizes.values():
        assert found["E_x"]["count"] == 2
        assert found["porosity"]["mean"] == pytest.approx(0.55, abs=0.02)
        assert 0 < found["E_x"]["mean"] < 0.45  # less than the share of solid


def test_walls(small, summary):
    record, folder = small("walls")
    assert summary(record, "walls")["porosity"] == pytest.approx(0.7, abs=0.005)
    assert summary(record, "phases")["void_removed_share"] < 1e-4
    assert all(summary(record, "phases")["solid_wraps"])
    assert summary(record, "check.sizes")["thinnest_wall"] < summary(record, "check.sizes")["narrowest_tunnel"]
    assert summary(record, "elastic")["isotropic"]["E"] > 0.1
    assert {"walls.png", "walls.ply"} <= outputs(folder)


def test_walls_tetrahedra(small):
    """Limits of fine grids agree better than the finest grids; the power of the spacing is that of the docs."""
    _, folder = small("walls_tetrahedra")
    coarse, fine, quadratic = json.loads((folder / "sweep.json").read_text())
    # quadratic elements are the softer, and the better, though their mesh is half as fine
    assert quadratic["tetrahedra.isotropic.E"] < coarse["tetrahedra.isotropic.E"]
    limits = []
    for name in ("tetrahedra.isotropic.E", "voxels.isotropic.E"):
        assert coarse[name] > fine[name]
        limits.append(fine[name] - (coarse[name] - fine[name]) / (1.5**1.5 - 1))
    assert fine["tetrahedra.isotropic.E"] / fine["voxels.isotropic.E"] > 1.03
    assert limits[0] / limits[1] == pytest.approx(1, abs=0.02)
    assert "agreement.md" in outputs(folder)


def test_composite(small):
    _, folder = small("composite")
    stiff, soft = json.loads((folder / "sweep.json").read_text())
    assert stiff["elastic.isotropic.E"] > soft["elastic.isotropic.E"] > 0
    assert 8e-5 < soft["elastic.expansion.1"] < stiff["elastic.expansion.1"] < 2.5e-4
    assert {"modulus.png", "expansion.png"} <= outputs(folder)


def test_crush_density(small):
    _, folder = small("crush_density")
    dense, light = json.loads((folder / "sweep.json").read_text())
    assert dense["measured.energy_40"] > 2 * light["measured.energy_40"] > 0
    assert {"energy.md", "energy.png"} <= outputs(folder)


def test_crush_animation(small, summary):
    record, folder = small("crush_animation")
    assert summary(record, "crush")["strain_max"] == pytest.approx(0.6)
    with Image.open(folder / "crushing" / "animation.png") as animation:
        assert animation.n_frames == 13


def rows_of(folder):
    """The rows of a sweep by their structure."""
    return {row["structure"]: row for row in json.loads((folder / "sweep.json").read_text())}


def test_compare_structures(small):
    _, folder = small("compare_structures")
    rows = rows_of(folder)
    assert len(rows) == 22
    for name, row in rows.items():
        assert row["tuned.porosity"] == pytest.approx(0.7, abs=0.02)
        assert row["elastic.bounds.within_voigt_and_reuss"] == 1
        if name not in ("stochastic_gyroid", "closed_foam"):  # their walls are thinner than these voxels
            assert [row[f"phases.solid_wraps.{axis}"] for axis in (1, 2, 3)] == [1, 1, 1], name
            assert 0 < row["sizes.solid.mean"] < 1 < row["pores.tortuosity.1"], name
    assert rows["octet"]["elastic.zener"] > 1 > rows["simple_cubic"]["elastic.zener"]
    table = (folder / "comparison.md").read_text().splitlines()
    assert len(table) == 2 + len(rows)
    assert len({line.count("|") for line in table}) == 1
    for name in ("comparison.png", "structures.png"):
        with Image.open(folder / name) as image:
            assert min(image.size) > 200


def test_property_map(small):
    """More pores are less permeable and have more surface; the gyroid is stiffer than the paper's pores."""
    _, folder = small("property_map")
    few, many, gyroid = (rows_of(folder)[name] for name in ("wide_16", "wide_64", "gyroid_1"))
    assert few["sound.permeability"] > 1.5 * many["sound.permeability"] > 0
    assert many["sizes.specific_surface"] > 1.3 * few["sizes.specific_surface"]
    assert gyroid["elastic.isotropic.E"] > 1.2 * few["elastic.isotropic.E"]
    assert 0 < few["sound.absorption_at.1000"] < many["sound.absorption_at.1000"] < 1
    assert (folder / "property_map.md").read_text().count("\n") == 5
    with Image.open(folder / "property_map.png") as image:
        assert image.size == (3000, 680)


def test_walls_are_as_stiff_as_the_gyroid(small):
    """The preset's limit of fine grids is 1.18 gyroids."""
    _, folder = small("walls_stiffness")
    rows = rows_of(folder)
    young = {name: row["elastic.isotropic.E"] for name, row in rows.items()}
    assert 1.14 < young["stiff"] / young["gyroid"] < 1.22
    assert young["gyroid"] > 1.6 * young["paper"]
    assert rows["stiff"]["elastic.deviation_invariant"] < 0.03 < rows["paper"]["elastic.deviation_invariant"]


def test_stiffest(small):
    """Walls beside tunnels, on a coarse grid."""
    _, folder = small("stiffest")
    rows = rows_of(folder)
    young = {name: row["elastic.isotropic.E"] for name, row in rows.items()}
    assert young["walls_hyper_mbdst_20"] > young["tunnels_hyper_mbdst_20"] > 0
    assert all(young[name] < row["elastic.bounds.hashin_shtrikman_young.2"] for name, row in rows.items())
    assert {"stiffest.png", "permeable.png", "stiffest.md"} <= outputs(folder)


def test_stiffest_grid(small):
    _, folder = small("stiffest_grid")
    rows = rows_of(folder)
    assert rows["walls"]["elastic.isotropic.E"] > rows["tunnels"]["elastic.isotropic.E"] > 0
    assert {"grid.png", "grid.md"} <= outputs(folder)


def test_crush_structures(small):
    _, folder = small("crush_structures")
    rows = rows_of(folder)
    for row in rows.values():
        assert row["crush.numbers.relative_density"] == pytest.approx(0.3, abs=0.03)
        assert 0.2 < row["measured.energy_25"] < row["measured.energy_40"] < 0.4 * 29
    # struts bend before walls do
    assert rows["tpms_p"]["measured.energy_25"] > 1.3 * rows["sppm_1"]["measured.energy_25"]
    assert len((folder / "crushed.md").read_text().splitlines()) == 4


def test_published_curves(small, tmp_path):
    _, folder = small("published_curves")
    rows = rows_of(folder)
    assert len(rows) == 5
    assert all(row["elastic.bounds.bulk_within"] == 1 for row in rows.values())
    path = digests.ROOT / "plugins" / "sppm-structures" / "examples" / "draw_published_curves.py"
    spec = importlib.util.spec_from_file_location("draw_published_curves", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.draw(folder, tmp_path / "curves.png")
    with Image.open(tmp_path / "curves.png") as image:
        assert image.size == (1000, 720)


@pytest.mark.parametrize("name", sorted(digests.SMALL))
def test_results_are_those_of_the_list(small, name):
    _, folder = small(name)
    digests.check(name, folder)


@pytest.mark.parametrize("which", ["configs", "examples"])
def test_no_configuration_is_forgotten(which):
    folder = digests.ROOT / which
    paths = [*folder.glob("*.yaml"), *folder.glob("designs/*.yaml")]
    names = {path.relative_to(folder).with_suffix("").as_posix() for path in paths}
    assert names == set(getattr(digests, which.upper()))


def test_only_what_a_file_says_counts(tmp_path):
    """Neither compression, nor the order of keys, nor rounding; but a pixel, a face, the sixth digit."""

    def differs(name, first, second):
        made = []
        for number, data in enumerate((first, second)):
            folder = tmp_path / f"{number}"
            folder.mkdir(exist_ok=True)
            (folder / name).write_bytes(data)
            made.append(digests.digests(folder))
            (folder / name).unlink()
        return made[0] != made[1]

    def png(level, **changed):
        pixels = np.zeros((4, 5), np.uint8)
        pixels[0, 0] = changed.get("corner", 0)
        out = io.BytesIO()
        Image.fromarray(pixels).save(out, "PNG", compress_level=level)
        return out.getvalue()

    assert png(0) != png(9)
    assert not differs("a.png", png(0), png(9))
    assert differs("a.png", png(0), png(0, corner=1))

    vertices, faces = primitive_meshes.torus_mesh((3.0, 4.0, 5.0), 2.0, 1.0, 8, 6)
    mesh, moved, turned = (
        b"".join(ply.encode(*arrays))
        for arrays in ((vertices, faces), (vertices + np.array([0, 0, 1e-3]), faces), (vertices, faces[:, [1, 2, 0]]))
    )
    assert differs("a.ply", mesh, moved)
    assert differs("a.ply", mesh, turned)

    base = {"b": 1, "a": {"E": 0.123456, "C": [[1.0, 1e-12], [1e-12, 1.0]], "C.1": 2.0, "C.2": 3e-13}}
    near = {"a": {"C": [[1.0, -3e-12], [0.0, 1.0 + 1e-9]], "E": 0.1234560001, "C.1": 2.0, "C.2": -5e-13}, "b": 1}
    assert not differs("a.json", json.dumps(base).encode(), json.dumps(near, indent=1).encode())
    for far in (base | {"b": 2}, base | {"a": base["a"] | {"E": 0.123457}}, base | {"a": base["a"] | {"C.2": 1e-5}}):
        assert differs("a.json", json.dumps(base).encode(), json.dumps(far).encode())
    assert not differs("a.csv", b"x,y\n1.5,2.0\n3.5,1e-12\n", b"x,y\n1.5000000001,2.0\n3.50,0.0\n")
    assert differs("a.csv", b"x,y\n1.5,2.0\n", b"x,y\n1.5,2.00001\n")
    assert differs("a.md", b"| 1.5 |", b"| 1.6 |")
    with pytest.raises(ValueError, match=r"no decoder for \.xyz"):
        differs("a.xyz", b"", b"")


def test_a_change_is_told(monkeypatch, tmp_path):
    """Which output of which configuration, and how to accept it; those with an asterisk only where they are alike."""
    listed = {"gone.png": "0", "kept.md": "1", "new.csv": "2", "same.ply": "3*", "moved.ply": "4*"}
    found = {"kept.md": "1", "new.csv": "5", "more.md": "6", "same.ply": "3", "moved.ply": "7"}
    monkeypatch.setattr(digests, "LIST", tmp_path / "list.json")
    monkeypatch.setattr(digests, "digests", lambda folder: found)
    digests.written({"of": digests.surroundings(), "digests": {"cell": listed}})
    with pytest.raises(AssertionError) as caught:
        digests.check("cell", tmp_path)
    assert str(caught.value).splitlines() == [
        "cell: gone.png is missing", "cell: more.md is new", "cell: moved.ply has changed", "cell: new.csv has changed",
        "if that is wanted: python -m benchmarks.digests --write cell",
    ]  # fmt: skip
    monkeypatch.setenv("NUMBA_CPU_NAME", "another")
    assert digests.changes("cell", tmp_path) == {
        "gone.png": "is missing", "more.md": "is new", "new.csv": "has changed",
    }  # fmt: skip
