"""Every configuration that comes with the program runs, at a low resolution, and gives what its comment promises."""

import json
import weakref
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks import kernel_list
from sppm_pipeline.engine.cli.kernels import kernels_of, listed_kernels
from sppm_pipeline.features.files.formats.detect import decode_mesh
from sppm_pipeline.method.part import primitive_meshes
from sppm_pipeline.services.formats import ply
from sppm_pipeline.services.mesh.measures import measure_surface

CONFIGS = Path(__file__).parents[1] / "configs"


def outputs(folder):
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


def reduced(name, tmp_path, **replacements):
    """A configuration with a smaller sweep."""
    text = (CONFIGS / name).read_text(encoding="utf-8")
    for old, new in replacements.values():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


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


def test_cell(run_yaml, summary):
    record, folder = run_yaml(
        CONFIGS / "cell.yaml",
        p=["pores=40"],
        s=["tune.porosity.resolution=32", "tune.porosity.trials=1", "tune.porosity.tolerance=0.005",
           "check.connectivity.resolution=24", "write.picture.resolution=16", "write.picture.image_size=[200, 150]",
           "extract.marching_cubes.resolution=24", "connect.mbdst.mode=greedy"],
    )  # fmt: skip
    assert summary(record, "tune.porosity")["porosity"] == pytest.approx(0.5, abs=0.005)
    assert summary(record, "check.connectivity")["porosity"] == pytest.approx(0.5, abs=0.02)
    assert all(summary(record, "check.connectivity")["solid_wraps"])
    assert {"graph.graphml", "cell.png", "cell.ply", "run.json"} <= outputs(folder)
    vertices, faces = decode_mesh((folder / "cell.ply").read_bytes(), "cell.ply")
    found = measure_surface(vertices, faces)
    assert found.edges.closed
    assert found.volume == pytest.approx(0.5, abs=0.03)


def test_quickstart(run_yaml, summary):
    record, folder = run_yaml(
        CONFIGS / "quickstart.yaml",
        p=["cell=8 mm"],
        s=["tile.scattered.resolution=16", "slice.field.pixel=0.5 mm", "part_picture.resolution=8",
           "part_picture.size=[200, 150]", "extract.marching_cubes.resolution=12"],
    )  # fmt: skip
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


def test_printer(run_yaml, summary):
    record, folder = run_yaml(
        CONFIGS / "printer.yaml", s=["read.primitive.size=[12 mm, 12 mm, 0.5 mm]", "tile.scattered.resolution=16"]
    )
    written = summary(record, "write.goo")
    assert (written["printer"], written["layers"], written["verified_on_hardware"]) == ("elegoo_saturn_4", 10, False)
    assert 0.1 < written["resin_ml"] / (np.pi * 0.6**2 * 0.05) < 0.6
    assert written["print_time_s"] == pytest.approx(5 * (25 + 8.5) + 5 * (2.5 + 8.5))
    assert (folder / "puck.goo").stat().st_size > 195_477 + 10 * 70
    with Image.open(folder / "puck-overview.png") as sheet:
        assert sheet.size[0] > 500


def test_wang_part(run_yaml, summary):
    record, folder = run_yaml(
        CONFIGS / "wang_part.yaml",
        p=["cell=8 mm"],
        s=["tileset.wang_3color.colors=2", "tileset.wang_3color.resolution=16", "tileset.wang_3color.tolerance=0.02",
           "tiles_picture.resolution=8", "slice.field.pixel=0.5 mm", "part_picture.resolution=8",
           "part_picture.size=[200, 150]", "extract.marching_cubes.resolution=12", "connect.mbdst.mode=greedy"],
    )  # fmt: skip
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


def test_bunny(run_yaml, summary, tmp_path):
    vertices, faces = primitive_meshes.torus_mesh((3.0, 4.0, 5.0), 2.0, 1.0, 24, 12)
    (tmp_path / "body.ply").write_bytes(b"".join(ply.encode(vertices, faces)))
    record, folder = run_yaml(
        CONFIGS / "bunny.yaml",
        p=[f"mesh={tmp_path / 'body.ply'}", "height=12 mm", "voxels=10"],
        s=["tile.scattered.resolution=16"],
    )
    size = summary(record, "read.mesh")["size_mm"]
    assert size[2] == pytest.approx(12)
    manifest = check_layers(folder / "slices")
    assert manifest["layers"] in (16, 17)
    assert manifest["pixel_mm"] == pytest.approx([0.75, 0.75])
    assert manifest["width_px"] * 0.75 == pytest.approx(size[0], abs=1.5)


def test_scattered(run_yaml, summary):
    record, folder = run_yaml(
        CONFIGS / "scattered.yaml",
        s=["tile.scattered.cells=[2, 2, 1]", "tile.scattered.resolution=12", "check.connectivity.resolution=20",
           "slice.field.pixel=0.5 mm", "extract.marching_cubes.resolution=10", "write.picture.resolution=8",
           "write.picture.image_size=[200, 150]"],
    )  # fmt: skip
    assert summary(record, "tile.scattered")["filled_cells"] == 4
    assert summary(record, "check.connectivity")["porosity"] == pytest.approx(0.7, abs=0.03)
    assert summary(record, "check.connectivity")["void_wraps"] == [True, True, True]
    manifest = check_layers(folder / "slices")
    assert (manifest["width_px"], manifest["layers"]) == (20, 10)
    assert {"box.stl", "box.png"} <= outputs(folder)


def test_scattered_part(run_yaml, summary):
    record, folder = run_yaml(
        CONFIGS / "scattered_part.yaml",
        p=["cell=10 mm"],
        s=["tile.scattered.resolution=12", "slice.field.pixel=[0.6 mm, 0.8 mm]", "slice.field.layer=0.5 mm",
           "write.picture.resolution=8", "write.picture.image_size=[200, 150]"],
    )  # fmt: skip
    manifest = check_layers(folder / "slices")
    assert manifest["layers"] == 24
    assert summary(record, "tile.scattered")["filled_cells"] > 4
    assert "part.png" in outputs(folder)


def test_graded_bar(run_yaml, summary):
    record, folder = run_yaml(
        CONFIGS / "graded_bar.yaml",
        s=["tile.graded.trials=1", "tile.graded.rounds=1", "tile.graded.resolution=32",
           "tune.local_porosity.resolution=32", "check.local_porosity.resolution=40",
           "check.connectivity.resolution=24", "write.picture.resolution=8", "write.picture.image_size=[200, 150]"],
    )  # fmt: skip
    assert summary(record, "check.local_porosity")["cell_error_max"] < 0.004
    assert summary(record, "tune.local_porosity")["cells_at_bound"] == 0
    assert summary(record, "check.connectivity")["graph_parts"] == 1
    rows = (folder / "porosity" / "cells.csv").read_text().splitlines()
    assert [row.split(",")[7] for row in rows[1:]] == [f"{p:.6f}" for p in (0.75, 0.65, 0.55, 0.45, 0.35, 0.25)]
    assert {"bar.png", "porosity/section.png", "porosity/scatter.png", "porosity/porosity.vti"} <= outputs(folder)


def test_how_random(run_yaml, tmp_path):
    path = reduced("how_random.yaml", tmp_path, seeds=("seed: {from: 1, to: 5}", "seed: [1]"))
    _, folder = run_yaml(
        path,
        p=["cells=[3, 3, 3]", "voxels=8"],
        s=[f"{stage}.resolution=12" for stage in ("paper_set", "wang_set", "free_set", "corner_set", "fresh_cells")],
    )
    (row,) = json.loads((folder / "sweep.json").read_text())
    assert row["status"] == "done"
    assert row["repeated.bragg_share"] == pytest.approx(1, abs=1e-3)
    assert min(row["paper.folded_corner"], row["paper.folded_edge"]) > 0.4
    assert row["scattered.bragg_share"] < row["fresh.bragg_share"] < row["wang.bragg_share"]
    assert {f"{name}.png" for name in ("paper", "wang", "scattered")} <= {Path(p).name for p in outputs(folder)}


def test_tileset_27(run_yaml, summary):
    record, folder = run_yaml(
        CONFIGS / "tileset_27.yaml",
        s=["tileset.wang_3color.resolution=16", "tileset.wang_3color.tolerance=0.02", "connect.mbdst.mode=greedy",
           "write.picture.resolution=8", "tile.wang_3color.cells=[3, 3, 3]", "assembly.resolution=8",
           "assembly.size=[200, 150]"],
    )  # fmt: skip
    tiles = summary(record, "tileset.wang_3color")
    assert tiles["interiors"] == 27
    assert tiles["colors"] == [3, 3, 3]
    assert tiles["porosity"] == pytest.approx(0.55, abs=0.01)
    assert 0 < summary(record, "check.residual_periodicity")["bragg_share"] < 1
    assert {"tiles.png", "assembly.png"} <= outputs(folder)


def test_periodic_vs_stochastic(run_yaml, summary, tmp_path):
    path = reduced(
        "periodic_vs_stochastic.yaml",
        tmp_path,
        sweep=("cells: [[3, 3, 3], [4, 4, 4], [5, 5, 5], [6, 6, 6]]", "cells: [[3, 3, 3], [4, 3, 3]]"),
    )
    record, folder = run_yaml(
        path,
        s=["tiles.resolution=12", "tiles.tolerance=0.05", "connect.mbdst.mode=greedy", "repeated_picture.resolution=6",
           "stochastic_picture.resolution=6", "repeated_picture.size=[120, 90]", "stochastic_picture.size=[120, 90]",
           "check.connectivity.resolution=10"],
    )  # fmt: skip
    assert [run["status"] for run in record["runs"]] == ["done", "done"]
    for row in json.loads((folder / "sweep.json").read_text()):
        assert row["repeated_order.bragg_share"] == pytest.approx(1, abs=1e-3)
        assert row["stochastic_order.bragg_share"] < 0.9
        assert row["check.connectivity.porosity"] == pytest.approx(0.55, abs=0.06)


def test_porosity_map(run_yaml, summary, tmp_path):
    path = reduced(
        "porosity_map.yaml",
        tmp_path,
        pores=("pores: [20, 30, 40, 50, 60, 70, 80, 90, 100, 110, 120]", "pores: [20, 60, 100]"),
        seed=("seed: {from: 1, to: 50}", "seed: {from: 1, to: 3}"),
    )
    record, folder = run_yaml(path, s=["check.porosity.resolution=16"])
    rows = json.loads((folder / "sweep.json").read_text())
    assert len(rows) == 9
    assert all(row["status"] == "done" for row in rows)
    mean = [np.mean([r["check.porosity.porosity"] for r in rows if r["pores"] == n]) for n in (20, 60, 100)]
    assert mean[0] < mean[1] < mean[2]
    assert 0.1 < mean[0] < 0.3
    assert 0.6 < mean[2] < 0.9
    assert summary(record, "write.chart")["r_squared"] > 0.95
    assert "porosity_map.png" in outputs(folder)


def test_table_mesh_free(run_yaml, tmp_path):
    path = reduced(
        "table_mesh_free.yaml", tmp_path, sweep=("cells: [[3, 3, 3], [6, 6, 6], [8, 8, 8]]", "cells: [[1, 2, 3]]")
    )
    record, folder = run_yaml(
        path, s=["slice.field.resolution=8", "tileset.wang_3color.resolution=12", "tileset.wang_3color.tolerance=0.05"]
    )
    assert record["runs"][0]["status"] == "done"
    manifest = check_layers(next(folder.glob("runs/*/slices")))
    assert (manifest["width_px"], manifest["height_px"], manifest["layers"]) == (8, 16, 24)


def test_stiffness_map(run_yaml, tmp_path):
    path = reduced(
        "stiffness_map.yaml", tmp_path,
        omega=("omega: [20, 30, 40]", "omega: [30]"),
        pores=("[16, 24, 32, 40, 48, 56, 64, 72, 84, 96, 112, 128]", "[24, 140]"),
        seeds=("seed: {from: 1, to: 10}", "seed: [1]"),
    )  # fmt: skip
    _, folder = run_yaml(path, s=["homogenize.voxel.resolution=12", "check.connectivity.resolution=12"])
    few, many = json.loads((folder / "sweep.json").read_text())
    assert few["status"] == many["status"] == "done"
    # each pore takes solid away, and stiffness more than in proportion
    assert few["elastic.porosity"] < many["elastic.porosity"]
    for row in (few, many):
        assert 0 < row["elastic.E_relative"] < 1 - row["elastic.porosity"]
    assert few["elastic.E_relative"] > many["elastic.E_relative"]
    assert {"young.png", "poisson.png", "deviation.png", "deviation_invariant.png"} <= outputs(folder)


def test_representative_volume(run_yaml, summary):
    record, folder = run_yaml(
        CONFIGS / "representative_volume.yaml",
        p=["samples=2", "assemblies=[1, 2]"],
        s=["homogenize.realizations.resolution=8", "tileset.wang_3color.colors=1", "tileset.wang_3color.resolution=12",
           "tileset.wang_3color.tolerance=0.05"],
    )  # fmt: skip
    assert {"young.png", "poisson.png", "deviation.png"} <= outputs(folder)
    sizes = summary(record, "elastic")["sizes"]
    assert set(sizes) == {"1", "2"}
    for found in sizes.values():
        assert found["E_x"]["count"] == 2
        assert found["porosity"]["mean"] == pytest.approx(0.55, abs=0.02)
        assert 0 < found["E_x"]["mean"] < 0.45  # less than the share of solid


def test_walls(run_yaml, summary):
    record, folder = run_yaml(
        CONFIGS / "walls.yaml",
        p=["pores=40"],
        s=["walls.resolution=32", "walls.tolerance=0.005", "phases.resolution=40", "check.sizes.resolution=24",
           "elastic.resolution=20", "write.picture.resolution=16", "write.picture.image_size=[200, 150]",
           "extract.marching_cubes.resolution=32"],
    )  # fmt: skip
    assert summary(record, "walls")["porosity"] == pytest.approx(0.7, abs=0.005)
    assert summary(record, "phases")["void_removed_share"] < 1e-4
    assert all(summary(record, "phases")["solid_wraps"])
    assert summary(record, "check.sizes")["thinnest_wall"] < summary(record, "check.sizes")["narrowest_tunnel"]
    assert summary(record, "elastic")["isotropic"]["E"] > 0.1
    assert {"walls.png", "walls.ply"} <= outputs(folder)


def test_walls_tetrahedra(run_yaml, tmp_path):
    """Limits of fine grids agree better than the finest grids; the power of the spacing is that of the docs."""
    text = (CONFIGS / "walls_tetrahedra.yaml").read_text(encoding="utf-8")
    sweep = text[text.index("sweep:") : text.index("after:")]
    rows = "".join(f"  - {{voxels: {2 * n}, lattice: {n}, order: 1, porosity: 0.5}}\n" for n in (10, 15))
    path = reduced("walls_tetrahedra.yaml", tmp_path, sweep=(sweep, f"sweep:\n{rows}"))
    _, folder = run_yaml(
        path, p=["pores=4", "tunnel_radius=0.08"], s=["walls.resolution=40", "tetrahedra.residual=1e-4"]
    )
    coarse, fine = json.loads((folder / "sweep.json").read_text())
    limits = []
    for name in ("tetrahedra.isotropic.E", "voxels.isotropic.E"):
        assert coarse[name] > fine[name]
        limits.append(fine[name] - (coarse[name] - fine[name]) / (1.5**1.5 - 1))
    assert fine["tetrahedra.isotropic.E"] / fine["voxels.isotropic.E"] > 1.03
    assert limits[0] / limits[1] == pytest.approx(1, abs=0.02)
    assert "agreement.md" in outputs(folder)


def test_composite(run_yaml, tmp_path):
    path = reduced(
        "composite.yaml",
        tmp_path,
        filling=("filling: [0.1, 0.01, 0.001]", "filling: [0.1, 0.001]"),
        porosity=("porosity: [0.3, 0.4, 0.5, 0.6, 0.7]", "porosity: [0.5]"),
    )
    _, folder = run_yaml(path, s=["solid.resolution=24", "solid.trials=1", "solid.tolerance=0.02"], p=["resolution=12"])
    stiff, soft = json.loads((folder / "sweep.json").read_text())
    assert stiff["elastic.isotropic.E"] > soft["elastic.isotropic.E"] > 0
    assert 8e-5 < soft["elastic.expansion.1"] < stiff["elastic.expansion.1"] < 2.5e-4
    assert {"modulus.png", "expansion.png"} <= outputs(folder)


def test_crush_density(run_yaml, tmp_path):
    path = reduced(
        "crush_density.yaml", tmp_path,
        porosity=("porosity: [0.6, 0.7, 0.8]", "porosity: [0.5, 0.8]"), pores=("pores: [20, 42, 70]", "pores: [20]"),
        cells=("cells: [2, 2, 2]", "cells: [1, 1, 1]"),
    )  # fmt: skip
    _, folder = run_yaml(path, p=["resolution=10", "rate=0.05"], s=["tune.porosity.resolution=24"])
    dense, light = json.loads((folder / "sweep.json").read_text())
    assert dense["measured.energy_40"] > 2 * light["measured.energy_40"] > 0
    assert {"energy.md", "energy.png"} <= outputs(folder)


def test_crush_animation(run_yaml, summary):
    record, folder = run_yaml(
        CONFIGS / "crush_animation.yaml",
        s=["tune.porosity.resolution=24", "tile.periodic.cells=[1, 1, 1]", "crush.resolution=10", "crush.rate=0.05",
           "write.frames.image_size=[60, 50]"],
    )  # fmt: skip
    assert summary(record, "crush")["strain_max"] == pytest.approx(0.6)
    with Image.open(folder / "crushing" / "animation.png") as animation:
        assert animation.n_frames == 13


def test_no_configuration_is_forgotten():
    tested = {name[5:] for name in globals() if name.startswith("test_")}
    # those that need a plugin are run by its tests
    for path in CONFIGS.parent.glob("plugins/*/tests/test_*.py"):
        tested |= {config.stem for config in CONFIGS.glob("*.yaml") if config.name in path.read_text(encoding="utf-8")}
    assert {path.stem for path in CONFIGS.glob("*.yaml")} <= tested
