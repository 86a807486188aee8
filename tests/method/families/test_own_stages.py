"""The base classes as authors of samplers, connectors, rules and tile sets use them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.assembly.contents import lone_periodic_cell
from sppm_pipeline.method.families.connector import Connector
from sppm_pipeline.method.families.field_maker import FieldMaker, PartFieldMaker
from sppm_pipeline.method.families.sampler import Sampler, start_of
from sppm_pipeline.method.families.tiler import KIND_TO_RULE, Tiler, lattice_for
from sppm_pipeline.method.families.tileset_maker import TileSetMaker
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.stages.read_primitive import ReadPrimitive
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tune_porosity import TunePorosity
from sppm_pipeline.nouns.length import Cell, Length
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.stage import option
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of
from tests.built_in import BUILT_IN


@dataclass(frozen=True, kw_only=True)
class Uniform(Sampler):
    """Independent pores."""

    name: ClassVar[str] = "sample.uniform"
    count: int = option(5, help="number of pores")

    def throw(self, rng, box):
        seen.append(box)
        return box.lower + rng.random((self.count, 3)) * (box.upper - box.lower)


@dataclass(frozen=True, kw_only=True)
class Chain(Connector):
    """One pore after the other."""

    name: ClassVar[str] = "connect.chain"

    def join(self, rng, piece):
        pieces.append(piece)
        n = len(piece.points)
        return np.stack([np.arange(n - 1), np.arange(1, n)], 1), np.zeros((n - 1, 3), np.int64)


seen: list = []
pieces: list = []


@pytest.fixture(autouse=True)
def _forget():
    seen.clear()
    pieces.clear()


def test_what_a_sampler_is_told():
    palette = Palette(2, (2, 2, 2))
    context = PlainContext(1, palette=palette)
    Uniform().run(context, None)
    lone = seen.pop()
    assert lone.periodic
    assert (lone.lower.tolist(), lone.upper.tolist()) == ([0] * 3, [1] * 3)
    assert (len(lone.obstacles), lone.face_pores, lone.spacing) == (0, 0, None)
    seen.clear()
    faces = MirroredFaces(count=9, spacing=Length(0.2, "cell"), edge=Length(2), faces_margin="paper").run(context, None)
    twice = Uniform(count=3).run(context, Uniform(count=2).run(context, faces))
    for box in seen:
        assert not box.periodic
        assert box.cell == Cell(2.0)
        assert box.face_pores == 9
    assert np.allclose(seen[0].lower, 0.2)
    assert [len(box.obstacles) for box in seen] == [36, 36, 38, 38]
    assert [len(twice.of_piece(t)) for t in range(2)] == [5, 5]
    assert twice.spacing is None


def test_a_sampler_that_returns_nonsense_is_blamed():
    @dataclass(frozen=True, kw_only=True)
    class Wrong(Uniform):
        """Two coordinates."""

        def throw(self, rng, box):
            return np.full((4, 3), np.nan)

    with pytest.raises(ValueError, match="must return"):
        Wrong().run(PlainContext(), None)


def test_what_a_connector_is_told_and_where_its_edges_go():
    context = PlainContext(1, palette=Palette(2, (1, 1, 1)))
    faces = MirroredFaces(count=9, spacing=Length(0.2)).run(context, None)
    graph = Chain().run(context, Uniform().run(context, faces))
    graph.check()
    assert [piece.region for piece in pieces] == ["interior"] * 2 + ["face"] * 3
    assert not any(piece.periodic for piece in pieces)
    own = graph.pores.piece[graph.edges]
    assert (own[:, 0] == own[:, 1]).sum() == 2 * 4 + 3 * 2
    assert (own[:, 0] != own[:, 1]).sum() == 2 * 2 * 9
    lone = Chain().run(context, Uniform(count=1).run(context, None))
    assert len(lone.edges) == 0


def test_only_meetings_that_occur_are_connected():
    meetings = np.array([[0, 0, 0, 1], [1, 2, 1, 0]])
    context = PlainContext(1, palette=Palette(2, (2, 2, 2), meetings))
    faces = MirroredFaces(count=6, spacing=Length(0.2)).run(context, None)
    graph = Chain().run(context, Uniform().run(context, faces))
    a, b = graph.pores.piece[graph.edges].T
    crossing = a != b
    met = {(int(t), int(p)) for t, p in zip(a[crossing], b[crossing], strict=True)}
    assert met == {(0, faces.face_piece(0, 1)), (1, faces.face_piece(2, 0))}
    assert set(map(tuple, graph.shift[crossing].tolist())) == {(0, 0, 0), (0, 0, 1)}


def test_all_meetings_of_an_open_palette():
    rows = Palette(2, (1, 2, 0)).all_meetings()
    assert len(rows) == len({tuple(row) for row in rows.tolist()}) == 2 * 2 * 3
    assert rows[:, 1].max() == 1


def test_a_rule_and_a_set_of_one_s_own(recipe):
    @dataclass(frozen=True, kw_only=True)
    class Two(TileSetMaker):
        """Two interiors, one color."""

        name: ClassVar[str] = "tileset.two"
        kind: ClassVar[str] = "free"

        def palette(self):
            return Palette(2)

        def trial(self):
            return [lone_periodic_cell(t) for t in range(2)]

        def palette_size(self):
            return 1

    @dataclass(frozen=True, kw_only=True)
    class Chequers(Tiler):
        """In turn."""

        name: ClassVar[str] = "tile.chequers"
        kinds: ClassVar[tuple[str, ...]] = ("free",)

        def lay(self, rng, mask, tileset):
            interior = np.where(mask, np.indices(mask.shape).sum(0) % 2, -1).astype(np.int32)
            faces = [np.zeros(np.array(mask.shape) + np.eye(3, dtype=int)[axis], np.int32) for axis in range(3)]
            return interior, tuple(faces)

    made = Two(porosity=0.4, resolution=16, tolerance=0.02).run(PlainContext(1), recipe())
    assert len(made.porosity) == 2
    assert np.mean(made.porosity) == pytest.approx(0.4, abs=0.005)
    tiling = Chequers(cells=(2, 2, 2)).run(PlainContext(1), made, None)
    assert np.isfinite(tiling.sample(tiling_grid(tiling))).all()


def tiling_grid(tiling):
    """A coarse grid over all cells."""
    from sppm_pipeline.services.grid import cell_nodes

    return cell_nodes(5, tiling.cells)


def test_lattices(wedge):
    assert lattice_for(None, (2, 3, 4), wedge, None).mask.shape == (2, 3, 4)
    assert lattice_for(None, (2, 3, 4), None, 5.0).edge == 5.0
    assert lattice_for(Length(3), (2, 3, 4), None, 5.0).edge == 3.0
    exact = lattice_for(Length(float(wedge.upper[0] - wedge.lower[0])), None, wedge, None)
    assert exact.mask.shape == (1, 1, 1)
    assert exact.mask.all()


def test_starts():
    assert start_of(None, None, 3)[1].interiors == 3
    assert start_of(Length(1, "cm"), None, 1)[0] == Cell(10.0, True)
    pores = PoreSet(Cell(2.0), np.zeros((0, 3)), np.zeros(0, np.int32))
    assert start_of(Length(2), pores, 1) == (Cell(2.0), pores)


def test_every_kind_names_a_rule_that_exists():
    assert all(f"tile.{rule}" in BUILT_IN for rule in KIND_TO_RULE.values())


@dataclass(frozen=True, kw_only=True)
class Primitive(FieldMaker):
    """The primitive surface of Schwarz."""

    name: ClassVar[str] = "field.primitive"
    level: float = option(0.0, help="value of the sum at the surface")

    def evaluate(self, x, y, z):
        return np.cos(2 * np.pi * x) + np.cos(2 * np.pi * y) + np.cos(2 * np.pi * z) - self.level


@dataclass(frozen=True, kw_only=True)
class Levelled(Primitive):
    """The same, with a name for what tuning changes."""

    name: ClassVar[str] = "field.levelled"

    def cut_at(self, value):
        return replace(self, level=self.level + value)

    @property
    def finest_radius(self):
        return 0.1


@dataclass(frozen=True, kw_only=True)
class Shell(PartFieldMaker):
    """A shell around the low corner of the part."""

    name: ClassVar[str] = "field.shell"
    radius: Length = option(Length(1.2), help="radius", unit="cell size")

    def evaluate(self, x, y, z):
        return np.abs(np.sqrt(x * x + y * y + z * z) - self.in_cells(self.radius)) - 0.1


class TestFieldMakerContract(StageContract):
    def stages(self):
        return [Primitive(), Levelled(level=0.3, edge=Length(5.0)), Primitive(edge=Length(2.0, "mm"))]


class TestPartFieldMakerContract(StageContract):
    def stages(self):
        return [Shell(cells=(2, 2, 1)), Shell(cells=(3, 1, 1), edge=Length(3.0), radius=Length(4.0, "mm"))]


@pytest.mark.parametrize("made", [(Primitive(),), (Shell(cells=(2, 2, 2)), None)])
def test_a_formula_gives_the_same_bytes_in_slabs_and_threads(made):
    stage, *ports = made
    field = stage.run(PlainContext(), *ports)
    grid = Grid((0.013, 0.2, 0.07), (1 / 37,) * 3, (90, 70, 40))
    whole = field.sample(grid)
    assert whole.dtype == np.float32
    assert np.array_equal(field.sample(grid, 3), whole)
    assert np.array_equal(field.sample_layers(grid, 11, 29, 2), whole[:, :, 11:29])
    assert np.array_equal(field.solid(grid), whole < 0)


def test_a_formula_repeats_to_the_last_bit():
    field = Primitive().run(PlainContext())
    assert (field.periodic, field.cells, field.edge_mm) == (True, (1, 1, 1), None)
    here, there = (field.sample(Grid((at + 0.1, -at, 7 * at), (0.1, 0.07, 0.03), (9, 8, 7))) for at in (0.0, 3.0))
    assert np.array_equal(here, there)


@pytest.mark.parametrize("stage", [Primitive(), Levelled()])
def test_a_formula_is_tuned(stage):
    recipe = recipe_of(stage)
    tuned = TunePorosity(target=0.6).run(PlainContext(), recipe)
    assert np.mean(tuned.sample(cell_centers(50)) >= 0) == pytest.approx(0.6, abs=2e-3)
    if isinstance(stage, Levelled):
        assert tuned.maker.level < 0 == tuned.offset
        assert "9 or more" in tuned.coarseness(0.2)
    else:
        assert tuned.maker.level == 0 > tuned.offset
        assert tuned.coarseness(0.2) is None


def test_a_formula_of_a_part():
    field = Shell(cells=(2, 2, 2), edge=Length(4.0)).run(PlainContext(), None)
    assert (field.periodic, field.cells, field.edge_mm) == (False, (2, 2, 2), 4.0)
    assert field.sample(Grid((1.2, 0.0, 0.0), (1.0,) * 3, (1, 1, 1))).item() == pytest.approx(-0.1)
    ball = ReadPrimitive(shape="ball", size=(Length(10.0),) * 3).run(PlainContext())
    covered = Shell(edge=Length(4.0)).run(PlainContext(), ball)
    assert covered.cells == (3, 3, 3)
    assert covered.origin_mm == pytest.approx(ball.lower - 1)
    with pytest.raises(ConfigError, match="size of a cell"):
        Shell().run(PlainContext(), ball)
    with pytest.raises(ConfigError, match="no physical size"):
        Shell(cells=(1, 1, 1), radius=Length(2.0, "mm")).run(PlainContext(), None).sample(cell_centers(2))


def test_a_formula_is_stored(tmp_path):
    field = Levelled(level=0.2, edge=Length(3.0)).run(PlainContext()).cut_at(0.1)
    assert "<locals>" not in type(field.maker).__qualname__
    assert field.digest() == Levelled(level=0.2, edge=Length(3.0)).run(PlainContext()).cut_at(0.1).digest()
    assert field.digest() != Levelled(level=0.2).run(PlainContext()).digest()


def test_a_formula_without_its_method_says_so():
    @dataclass(frozen=True, kw_only=True)
    class Empty(FieldMaker):
        """Nothing."""

        name: ClassVar[str] = "field.empty"

    with pytest.raises(NotImplementedError, match="Empty needs the method `evaluate`"):
        Empty().run(PlainContext()).sample(cell_centers(2))
