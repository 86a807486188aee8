"""Layers without a mesh against an independent slicer on the same part: how far they agree, and what each costs.

Usage: python -m benchmarks.agreement MESH [VOXELS [MESH_VOXELS [HEIGHT_MM]]]

The part, scaled to HEIGHT_MM (30), is cut into layers straight from the field at VOXELS (50) pixels along a cell edge,
and meshed at MESH_VOXELS (149, which puts hardly a node where a pixel has its center: at twice VOXELS all of them would
coincide, and there the mesh can only agree). PrusaSlicer cuts that mesh, with everything that prepares a print switched
off, on a display of the same pixels. Where it is not installed, trimesh cuts the mesh and an even-odd rule fills the
sections.

What is compared is made alike, as far as it can be:

* Islands are kept. Which solid hangs on nothing depends on the grid: a neck that a fine grid resolves is open on a
coarse one, and what hangs on it then is an island there. Of a small part that is more than a hundredth of the solid. *
The slicer fills a pixel where it is covered by half. So do the layers here, by 15 x 15 samples a pixel (`gray: 15`, cut
at one half); layers in black and white fill a pixel where its center is solid, which makes another 0.5 %. * The error
of the mesh's chords is separated from that of the slicer by scanlines of this file through its mesh.

Registration is known, never searched for. Two posts are added to the mesh at opposite corners of the stack of layers,
`MARGIN` pixels outside of it and as high as it is. The slicer centers what it is given and puts it down on the plate,
so that with the posts its pixels and layers fall on those here. The posts differ in width: a mirrored or turned picture
shows them in wrong places and is refused. Both ways cut at the mid-height of a layer.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.measure import Run, median, pipeline_command, run, table
from sppm_pipeline.features.files.formats.detect import decode_mesh
from sppm_pipeline.method.part.inside import inside_layers, prepare_inside
from sppm_pipeline.services.grid import Grid

CONFIG = Path(__file__).parent.parent / "configs" / "bunny.yaml"
LAYERS = """  - {stage: slice.field, resolution: "${voxels}"}
  - {stage: write.png, path: slices, sheet: 0}
"""
GRAY = 15  # odd, so that no pixel is covered by exactly half of its samples
COVERED = LAYERS.replace("{stage: slice.field,", f"{{stage: slice.field, gray: {GRAY},")
SURFACE = """  - {stage: extract.marching_cubes, resolution: "${voxels}", islands: keep}
  - {stage: write.mesh, path: part.stl}
"""
# everything that makes a print better makes a comparison worse
SLICER = """printer_technology = SLA
layer_height = {layer}
initial_layer_height = {layer}
slice_closing_radius = 0
elefant_foot_compensation = 0
absolute_correction = 0
relative_correction = 1,1
gamma_correction = 0
faded_layers = 3
supports_enable = 0
pad_enable = 0
hollowing_enable = 0
max_print_height = 1000
display_orientation = landscape
display_mirror_x = 0
display_mirror_y = 0
display_pixels_x = {columns}
display_pixels_y = {rows}
display_width = {width}
display_height = {height}
bed_shape = 0x0,{width}x0,{width}x{height},0x{height}
"""
MARGIN = 6  # pixels between the layers and the outer sides of the posts
BORDER = 4  # pixels between the posts and the rim of the display
POSTS = (2, 3)  # pixels along x, of the post at the low and at the high corner; both are 2 pixels along y


def posts(manifest: dict[str, Any]) -> NDArray[np.float64]:
    """Corners (24, 3, 3) in mm of the triangles of the two posts."""
    pixel, size = np.array(manifest["pixel_mm"]), np.array([manifest["width_px"], manifest["height_px"]])
    low = np.array(manifest["origin_mm"])
    height = manifest["layers"] * manifest["layer_mm"]
    unit = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    quads = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    triangles = np.array([corner for a, b, c, d in quads for corner in ([a, b, c], [a, c, d])])
    made = []
    for start, width in zip(((-MARGIN, -MARGIN), size + MARGIN - (POSTS[1], 2)), POSTS, strict=True):
        corner = low + np.append(np.array(start) * pixel, 0)
        made.append((unit * [width * pixel[0], 2 * pixel[1], height] + corner)[triangles])
    return np.concatenate(made)


def with_posts(stl: Path, manifest: dict[str, Any]) -> None:
    """Append the posts to a binary STL."""
    records = np.zeros(24, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    records["corners"] = posts(manifest)
    with stl.open("r+b") as file:
        file.seek(80)
        count = int.from_bytes(file.read(4), "little") + len(records)
        file.seek(80)
        file.write(count.to_bytes(4, "little"))
        file.seek(0, 2)
        file.write(records.tobytes())


def slicer_layers(program: str, stl: Path, manifest: dict[str, Any]) -> tuple[Run, Iterator[NDArray[np.bool_]]]:
    """Cut with PrusaSlicer; layers (rows, columns) cropped to those of this program, lowest y first."""
    (pitch_x, pitch_y), frame = manifest["pixel_mm"], MARGIN + BORDER
    columns, rows = manifest["width_px"] + 2 * frame, manifest["height_px"] + 2 * frame
    profile, archive = stl.with_suffix(".ini"), stl.with_suffix(".sl1")
    width, height = columns * pitch_x, rows * pitch_y
    profile.write_text(
        SLICER.format(layer=manifest["layer_mm"], columns=columns, rows=rows, width=width, height=height)
    )
    place = ["--center", f"{width / 2!r},{height / 2!r}"]
    spent = run([program, "--export-sla", "--load", str(profile), *place, "--output", str(archive), str(stl)])

    def read() -> Iterator[NDArray[np.bool_]]:
        expected = np.zeros((rows, columns), bool)
        expected[BORDER : BORDER + 2, BORDER : BORDER + POSTS[0]] = True
        expected[rows - BORDER - 2 : rows - BORDER, columns - BORDER - POSTS[1] : columns - BORDER] = True
        with zipfile.ZipFile(archive) as pack:
            names = sorted(n for n in pack.namelist() if n.endswith(".png") and "/" not in n)
            if len(names) != manifest["layers"]:
                raise SystemExit(f"the slicer made {len(names)} layers, the field {manifest['layers']}")
            for name in names:
                with pack.open(name) as file:
                    solid = np.asarray(Image.open(file).convert("L"))[::-1] >= 128
                inner = solid[frame:-frame, frame:-frame].copy()
                rim = solid.copy()
                rim[frame:-frame, frame:-frame] = False
                if not np.array_equal(rim, expected):
                    raise SystemExit(f"{name}: the posts are not where they should be; the picture is turned or moved")
                yield inner

    return spent, read()


def filled(
    segments: NDArray[np.float64], origin: tuple[float, float], pixel: tuple[float, float], shape: tuple[int, int]
) -> NDArray[np.bool_]:
    """Pixels (rows, columns) whose center lies within a section, by the even-odd rule along every row.

    `segments` is (n, 2, 2): both ends of each piece of the outline, x and y in mm, in any order and direction.
    """
    ends = (segments - origin) / pixel - 0.5  # centers of pixels are whole numbers
    (x0, y0), (x1, y1) = ends[:, 0].T, ends[:, 1].T
    first = np.clip(np.ceil(np.minimum(y0, y1)), 0, shape[0]).astype(int)
    count = np.clip(np.ceil(np.maximum(y0, y1)), 0, shape[0]).astype(int) - first
    piece = np.repeat(np.arange(len(ends)), count)
    row = np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count) + first[piece]
    x = x0[piece] + (row - y0[piece]) * ((x1 - x0)[piece] / (y1 - y0)[piece])
    crossings = np.zeros((shape[0], shape[1] + 1), int)
    np.add.at(crossings, (row, np.clip(np.ceil(x), 0, shape[1]).astype(int)), 1)
    return np.asarray(np.cumsum(crossings, axis=1)[:, :-1] % 2 == 1)


def section_layers(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], manifest: dict[str, Any]
) -> Iterator[NDArray[np.bool_]]:
    """Cut a mesh with trimesh; layers (rows, columns), lowest y first."""
    import trimesh

    low = manifest["origin_mm"]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    heights = (np.arange(manifest["layers"]) + 0.5) * manifest["layer_mm"]
    shape = (manifest["height_px"], manifest["width_px"])
    for height in heights:
        lines = trimesh.intersections.mesh_plane(mesh, (0, 0, 1), (0, 0, low[2] + height))
        yield filled(np.asarray(lines).reshape(-1, 2, 3)[:, :, :2], (low[0], low[1]), manifest["pixel_mm"], shape)


def sections_of_file(stl: str, manifest: str, out: str) -> None:
    """Cut the mesh in a process of its own, where PrusaSlicer is missing."""
    import trimesh

    mesh = trimesh.load_mesh(stl)
    layers = section_layers(mesh.vertices, mesh.faces, json.loads(Path(manifest).read_text()))
    np.save(out, np.stack(list(layers)))


def scanned_layers(
    vertices: NDArray[np.float64], faces: NDArray[np.integer], manifest: dict[str, Any]
) -> Iterator[NDArray[np.bool_]]:
    """Cut a mesh with our own scanlines: pixels whose center is inside, (rows, columns), lowest y first."""
    pitch = (*manifest["pixel_mm"], manifest["layer_mm"])
    x, y, z = np.array(manifest["origin_mm"]) + np.array(pitch) / 2
    shape = (manifest["width_px"], manifest["height_px"], manifest["layers"])
    scan = prepare_inside(vertices, faces, Grid((x, y, z), pitch, shape))
    for k in range(shape[2]):
        yield inside_layers(scan, k, k + 1).mask[0].astype(bool)


def own_layers(folder: Path, manifest: dict[str, Any]) -> Iterator[NDArray[np.bool_]]:
    """The layers written by the pipeline (rows, columns), lowest y first."""
    for k in range(manifest["layers"]):
        yield np.asarray(Image.open(folder / f"{k:05d}.png").convert("L"))[::-1] >= 128


def compare(ours: Iterator[NDArray[np.bool_]], theirs: Iterator[NDArray[np.bool_]]) -> NDArray[np.int64]:
    """Pixels (layers, 3) that are solid in both, in the first only, in the second only."""
    counts = [((a & b).sum(), (a & ~b).sum(), (b & ~a).sum()) for a, b in zip(ours, theirs, strict=True)]
    return np.array(counts, np.int64)


def main() -> None:
    source = Path(sys.argv[1]).resolve()
    voxels, mesh_voxels, height = [int(v) for v in sys.argv[2:]] + [50, 149, 30][len(sys.argv) - 2 :]
    program = shutil.which("prusa-slicer")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)

        def command(name: str, tail: str, resolution: int) -> list[str]:
            config = folder / f"{name}.yaml"
            head = CONFIG.read_text().split("  - {stage: slice.field")[0]
            config.write_text(head.replace("{stage: fill.implicit}", "{stage: fill.implicit, islands: keep}") + tail)
            made = pipeline_command(config, folder / name)
            return [*made, "-p", f"mesh={source}", "-p", f"voxels={resolution}", "-p", f"height={height} mm"]

        direct = median(command("layers", LAYERS, voxels), runs=3)
        run(command("covered", COVERED, voxels))
        run(command("warm", SURFACE, 16))
        meshed = run(command("surface", SURFACE, mesh_voxels))
        slices, stl = folder / "layers" / "slices", folder / "surface" / "part.stl"
        manifest = json.loads((slices / "manifest.json").read_text())
        mesh = decode_mesh(stl.read_bytes(), stl.name)
        if program:
            name = "PrusaSlicer"
            with_posts(stl, manifest)
            cut, theirs = slicer_layers(program, stl, manifest)
        else:
            print("prusa-slicer is not installed; the mesh is cut by trimesh and filled by the even-odd rule instead")
            name, out = "trimesh", folder / "sections.npy"
            script = "import sys; from benchmarks.agreement import sections_of_file as f; f(*sys.argv[1:])"
            cut = run([sys.executable, "-c", script, str(stl), str(slices / "manifest.json"), str(out)])
            theirs = iter(np.load(out))
        cuts = list(theirs)
        centers = list(own_layers(slices, manifest))
        covered = list(own_layers(folder / "covered" / "slices", manifest))
        counts = compare(iter(covered), iter(cuts))
        through = list(scanned_layers(*mesh, manifest))
        others = {
            f"layers in black and white and {name}'s": (centers, cuts),
            f"our scanlines through the mesh and {name}'s, on the same mesh": (through, cuts),
            "layers in black and white and our scanlines through the mesh": (centers, through),
        }
        sizes = [sum(f.stat().st_size for f in slices.glob("*.png")) / 1e6, stl.stat().st_size / 1e6]

    both, only_ours, only_theirs = counts.sum(axis=0)
    union = counts.sum(axis=1)
    iou = (counts[:, 0] + (union == 0)) / np.maximum(1, union)
    print(
        f"\nIoU of the solid, both filled where covered by half: {both / union.sum():.4f}; of the union"
        f" {only_ours / union.sum():.4f} is in ours only, {only_theirs / union.sum():.4f} in {name}'s only\n"
        f"median layer {np.median(iou):.4f}"
    )
    for which, (one, other) in others.items():
        common, a, b = compare(iter(one), iter(other)).sum(axis=0)
        print(f"IoU of {which}: {common / (common + a + b):.4f}")
    # the tip of a part may be ten pixels, of which one in doubt is a tenth
    for which, least in (
        ("worst layer", 0),
        ("worst of those with a twentieth of the largest's solid", union.max() / 20),
    ):
        k = int(np.where(union >= least, iou, 2).argmin())
        print(f"{which}: {iou[k]:.4f} (layer {k} of {len(iou)}, {union[k]} pixels)")
    total = Run(meshed.wall + cut.wall, meshed.cpu + cut.cpu, max(meshed.peak, cut.peak))
    ratio = [b / a for a, b in zip(direct, total, strict=True)]
    table(
        f"{source.name}: {manifest['width_px']} x {manifest['height_px']} x {manifest['layers']} pixels of"
        f" {manifest['pixel_mm'][0]:g} x {manifest['pixel_mm'][1]:g} mm, mesh at {mesh_voxels} per cell",
        ["way", "wall s", "CPU s", "peak MB", "output MB"],
        [
            ["layers from the field", *direct, sizes[0]],
            ["mesh from the field", *meshed, sizes[1]],
            [f"{name} on that mesh", *cut, ""],
            ["both together", *total, ""],
            ["ratio to the first", *ratio, ""],
        ],
    )


if __name__ == "__main__":
    main()
