"""``check.sizes``: sizes and surface of a field and of an image."""

from dataclasses import dataclass

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, ResourceError
from sppm_pipeline.features.printing.stages.check_sizes import CheckSizes
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.method.stages.extract_voxels import ExtractVoxels
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.stage import Rejected
from sppm_pipeline.testing.plain_context import PlainContext


@dataclass(frozen=True, eq=False)
class Bubble(ScalarField):
    """A round pore of some radius in the middle of each cell of a solid."""

    radius: float
    extent: tuple[int, int, int] = (1, 1, 1)
    edge: float | None = None

    @property
    def cells(self):
        return self.extent

    @property
    def periodic(self):
        return True

    @property
    def edge_mm(self):
        return self.edge

    def sample_layers(self, grid, start, stop, threads=1):
        grid = grid.layers(start, stop)
        x, y, z = (np.mod(grid.axis(axis), 1.0) - 0.5 for axis in range(3))
        return (self.radius - np.sqrt(x[:, None, None] ** 2 + y[:, None] ** 2 + z**2)).astype(np.float32)


def measured(source, **options):
    context = PlainContext()
    CheckSizes(**options).run(context, source)
    return context.reported


@pytest.mark.parametrize("extent", [(1, 1, 1), (2, 1, 1)])
@pytest.mark.parametrize("edge", [None, 5.0])
def test_a_round_pore(extent, edge):
    found = measured(Bubble(0.3, extent, edge), resolution=32)
    scale = edge or 1.0
    assert found["unit"] == ("mm" if edge else "cell size")
    # too small by three voxels at most, never too large
    assert 0.6 - 3 / 32 <= found["void"]["largest"] / scale <= 0.6
    assert 0.6 - 3 / 32 <= found["void"]["quantiles"][1] / scale <= 0.6
    assert found["specific_surface"] == pytest.approx(4 * np.pi * 0.3**2 / scale, rel=0.02)
    # the largest ball between eight bubbles sits at the corner of the cell
    assert 0 <= 2 * (0.75**0.5 - 0.3) - found["solid"]["largest"] / scale <= 3 / 32


def test_a_pore_across_the_seam_has_all_its_surface(cell):
    """Moving the cell changes nothing: the seam is no surface."""

    @dataclass(frozen=True, eq=False)
    class Moved(Bubble):
        def sample_layers(self, grid, start, stop, threads=1):
            grid = grid.layers(start, stop)
            x, y, z = (np.mod(grid.axis(axis) + 0.4, 1.0) - 0.5 for axis in range(3))
            return (self.radius - np.sqrt(x[:, None, None] ** 2 + y[:, None] ** 2 + z**2)).astype(np.float32)

    moved, still = (measured(field, resolution=20)["specific_surface"] for field in (Moved(0.3), Bubble(0.3)))
    assert moved == pytest.approx(still, rel=1e-3)


def test_an_image_gives_the_sizes_of_its_field(cell):
    field = measured(cell, resolution=32)
    image = measured(ExtractVoxels(resolution=32).run(PlainContext(), cell))
    assert image["solid"] == field["solid"]
    assert image["void"] == field["void"]
    assert "specific_surface" not in image


def test_a_phase_that_is_not_there():
    found = measured(Voxels(np.ones((8, 8, 8), np.uint8), (0.5,) * 3, True, (True,) * 3))
    assert found["void"] is None
    assert found["solid"]["mean"] == 4.0


def test_what_cannot_be_measured(cell):
    with pytest.raises(ConfigError, match="cubic"):
        measured(Voxels(np.ones((2, 2, 2), np.uint8), (1, 1, 2), True, (True,) * 3))
    with pytest.raises(ResourceError, match="resolution"):
        measured(Bubble(0.3, (100, 100, 100)), resolution=64)


def plates(spacing=0.1):
    """Plates of 3 and 9 voxels, with gaps of 5 and 15 between them."""
    solid = np.zeros((8, 8, 32), np.uint8)
    solid[:, :, :3] = solid[:, :, 8:17] = 1
    return Voxels(solid, (spacing,) * 3, True, (True,) * 3)


def test_what_the_machine_makes():
    """A plate as thick as the limit is not thinner; a nozzle limits walls only, powder has a limit for each."""
    found = measured(plates(), nozzle=Length(0.9, "mm"))
    assert found["thin_solid_share"] == 3 / 12
    assert found["solid_limit_mm"] == 0.9
    assert "narrow_void_share" not in found
    assert "void_limit_mm" not in found
    assert measured(plates(), nozzle=Length(0.3, "mm"))["thin_solid_share"] == 0
    assert measured(plates(), nozzle=Length(0.91, "mm"))["thin_solid_share"] == 1
    found = measured(plates(), powder=(Length(0.2, "mm"), Length(1.0, "mm")), nozzle=Length(0.4, "mm"))
    assert (found["thin_solid_share"], found["narrow_void_share"]) == (3 / 12, 5 / 20)
    assert (found["solid_limit_mm"], found["void_limit_mm"]) == (0.4, 1.0)
    context = PlainContext()
    CheckSizes(powder=(Length(0.8, "mm"), Length(0.5, "mm"))).run(context, plates())
    assert context.warnings[0] == "share of the solid that is thinner than the machine makes it: 25.0%, below 0.8 mm"
    assert "0.5 mm are 5 voxels" in context.warnings[1]
    assert len(context.warnings) == 2


def test_rules_reject_what_the_machine_does_not_make(cell):
    thin = {"nozzle": Length(0.8, "mm"), "fail": ("thin > 0.2",)}
    with pytest.raises(Rejected, match=r"thinner than the machine makes it: 0\.25, more than 0\.2"):
        measured(plates(), **thin)
    assert measured(plates(), nozzle=Length(0.8, "mm"), fail=("thin > 0.3",))["thin_solid_share"] == 0.25
    with pytest.raises(Rejected, match="narrower"):
        measured(plates(), printable=Length(0.8, "mm"), fail=("narrow",))
    for rule, message in (("narrow > 0.1", "there is none"), ("wide", "thin > 0.1"), ("thin < 1", "can't be compared")):
        with pytest.raises(ConfigError) as caught:
            CheckSizes(nozzle=Length(0.8, "mm"), fail=(rule,)).check_options()
        assert message in f"{caught.value} {caught.value.hint}"
    with pytest.raises(ConfigError, match="no physical size"):
        measured(Bubble(0.3, (1, 1, 1), None), **thin)
