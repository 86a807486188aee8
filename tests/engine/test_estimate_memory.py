"""Memory is never estimated too low: by runs in processes of their own, and where grids are made later."""

from benchmarks.rates import measure
from sppm_pipeline import Size
from sppm_pipeline.engine.plan.estimate import cost
from sppm_pipeline.method.stages.fill_implicit import ImplicitFill
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.size import ONE, CellDesign, Geometry


def test_laid_cells_are_measured_and_that_takes_memory(tmp_path):
    """`tile.wang_3color` cuts the level for what was laid; the table had only the time of laying it."""
    _, _, stages = measure("folded", tmp_path)
    tile = next(stage for stage in stages if stage.stage == "tile.wang_3color")
    assert 0 < tile.taken[1] <= tile.estimated[1] < 1.4 * tile.taken[1]


def test_a_round_border_keeps_its_grid():
    """Parts that were filled with `border: round` took up to twice of what was estimated; what the border takes now."""
    field = Size(design=CellDesign(edge_mm=4.0), geometry=Geometry(edge_mm=4.0, porosity=0.7, surface=6.0))
    for size, thinnest, taken in ((12, 0.3, 42e6), (24, 0.5, 69e6), (18, 0.3, 127e6), (24, 0.3, 193e6)):
        domain = Size(geometry=Geometry(box=(size, size, size / 2), volume=size**3 / 8, envelope=4.0 * size**2))
        round_, cut = (
            cost("fill.implicit", ImplicitFill(**options).estimate(ONE, field, domain).units()).kept
            for options in ({"border": "round", "thinnest": Length(thinnest, "mm")}, {})
        )
        assert cut < 1e4
        assert taken <= round_ < 1.35 * taken
