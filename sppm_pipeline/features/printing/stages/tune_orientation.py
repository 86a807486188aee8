"""``tune.orientation``: which way up a part is printed best."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, cast

import numpy as np

from sppm_pipeline import ConfigError, Context, DesignError, Headline, Palette, Part, Size, Stage, option, options
from sppm_pipeline.features.printing.numerics.layers import PrintScan
from sppm_pipeline.method.part.part import coarse_size
from sppm_pipeline.services.arrays import F64, U8, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.rotation import rotation

GOLDEN = (1 + math.sqrt(5)) / 2


class Score(NamedTuple):
    """Costs of a body in one orientation; lengths in voxels."""

    supports: int  # area of what hangs farther than a voxel beyond the layer below, summed over the layers
    cups: int  # largest area in a layer of void that is closed while that layer is printed
    height: int  # layers from the first to the last that hold solid
    area: int  # largest area of a layer
    # (nz, nx), depth at which it is met along y, over its box, lowest layer first; NaN where it is not
    view: F64


def upward_directions(count: Literal[6, 26]) -> F64:
    """Unit vectors, (count, 3): both ways along the axes, +z first; of 26, also to the corners of a dodecahedron."""
    axes = [(0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)]
    if count == 6:
        return np.array(axes, float)
    both = (1.0, -1.0)
    corners = [(x, y, z) for x in both for y in both for z in both]
    for a in both:
        for b in both:
            p = (0.0, a / GOLDEN, b * GOLDEN)
            corners += [p, (p[2], p[0], p[1]), (p[1], p[2], p[0])]
    return np.concatenate([np.array(axes, float), np.array(corners) / math.sqrt(3)])


def turn_up(direction: F64) -> tuple[float, float, float]:
    """Turns about x, then y, then z, in degrees as `rotation` takes them, after which a direction points up."""
    x, y, z = (float(v) for v in direction)
    about_x = math.degrees(math.atan2(y, z))
    about_y = math.degrees(math.atan2(-x, math.hypot(y, z)))
    return (round(about_x, 6) + 0.0, round(about_y, 6) + 0.0, 0.0)


def score_turned(
    solid: U8, turn: tuple[float, float, float], plate: Literal["sealed", "supports"], reach: float = 1.0
) -> Score:
    """Turn a body of cubic voxels (nz, ny, nx), which holds some, by nearest voxels and scan its layers.

    `turn` is as for `rotation`; `plate` and `reach`, in voxels, are as for `PrintScan`.
    """
    matrix = rotation(turn)
    low = np.array([np.flatnonzero(solid.any(axes))[0] for axes in ((0, 1), (0, 2), (1, 2))], float)
    high = np.array([np.flatnonzero(solid.any(axes))[-1] + 1 for axes in ((0, 1), (0, 2), (1, 2))], float)
    half = np.abs(matrix) @ (high - low) / 2
    nx, ny, nz = (int(n) + 2 for n in np.ceil(2 * half - 1e-6))  # a margin of void, which is ambient
    middle, center = (low + high) / 2, np.array([nx, ny, nz]) / 2
    # each voxel of the result looks up where it came from, so that no gaps open
    back = np.ascontiguousarray(matrix.T)
    scan = PrintScan((nx, ny, nz), (1.0, 1.0), reach, plate, pictures=0)
    layer = np.empty((ny, nx), np.uint8)
    view = np.full((nz, nx), np.nan)
    for k in range(nz):
        _turned_layer(solid, back, middle, center, k, layer)
        scan.add(layer)
        hit = layer.any(0)
        view[k, hit] = layer.argmax(0)[hit] / ny
    curves = scan.finish().curves
    there = np.flatnonzero(curves["area"])
    height = int(there[-1] - there[0] + 1) if len(there) else 0
    return Score(
        int(curves["overhang"].sum()), int(curves["sealed"].max()), height, int(curves["area"].max()), view
    )  # fmt: skip


@jit
def _turned_layer(solid: U8, back: F64, middle: F64, center: F64, k: int, layer: U8) -> None:
    """Fill a layer with the voxels in which its centers lie once they are turned back."""
    nz, ny, nx = solid.shape
    z = k + 0.5 - center[2]
    for j in range(layer.shape[0]):
        y = j + 0.5 - center[1]
        for i in range(layer.shape[1]):
            x = i + 0.5 - center[0]
            # a hair beside borders of voxels, so that rounding does not choose between them
            a = math.floor(back[0, 0] * x + back[0, 1] * y + back[0, 2] * z + middle[0] + 1e-9)
            b = math.floor(back[1, 0] * x + back[1, 1] * y + back[1, 2] * z + middle[1] + 1e-9)
            c = math.floor(back[2, 0] * x + back[2, 1] * y + back[2, 2] * z + middle[2] + 1e-9)
            inside = 0 <= a < nx and 0 <= b < ny and 0 <= c < nz
            layer[j, i] = solid[c, b, a] if inside else 0


def not_dominated(costs: F64) -> Bools:
    """Rows (n, m) than which no other is as good in every column and better in one."""
    as_good = (costs[:, None] <= costs[None]).all(2)
    better = (costs[:, None] < costs[None]).any(2)
    return np.asarray(~(as_good & better).any(0))


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

    def _write(self, context: Context, rows: list[dict[str, Any]], views: list[F64], voxel: float) -> None:
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
