"""``check.print``: what happens to layers in a resin printer, before they are printed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, ClassVar, Literal, cast

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.print_report import PrintReport, parse_rule, rounded, trapped
from sppm_pipeline.data.size import Size
from sppm_pipeline.families import options
from sppm_pipeline.fields.slice_stack import SliceStack
from sppm_pipeline.stage import Context, Headline, Rejected, Stage, option

if TYPE_CHECKING:
    from sppm_pipeline.numerics.printing.scan import Scan
    from sppm_pipeline.numerics.printing.tracker import Events

ATMOSPHERE = 0.101
"""N/mm2: a cup that is pulled off the film is held by no more than the pressure of the air outside."""

LISTED = 100
"""Events of a kind that the report lists one by one, the largest first."""

SOLID_FROM = 128
"""Gray values from here on count as solid: half of the pixel is covered."""


@dataclass(frozen=True, kw_only=True)
class CheckPrint(Stage):
    """Report resin traps, suction cups, islands and overhang of layers, in one pass; the layers are passed on.

    Half-stack k is what is there when layer k is printed: layers 0 to k, bottom first, with the film below layer k. A
    suction cup is void in it that meets layer k and reaches neither the border of the image nor, with
    `plate: supports`, the space below the first layer. A resin trap is void of the whole part that opens nowhere. An
    island is solid that does not hang on the first layer yet. Void and solid are joined across faces of voxels only,
    which errs on the safe side for both. The suction is an upper bound: the pressure of the air on all cups of a layer.

    With `fail`, a print that breaks a rule is rejected (exit code 3); without, the report is all.
    """

    name: ClassVar[str] = "check.print"
    advice: ClassVar[str] = "slice with a larger `pixel` or `layer`"
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("verdict"), Headline("trap_mm3", "trapped", "mm^3"), Headline("suction_n", "suction up to", "N"),
        Headline("largest_overhang_mm2", "largest overhang", "mm^2"), Headline("adhesion"),
    )  # fmt: skip

    report: str = options.write_path("print", note="with report.json, layers.csv, layers.png and marked/")
    plate: str = option(
        "sealed",
        help="what closes the part from below: the build plate, or nothing, as it stands on supports",
        choices=("sealed", "supports"),
    )
    overhang_angle: float = option(
        45.0,
        help="solid is held by what lies below it within this angle from upright, and within a pixel",
        unit="degrees",
        minimum=0,
        maximum=89,
    )
    pictures: int = option(6, help="worst layers that are drawn with colors", minimum=0, maximum=100)
    fail: tuple[str, ...] = option((), help="rules that reject the print, such as trap or 'cup > 100 mm2'")

    def check_options(self) -> None:
        """Rules that can be read."""
        for rule in self.fail:
            parse_rule(rule)

    def estimate(self, palette: Palette, stack: Size) -> Size:
        return replace(stack, triangles=0.0)

    def run(self, context: Context, stack: SliceStack) -> SliceStack:
        """Read all layers once, write the report, and refuse what breaks a rule."""
        scan = self._scanned(context, stack)
        report = self._report(stack, scan)
        self._write(context, stack, report, scan)
        context.report(verdict=report.verdict, **report.numbers)
        if report.numbers["traps"]:
            first = report.events["traps"][0]
            context.warn(f"liquid resin stays inside: {trapped(report.numbers)}, that at {first['place_mm']} mm")
        if report.numbers["floating_parts"]:
            context.warn(f"{report.numbers['floating_parts']} parts never join the others: they float away in the vat")
        broken = [text for rule in self.fail if (text := parse_rule(rule).broken_by(report.numbers))]
        if broken:
            raise Rejected(
                f"the print is rejected: {'; '.join(broken)}",
                hint="change the part, or take the rule off `fail` of `check.print` to get the report and the layers",
            )
        return stack

    def _scanned(self, context: Context, stack: SliceStack) -> Scan:
        from sppm_pipeline.numerics.printing.scan import PrintScan

        reach = max(*stack.pixel_mm, stack.layer_mm * math.tan(math.radians(self.overhang_angle)))
        plate = cast(Literal["sealed", "supports"], self.plate)
        scan = PrintScan(stack.shape, stack.pixel_mm, reach, plate, self.pictures)
        nz = stack.shape[2]
        for start, slab in stack.slabs(context.threads):
            for layer in slab:
                scan.add((layer >= SOLID_FROM).view(np.uint8))
            context.progress(start + len(slab), nz, "layers")
        return scan.finish()

    def _report(self, stack: SliceStack, scan: Scan) -> PrintReport:
        from sppm_pipeline.numerics.printing.layers import margin_inside
        from sppm_pipeline.numerics.printing.tracker import AT_END, AT_PLATE, JOINED, NEVER

        (px, py), h = stack.pixel_mm, stack.layer_mm
        pixel, voxel = px * py, px * py * h
        curves, cups, islands = scan.curves, scan.cups, scan.islands
        area = curves["area"] * pixel
        largest = float(area.max())
        solid = largest > 0
        center = np.array(stack.origin_mm) + scan.center * (px, py, h)
        numbers: dict[str, Any] = {
            "traps": int(cups.count[NEVER]),
            "trap_mm3": float(cups.total[NEVER] * voxel),
            "largest_trap_mm3": float(cups.volume[cups.kind == NEVER].max(initial=0) * voxel),
            "cups": int(cups.count[JOINED] + cups.count[AT_PLATE] + cups.count[AT_END]),
            "cups_at_plate": int(cups.count[AT_PLATE]),
            "cups_open_at_top": int(cups.count[AT_END]),
            "largest_cup_mm2": float(cups.section.max(initial=0) * pixel),
            "suction_n": float(curves["sealed"].max() * pixel * ATMOSPHERE),
            "islands": int(islands.count[JOINED]),
            "largest_island_mm2": float(islands.section[islands.kind == JOINED].max(initial=0) * pixel),
            "floating_parts": int(islands.count[NEVER]),
            "floating_mm3": float(islands.total[NEVER] * voxel),
            "overhang_mm2": float(curves["overhang"].sum() * pixel),
            "largest_overhang_mm2": float(curves["overhang"].max() * pixel),
            "solid_mm3": float(area.sum() * h),
            "largest_layer_mm2": largest,
            "largest_section_mm2": float(curves["largest"].max() * pixel),
            "adhesion": float(area[scan.ground] / largest) if solid else None,
            "center_of_mass_mm": rounded(center) if solid else None,
            "foot_margin_mm": None,
        }
        if solid:
            foot, (cx, cy, _) = scan.foot * (px, py), scan.center * (px, py, h)
            numbers["foot_margin_mm"] = margin_inside(foot, (float(cx), float(cy)))
        z = stack.origin_mm[2] + (np.arange(stack.shape[2]) + 1) * h
        layers = {
            "layer": np.arange(stack.shape[2]),
            "top_mm": z,
            "area_mm2": area,
            "sealed_mm2": curves["sealed"] * pixel,
            "floating_mm2": curves["floating"] * pixel,
            "islands_mm2": curves["islands"] * pixel,
            "overhang_mm2": curves["overhang"] * pixel,
            "components": curves["components"],
            "largest_mm2": curves["largest"] * pixel,
            "perimeter_mm": curves["edges_x"] * px + curves["edges_y"] * py,
            "suction_n": curves["sealed"] * pixel * ATMOSPHERE,
        }
        listed = {
            "traps": _listed(cups, cups.kind == NEVER, stack),
            "cups": _listed(cups, cups.kind != NEVER, stack),
            "islands": _listed(islands, np.ones(len(islands.kind), bool), stack),
        }
        settings = {
            "pixel_mm": list(stack.pixel_mm), "layer_mm": h, "pixels": list(stack.shape[:2]), "layers": stack.shape[2],
            "plate": self.plate, "overhang_angle": self.overhang_angle, "first_layer": scan.ground if solid else None,
        }  # fmt: skip
        return PrintReport(numbers, listed, layers, settings)

    def _write(self, context: Context, stack: SliceStack, report: PrintReport, scan: Scan) -> None:
        from PIL import Image

        from sppm_pipeline.render.print_pictures import curves_chart, marked_layer, marked_sheet

        folder = context.output(self.report)
        folder.mkdir()
        (folder / "report.json").write_text(report.json(), encoding="utf-8")
        (folder / "layers.csv").write_text(report.csv(), encoding="utf-8", newline="")
        if find_spec("matplotlib"):
            (folder / "layers.png").write_bytes(curves_chart(report.layers))
        else:
            context.warn("layers.png is left out: charts are drawn by matplotlib (pip install 'sppm-pipeline[plot]')")
        if scan.worst:
            (folder / "marked").mkdir()
            for k, codes in scan.worst:
                Image.fromarray(marked_layer(codes)).save(folder / "marked" / f"{k:05d}.png")
            sheet = marked_sheet(scan.worst, stack.pixel_mm, report.layers)
            Image.fromarray(sheet).save(folder / "marked.png")


def _listed(found: Events, which: NDArray[np.bool_], stack: SliceStack) -> list[dict[str, Any]]:
    """The largest of some events in millimeters."""
    (px, py), h = stack.pixel_mm, stack.layer_mm
    ends = {0: "joined", 1: "never", 2: "at the plate", 3: "open at the top"}
    rows = []
    for i in np.flatnonzero(which)[:LISTED]:
        place = (found.place[i, ::-1] + 0.5) * (px, py, h) + stack.origin_mm
        rows.append(
            {
                "first_layer": int(found.birth[i]),
                "last_layer": int(found.end[i]) - 1,
                "end": ends[int(found.kind[i])],
                "volume_mm3": float(found.volume[i] * px * py * h),
                "largest_section_mm2": float(found.section[i] * px * py),
                "place_mm": rounded(place),
            }
        )
    return rows
