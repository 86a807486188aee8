import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.method.assembly.contents import Pieces, lone_periodic_cell
from sppm_pipeline.method.assembly.overlap_add import assemble, assemble_bits
from sppm_pipeline.method.assembly.patches import build_bank
from sppm_pipeline.method.kernels.kernels import concatenated, empty_kernels
from sppm_pipeline.services.bit_rows import unpack
from sppm_pipeline.testing.exact_sum import cutoff_bound, exact_sum

# Patches that can lie over one voxel: sites within one cell, ten pieces each.
MAX_PATCHES = 27 * 10


def assemble_solid(bank, tiling, level, z0, z1, x0, x1, *rest, **options) -> np.ndarray:
    return unpack(assemble_bits(bank, tiling, level, z0, z1, x0, x1, *rest, **options), x1 - x0)


def samples(low: tuple[int, int, int], high: tuple[int, int, int], n: int, offset: float) -> np.ndarray:
    x, y, z = ((np.arange(a, b) + offset) / n for a, b in zip(low, high, strict=True))
    return np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], axis=-1).reshape(-1, 3)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32),
    shape=st.tuples(*[st.integers(1, 3)] * 3),
    interiors=st.integers(1, 4),
    colors=st.integers(1, 3),
    periodic=st.booleans(),
    profile=st.sampled_from(["linear", "squared"]),
    merged=st.booleans(),
    n=st.integers(5, 18),
    offset=st.sampled_from([0.0, 0.5]),
    corner=st.tuples(*[st.integers(-12, 40)] * 3),
    size=st.tuples(*[st.integers(1, 9)] * 3),
)
def test_random_tilings_within_the_bound(
    sets, seed, shape, interiors, colors, periodic, profile, merged, n, offset, corner, size
) -> None:
    pieces = sets.pieces(seed, interiors, colors, profile)
    tiling = sets.tiling(seed, shape, pieces, periodic)
    bank = build_bank(pieces, n, sets.combinations(tiling) if merged else None, offset=offset)
    stop = tuple(c + s for c, s in zip(corner, size, strict=True))
    field = assemble(bank, tiling, corner[2], stop[2], corner[0], stop[0], corner[1], stop[1])
    # One image on each side is enough: what lies a whole cell away is below 1e-15.
    everything = sets.every_kernel(pieces, tiling, images=1 if periodic else 0)
    points = samples(corner, stop, n, offset)
    if periodic:
        points %= np.array(shape)
    bound = cutoff_bound(everything, points.min(axis=0), points.max(axis=0), blocks=4) + MAX_PATCHES * 1e-5
    assert np.abs(field.ravel() - exact_sum(everything, points)).max() <= bound


def test_merged_and_separate_patches_agree_far_below_the_worst_case(sets) -> None:
    pieces = sets.pieces(1)
    tiling = sets.tiling(2, (3, 3, 3), pieces)
    box = (0, 60, 0, 60, 0, 60)
    separate = assemble(build_bank(pieces, 20), tiling, *box)
    merged = assemble(build_bank(pieces, 20, sets.combinations(tiling)), tiling, *box)
    assert merged == pytest.approx(separate, abs=2e-4)
    assert separate.max() > 1.5


@pytest.mark.parametrize("offset", [0.0, 0.5])
def test_a_lone_cell_is_an_assembly_of_itself(sets, offset: float) -> None:
    pieces = sets.pieces(3, share=1.0)
    tiling = lone_periodic_cell(1, (0, 1, 1))
    members = sets.lone(pieces, 1, (0, 1, 1))
    bank = build_bank(pieces, 24, sets.combinations(tiling), offset=offset)
    m = 24 if offset else 25
    field = assemble(bank, tiling, 0, m, 0, m, 0, m)
    steps = [np.array(step, float) for step in np.ndindex(5, 5, 5)]
    images = concatenated(members.shifted(step - 2.0) for step in steps)
    exact = exact_sum(images, samples((0, 0, 0), (m, m, m), 24, offset))
    assert field.ravel() == pytest.approx(exact, abs=3e-4)


@pytest.mark.parametrize("merged", [False, True])
def test_a_periodic_tiling_repeats_to_the_last_bit(sets, merged: bool) -> None:
    pieces = sets.pieces(4)
    tiling = sets.tiling(5, (2, 1, 3), pieces, periodic=True)
    bank = build_bank(pieces, 10, sets.combinations(tiling) if merged else None, offset=0.0)
    field = assemble(bank, tiling, 0, 31, 0, 21, 0, 11)
    assert field[0].tobytes() == field[30].tobytes()
    assert field[:, 0].tobytes() == field[:, 10].tobytes()
    assert field[:, :, 0].tobytes() == field[:, :, 20].tobytes()
    away = assemble(bank, tiling, -60, -29, 40, 61, -30, -19)
    assert away.tobytes() == field.tobytes()


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    lower=st.tuples(*[st.integers(-9, 50)] * 3),
    size=st.tuples(*[st.integers(0, 50)] * 3),
    threads=st.integers(1, 3),
    merged=st.booleans(),
)
def test_same_bytes_for_any_slab_window_and_threads(whole_field, lower, size, threads, merged) -> None:
    bank, tiling, whole = whole_field[merged]
    x0, y0, z0 = lower
    x1, y1, z1 = (min(a + s, 60) for a, s in zip(lower, size, strict=True))
    part = assemble(bank, tiling, z0, z1, x0, x1, y0, y1, threads=threads)
    assert part.tobytes() == whole[z0 + 9 : z1 + 9, y0 + 9 : y1 + 9, x0 + 9 : x1 + 9].tobytes()
    solid = assemble_solid(bank, tiling, 0.25, z0, z1, x0, x1, y0, y1, threads=threads)
    assert (solid == (part < np.float32(0.25))).all()


@pytest.fixture(scope="module")
def whole_field(sets):
    pieces = sets.pieces(6)
    tiling = sets.tiling(7, (3, 4, 3), pieces)
    banks = [build_bank(pieces, 13, combinations) for combinations in (None, sets.combinations(tiling))]
    return [(bank, tiling, assemble(bank, tiling, -9, 60, -9, 60, -9, 60)) for bank in banks]


def test_many_small_blocks_give_the_same_bytes(whole_field, monkeypatch) -> None:
    bank, tiling, whole = whole_field[1]
    monkeypatch.setattr("sppm_pipeline.method.assembly.overlap_add._BLOCK_SAMPLES", 700)
    assert assemble(bank, tiling, -9, 60, -9, 60, -9, 60, threads=2).tobytes() == whole.tobytes()


@given(
    data=st.data(),
    lower=st.tuples(*[st.integers(-9, 20)] * 3),
    size=st.tuples(st.integers(1, 90), st.integers(1, 40), st.integers(1, 20)),
    threads=st.integers(1, 2),
    level=st.sampled_from([None, 0.25]),
)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_wanted_parts_of_rows_are_those_of_the_whole(some_banks, data, lower, size, threads, level) -> None:
    bank, tiling = some_banks[level]
    (x0, y0, z0), (nx, ny, nz) = lower, size
    box = (z0, z0 + nz, x0, x0 + nx, y0, y0 + ny)
    ends = st.lists(st.integers(0, nx), min_size=ny, max_size=ny)
    wanted = np.array([data.draw(ends), data.draw(ends)], np.int32).T.copy()  # some rows begin after their end
    mask = np.array([(np.arange(nx) >= a) & (np.arange(nx) < b) for a, b in wanted])
    whole = assemble_solid(bank, tiling, 0.25, *box)
    some = assemble_solid(bank, tiling, 0.25, *box, threads=threads, wanted=wanted)
    assert (some[:, mask] == whole[:, mask]).all()
    assert (some <= whole).all()
    if level is None:
        out = np.full((nz, ny, nx), np.nan, np.float32)
        assemble(bank, tiling, *box, out=out, threads=threads, wanted=wanted)
        assert out[:, mask].tobytes() == assemble(bank, tiling, *box)[:, mask].tobytes()
        assert np.isnan(out[:, ~mask]).all()
        assert not assemble(bank, tiling, *box, wanted=wanted)[:, ~mask].any()


@pytest.fixture(scope="module")
def some_banks(sets):
    pieces = sets.pieces(6)
    tiling = sets.tiling(7, (3, 4, 3), pieces)
    combinations = sets.combinations(tiling)
    return {level: (build_bank(pieces, 13, combinations, solid_level=level), tiling) for level in (None, 0.25)}


def test_outside_of_the_tiling_there_is_nothing(whole_field) -> None:
    bank, tiling, _ = whole_field[0]
    assert not assemble(bank, tiling, 200, 204, 0, 20, 0, 20).any()
    assert assemble_solid(bank, tiling, 0.25, -90, -88, 0, 20, 0, 20).all()
    assert assemble(bank, tiling, 5, 5, 0, 20, 0, 20).shape == (0, 20, 20)


def test_out_is_used_and_overwritten(whole_field) -> None:
    bank, tiling, whole = whole_field[0]
    out = np.full((3, 13, 20), np.nan, dtype=np.float32)
    assert assemble(bank, tiling, 4, 7, 0, 20, 0, 13, out=out) is out
    assert out.tobytes() == whole[13:16, 9:22, 9:29].tobytes()


def test_empty_pieces(sets) -> None:
    full = sets.pieces(8)
    faces = [[full[full.interiors + 2 * axis + color] for color in range(2)] for axis in range(3)]
    pieces = Pieces.of([empty_kernels()] * 3, faces)
    tiling = sets.tiling(9, (2, 2, 2), pieces, holes=0.0)
    for combinations in (None, sets.combinations(tiling)):
        bank = build_bank(pieces, 8, combinations)
        points = samples((0, 0, 0), (16, 16, 16), 8, 0.5)
        exact = exact_sum(sets.every_kernel(pieces, tiling), points)
        assert assemble(bank, tiling, 0, 16, 0, 16, 0, 16).ravel() == pytest.approx(exact, abs=1e-3)
    bare = Pieces.of([empty_kernels()] * 3, [[empty_kernels()]] * 3)
    assert not assemble(build_bank(bare, 8), lone_periodic_cell(), 0, 8, 0, 8, 0, 8).any()


@pytest.mark.parametrize("merged", [False, True])
def test_sixteen_bits_differ_only_beside_the_surface(sets, merged: bool) -> None:
    pieces = sets.pieces(10)
    tiling = sets.tiling(11, (3, 2, 3), pieces)
    combinations = sets.combinations(tiling) if merged else None
    field = assemble(build_bank(pieces, 16, combinations), tiling, -5, 50, -5, 50, -5, 40)
    bank = build_bank(pieces, 16, combinations, solid_level=0.25)
    assert bank.data.dtype == np.int16
    solid = assemble_solid(bank, tiling, 0.25, -5, 50, -5, 50, -5, 40)
    assert 0.1 < solid.mean() < 0.97
    # Half a unit and the trimming threshold for each of at most 8 x 10 patches.
    unsure = np.abs(field - 0.25) <= 80 * (0.25 / 32767 / 2 + 1e-5)
    assert ((solid == (field < 0.25)) | unsure).all()
    assert (solid != (field < 0.25)).mean() < 1e-4
    part = assemble_solid(bank, tiling, 0.25, 3, 20, 7, 31, -2, 9, threads=2)
    assert part.tobytes() == solid[8:25, 3:14, 12:36].tobytes()


def test_sixteen_bits_serve_one_level_and_no_field(sets) -> None:
    pieces = sets.pieces(10)
    tiling = lone_periodic_cell()
    bank = build_bank(pieces, 8, solid_level=0.25)
    with pytest.raises(ValueError, match=r"level 0\.25, not 0\.3"):
        assemble_solid(bank, tiling, 0.3, 0, 8, 0, 8, 0, 8)
    with pytest.raises(ValueError, match="only solid and void"):
        assemble(bank, tiling, 0, 8, 0, 8, 0, 8)


def test_bad_arguments(sets, whole_field) -> None:
    bank, _, _ = whole_field[1]
    other = sets.tiling(99, (3, 3, 3), sets.pieces(6), holes=0.0)
    with pytest.raises(ValueError, match="no patches"):
        assemble(bank, other, 0, 30, 0, 30, 0, 30)
