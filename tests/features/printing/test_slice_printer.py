"""Slices for a printer: its pixels, its layers, its room."""

import pytest

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.primitive_meshes import box_mesh
from sppm_pipeline.method.stages.slice_field import SliceField
from sppm_pipeline.method.stages.slice_mesh import SliceMesh
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.plain_context import PlainContext

LAYER = Length(0.1, "mm")


def box(*size):
    return SurfaceMesh(*box_mesh((0, 0, 0), size), name="box")


def test_the_printer_sets_the_pixels(wang_tiling):
    for stack in (
        SliceMesh(printer="elegoo_saturn_4", layer=LAYER).run(PlainContext(), box(10, 5, 1)),
        SliceField(printer="elegoo_saturn_4", layer=LAYER).run(PlainContext(), wang_tiling),
    ):
        assert stack.printer.name == "elegoo_saturn_4"
        assert (*stack.pixel_mm, stack.layer_mm) == (0.019, 0.024, 0.1)
        assert stack.summary()["printer"] == "elegoo_saturn_4"


@pytest.mark.parametrize("stage", [SliceField, SliceMesh])
def test_what_the_printer_cannot_do_is_refused_before_any_work(stage):
    same = stage(printer="prusa_sl1s", pixel=Length(0.05, "mm"), layer=LAYER)
    same.check_options()
    for options, message in (
        ({"printer": "prusa_sl1s"}, "needs a `layer`"),
        ({"printer": "prusa_sl1s", "layer": Length(0.2, "mm")}, r"layers of 0.025 to 0.1 mm"),
        ({"printer": "prusa_sl1s", "layer": LAYER, "pixel": Length(0.04, "mm")}, "those of prusa_sl1s are 50 x 50 um"),
        ({"printer": "prusa_sl9", "layer": LAYER}, "no printer called 'prusa_sl9'"),
        ({"layer": LAYER}, "`pixel`"),
    ):
        with pytest.raises(ConfigError, match=message):
            stage(**options).check_options()


def test_a_part_that_is_too_large(tmp_path):
    slicer = SliceMesh(printer="prusa_sl1s", layer=LAYER)
    slicer.run(PlainContext(), box(128, 81, 150))
    with pytest.raises(
        DesignError, match=r"the part is 81 x 128 x 20 mm; prusa_sl1s prints 128 x 81 x 150 mm"
    ) as caught:
        slicer.run(PlainContext(), box(81, 128, 20))
    assert "turned by 90 degrees" in caught.value.hint
    assert "elegoo_mars_2 " in caught.value.hint


def test_cards_without_a_printer(tmp_path):
    file = tmp_path / "cards.yaml"
    file.write_text("printers: {}")
    with pytest.raises(ConfigError, match="`printer` names none"):
        SliceMesh(pixel=Length(0.05, "mm"), cards=file).check_options()
    with pytest.raises(ConfigError, match=r"which can't be read: No such file"):
        SliceMesh(printer="prusa_sl1s", layer=LAYER, cards=tmp_path / "none.yaml").check_options()
