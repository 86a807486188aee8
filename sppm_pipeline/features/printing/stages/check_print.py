"""``check.print``: what happens to layers in a resin printer, before they are printed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, cast

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, Headline, Length, Rejected, SliceStack, Stage, option, options
from sppm_pipeline.features.printing.print_pictures import marked_layer, marked_sheet
from sppm_pipeline.features.printing.print_report import PrintReport, parse_rule, rounded, trapped
from sppm_pipeline.method.nouns.printer import Job, Resin, cards
from sppm_pipeline.services.arrays import U8, Bools

if TYPE_CHECKING:
    from sppm_pipeline.features.printing.numerics.layers import Scan
    from sppm_pipeline.features.printing.numerics.tracker import Events

ATMOSPHERE = 0.101
"""N/mm2: a cup that is pulled off the film is held by no more than the pressure of the air outside."""

LARGE_CUP, SMALL_CUP = 30.0, 3.0
"""mm2; cups above the first, at which the air may pull with 3 N, are worth a drain, those below the second are not."""

MAX_LISTED = 100
"""Events of a kind that the report lists one by one, the largest first."""

THROATS = (0.5, 2**-0.5, 1.0, 2**0.5, 2.0)
"""Throats that are measured, as multiples of `drain`."""

VOXELS_ACROSS = 4
"""Voxels across the smallest size that is looked for; layers with finer pixels are merged. A heuristic: sizes are
right to within one of these voxels, so twice as many halve the error and cost eight times the time."""

MAX_BLOCKS = 2**26
"""Blocks in which ways out are searched, which are held in memory, five bytes each."""

SOLID_FROM = 128
"""Gray values from here on count as solid: half of the pixel is covered."""


def curves_chart(columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Area, cups, islands and overhang of each layer over its height, as PNG; layers without any are left out."""
    from sppm_pipeline.services.pictures.charts import Series, chart

    shown = (
        ("area_mm2", "solid", "#000000"),
        ("overhang_mm2", "overhang", "#888888"),
        ("sealed_mm2", "sealed (cups, traps)", "#0072b2"),
        ("floating_mm2", "not on the plate yet", "#e69f00"),
    )
    series = [
        Series(columns["top_mm"], columns[name], label, "line", color=color)
        for name, label, color in shown
        if (columns[name] > 0).any()
    ]
    return chart(
        series, "layers.png", x_label="height (mm)", y_label="area of the layer (mm²)", log_y=True, size=(7.5, 3.6)
    )


def throats_chart(rows: Sequence[Mapping[str, float]]) -> bytes:
    """Room of balls that can't leave over their diameter, as PNG."""
    from sppm_pipeline.services.pictures.charts import Series, chart

    x, y = ([row[name] for row in rows] for name in ("diameter_mm", "undrained_mm3"))
    series = [Series(x, y, kind="line", color="#0072b2"), Series(x, y, color="#0072b2")]
    return chart(series, "throats.png", x_label="throat (mm)", y_label="centers of balls that can't leave (mm³)")


@dataclass(frozen=True, kw_only=True)
class CheckPrint(Stage):
    """Report resin traps, suction cups, islands and overhang of layers, in one pass; the layers are passed on.

    Half-stack k is what is there when layer k is printed: layers 0 to k, bottom first, with the film below layer k. A
    suction cup is void in it that meets layer k and reaches neither the border of the image nor, with
    `plate: supports`, the space below the first layer. A resin trap is void of the whole part that opens nowhere. An
    island is solid not yet connected to the first layer. Void and solid are joined across faces of voxels only,
    which errs on the safe side for both. The suction is an upper bound: the pressure of the air on all cups of a layer.

    With `drain`, throats are measured: void from which a ball of that diameter, or of half to twice of it, can't be
    moved out is undrained; `way_out_mm` is the longest distance that powder must travel to an opening, along the axes
    and to within two diameters. With `min_feature`, walls and channels are found that no
    ball of that diameter fits into; sharp edges of solid count among them. Both look at voxels of about a quarter of
    the smallest size. With a `resin`, or its `penetration` and `cure_depth`, resin that later layers cure in the void
    below them is found (Jacobs' working curve): a model, not a measurement of your resin. Time is that of exposures and
    ways of the plate, if the layers were cut for a `printer`.

    With `fail`, a print that breaks a rule is rejected (exit code 3), and the report stays; without, it is all.
    """

    name: ClassVar[str] = "check.print"
    libraries: ClassVar[tuple[str, ...]] = ("matplotlib",)
    reported: ClassVar[tuple[str, ...]] = (
        "traps", "trap_mm3", "largest_trap_mm3", "cups", "cups_at_plate", "cups_open_at_top", "largest_cup_mm2",
        "cups_above_30_mm2", "cups_below_3_mm2",
        "suction_n", "islands", "largest_island_mm2", "floating_parts", "floating_mm3", "overhang_mm2",
        "largest_overhang_mm2", "solid_mm3", "largest_layer_mm2", "largest_section_mm2", "adhesion",
        "center_of_mass_mm.#3", "foot_margin_mm", "undrained_mm3", "way_out_mm", "thin_solid_share", "thin_void_mm3",
        "clogged_mm3", "clogged_trap_mm3", "resin_ml", "resin_g", "print_time_s", "price",
    )  # fmt: skip
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
    overhang_angle: float = options.overhang_angle(45.0)
    drain: Length | None = option(
        None, help="narrowest throat through which resin or powder leaves; not measured if omitted", unit="mm", above=0,
        maximum=100,
    )  # fmt: skip
    min_feature: Length | None = option(
        None, help="thinnest wall and channel that the printer makes; not measured if omitted", unit="mm", above=0,
        maximum=100,
    )  # fmt: skip
    resin: str | None = option(
        None, help="resin; `sppm printers --resins` lists them, for cure-through and, with a `printer`, time and price"
    )
    cards: Path | None = options.cards(None)
    penetration: Length | None = options.penetration(None, note="that of its card if omitted")
    cure_depth: Length | None = options.cure_depth(None, note="that of its card if omitted")
    loss: float = option(
        0.05, help="resin that is washed away, as a fraction of what becomes solid", minimum=0, maximum=10
    )
    pictures: int = option(6, help="worst layers that are drawn with colors", minimum=0, maximum=100)
    fail: tuple[str, ...] = options.fail((), note="such as trap or 'cup > 100 mm2'")

    def check_options(self) -> None:
        """Rules that can be read, a resin that is known, and both of its depths or none."""
        card = self.card()
        if card is None and (self.penetration is None) != (self.cure_depth is None):
            raise ConfigError("`penetration` and `cure_depth` describe a resin together; give both, none, or a `resin`")
        if card is None and self.cards is not None:
            raise ConfigError("`cards` holds resins, and `resin` names none of them")
        for rule in self.fail:
            parse_rule(rule)

    def card(self) -> Resin | None:
        """The card of the resin, with the depths that the options say otherwise."""
        if self.resin is None:
            return None
        found = cards(self.cards).resin(self.resin)
        return replace(
            found,
            penetration_mm=self.penetration.mm() if self.penetration else found.penetration_mm,
            cure_depth_mm=self.cure_depth.mm() if self.cure_depth else found.cure_depth_mm,
        )

    def depths(self) -> tuple[float, float] | None:
        """D_p and C_d in mm; None if they are not known."""
        card = self.card()
        if card is not None:
            p, c = card.penetration_mm, card.cure_depth_mm
        else:
            p, c = (length.mm() if length else None for length in (self.penetration, self.cure_depth))
        return None if p is None or c is None else (p, c)

    def run(self, context: Context, stack: SliceStack) -> SliceStack:
        """Read all layers once, write the report, and refuse what breaks a rule."""
        passes = Passes(self, stack)
        nz = stack.shape[2]
        for start, slab in stack.slabs(context.threads):
            for layer in slab:
                passes.add((layer >= SOLID_FROM).view(np.uint8))
            context.progress(start + len(slab), nz, "layers")
        passes.finish()
        report = self._report(stack, passes)
        self._write(context, stack, report, passes.scan)
        context.report(verdict=report.verdict, **report.numbers)
        if report.numbers["traps"]:
            first = report.events["traps"][0]
            context.warn(f"liquid resin stays inside: {trapped(report.numbers)}, that at {first['place_mm']} mm")
        if report.numbers["floating_parts"]:
            context.warn(f"{report.numbers['floating_parts']} parts never join the others: they float away in the vat")
        if self.resin is not None and self.depths() is None:
            context.warn(
                f"the card of {self.resin} has no `penetration_mm` and `cure_depth_mm`: cure-through is left out"
            )
        broken = [text for rule in self.fail if (text := parse_rule(rule).broken_by(report.numbers))]
        if broken:
            raise Rejected(
                f"the print is rejected: {'; '.join(broken)}",
                hint=f"{self.report}/report.json in the run directory says where; change the part, or take the rule "
                "off `fail` to get the layers",
                keep_outputs=True,
            )
        return stack

    def _report(self, stack: SliceStack, passes: Passes) -> PrintReport:
        from sppm_pipeline.features.printing.numerics.layers import margin_inside
        from sppm_pipeline.features.printing.numerics.tracker import AT_END, AT_PLATE, JOINED, NEVER

        (px, py), h = stack.pixel_mm, stack.layer_mm
        pixel, voxel = px * py, px * py * h
        scan = passes.scan
        curves, cups, islands = scan.curves, scan.cups, scan.islands
        area = curves["area"] * pixel
        largest = float(area.max())
        solid = largest > 0
        center = np.array(stack.origin_mm) + scan.center * (px, py, h)
        numbers: dict[str, Any] = {
            "traps": int(cups.counts[NEVER]),
            "trap_mm3": float(cups.totals[NEVER] * voxel),
            "largest_trap_mm3": float(cups.volume[cups.kind == NEVER].max(initial=0) * voxel),
            "cups": int(cups.counts[JOINED] + cups.counts[AT_PLATE] + cups.counts[AT_END]),
            "cups_at_plate": int(cups.counts[AT_PLATE]),
            "cups_open_at_top": int(cups.counts[AT_END]),
            "largest_cup_mm2": float(cups.section.max(initial=0) * pixel),
            "cups_above_30_mm2": int((cups.section[cups.kind != NEVER] * pixel > LARGE_CUP).sum()),
            "cups_below_3_mm2": int((cups.section[cups.kind != NEVER] * pixel < SMALL_CUP).sum()),
            "suction_n": float(curves["sealed"].max() * pixel * ATMOSPHERE),
            "islands": int(islands.counts[JOINED]),
            "largest_island_mm2": float(islands.section[islands.kind == JOINED].max(initial=0) * pixel),
            "floating_parts": int(islands.counts[NEVER]),
            "floating_mm3": float(islands.totals[NEVER] * voxel),
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
        numbers |= passes.numbers() | self._job(stack, numbers["solid_mm3"])
        z = stack.origin_mm[2] + (np.arange(stack.shape[2]) + 1) * h
        layers = {
            "layer": np.arange(stack.shape[2]), "top_mm": z, "area_mm2": area, "sealed_mm2": curves["sealed"] * pixel,
            "floating_mm2": curves["floating"] * pixel, "islands_mm2": curves["islands"] * pixel,
            "overhang_mm2": curves["overhang"] * pixel, "components": curves["components"],
            "largest_mm2": curves["largest"] * pixel, "perimeter_mm": curves["edges_x"] * px + curves["edges_y"] * py,
            "suction_n": curves["sealed"] * pixel * ATMOSPHERE,
        }  # fmt: skip
        listed = {
            "traps": _listed(cups, cups.kind == NEVER, stack),
            "cups": _listed(cups, cups.kind != NEVER, stack),
            "islands": _listed(islands, np.ones(len(islands.kind), bool), stack),
            "throats": passes.throat_rows,
        }
        settings = {
            "pixel_mm": list(stack.pixel_mm), "layer_mm": h, "pixels": list(stack.shape[:2]), "layers": stack.shape[2],
            "plate": self.plate, "overhang_angle": self.overhang_angle, "first_layer": scan.ground if solid else None,
            "coarse_voxel_mm": {name: list(pitch) for name, pitch in passes.pitches.items()},
        }  # fmt: skip
        return PrintReport(numbers, listed, layers, settings)

    def _job(self, stack: SliceStack, solid_mm3: float) -> dict[str, Any]:
        """Resin, and time and price as far as printer and resin are known."""
        found: dict[str, Any] = {"resin_ml": solid_mm3 / 1000 * (1 + self.loss)}
        found |= dict.fromkeys(("resin_g", "print_time_s", "price"))
        if (card := self.card()) is not None:
            found["resin_g"] = found["resin_ml"] * card.density_g_ml
            if card.price_per_liter is not None:
                found["price"] = found["resin_ml"] / 1000 * card.price_per_liter
            if stack.printer is not None:
                job = Job("", stack.printer, card, stack.shape[2], stack.layer_mm, stack.gray, solid_mm3)
                found["print_time_s"] = job.seconds
        return found

    def _write(self, context: Context, stack: SliceStack, report: PrintReport, scan: Scan) -> None:
        from PIL import Image

        folder = context.output(self.report)
        folder.mkdir()
        (folder / "report.json").write_text(report.json(), encoding="utf-8")
        (folder / "layers.csv").write_text(report.csv(), encoding="utf-8", newline="")
        if find_spec("matplotlib"):
            (folder / "layers.png").write_bytes(curves_chart(report.layers))
        else:
            context.warn("layers.png is left out: charts are drawn by matplotlib (pip install 'sppm-pipeline[plot]')")
        if report.events["throats"] and find_spec("matplotlib"):
            (folder / "throats.png").write_bytes(throats_chart(report.events["throats"]))
        if scan.worst:
            (folder / "marked").mkdir()
            for k, codes in scan.worst:
                Image.fromarray(marked_layer(codes)).save(folder / "marked" / f"{k:05d}.png")
            sheet = marked_sheet(scan.worst, stack.pixel_mm, report.layers)
            Image.fromarray(sheet).save(folder / "marked.png")


class Passes:
    """Everything that looks at the layers of a stack while they are read once."""

    def __init__(self, stage: CheckPrint, stack: SliceStack) -> None:
        from sppm_pipeline.features.printing.numerics.layers import PrintScan
        from sppm_pipeline.features.printing.numerics.openings import (
            Coarse,
            Coarsened,
            CureThrough,
            ThinFeatures,
            Throats,
            coarse_factors,
        )
        from sppm_pipeline.features.printing.numerics.routes import Depth

        h, shape = stack.layer_mm, stack.shape
        reach = max(*stack.pixel_mm, h * math.tan(math.radians(stage.overhang_angle)))
        plate = cast(Literal["sealed", "supports"], stage.plate)
        self._scan = PrintScan(shape, stack.pixel_mm, reach, plate, stage.pictures)
        self.pitches: dict[str, tuple[float, float, float]] = {}
        self._coarse: list[Coarse] = []

        def coarsened(name: str, smallest: float) -> Coarsened:
            factors = coarse_factors((*stack.pixel_mm, h), smallest / VOXELS_ACROSS)
            px, py = stack.pixel_mm
            self.pitches[name] = (px * factors[0], py * factors[1], h * factors[2])
            return Coarsened(shape[:2], factors)

        self._throats = self._thin = None
        if stage.drain is not None:
            sizes = [stage.drain.mm() * factor for factor in THROATS]
            coarse = coarsened("throats", sizes[0])
            blocks = math.prod(coarse.shape) * stack.shape[2] * h / self.pitches["throats"][2]
            block = max(VOXELS_ACROSS, math.ceil(math.cbrt(blocks / MAX_BLOCKS)))
            self._depth = Depth(coarse.shape, block)
            self._throats = Throats(
                coarse.shape, self.pitches["throats"], sizes, (sizes[THROATS.index(1.0)], self._depth)
            )
            self._coarse.append(Coarse(coarse, (self._throats, False)))
        if stage.min_feature is not None:
            smallest = stage.min_feature.mm()
            coarse = coarsened("features", smallest)
            pitch = self.pitches["features"]
            walls, channels = (ThinFeatures(coarse.shape, pitch, smallest, void) for void in (False, True))
            self._thin = (walls, channels)
            self._coarse.append(Coarse(coarse, (walls, False), (channels, True)))
        self._begun = False
        self._cure = self._printed = None
        if (depths := stage.depths()) is not None:
            self._cure = CureThrough(shape[:2], h, *depths)
            self._printed = PrintScan(shape, stack.pixel_mm, reach, plate, 0)
        self._voxel_mm3 = math.prod(stack.pixel_mm) * h
        self.throat_rows: list[dict[str, float]] = []

    def add(self, solid: U8) -> None:
        """Take in the next layer of zeros and ones."""
        self._begun |= self._scan.add(solid).n_runs > 0
        for coarse in self._coarse:
            coarse.add(solid)
        # below the first layer is the plate, and nothing that cures
        if self._begun and self._cure is not None and self._printed is not None:
            for layer in self._cure.add(solid):
                self._printed.add(layer)

    def finish(self) -> None:
        """Close all passes."""
        self.scan = self._scan.finish()
        for coarse in self._coarse:
            coarse.finish()
        if self._cure is not None and self._printed is not None:
            for layer in self._cure.finish():
                self._printed.add(layer)

    def numbers(self) -> dict[str, Any]:
        """Measurements beyond the half-stacks; None for those that were not requested."""
        from sppm_pipeline.features.printing.numerics.tracker import NEVER

        found: dict[str, Any] = dict.fromkeys(
            ("undrained_mm3", "way_out_mm", "thin_solid_share", "thin_void_mm3", "clogged_mm3", "clogged_trap_mm3")
        )
        if self._throats is not None:
            voxel = math.prod(self.pitches["throats"])
            self.throat_rows += [
                {"diameter_mm": d, "room_mm3": room * voxel, "undrained_mm3": undrained * voxel}
                for d, room, undrained in self._throats.finish()
            ]
            found["way_out_mm"] = self._depth.longest() * max(self.pitches["throats"])
            found["undrained_mm3"] = self.throat_rows[THROATS.index(1.0)]["undrained_mm3"]
        if self._thin is not None:
            voxel = math.prod(self.pitches["features"])
            thin, solid = (int(counts.sum()) for counts in self._thin[0].finish())
            found["thin_solid_share"] = thin / solid if solid else 0.0
            found["thin_void_mm3"] = float(self._thin[1].finish()[0].sum() * voxel)
        if self._printed is not None:
            printed = self._printed.finish()
            cured = printed.curves["area"].sum() - self.scan.curves["area"].sum()
            found["clogged_mm3"] = float(cured * self._voxel_mm3)
            found["clogged_trap_mm3"] = float(printed.cups.totals[NEVER] * self._voxel_mm3)
        return found


def _listed(found: Events, which: Bools, stack: SliceStack) -> list[dict[str, Any]]:
    """The largest of some events in millimeters."""
    (px, py), h = stack.pixel_mm, stack.layer_mm
    ends = {0: "joined", 1: "never", 2: "at the plate", 3: "open at the top"}
    return [
        {
            "first_layer": int(found.birth[i]), "last_layer": int(found.end[i]) - 1, "end": ends[int(found.kind[i])],
            "volume_mm3": float(found.volume[i] * px * py * h),
            "largest_section_mm2": float(found.section[i] * px * py),
            "place_mm": rounded((found.place[i, ::-1] + 0.5) * (px, py, h) + stack.origin_mm),
        }
        for i in np.flatnonzero(which)[:MAX_LISTED]
    ]  # fmt: skip
