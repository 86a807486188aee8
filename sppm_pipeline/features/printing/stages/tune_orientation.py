"""``tune.orientation``: which way up a part is printed best."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, cast

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, Context, DesignError, Headline, Palette, Part, Size, Stage, option, options
from sppm_pipeline.method.part.part import coarse_size

COSTS = ("supports_mm2", "cups_mm2", "height_mm", "area_mm2")


@dataclass(frozen=True, kw_only=True)
class TuneOrientation(Stage):
    """Score a part in 6 or 26 orientations, and tell the `turn` of `read.mesh` for the best; the part is passed on.

    The part is sampled once, on about a million cubic voxels, and turned by nearest voxels. In each orientation the
    layers are scanned as by `check.print`: area that hangs beyond the layer below by more than `overhang_angle`, and
    than a voxel, for supports; the largest area of suction cups; height; and the largest area of a layer, for peeling.
    Each cost is divided by its largest over all orientations; the score is the sum, weighted. Lower is better.

    Struts and channels thinner than about two of these voxels (`voxel_mm`) are not seen, or are seen broken, and turned
    surfaces have stairs, which add up to a sixth to the supports of a ball of 92 voxels: run `check.print` on the
    layers of the orientation that is taken. `turn` of `read.mesh` turns the part only; the microstructure and drains
    are then made again in it, and differ from those that were scored.
    """

    name: ClassVar[str] = "tune.orientation"
    libraries: ClassVar[tuple[str, ...]] = ("matplotlib",)
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("turn", unit="degrees"), Headline("score"), Headline("score_as_is", "as it is"),
        Headline("voxel_mm", "voxels of", "mm"),
    )  # fmt: skip

    directions: int = option(26, help="orientations: the 6 along the axes, or 20 more between them: 6 or 26", minimum=6,
        maximum=26,
    )  # fmt: skip
    cost_weights: tuple[float, float, float, float] = option(
        (1.0, 1.0, 0.5, 0.3), help="weights of supports, cups, height and area", minimum=0, maximum=1e6
    )
    turned: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), help="current `turn` of `read.mesh`; the reported `turn` replaces it", unit="degrees",
        minimum=-1e6, maximum=1e6,
    )  # fmt: skip
    overhang_angle: float = options.overhang_angle(45.0, note="which is one of the voxels")
    plate: str = option(
        "sealed",
        help="what closes the part from below: the build plate, or nothing, as it stands on supports",
        choices=("sealed", "supports"),
    )
    report: str = options.write_path(
        "orientation", note="with orientations.csv, orientations.json and orientations.png"
    )

    def check_options(self) -> None:
        if self.directions not in (6, 26):
            raise ConfigError(f"`directions` is {self.directions}; allowed are 6 and 26")
        if not any(self.cost_weights):
            raise ConfigError("all `cost_weights` are 0, so that every orientation is the best")

    def estimate(self, palette: Palette, part: Size) -> Size:
        return coarse_size(part)

    def run(self, context: Context, part: Part) -> Part:
        """Sample, then turn and scan."""
        from sppm_pipeline.features.printing.numerics.orientation import (
            not_dominated,
            score_turned,
            turn_up,
            upward_directions,
        )
        from sppm_pipeline.services.mesh.rotation import rotation

        solid, grid = part.coarse_solid(context.threads)
        if not solid.any():
            raise DesignError("the part is empty on the coarse grid", hint="make the structure denser, or give a skin")
        h = grid.spacing[0]
        ups = upward_directions(cast(Literal[6, 26], self.directions))
        plate = cast(Literal["sealed", "supports"], self.plate)
        reach = max(1.0, math.tan(math.radians(self.overhang_angle)))
        scores = []
        for number, up in enumerate(ups):
            scores.append(score_turned(solid, turn_up(up), plate, reach))
            context.progress(number + 1, len(ups), "orientations")
        costs = np.array([[s.supports * h**2, s.cups * h**2, s.height * h, s.area * h**2] for s in scores])
        largest = costs.max(0)
        score = (costs / np.where(largest > 0, largest, 1)) @ np.array(self.cost_weights)
        pareto = not_dominated(costs)
        before = rotation(self.turned).T
        rows: list[dict[str, Any]] = [
            {
                "turn": list(turn_up(before @ up)),
                "up": [round(float(v), 6) for v in up],
                "score": _short(score[i]),
                **{name: _short(cost) for name, cost in zip(COSTS, costs[i], strict=True)},
                "pareto": bool(pareto[i]),
            }
            for i, up in enumerate(ups)
        ]
        order = np.argsort(score, kind="stable")
        best = rows[order[0]]
        context.report(**best, score_as_is=rows[0]["score"], voxel_mm=h, orientations=len(rows))
        self._write(context, [rows[i] for i in order], [scores[i].view for i in order], h)
        return part

    def _write(
        self, context: Context, rows: list[dict[str, Any]], views: list[NDArray[np.float64]], voxel: float
    ) -> None:
        from PIL import Image

        from sppm_pipeline.features.printing.print_pictures import orientations_sheet

        folder = context.output(self.report)
        folder.mkdir()
        found = {
            "voxel_mm": voxel, "overhang_angle": self.overhang_angle, "cost_weights": list(self.cost_weights),
            "orientations": rows,
        }  # fmt: skip
        (folder / "orientations.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(["turn_x", "turn_y", "turn_z", "up_x", "up_y", "up_z", "score", *COSTS, "pareto"])
        for row in rows:
            costs = [row[name] for name in COSTS]
            table.writerow([*row["turn"], *row["up"], row["score"], *costs, int(row["pareto"])])
        (folder / "orientations.csv").write_text(text.getvalue(), encoding="utf-8", newline="")
        Image.fromarray(orientations_sheet(rows, views, voxel)).save(folder / "orientations.png")


def _short(value: float) -> float:
    return float(f"{value:.6g}")
