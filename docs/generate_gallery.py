"""Write the gallery: runs small examples, and makes a page of each with its picture, its YAML and the same in Python.

Usage: ``python docs/generate_gallery.py`` writes the pages; ``--check`` only lists stale ones (exit code 1);
``--run [NAME ...]`` runs the examples and redraws the pictures; ``--reports DIR`` runs them and writes their
reports, for the site.

The text of a page is the comment on top of its configuration.
"""

from __future__ import annotations

import argparse
import io
import pprint
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "gallery"
NOTICE = "<!-- Written by docs/generate_gallery.py from the configuration; edit that, not this page. -->"

GALLERY = {
    "Parts": {
        "knot": ("A part of scattered pores", "knot.png"),
        "border": ("Without shards", "border.png"),
        "skin": ("A closed skin, with a hole", "skin.png"),
        "plate_with_holes": ("Plate and screw holes", "plate.png"),
        "tube": ("Around a tube", "tube.png"),
        "elbow": ("A mesh of hexahedra", "elbow.png"),
    },
    "Cells and tiles": {
        "walls_cell": ("Walls between pores", "walls.png"),
        "sheet_cell": ("A sheet between two networks", "sheet.png"),
        "wang_tiles": ("The 27 tiles of the paper", "tiles.png"),
        "folded": ("What repeats", "folded.png"),
    },
    "Graded": {
        "graded_stem": ("Dense outside, open inside", "stem.png"),
        "finer_pores": ("Finer pores at the same porosity", "bar.png"),
        "two_sets": ("Two tile sets in one part", "joined.png"),
        "blend": ("A sponge becomes a gyroid", "blend.png"),
        "regions": ("Bodies of their own", "regions.png"),
    },
    "Other structures": {
        "foam_ball": ("A foam", "foam.png"),
        "lattice_puck": ("A lattice", "puck.png"),
        "spinodoid": ("A spinodoid", "spinodoid.png"),
    },
    "Print": {
        "layers": ("Layers without a mesh", "slices-overview.png"),
        "trapped_resin": ("Trapped resin", "print/marked.png"),
    },
    "Simulate": {
        "bracket": ("A bracket under its load", "tested.png"),
        "loaded_stem": ("An implant stem under its load", "stem.png"),
        "loaded_insole": ("A heel pad under its load", "pad.png"),
        "modulus": ("The modulus in all directions", "stiffness/young.png"),
        "stiffness_over_porosity": ("Stiffness over porosity", "young.png"),
        "flow": ("Flow through the pores", "flow.png"),
        "crush": ("Crushed", "crushed/animation.png"),
        "tetrahedra": ("Tetrahedra", "tetrahedra.png"),
    },
}
"""Title of each example, and which of its files is its picture, by heading."""

THINGS = {
    "insole": "An insole, cut open", "bracket": "A bracket with a skin, cut open",
    "implant": "A cage between two vertebrae",
    "liner": "A pad of a helmet liner", "handle": "A handle with a skin, cut open",
    "filter": "A filter cartridge", "sink": "A heat sink with open ribs",
    "knot": "A torus knot",
}  # fmt: skip
"""Captions of the pictures that ``draw_heroes.py`` draws."""

LARGEST = (760, 600)
"""Pixels of a picture; larger ones are reduced."""

MOST_BYTES = 100_000
"""Of a picture; colors are merged until it holds."""


def pages() -> dict[str, str]:
    """Text of every page by its name."""
    examples = {name: title for group in GALLERY.values() for name, (title, _) in group.items()}
    return {"README.md": index_page()} | {f"{name}.md": example_page(name, title) for name, title in examples.items()}


def stale(folder: Path, wanted: Mapping[str, str]) -> list[str]:
    """Pages and pictures that are missing, differ, or belong to nothing any more."""
    there = {path.name for path in folder.glob("*.*")}
    pictures = {name.replace(".md", ".png") for name in wanted if name != "README.md"}
    differs = {name for name in there & set(wanted) if (folder / name).read_text(encoding="utf-8") != wanted[name]}
    return sorted(differs | (there ^ (set(wanted) | pictures)))


def index_page() -> str:
    """All pictures, two in a row."""
    lines = [
        "# Gallery",
        "",
        NOTICE,
        "",
        "Click a picture for the YAML and the Python that make it.",
    ]
    first = [f"![{title}](../pictures/hero-{name}.jpg)<br>{title}" for name, title in THINGS.items()]
    lines += [
        "",
        "## Things",
        "",
        "Bodies from primitives, and an insole, filled by [a script](../draw_heroes.py). The disc is 23 mm wide.",
    ]
    lines += ["", "| | |", "|---|---|", *(f"| {a} | {b} |" for a, b in zip(first[::2], first[1::2], strict=True))]
    for heading, group in GALLERY.items():
        lines += ["", f"## {heading}", "", "| | |", "|---|---|"]
        cells = [f"[![{title}]({name}.png)]({name}.md)<br>{title}" for name, (title, _) in group.items()]
        cells += [""] * (len(cells) % 2)
        lines += [f"| {left} | {right} |" for left, right in zip(cells[::2], cells[1::2], strict=True)]
    return "\n".join(lines) + "\n"


def example_page(name: str, title: str) -> str:
    """The page of one example."""
    text = configuration(name).read_text(encoding="utf-8")
    rows = text.splitlines(keepends=True)
    head = [row for row in rows if row.startswith("#")]
    words = " ".join(row.removeprefix("#").strip() for row in head)
    body = "".join(rows[len(head) :])
    lines = [f"# {title}", "", NOTICE, "", words, "", f"![{title}]({name}.png)", ""]
    lines += ["```sh", f"sppm run {name} --report", "```", ""]
    lines += [f"[`examples/{name}.yaml`](../../examples/{name}.yaml):", "", "```yaml", body.rstrip(), "```", ""]
    lines += ["The same in Python:", "", "```python", python_of(YAML(typ="safe").load(text)), "```", ""]
    return "\n".join(lines)


def configuration(name: str) -> Path:
    """The file of an example."""
    return ROOT / "examples" / f"{name}.yaml"


def python_of(document: Mapping[str, Any]) -> str:
    """Python that makes and runs the same pipeline as a configuration."""
    lines = ["import sppm_pipeline as sppm", "", "step = sppm.step", "pipeline = sppm.Pipeline("]
    lines += ["    [", *(f"        {line}" for line in steps_of(document["pipeline"])), "    ],"]
    if "recipes" in document:
        lines.append("    recipes={")
        for key, entries in document["recipes"].items():
            lines += [f"        {key!r}: [", *(f"            {line}" for line in steps_of(entries)), "        ],"]
        lines.append("    },")
    if "params" in document:
        lines.append(f"    params={document['params']!r},")
    lines += [f"    name={document['name']!r},", f"    seed={document.get('seed', 0)},", ")"]
    if "sweep" in document:
        axes = ", ".join(f"{key}={value!r}" for key, value in document["sweep"].items())
        lines += [f"run = pipeline.sweep({axes}).run()", *after_of(document.get("after", ()))]
    else:
        lines.append(f"pipeline.run('runs/{document['name']}')")
    return "\n".join(lines).replace("'", '"')


def steps_of(entries: Iterable[Mapping[str, Any] | str]) -> list[str]:
    """Stages of a list as calls of `sppm.step`, one a line, or some lines if they are long."""
    lines = []
    for entry in entries:
        options = {} if isinstance(entry, str) else {key: value for key, value in entry.items() if key != "stage"}
        name = entry if isinstance(entry, str) else entry["stage"]
        if "from" in options:
            options["sources"] = options.pop("from")
        arguments = [f"{key}={pprint.pformat(value, width=200, sort_dicts=False)}" for key, value in options.items()]
        line = f"step.{name}({', '.join(arguments)}),"
        if len(line) > 96:
            lines.append(f"step.{name}(")
            for argument, value in zip(arguments, options.values(), strict=True):
                if len(argument) > 100:
                    lines += [f"    {argument.split('=')[0]}=[", *(f"        {item!r}," for item in value), "    ],"]
                else:
                    lines.append(f"    {argument},")
            lines.append("),")
        else:
            lines.append(line)
    return lines


def after_of(entries: Iterable[Mapping[str, Any]]) -> list[str]:
    """What comes after a sweep, as calls of stages on its table."""
    lines = []
    for entry in entries:
        options = [f"    {key}={value!r}," for key, value in entry.items() if key != "stage"]
        lines += [f"sppm.{entry['stage']}(", "    run.table,", *options, ")"]
    return lines


def run_example(name: str, picture: str, reports: Path | None, draw: bool) -> None:
    """Run one example; write its picture, or its report, or both."""
    with tempfile.TemporaryDirectory() as scratch:
        program, folder = [sys.executable, "-m", "sppm_pipeline"], f"{scratch}/run"
        subprocess.run([*program, "run", str(configuration(name)), "-q", "-o", folder], check=True)
        if draw:
            (FOLDER / f"{name}.png").write_bytes(reduced(Path(scratch, "run", picture).read_bytes()))
        if reports:
            page = str(reports / f"{name}.html")
            subprocess.run([*program, "report", folder, "-o", page], check=True)


def reduced(data: bytes) -> bytes:
    """A picture that is small enough for the repository."""
    from PIL import Image, ImageSequence

    with Image.open(io.BytesIO(data)) as image:
        pause = image.info.get("duration", 0)
        frames = [frame.convert("RGB") for frame in ImageSequence.Iterator(image)]
    for frame in frames:
        frame.thumbnail(LARGEST, Image.Resampling.LANCZOS)
    width, height = frames[0].size
    side_by_side = Image.new("RGB", (width * len(frames), height))
    for number, frame in enumerate(frames):
        side_by_side.paste(frame, (number * width, 0))
    moving = {"save_all": True, "duration": pause, "loop": 0} if len(frames) > 1 else {}
    for colors in (256, 128, 64, 48, 32, 24, 16):
        out = io.BytesIO()
        dither = Image.Dither.NONE if colors > 64 else Image.Dither.FLOYDSTEINBERG
        palette = side_by_side.quantize(colors, dither=dither)  # one for all frames
        reduced = [frame.quantize(palette=palette, dither=dither) for frame in frames] if moving else [palette]
        options = moving | {"append_images": reduced[1:]} if moving else {}
        reduced[0].save(out, "PNG", optimize=True, **options)
        if out.tell() <= MOST_BYTES:
            return out.getvalue()
    raise ValueError(f"a picture of {width} x {height} pixels takes more than {MOST_BYTES} bytes in 16 colors")


def main() -> int:
    """Write the pages, or say which are stale; run the examples if asked."""
    parser = argparse.ArgumentParser(description="Write the gallery.")
    parser.add_argument("--check", action="store_true", help="only list stale pages")
    parser.add_argument("--run", nargs="*", metavar="NAME", help="redraw the pictures: all, or these")
    parser.add_argument("--reports", type=Path, metavar="DIR", help="write the reports of all examples here")
    arguments = parser.parse_args()
    if arguments.reports:
        arguments.reports.mkdir(parents=True, exist_ok=True)
    for group in GALLERY.values():
        for name, (_, picture) in group.items():
            draw = arguments.run is not None and (not arguments.run or name in arguments.run)
            if draw or arguments.reports:
                run_example(name, picture, arguments.reports, draw)
    wanted = pages()
    old = stale(FOLDER, wanted)
    if arguments.check:
        print("\n".join(old) or "all pages are up to date")
        return 1 if old else 0
    for name in old:
        if name in wanted:
            (FOLDER / name).write_text(wanted[name], encoding="utf-8")
        elif name.endswith((".md", ".png")) and name.removesuffix(".png") + ".md" not in wanted:
            (FOLDER / name).unlink()
    print(f"{len(wanted)} pages, {len(old)} of them changed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
