"""Options that several stages share: one word, one meaning, one unit.

A stage calls a declaration with its default, and with bounds or choices of its own where they differ. What is
particular to the stage goes behind the shared sentence as a note::

    resolution: int = options.resolution(48, maximum=512)
    islands: str = options.islands("auto", note="in the finished part")

`tests/stages/test_option_words.py` holds every stage to it. Lengths without a unit are fractions of the cell size.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.nouns.length import UNITS_IN_MM
from sppm_pipeline.stage import option

CHARTS = (".png", ".pdf", ".svg")
"""Files that charts are written to."""


def _shared(sentence: str, **declared: Any) -> Callable[..., Any]:
    """A declaration: what `option` takes, with a note in place of the help."""

    def declare(default: Any = dataclasses.MISSING, *, note: str = "", **changed: Any) -> Any:
        return option(default, help=f"{sentence}; {note}" if note else sentence, **(declared | changed))

    return declare


# the cell and its grid
edge = _shared("cell size", unit="mm", above=0)
cell = _shared("cell size", unit="mm", minimum=1e-3, maximum=1e5)
cells = _shared("number of cells along x, y, z, for a box of cells instead of a part", minimum=1, maximum=4096)
periodic = _shared("opposite sides are neighbors, as homogenization needs it")
resolution = _shared("voxels along an edge of the cell", unit="voxels", minimum=2, maximum=1024)
voxel = _shared("edge of a voxel", unit="mm", above=0, maximum=1e6)
islands = _shared(
    "treatment of disconnected solid: auto removes it, but refuses to remove 10 % of the solid or more",
    choices=("auto", "remove", "keep"),
)
exact = _shared("sum the kernels at every sample of fine grids, too, instead of interpolating between coarser sums")

# pores
count = _shared("number of pores that the stage places", minimum=0, maximum=100_000)
total = _shared("number of pores of one cell, faces and interior", minimum=2, maximum=100_000)
share = _shared("pores as a fraction of the maximum that the spacing allows", above=0, maximum=1)
spacing = _shared("smallest distance between pores", unit="cell size", above=0, maximum=1e6)
pore_radius = _shared("radius of an isolated pore", unit="cell size", minimum=1e-9, maximum=1e6)
tunnel_radius = _shared("radius of an isolated tunnel", unit="cell size", minimum=1e-9, maximum=1e6)
tunnel_spread = _shared("standard deviation of the logarithm of the tunnel radii", minimum=0, maximum=1)
degree = _shared("minimum and maximum number of tunnels of a pore, A and B", minimum=1, maximum=64)
level = _shared("level C at which the sum of the kernels is cut", minimum=0.001, maximum=0.999)

# porosity, tile sets and tuning
porosity = _shared("target porosity", above=0, below=1)
tolerance = _shared("largest error of the porosity, checked on a finer grid", above=0, below=0.5)
colors = _shared("number of colors c", minimum=1)
interiors = _shared("number of interiors K", minimum=1, maximum=1024)
target = _shared("target value", above=0)
trials = _shared("trial cells for each number of pores", minimum=1, maximum=200)
accuracy = _shared("largest relative error of what is tuned", above=0, below=0.5)
draws = _shared("number of independent draws", minimum=1)
evaluations: Callable[..., Any] = _shared("maximum number of evaluations", minimum=3, maximum=1000)

# solvers and materials
EACH_PHASE = "or of each phase from 1 on"
iterations = _shared("maximum number of solver iterations for a load case", minimum=1, maximum=1_000_000)
residual = _shared("relative residual at which the solver stops", minimum=1e-14, maximum=0.1)
young = _shared("Young's modulus of the solid", above=0, maximum=1e15)
poisson = _shared("Poisson's ratio of the solid", above=-1, below=0.5)
stress_unit = _shared("unit of Young's modulus and of the result", choices=("relative", "MPa", "GPa"))

threshold = _shared("gray value from which on a voxel is solid", minimum=-1e15, maximum=1e15)

# resins
penetration = _shared("depth D_p at which light has fallen to 1/e in the resin", unit="mm", minimum=1e-3, maximum=5)
cure_depth = _shared("depth C_d to which one exposure cures the resin", unit="mm", minimum=1e-3, maximum=5)

axis = _shared("axis of the load, flow, sound or section", choices=("x", "y", "z"))

# parts and meshes
accept = _shared("which meshes are accepted")
inside = _shared(
    "inside test of the part: by rays along x, by the winding number, by a vote of rays along x, y and z; auto takes "
    "rays for a closed part and the winding number for others",
    choices=("auto", "scanline", "winding", "vote"),
)
scale = _shared("factor of all lengths", maximum=1e9)
skin = _shared("thickness of a solid skin inside the surface of the part", unit="mm")
turn = _shared("angles about x, then y, then z", unit="degrees", minimum=-360, maximum=360)
rounds = _shared("number of rounds", minimum=1)
time_limit = _shared("each child process is ended after this time", unit="s", above=0, maximum=1e7)

overhang_angle = _shared(
    "solid is held by what lies below it within this angle from upright, and within a pixel", unit="degrees", minimum=0,
    maximum=89,
)  # fmt: skip
fail = _shared("rules that reject what is checked (exit code 3)")

# layers
gray = _shared("samples along a pixel's edge for gray by area coverage; 1 for black and white", minimum=1, maximum=16)
gray_layers = _shared(
    "samples along the height of a layer for gray by coverage; 1 cuts it once, in the middle", minimum=1, maximum=16
)
layer = _shared("layer height; the pitch of square pixels if omitted", unit="mm", minimum=1e-6, maximum=1e3)
pixel = _shared(
    "pixel pitch, or [along x, along y] of pixels that are not square", unit="mm", minimum=1e-6, maximum=1e3
)
printer = _shared("printer that the layers are cut for; `sppm printers` lists them")
cards = _shared("YAML file with printers and resins of your own")

# mappings
sizes = _shared(
    "radii follow the cube root of the volume of a cell, which keeps the porosity, or are fixed in mm",
    choices=("cell", "fixed"),
)
inner_radius = _shared("inner radius", unit="mm", above=0, maximum=1e6)

# files, pictures and tables
size = _shared("box that the body just fills, along x, y, z", unit="mm", minimum=1e-3, maximum=1e5)
read_path = _shared("file or folder to read")
write_path = _shared("file or folder to write", output=True)
unit = _shared("unit of the coordinates", choices=tuple(UNITS_IN_MM))
azimuth = _shared("direction of view around z", unit="degrees", minimum=-360, maximum=360)
elevation = _shared("height of the view above the xy plane", unit="degrees", minimum=-90, maximum=90)
section = _shared("keep only this share of the part, the side away from the viewer, to look inside", above=0, maximum=1)
image_size = _shared("width and height of the picture", unit="pixels", maximum=8192)
title = _shared("title of what is written")
label = _shared("column that names the rows", column=True)
columns = _shared("columns of the table, from left to right", column=True)
headings = _shared("headings of the columns; their names if omitted")
sort = _shared("column by which rows are sorted; as they stand if empty", column=True)
descending = _shared("sort from large to small")


def check_degree(degree: tuple[int, int]) -> None:
    """Raise ConfigError if the first bound of the option `degree` is the larger one."""
    if degree[0] > degree[1]:
        raise ConfigError(f"the degree bounds [{degree[0]}, {degree[1]}] are in the wrong order")
