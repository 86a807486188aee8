"""``check.print``: the report of bodies with known answers, its files, its rules, and its ends."""

import csv
import json

import numpy as np
import pytest
from PIL import Image

from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.plan.checking import declared_numbers
from sppm_pipeline.engine.run.sweep_table import numbers_of
from sppm_pipeline.engine.strict_json import jsonable
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.printing.print_pictures import MARKS
from sppm_pipeline.features.printing.print_report import MEASURES, parse_rule
from sppm_pipeline.features.printing.stages.check_print import CheckPrint
from sppm_pipeline.method.nouns.printer import cards
from sppm_pipeline.method.slicing.slice_stack import ArraySlices, SliceStack
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.stage import Rejected
from sppm_pipeline.testing.plain_context import PlainContext

PIXEL, LAYER = (0.2, 0.25), 0.5
VOXEL = 0.2 * 0.25 * 0.5


@pytest.fixture
def vase():
    """A box with a closed void, a cup that is open at the top, an island and a part that floats."""
    solid = np.zeros((12, 14, 20), bool)
    solid[1:9, 1:11, 1:15] = True
    solid[3:6, 3:7, 3:6] = False
    solid[4:, 3:6, 9:12] = False
    solid[3:9, 12, 17] = True
    solid[8, 10:13, 14:18] = True
    solid[10, 0, 0] = True
    return solid


def checked(solid, **options):
    context = PlainContext()
    layers = np.asarray(solid)
    stack = SliceStack.from_array(layers, pixel_mm=PIXEL, layer_mm=LAYER)
    try:
        made = CheckPrint(**options).run(context, stack)
        assert made is stack
    except Rejected as rejection:
        return context, str(rejection)
    return context, None


def test_report_of_a_body_with_known_answers(vase):
    context, _ = checked(vase)
    found = context.reported
    assert found["traps"] == 1
    assert found["trap_mm3"] == pytest.approx(3 * 4 * 3 * VOXEL)
    assert (found["cups"], found["cups_open_at_top"], found["cups_at_plate"]) == (1, 0, 0)
    assert found["largest_cup_mm2"] == pytest.approx(4 * 3 * 0.05)
    assert (found["cups_above_30_mm2"], found["cups_below_3_mm2"]) == (0, 1)
    assert "(0 above 30 mm2, 1 below 3 mm2, 0 through holes)" in found["verdict"]
    assert found["resin_g"] is None  # of what resin, is not known
    assert found["suction_n"] == pytest.approx((4 * 3 + 3 * 3) * 0.05 * 0.101)
    assert (found["islands"], found["floating_parts"]) == (1, 1)
    assert found["largest_island_mm2"] == pytest.approx(0.05)
    assert found["floating_mm3"] == pytest.approx(VOXEL)
    assert found["solid_mm3"] == pytest.approx(vase.sum() * VOXEL)
    declared = declared_numbers(CheckPrint, True, ())
    reported = {name: value for name, value in found.items() if name != "verdict"}
    numbers = numbers_of([{"id": "p", "summary": jsonable(reported)}])
    missing = {f"p.{name}" for name, value in reported.items() if value is None}
    assert set(numbers) | missing == {f"p.{place}" for place in declared}
    x, y, z = (i.mean() + 0.5 for i in np.nonzero(vase)[::-1])
    assert found["center_of_mass_mm"] == pytest.approx([x * 0.2, y * 0.25, z * 0.5], abs=1e-4)
    assert found["foot_margin_mm"] == pytest.approx(min(0.2 * (x - 1), 0.2 * (15 - x), 0.25 * (y - 1), 0.25 * (11 - y)))
    assert found["adhesion"] == pytest.approx(140 / vase.sum((1, 2)).max())
    assert "1 resin trap of 0.9 mm3" in found["verdict"]
    assert any("liquid resin" in text for text in context.warnings)
    assert any("float" in text for text in context.warnings)


def test_files_of_the_report(vase):
    context, _ = checked(vase)  # the folder goes with it
    folder = context.directory / "print"
    report = json.loads((folder / "report.json").read_text())
    assert report["traps"] == [
        {
            "first_layer": 3, "last_layer": 5, "end": "never", "volume_mm3": 0.9, "largest_section_mm2": 0.6,
            "place_mm": [0.9, 0.875, 1.75],
        }
    ]  # fmt: skip
    assert [island["end"] for island in report["islands"]] == ["joined", "never"]
    assert report["settings"]["first_layer"] == 1
    rows = list(csv.DictReader((folder / "layers.csv").read_text().splitlines()))
    assert [int(row["layer"]) for row in rows] == list(range(12))
    assert [float(row["area_mm2"]) for row in rows] == pytest.approx(vase.sum((1, 2)) * 0.05)
    assert [float(row["sealed_mm2"]) for row in rows][2:10] == pytest.approx([0, 0.6, 1.05, 1.05, 0.45, 0.45, 0.45, 0])
    assert float(rows[1]["perimeter_mm"]) == pytest.approx(2 * (14 * 0.2 + 10 * 0.25))
    assert (folder / "layers.png").read_bytes().startswith(b"\x89PNG")
    painted = np.asarray(Image.open(folder / "marked" / "00004.png"))
    colors = dict(MARKS)
    assert tuple(painted[::-1][4, 4]) == colors["resin trap"]
    assert tuple(painted[::-1][4, 10]) == colors["suction cup"]
    assert tuple(painted[::-1][12, 17]) == colors["island"]
    assert tuple(painted[::-1][1, 1]) == colors["solid"]
    assert (folder / "marked.png").exists()


def test_rules_reject_what_breaks_them(vase):
    assert checked(vase, fail=("cup > 0.7 mm2", "trap > 1", "adhesion < 0.9", "margin < 0.1"))[1] is None
    assert "0.9 mm3" in checked(vase, fail=("trap",))[1]
    assert "more than 0.5" in checked(vase, fail=("cup > 0.5 mm2",))[1]
    assert "less than 2" in checked(vase, fail=("adhesion < 2",))[1]
    both = checked(vase, fail=("floating", "overhang"))[1]
    assert "never joins" in both
    assert "overhang" in both


@pytest.mark.parametrize("name", MEASURES)
def test_every_measure_of_a_rule_is_reported(vase, name):
    assert MEASURES[name].number in checked(vase)[0].reported


@pytest.mark.parametrize(
    ("rule", "said"),
    [
        ("traps", "is no rule"), ("trap > 1 cm3", "trap > NUMBER mm3"), ("cup < 3 mm2", "cup > NUMBER"),
        ("adhesion", "threshold"), ("", "is no rule"), ("trap > .e-1", "not a number"), ("trap 3", "is no rule"),
    ],
)  # fmt: skip
def test_what_is_no_rule(rule, said):
    with pytest.raises(ConfigError) as refused:
        parse_rule(rule)
    assert said in f"{refused.value} {refused.value.hint}"


def test_gray_counts_from_the_half():
    layers = np.full((3, 6, 7), 127, np.uint8)
    layers[:, 2:4, 2:4] = 128
    stack = SliceStack.from_array(layers, pixel_mm=0.1)
    context = PlainContext()
    CheckPrint(pictures=0).run(context, stack)
    assert context.reported["solid_mm3"] == pytest.approx(12 * 1e-3)
    assert not (context.directory / "print" / "marked").exists()


@pytest.mark.parametrize("value", [0, 255])
def test_nothing_and_everything(value):
    context = PlainContext()
    CheckPrint().run(context, SliceStack.from_array(np.full((2, 3, 4), value, np.uint8), pixel_mm=0.1))
    assert "no resin trap" in context.reported["verdict"]
    assert (context.reported["foot_margin_mm"] is None) == (value == 0)
    json.loads((context.directory / "print" / "report.json").read_text())


def test_a_layer_without_void_over_a_void():
    """A part that fills its image, as a panel with faces does: what the face closes is a trap."""
    solid = np.ones((5, 6, 7), bool)
    solid[1:3, 2:4, 2:5] = False
    found = checked(solid)[0].reported
    assert (found["traps"], found["cups"]) == (1, 0)
    assert found["trap_mm3"] == pytest.approx(2 * 2 * 3 * VOXEL)


def test_on_supports_the_void_below_is_open(vase):
    hollow = vase.copy()
    hollow[1:3, 4:6, 4:6] = False
    assert checked(hollow)[0].reported["cups_at_plate"] == 1
    found = checked(hollow, plate="supports")[0].reported
    assert (found["traps"], found["cups_at_plate"]) == (0, 0)


def test_throats_walls_and_cure_through_of_a_box_with_a_hole():
    """A shell of 5 voxels with a hole of 5 voxels at its side."""
    solid = np.zeros((40, 40, 40), bool)
    solid[2:38, 2:38, 2:38] = True
    solid[7:33, 7:33, 7:33] = False
    solid[18:23, 18:23, 33:] = False
    context = PlainContext()
    stack = SliceStack.from_array(solid, pixel_mm=0.1)
    # voxels are a quarter of half the throat: those of the layers
    stage = CheckPrint(drain=Length(0.5), min_feature=Length(0.4), penetration=Length(0.1), cure_depth=Length(0.1))
    stage.run(context, stack)
    found = context.reported
    report = json.loads((context.directory / "print" / "report.json").read_text())
    by_size = {row["diameter_mm"]: row["undrained_mm3"] for row in report["throats"]}
    assert [size for size, stays in by_size.items() if stays] == pytest.approx([0.5 * 2**0.5, 1.0], rel=1e-5)
    assert found["undrained_mm3"] == 0
    # from a corner of the room of 26 voxels, in which the ball has 22, to the hole in the middle of a side, and out
    assert found["way_out_mm"] == pytest.approx(0.1 * (22 + 11 + 11 + 7), abs=2 * 0.4)
    assert report["settings"]["coarse_voxel_mm"] == {"throats": [0.1] * 3, "features": [0.1] * 3}
    # flat walls of five voxels are thick enough, and only edges are rounded off
    assert 0 < found["thin_solid_share"] < 0.05
    ceiling = 26 * 26 + 5 * 5
    assert found["clogged_mm3"] == pytest.approx(ceiling * 1e-3, rel=0.05)
    assert (context.directory / "print" / "throats.png").exists()
    with pytest.raises(Rejected, match="cure shut"):
        CheckPrint(fail=("clogged",), penetration=Length(0.1), cure_depth=Length(0.1)).run(PlainContext(), stack)


def test_a_resin_has_both_depths(tmp_path):
    with pytest.raises(ConfigError, match="cure_depth"):
        CheckPrint(penetration=Length(0.1)).check_options()
    CheckPrint(penetration=Length(0.1), resin="generic_gray").check_options()
    with pytest.raises(ConfigError, match="generic_grey"):
        CheckPrint(resin="generic_grey").check_options()
    with pytest.raises(ConfigError, match="names none"):
        CheckPrint(cards=tmp_path / "own.yaml").check_options()


def test_resin_time_and_price(vase, tmp_path):
    own = tmp_path / "own.yaml"
    own.write_text(
        "resins:\n  plain: {density_g_ml: 1.1, exposure_s: [20, 2], bottom_layers: 3, price_per_liter: 50,"
        " source: a test, measured: false}\n"
    )
    plain = checked(vase)[0].reported
    assert plain["resin_ml"] == pytest.approx(vase.sum() * VOXEL / 1000 * 1.05)
    assert (plain["print_time_s"], plain["price"], plain["clogged_mm3"]) == (None, None, None)
    context, _ = checked(vase, resin="plain", cards=own, loss=0.0)
    assert context.reported["price"] == pytest.approx(vase.sum() * VOXEL / 1e6 * 50)
    assert context.reported["resin_g"] == pytest.approx(1.1 * context.reported["resin_ml"])
    assert f"ml of resin, {context.reported['resin_g']:.3g} g, price" in context.reported["verdict"]
    # a card without the depths of the working curve
    assert context.reported["clogged_mm3"] is None
    assert "cure-through is left out" in context.warnings[-1]
    printer = cards().printer("elegoo_mars_4")
    stack = SliceStack.from_array(vase, pixel_mm=printer.pixel_mm, layer_mm=0.05, printer=printer)
    timed = PlainContext()
    CheckPrint(resin="plain", cards=own).run(timed, stack)
    ways = [printer.motion.seconds(bottom) for bottom in (True, False)]
    assert timed.reported["print_time_s"] == pytest.approx(3 * (20 + ways[0]) + 9 * (2 + ways[1]))
    assert checked(vase, resin="generic_gray")[0].reported["clogged_mm3"] is not None


def test_the_same_report_however_the_layers_come(vase):
    """Slabs of one layer and of five, over one thread and two: the same bytes in all files."""

    class Slabby(ArraySlices):
        def read(self, threads):
            for start in range(0, len(self.layers), 5):
                yield start, self.layers[start : start + 5].copy()
            return {}

    layers = vase * np.uint8(255)
    found = []
    for kind, threads in ((ArraySlices, 1), (Slabby, 2)):
        context = PlainContext(threads=threads)
        CheckPrint(drain=Length(0.5), min_feature=Length(0.5)).run(context, kind(layers, (*PIXEL, LAYER)))
        files = sorted((context.directory / "print").rglob("*.*"))
        found.append({file.name: file.read_bytes() for file in files})
    assert found[0].keys() == found[1].keys()
    assert all(found[0][name] == found[1][name] for name in found[0])


BALL = """sppm: 1
name: ball
pipeline:
  - {stage: read.primitive, shape: ball, size: [2, 2, 2]}
  - {stage: slice.mesh, pixel: 0.1 mm, layer: 0.1 mm}
  - {stage: check.print, pictures: 1, fail: [overhang > 0.1 mm2]}
"""


def test_a_rejected_print_keeps_its_report(tmp_path, capsys):
    file, run = tmp_path / "ball.yaml", tmp_path / "run"
    file.write_text(BALL)
    words = ["run", str(file), "-o", str(run), "--no-plugins", "-q", "--no-cache"]
    assert main([*words, "-s", "check.print.fail=[]"]) == 0
    accepted = (run / "print" / "report.json").read_bytes()
    (run / "print" / "report.json").write_text("of an earlier run")
    assert main(words) == 3
    assert "print/report.json" in capsys.readouterr().err
    assert (run / "print" / "report.json").read_bytes() == accepted
    record = json.loads((run / "run.json").read_text())
    assert (record["status"], record["error"]["kind"]) == ("failed", "Rejected")
    entry = record["stages"][-1]
    assert entry["rejected"] is True
    assert entry["summary"]["largest_overhang_mm2"] > 0.1
    assert [output["path"] for output in entry["outputs"]] == ["print"]
    assert main(["verify", str(run)]) == 0  # the record accounts for all that is there
    assert main(words) == 3  # and the cache or the folder do not make it look accepted
    assert main([*words, "-s", "check.print.report=other", "-s", "check.print.fail=[]"]) == 0
    assert not (run / "print").exists()
    assert "rejected" not in json.loads((run / "run.json").read_text())["stages"][-1]
