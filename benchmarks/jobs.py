"""The five jobs of ``examples/jobs``, from a CAD file to print files, each by a process of its own.

Usage: ``python -m benchmarks.jobs [--write] [--again] [--folder FOLDER] [NAMES]``. Each job is run with its report;
kernels are compiled if they are not yet, as in a new installation. With `--again` it is run a second time, without the
cache of results. `--write` stores the numbers in benchmarks/jobs.json and the pictures in docs/pictures,
and writes the tables of docs/howto/from-cad-to-print.md from the numbers of all jobs stored there.

Judges are programs of others, where they are installed: PrusaSlicer (``prusa-slicer --info`` of meshes; the project is
sliced), ADMesh, the readers of lib3mf. SL1 and CLI have no reader there; tests decode what the writers make.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from PIL import Image

from benchmarks.measure import between_marks, run

ROOT = Path(__file__).resolve().parents[1]
JOBS = ROOT / "examples" / "jobs"
STORED, PAGE = ROOT / "benchmarks" / "jobs.json", ROOT / "docs" / "howto" / "from-cad-to-print.md"
MARK = "<!-- benchmarks.jobs -->\n"
NAMES = ("bracket", "rocker", "insole", "lattice", "cube")
WHAT = {
    "bracket": "bracket from STEP, bolt holes kept",
    "rocker": "rocker arm, density by the stresses",
    "insole": "insole, softer in two places",
    "lattice": "ring without skin, net of struts",
    "cube": "cube of 60 mm, walls and structure for FDM",
}
MESHES = {"bracket": "bracket.stl", "rocker": "rocker.stl", "insole": "printed.stl", "lattice": "lattice.3mf"}


def output_of(*command: str, folder: Path) -> str:
    """What a program prints; nothing if it is not installed."""
    if shutil.which(command[0]) is None:
        return ""
    done = subprocess.run(command, cwd=folder, capture_output=True, check=False)
    return (done.stdout + done.stderr).decode(errors="replace")


def judged(name: str, folder: Path) -> dict[str, Any]:
    """What programs of others say about the files of a job."""
    found: dict[str, Any] = {}
    if name == "cube":
        settings = {
            "nozzle-diameter": 0.4, "filament-diameter": 1.75, "filament-density": 1.24, "layer-height": 0.2,
            "first-layer-height": 0.2, "skirts": 0, "gcode-flavor": "marlin2", "layer-gcode": "G92 E0",
        }  # fmt: skip
        options = [f"--{key}={value}" for key, value in settings.items()]
        output_of(
            "prusa-slicer", "-g", "--use-relative-e-distances", *options, "-o", "a.gcode", "cube.3mf", folder=folder
        )
        if (folder / "a.gcode").exists():
            text = (folder / "a.gcode").read_text()
            widths = [float(width) for width in re.findall(r"^;WIDTH:([\d.]+)", text, re.MULTILINE)]
            found["filament_g"] = float(re.findall(r"filament used \[g\] = ([\d.]+)", text)[0])
            found["narrowest_mm"] = min(widths)
            (folder / "a.gcode").unlink()
        return found
    mesh = MESHES[name]
    info = output_of("prusa-slicer", "--info", mesh, folder=folder)
    for key, pattern in (("manifold", r"manifold = (\w+)"), ("facets", r"number_of_facets = (\d+)")):
        for word in re.findall(pattern, info)[:1]:
            found[key] = word
    found["repaired"] = bool(re.search(r"edges_fixed|facets_removed|facets_added|facets_reversed", info))
    if mesh.endswith(".stl"):
        text = output_of("admesh", mesh, folder=folder)
        for key, words in (("disconnected", "Total disconnected facets"), ("reversed", "Facets reversed")):
            for number in re.findall(rf"{words}\s*:\s*(\d+)", text)[:1]:
                found[f"admesh_{key}"] = int(number)
    else:
        try:
            import lib3mf
        except ImportError:
            return found
        model = lib3mf.Wrapper().CreateModel()
        reader = model.QueryReader("3mf")
        reader.ReadFromFile(str(folder / mesh))
        iterator = model.GetMeshObjects()
        iterator.MoveNext()
        object_ = iterator.GetCurrentMeshObject()
        found |= {"lib3mf_warnings": reader.GetWarningCount(), "lib3mf_manifold": object_.IsManifoldAndOriented()}
    return found


def known(folder: Path) -> dict[str, Any]:
    """What the record of a run says about weight, stiffness and print."""
    found: dict[str, Any] = {}
    for stage in json.loads((folder / "run.json").read_text())["stages"]:
        summary = stage.get("summary") or {}
        for key in (
            "verdict",
            "resin_g",
            "resin_ml",
            "print_time_s",
            "price",
            "traps",
            "floating_parts",
            "thin_solid_share",
        ):
            if summary.get(key) is not None:  # of files, which come last, without what is washed away
                found[key] = summary[key]
        if stage["stage"] == "simulate.part":
            found["tested"] = summary
        if stage["stage"] == "homogenize.voxel":
            found["E_MPa"] = summary.get("isotropic", {}).get("E", summary.get("E"))
    return found


def measured(name: str, folder: Path, again: bool) -> dict[str, Any]:
    """Run a job, once more if it is asked for, and gather what is known of it."""
    file = folder / f"{name}.yaml"
    out = folder / "runs" / name
    command = [
        sys.executable,
        "-I",
        "-m",
        "sppm_pipeline",
        "run",
        str(file),
        "-q",
        "--report",
        "--threads",
        "1",
        "-o",
        str(out),
    ]
    # the installed program, whatever lies in the working directory
    first = run([*command, "--no-cache"])
    second = run([*command, "--no-cache"]) if again else first
    report = out / "report.html"
    text = report.read_text("utf-8")
    return {
        "first_cpu_s": first.cpu, "cpu_s": second.cpu if again else None, "peak_mb": second.peak,
        "report_mb": report.stat().st_size / 1e6, "live_view": 'class="view"' in text or "<canvas" in text,
        **known(out), **judged(name, out),
    }  # fmt: skip


def prepared(folder: Path) -> None:
    """Copy the jobs into a folder, and make the parts that are read from files."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in JOBS.iterdir():
        if file.suffix in (".yaml", ".py"):
            shutil.copy(file, folder)
    subprocess.run([sys.executable, "-I", "make_parts.py"], cwd=folder, check=True, stdout=subprocess.DEVNULL)


def number(value: Any, form: str = ".3g") -> str:
    """A number, or a dash."""
    return "–" if value is None else format(value, form)


def tables(stored: dict[str, Any]) -> str:
    """The tables of the page."""
    runs = [
        "| job | weight | how stiff | will it print |",
        "|---|---|---|---|",
    ]
    costs = [
        "| job | time | memory | report | judged by others |",
        "|---|---|---|---|---|",
    ]
    for name in NAMES:
        if (one := stored.get(name)) is None:
            continue
        tested = one.get("tested") or {}
        weight = tested.get("mass") or one.get("filament_g") or one.get("resin_g")
        stiff = "–"
        if tested:
            stiff = (
                f"moves {tested['deflection']:.2g} mm, yields at {number(tested.get('safety'), '.2g')} times the load"
            )
        elif one.get("E_MPa"):
            stiff = f"E = {one['E_MPa']:.0f} MPa"
        verdict = str(one.get("verdict") or f"no line below {one.get('narrowest_mm', 0):.2f} mm").split(";")[0]
        if "print_time_s" in one:
            verdict += f"; {one['resin_ml']:.0f} ml, {one['print_time_s'] / 3600:.1f} h, price {one['price']:.2f}"
        runs.append(f"| [{WHAT[name]}](../../examples/jobs/{name}.yaml) | {number(weight)} g | {stiff} | {verdict} |")
        judges = []
        if "manifold" in one:
            word = "manifold" if one["manifold"] == "yes" else "not manifold"
            judges.append(f"PrusaSlicer: {word}, {'repaired' if one['repaired'] else 'nothing repaired'}")
        if "admesh_disconnected" in one:
            judges.append(f"ADMesh: {one['admesh_disconnected']} open, {one['admesh_reversed']} reversed facets")
        if "lib3mf_warnings" in one:
            word = "manifold and oriented" if one["lib3mf_manifold"] else "not manifold"
            judges.append(f"lib3mf: {one['lib3mf_warnings']} warnings, {word}")
        if "filament_g" in one:
            judges.append(
                f"PrusaSlicer: {one['filament_g']:.0f} g of filament, lines of {one['narrowest_mm']:.2f} mm or more"
            )
        costs.append(
            f"| {name} | {one['first_cpu_s']:.0f} s | {one['peak_mb']:.0f} MB | {one['report_mb']:.1f} MB | "
            f"{'; '.join(judges) or '–'} |"
        )
    pictures = " ".join(f"![{WHAT[name]}](../pictures/job-{name}.png)" for name in NAMES if name in stored)
    words = "Times are those of a processor, and the first job to need a kernel compiled it."
    return "\n".join([*runs, "", *costs, "", words, "", pictures, ""])


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the jobs, and print what is known."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAMES")
    parser.add_argument("--write", action="store_true", help="store the numbers and pictures, and write the page")
    parser.add_argument("--folder", type=Path, help="where to run them")
    parser.add_argument("--again", action="store_true", help="run each a second time, with compiled kernels")
    args = parser.parse_args(arguments)
    folder = args.folder or Path(tempfile.mkdtemp(prefix="jobs-"))
    prepared(folder)
    stored: dict[str, Any] = json.loads(STORED.read_text("utf-8")) if STORED.exists() else {}
    for name in args.names or NAMES:
        stored[name] = measured(name, folder, args.again)
        print(name, json.dumps(stored[name], indent=1, default=str), flush=True)
        if args.write:
            STORED.write_text(json.dumps(stored, indent=1, default=str) + "\n", "utf-8")
            picture = Image.open(folder / "runs" / name / f"{name}.png").convert("RGB").resize((600, 450))
            path = ROOT / "docs" / "pictures" / f"job-{name}.png"
            picture.quantize(128, dither=Image.Dither.FLOYDSTEINBERG).save(path, "PNG", optimize=True)
            between_marks(PAGE, MARK, tables(stored))


if __name__ == "__main__":
    os.environ.setdefault("MPLBACKEND", "agg")
    main()
