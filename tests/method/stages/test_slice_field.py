"""Layers: where they are, what they show, and what is removed."""

from collections import namedtuple
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.connectivity.islands import keep_largest
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.slicing import sampled_slices, spool
from sppm_pipeline.method.stages.fill_implicit import ImplicitFill
from sppm_pipeline.method.stages.slice_field import SliceField
from sppm_pipeline.method.stages.write_png import WritePng
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.testing.plain_context import PlainContext

MM = "mm"


def layers(stack, threads=1):
    """All layers, and that slabs come in order without a gap."""
    return layers_and_findings(stack, threads)[0]


def layers_and_findings(stack, threads=1):
    slabs, at = [], 0
    reading = stack.slabs(threads)
    for start, slab in reading:
        assert start == at
        at += len(slab)
        slabs.append(slab.copy())
    found = np.concatenate(slabs)
    assert found.shape == stack.shape[::-1]
    assert found.dtype == np.uint8
    return found, reading.findings


def slices(field, **options):
    stage = SliceField(**options)
    stage.check_options()
    return stage.run(PlainContext(), field)


def test_layers_are_the_voxels(wang_tiling):
    stack = slices(wang_tiling, resolution=10, islands="keep")
    assert stack.shape == (40, 30, 30)
    assert (stack.pixel_mm, stack.layer_mm) == ((0.4, 0.4), 0.4)
    assert stack.origin_mm == (0, 0, 0)
    found, findings = layers_and_findings(stack)
    expected = wang_tiling.solid(cell_centers(10, wang_tiling.cells)).T
    assert np.array_equal(found, expected * 255)
    assert findings["solid_share_of_box"] == expected.mean()
    assert findings["solid_volume_mm3"] == pytest.approx(expected.sum() * 0.4**3)
    by_pitch = slices(wang_tiling, pixel=Length(400, "um"), islands="keep")
    assert np.array_equal(layers(by_pitch), found)


def test_islands_are_removed_as_on_the_whole(wang_tiling, monkeypatch):
    expected = keep_largest(wang_tiling.solid(cell_centers(10, wang_tiling.cells)).T, (False,) * 3)
    stack = slices(wang_tiling, resolution=10)
    found, findings = layers_and_findings(stack)
    assert np.array_equal(found, expected * 255)
    removed = findings["removed_share"]
    assert removed == pytest.approx(1 - expected.sum() / wang_tiling.solid(cell_centers(10, wang_tiling.cells)).sum())
    assert removed > 0
    monkeypatch.setattr(sampled_slices, "SLAB_PIXELS", 2000)
    for memory, disk in (
        (1000, 0.25),
        (0, 0.25),
        (0, 0.0),
    ):  # some in memory, all on the disk, no room: evaluated twice
        monkeypatch.setattr(spool, "IN_MEMORY", memory)
        monkeypatch.setattr(spool, "MAX_DISK_SHARE", disk)
        again, found_again = layers_and_findings(slices(wang_tiling, resolution=10), threads=2)
        assert again.tobytes() == found.tobytes()
        assert found_again == findings


def test_a_spool_leaves_most_of_the_disk_to_others(monkeypatch):
    monkeypatch.setattr(spool, "IN_MEMORY", 0)
    written = []
    usage = namedtuple("usage", "free")
    monkeypatch.setattr(spool.shutil, "disk_usage", lambda path: usage(64000 - 800 * len(written)))
    kept = spool.Spool()
    for start in range(40):
        kept.append(start, np.ones((1, 25, 4), np.uint64))
        written.append(start)
        if not kept.whole:
            break
    assert start == 20  # 16000 of 64000 bytes are used


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_spool_gives_back_what_it_was_given(share):
    rng = np.random.default_rng(4)
    slabs = [np.where(rng.random((3, 7, 5)) < share, rng.integers(1, 2**63, (3, 7, 5)), 0).astype(np.uint64)] * 2
    kept = spool.Spool()
    for number, bits in enumerate(slabs):
        kept.append(3 * number, bits)
    assert kept._held < 2 * 850 if share < spool.SPARSE else kept._held == 2 * slabs[0].nbytes
    kept.replace(1, slabs[1] & np.uint64(0xFF))
    assert [(start, bits.tobytes()) for start, bits in map(kept.slab, range(2))] == [
        (0, slabs[0].tobytes()),
        (3, (slabs[1] & np.uint64(0xFF)).tobytes()),
    ]


@pytest.mark.parametrize("memory", [2**27, 1000])
def test_layers_without_islands_are_evaluated_once_for_all_who_read_them(wang_tiling, monkeypatch, memory):
    monkeypatch.setattr(sampled_slices, "SLAB_PIXELS", 2000)
    monkeypatch.setattr(spool, "IN_MEMORY", memory)
    evaluated = []
    decided = sampled_slices.FieldSlices.decided
    monkeypatch.setattr(sampled_slices.FieldSlices, "decided", lambda *args: evaluated.append(1) or decided(*args))
    stack = slices(wang_tiling, resolution=10)
    half = iter(stack.slabs())
    next(half)
    half.close()  # by somebody who has seen enough
    found, findings = layers_and_findings(stack)
    assert len(evaluated) == 2
    readers = [stack.slabs(), stack.slabs()]  # a plate reads a stack that lies on it twice so
    pairs = [pair for pairs in zip(*readers, strict=True) for pair in pairs]
    assert b"".join(layers.tobytes() for _, layers in pairs[::2]) == found.tobytes()
    assert b"".join(layers.tobytes() for _, layers in pairs[1::2]) == found.tobytes()
    assert [reader.findings for reader in readers] == [findings] * 2
    assert len(evaluated) == 2


@pytest.mark.parametrize(("pixel", "layer", "gray"), [(0.4, 0.25, 1), (0.37, 0.11, 1), (0.4, 0.4, (3, 2))])
def test_threads_and_slabs_change_no_byte(wang_tiling, ball, monkeypatch, pixel, layer, gray):
    part = Part(wang_tiling, ball, 0.5)

    def made(threads):
        shades = {"gray": gray[0], "gray_layers": gray[1]} if gray != 1 else {}
        return layers(slices(part, pixel=Length(pixel, MM), layer=Length(layer, MM), **shades), threads).tobytes()

    first = made(1)
    assert made(2) == first
    monkeypatch.setattr(sampled_slices, "SLAB_PIXELS", 1)
    assert made(1) == first


def test_where_pixels_and_layers_lie(wang_tiling, wedge):
    """The body alone: each pixel of each layer is decided at its middle, at mid-height."""
    dense = type(wang_tiling)(
        type(wang_tiling.tileset)(wang_tiling.tileset.micro.with_level(99.0), "wang", 2), wang_tiling.arrays, 4.0
    )
    stack = slices(Part(dense, wedge, 0.0, "keep"), pixel=Length(0.3, MM), layer=Length(0.2, MM))
    found = layers(stack) > 0
    ox, oy, oz = stack.origin_mm
    nx, ny, nz = stack.shape
    for axis, (o, n, h) in enumerate(((ox, nx, 0.3), (oy, ny, 0.3), (oz, nz, 0.2))):
        assert o <= wedge.lower[axis] < o + h
        assert o + (n - 1) * h < wedge.upper[axis] <= o + n * h + 1e-9
        assert o / h == pytest.approx(round(o / h))  # anchored at the lattice
    x = ox + (np.arange(nx) + 0.5) * 0.3
    y = oy + (np.arange(ny) + 0.5) * 0.3
    z = oz + (np.arange(nz) + 0.5) * 0.2
    points = np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], -1)
    inside = np.ones(points.shape[:3], bool)
    for a, b, c in wedge.vertices[wedge.faces]:
        inside &= (points - a) @ np.cross(b - a, c - a) < 0
    assert np.array_equal(found, inside)
    assert found.any()


def test_gray_is_the_share_of_the_pixel(wang_tiling):
    stack = slices(wang_tiling, pixel=Length(0.4, MM), gray=4, islands="keep")
    assert stack.gray
    found, findings = layers_and_findings(stack)
    fine = layers(slices(wang_tiling, pixel=Length(0.1, MM), layer=Length(0.4, MM), islands="keep")) > 0
    share = fine.reshape(30, 30, 4, 40, 4).mean((2, 4))
    assert np.abs(found / 255 - share).max() <= 0.5 / 255 + 1e-9
    assert len(np.unique(found)) > 5
    assert findings["solid_share_of_box"] == pytest.approx(fine.mean())
    assert not slices(wang_tiling, resolution=4).gray
    # over the height of the layer as well, and over that alone
    for across in (4, 1):
        stack = slices(wang_tiling, pixel=Length(0.4, MM), gray=across, gray_layers=2, islands="keep")
        assert stack.gray
        found, findings = layers_and_findings(stack)
        pitch = {"pixel": Length(0.4 / across, MM), "layer": Length(0.2, MM)}
        fine = layers(slices(wang_tiling, **pitch, islands="keep")) > 0
        share = fine.reshape(30, 2, 30, across, 40, across).mean((1, 3, 5))
        assert np.mean(np.abs(found / 255 - share) > 0.5 / 255 + 1e-9) < 1e-3  # samples that rounding moves
        assert findings["solid_volume_mm3"] == pytest.approx(fine.mean() * 16 * 12 * 12, rel=1e-4)


def test_a_part_decides_about_its_islands(wang_tiling, ball):
    for islands in ("remove", "keep"):
        part = ImplicitFill(skin=Length(0.5, MM), islands=islands).run(PlainContext(), wang_tiling, ball)
        other = "keep" if islands == "remove" else "remove"
        stack = slices(part, pixel=Length(0.4, MM), islands=other)
        found = layers(stack) > 0
        whole = part.solid(stack.grid).T
        assert np.array_equal(found, keep_largest(whole, (False,) * 3) if islands == "remove" else whole)
        assert (part.skin_mm, part.domain.name) == (0.5, "ball")


def test_the_skin_is_closed_in_every_layer(wang_tiling, ball):
    part = ImplicitFill(skin=Length(0.9, MM)).run(PlainContext(), wang_tiling, ball)
    stack = slices(part, pixel=Length(0.3, MM))
    found = layers(stack) > 0
    inside = part._in_domain(stack.grid).inside(0, stack.shape[2])
    rim = inside.astype(bool) & ~(np.roll(inside, 1, 2) & np.roll(inside, -1, 2) & np.roll(inside, 1, 1)).astype(bool)
    assert found[rim].all()
    middle = found[stack.shape[2] // 2]
    row = middle[middle.shape[0] // 2]
    first = np.flatnonzero(row)[0]
    assert row[first : first + 3].all()  # 0.9 mm are three pixels


@pytest.mark.parametrize(
    "options",
    [{}, {"pixel": Length(1), "resolution": 3}, {"resolution": 3, "layer": Length(1)}],
)
def test_contradictions(options):
    with pytest.raises(ConfigError):
        SliceField(**options).check_options()


def test_a_size_is_needed(cell, ball):
    with pytest.raises(DesignError, match="physical size"):
        slices(cell, resolution=8)
    with pytest.raises(DesignError, match="physical size"):
        ImplicitFill().run(PlainContext(), cell, ball)


@dataclass(frozen=True, eq=False)
class Balls(ScalarField):
    """A solid ball in each cell of 2 mm, 0.6 mm in radius, none of which touches another."""

    cells: ClassVar = (6, 6, 6)
    periodic: ClassVar = True
    edge_mm: ClassVar = 2.0

    def sample_layers(self, grid, start, stop, threads=1):
        grid = grid.layers(start, stop)
        x, y, z = (np.mod(grid.axis(axis), 1.0) - 0.5 for axis in range(3))
        return (np.sqrt(x[:, None, None] ** 2 + y[:, None] ** 2 + z**2) - 0.3).astype(np.float32)


@pytest.mark.parametrize(("islands", "workers"), [("auto", 0), ("auto", 2), ("remove", 0), ("keep", 0)])
def test_a_part_that_falls_apart_is_refused_before_a_file_is_there(ball, tmp_path, islands, workers):
    """More than 10 % of the solid disconnected: no layer is written unless the user has asked for removal."""
    part = ImplicitFill(islands=islands, skin=Length(0.5, MM)).run(PlainContext(), Balls(), ball)
    context = PlainContext(directory=tmp_path, workers=workers)
    stack = slices(part, pixel=Length(0.1, MM))
    if islands == "auto":
        with pytest.raises(DesignError, match=r"porosity 0\.\d+ with it, 0\.\d+ without"):
            WritePng().run(context, stack)
        assert not any(path.is_file() for path in tmp_path.rglob("*"))
        return
    WritePng().run(context, stack)
    found, grid = context.reported, stack.samples
    inside, whole = part.inside_zyx(grid, 0, grid.shape[2]), part.solid_zyx(grid, 0, grid.shape[2])
    before, after = (1 - (solid > 0).sum() / inside.sum() for solid in (whole, stack.to_numpy()))
    assert found["porosity"] == pytest.approx(after)
    assert found["porosity_with_islands"] == pytest.approx(before)
    assert (after > before + 0.02) == (islands == "remove")
    # balls take 4.19 x 0.3^3 of what the skin leaves
    assert found["infill_porosity_with_islands"] == pytest.approx(1 - 4.19 * 0.3**3, abs=0.05)
    assert found["infill_porosity"] > found["porosity"]
    assert len(context.warnings) == (islands == "remove")
