"""Draw the pictures of `docs/pictures/hero-*.jpg`: things made of primitives, and an insole, in one material each, some
beside a plain disc of 23 mm, as large as a coin.

Usage: ``python docs/draw_heroes.py [--size 2400] [NAMES]`` writes them, 2400 pixels wide if no size is given, each in
the best quality that fits 600 kB, and prints the seconds of processor time of each picture.
"""

from __future__ import annotations

import argparse
import io
import runpy
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from PIL import Image

import sppm_pipeline as sppm

ROOT = Path(__file__).resolve().parents[1]
CELL = [
    {"stage": "sample.dart_throwing", "total": 72, "share": 0.55},
    {"stage": "connect.mbdst", "degree": [3, 5], "mode": "greedy"},
    {"stage": "field.gaussian", "pore_radius": 0.11, "tunnel_radius": 0.03},
]

MAX_BYTES = 600_000

Place = tuple[float, float, float]


def body(shape: str, *size: float) -> sppm.SurfaceMesh:
    """A primitive of these sizes in mm, which stands on the ground."""
    return sppm.read.primitive(shape=shape, size=[f"{edge} mm" for edge in size])


def combined(
    mesh: sppm.SurfaceMesh, operation: str, tool: sppm.SurfaceMesh, *at: Place, turn: Place = (0, 0, 0)
) -> sppm.SurfaceMesh:
    """A mesh with another one, at some places in mm."""
    places = [[f"{v} mm" for v in place] for place in at or [(0.0, 0.0, 0.0)]]
    return sppm.fill.combine(mesh=mesh, tool=tool, operation=operation, at=places, turn=list(turn))


def implant_cage() -> sppm.SurfaceMesh:
    """A cage between two vertebrae: a rounded box with a window for bone, and a groove for the tool."""
    ends = combined(body("box", 16, 18, 9), "union", body("cylinder", 18, 18, 9), (-8, 0, 0), (8, 0, 0))
    window = combined(body("box", 12, 8, 20), "union", body("cylinder", 8, 8, 20), (-6, 0, 0), (6, 0, 0))
    return combined(ends, "difference", window, (0, 0, -5))


def helmet_liner() -> sppm.SurfaceMesh:
    """A pad of a liner: a part of a thick sphere."""
    shell = combined(body("ball", 120, 120, 120), "difference", body("ball", 92, 92, 92), (0, 0, 14))
    return combined(shell, "intersection", body("box", 70, 52, 60), (0, 0, 84))


def handle() -> sppm.SurfaceMesh:
    """A grip with a hole for the rod, lying: a cylinder with three shallow grooves."""
    grip = body("cylinder", 27, 27, 84)
    for height in (11.0, 32.0, 53.0):
        grip = combined(grip, "difference", body("torus", 53, 53, 21), (0, 0, height))
    grip = combined(grip, "difference", body("cylinder", 9, 9, 80), (0, 0, -12))
    return combined(body("box", 200, 200, 200), "intersection", grip, (-42, 0, 13.5), turn=(0, 90, 0))


def filter_cartridge() -> sppm.SurfaceMesh:
    """A hollow cylinder, through whose wall a liquid runs."""
    return combined(body("cylinder", 30, 30, 34), "difference", body("cylinder", 13, 13, 60), (0, 0, -10))


def heat_sink() -> sppm.SurfaceMesh:
    """A plate with open ribs."""
    ribs = [(0.0, y, 0.0) for y in (-14.5, -4.83, 4.83, 14.5)]
    return combined(body("box", 34, 34, 2.4), "union", body("box", 34, 5, 16), *ribs)


def insole() -> sppm.SurfaceMesh:
    """The insole of examples/jobs, with its heel to the front."""
    make: Callable[[], sppm.SurfaceMesh] = runpy.run_path(str(ROOT / "examples" / "jobs" / "make_parts.py"))["insole"]
    return make()


def bolts() -> sppm.SurfaceMesh:
    """The bolts of the bracket: two through its base, two through its wall."""
    pin = body("cylinder", 6.6, 6.6, 24)
    upright = combined(pin, "union", pin, (0, -22, 0))
    lying = combined(body("box", 1, 1, 1), "union", pin, (-42, 11, 57), (-42, -11, 57), turn=(0, 90, 0))
    return combined(lying, "union", upright, (25, 11, -6))


def bracket() -> sppm.SurfaceMesh:
    """An angle with a gusset and four holes for bolts."""
    angle = combined(body("box", 70, 40, 14), "union", body("box", 14, 40, 70), (-28, 0, 0))
    gusset = combined(body("box", 34, 40, 34), "difference", body("box", 90, 60, 90), (0, 0, 17), turn=(0, 45, 0))
    return combined(combined(angle, "union", gusset, (-4, 0, 14)), "difference", bolts())


def coin() -> sppm.SurfaceMesh:
    """A plain disc of 23 mm with a rim."""
    return combined(body("cylinder", 23, 23, 2.2), "difference", body("cylinder", 20.6, 20.6, 4), (0, 0, 1.8))


def primitive(shape: str, *size: float) -> Any:
    """A maker of a primitive."""
    return lambda: body(shape, *size)


TITANIUM, BONE, RESIN = {"material": "titanium"}, {"material": "bone"}, {"material": "resin"}
OPEN = {"section": 0.5, "section_along": "corner", "cut": "plain"}

HEROES: dict[str, tuple[Any, str, dict[str, Any], Place | None, dict[str, Any]]] = {
    "insole": (
        insole, "10 mm", {"skin": "1.4 mm", "skin_toward": [[0, 0, 1]]}, None,
        RESIN | {"section": 0.82, "section_along": "x", "cut": "plain", "azimuth": -143.0, "elevation": 24.0,
                 "resolution": 40},
    ),
    "bracket": (
        bracket, "7 mm", {"skin": "1.5 mm"}, None,
        TITANIUM | {"section": 0.775, "section_along": "y", "cut": "plain", "azimuth": -62.0, "elevation": 24.0},
    ),
    "knot": (primitive("torus_knot", 30, 30, 15), "4 mm", {}, None, RESIN | {"elevation": 30.0}),
    "implant": (implant_cage, "4 mm", {}, (4, -20.45, 0), TITANIUM | {"azimuth": -65.0, "elevation": 32.0}),
    "liner": (helmet_liner, "10 mm", {}, None, RESIN | {"azimuth": -62.0, "elevation": 24.0}),
    "handle": (handle, "6 mm", {"skin": "1.2 mm"}, None, RESIN | OPEN | {"azimuth": -58.0, "elevation": 24.0}),
    "filter": (filter_cartridge, "6 mm", {}, (9, -24.85, 0), BONE | {"azimuth": -58.0, "elevation": 30.0}),
    "sink": (
        heat_sink, "4 mm", {"skin": "2.4 mm", "skin_toward": [[0, 0, -1]]}, None,
        TITANIUM | {"azimuth": -58.0, "elevation": 30.0},
    ),
}  # fmt: skip
"""Name -> body, cell size, options of the filling, place of the disc, options of the picture."""


def drawn(name: str, width: int, path: Path) -> float:
    """Fill a body with scattered pores, and draw it; seconds of processor time of the picture."""
    make, cell, filling, place, view = HEROES[name]
    whole = make()
    near = {}
    if place is not None:
        disc = coin()
        whole = combined(whole, "union", disc, place)
        near = {"skin_near": combined(body("box", 0.01, 0.01, 0.01), "union", disc, place)}
        filling = {**filling, "skin": "1.1 mm", "skin_within": "0.01 mm"}
    cells = sppm.tile.scattered(whole, recipe=CELL, cell=cell, porosity=0.7, seed=7)
    part = sppm.fill.implicit(cells, domain=whole, **near, **filling)
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        sppm.write.picture(
            part, path="hero.png", image_size=(width, width * 3 // 4), shadow=True, annotate=False, output=folder,
            **{"resolution": 48, **view},
        )  # fmt: skip
        picture = Image.open(Path(folder, "hero.png")).convert("RGB")
    for quality in range(92, 40, -4):
        file = io.BytesIO()
        picture.save(file, "JPEG", quality=quality, optimize=True, progressive=True)
        if file.tell() <= MAX_BYTES:
            break
    path.write_bytes(file.getvalue())
    return time.process_time() - began


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw those that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAMES", help=f"of {', '.join(HEROES)}; all if omitted")
    parser.add_argument("--size", type=int, default=2400, help="width in pixels")
    parser.add_argument("--folder", type=Path, default=ROOT / "docs" / "pictures")
    args = parser.parse_args(arguments)
    for name in args.names or HEROES:
        path = args.folder / f"hero-{name}.jpg"
        seconds = drawn(name, args.size, path)
        print(f"{path.name}: {seconds:.1f} CPU-s, {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
