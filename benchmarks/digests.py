"""Digests of what every configuration and example makes at a low resolution: whatever changes a result is noticed.

Usage: python -m benchmarks.digests [--write | --mark] [NAME...]

Runs all configurations and examples, or those named, prints which outputs differ from the list in
``benchmarks/digests.json``, and ends with exit code 1 if any does; with ``--write`` the list is written again. The same
runs are compared with it by ``tests/test_configs.py``.

A digest is the first 16 hexadecimal digits of a SHA-256 of what a file says, not of its bytes: other compression,
another order of keys or another spacing changes nothing. Layers of a stack, and files of the same name in the runs of a
sweep, share one digest. What counts:

* layers, pictures, charts and animations: every pixel;
* meshes and volume meshes: faces and cells as they are, coordinates rounded to 1e-6 of the largest;
* arrays of voxels: whole numbers as they are, others rounded to 1e-6 of the largest;
* numbers of the run record, of tables and of text: rounded to 6 significant digits, but not finer than 1e-12; those of
  a list (a tensor, a column, ``C.1.1`` to ``C.6.6``) to as many decimals as its largest, so that an entry that vanishes
  by symmetry counts as 0, whatever a solver leaves there;
* a printer's file: every byte, as no library has a part in it.

Of the run record, summaries of stages count; times, memory, versions, paths, options and the words of warnings do not.
``sweep.csv`` is left out, whose numbers are those of ``sweep.json``.

Results are the same on any number of threads, but not on any processor, nor with any release of a library: compiled
kernels round differently, a vertex moves by 1e-6, a search for a porosity ends elsewhere, a font is wider. No rounding
makes that go away. Outputs with an asterisk in the list are those that were seen to differ; they are compared only on a
processor and with releases as the list names them, all others everywhere. Elsewhere write the list again before a
change, and compare with that. ``--mark`` gives an asterisk to whatever differs from the list, for instance on a
processor without fused multiply-add::

    NUMBA_CPU_NAME=x86-64-v2 NUMBA_CPU_FEATURES= OPENBLAS_CORETYPE=Nehalem python -m benchmarks.digests --mark

and with the libraries of ``make test-oldest``.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import hashlib
import io
import json
import math
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_suffix(".json")
LIBRARIES = ("numpy", "numba", "scipy", "pillow", "matplotlib", "manifold3d", "networkx")


class Small(NamedTuple):
    """Changes with which a configuration is run at a low resolution.

    `params` and `options` are as after ``-p`` and ``-s`` of ``sppm run``; ``{folder}`` stands for the folder of the
    run. `sweep` replaces that of the configuration, if not empty. `plugins` are needed: sppm-structures, sppm-crushing,
    sppm-tetrahedra, or a file of its own.
    """

    params: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    sweep: str = ""
    plugins: bool = False


def _small(params: str = "", options: str = "", sweep: str = "", plugins: bool = False) -> Small:
    """`Small` of words between semicolons."""
    split = [tuple(word.strip() for word in text.split(";") if word.strip()) for text in (params, options)]
    return Small(*split, sweep, plugins)


_ISLANDS = "fill.implicit.islands=remove"  # coarse pixels break walls
_PART = f"""{_ISLANDS}; slice.field.pixel=0.5 mm; part_picture.resolution=8; part_picture.size=[200, 150];
    extract.marching_cubes.resolution=12"""
_PICTURE = "write.picture.resolution=8; write.picture.image_size=[200, 150]"
_VIEW = "write.picture.resolution=10"
_DRAWN = "picture.resolution=8; picture.image_size=[200, 150]; filled.islands=remove"
_GOO = f"layers.layer=0.1 mm; print.fail=[]; {_DRAWN}"
_WALLS = "".join(
    f"  - {{voxels: {2 * n}, lattice: {n}, order: {order}, porosity: 0.5}}\n" for n, order in ((10, 1), (15, 1), (8, 2))
)

CONFIGS: Mapping[str, Small] = {
    "bunny": _small("mesh={folder}/body.ply; height=12 mm; voxels=10", "tile.scattered.resolution=16"),
    "cell": _small(
        "pores=40",
        """tune.porosity.resolution=32; tune.porosity.trials=1; tune.porosity.tolerance=0.005;
        check.connectivity.resolution=24; write.picture.resolution=16; write.picture.image_size=[200, 150];
        extract.marching_cubes.resolution=24; connect.mbdst.mode=greedy""",
    ),
    "compare_structures": _small(
        "resolution=16; pixels=[90, 80]",
        "write.picture.resolution=12; tuned.resolution=24; tuned.tolerance=0.02",
        plugins=True,
    ),
    "composite": _small(
        "resolution=12",
        "solid.resolution=24; solid.trials=1; solid.tolerance=0.02",
        "{filling: [0.1, 0.001], porosity: [0.5]}",
    ),
    "crush_animation": _small(
        options="""tune.porosity.resolution=24; tile.periodic.cells=[1, 1, 1]; crush.resolution=10; crush.rate=0.05;
        write.frames.image_size=[60, 50]""",
        plugins=True,
    ),
    "crush_density": _small(
        "resolution=10; rate=0.05",
        "tune.porosity.resolution=24; tile.periodic.cells=[1, 1, 1]",
        "{porosity: [0.5, 0.8], pores: [20]}",
        plugins=True,
    ),
    "crush_structures": _small(
        "resolution=10; cells=[1, 1, 1]; rate=0.04",
        "tune.porosity.resolution=24; write.frames.image_size=[160, 120]",
        "{structure: [tpms_p, sppm_1]}",
        plugins=True,
    ),
    "designs/damper": _small(
        "", f"porous.resolution=20; tuned.resolution=20; part.size=[10 mm, 10 mm, 0.5 mm]; {_GOO}"
    ),
    "designs/filter": _small(
        "", f"porous.resolution=24; flow.resolution=16; sizes.resolution=24; part.size=[9 mm, 9 mm, 0.5 mm]; {_GOO}"
    ),
    "designs/implant_core": _small(
        "",
        f"""design.resolution=32; design.draws=1; block.resolution=16; elastic.resolution=20; flow.resolution=16;
        sizes.resolution=24; part.size=[4 mm, 4 mm, 4 mm]; laid.resolution=16; surface.resolution=10; {_DRAWN}""",
    ),
    "designs/insole": _small(
        "",
        f"""part.size=[18 mm, 15 mm, 1 mm]; curve.trials=1; curve.resolution=16; laid.resolution=16; laid.rounds=0;
        local.resolution=12; {_GOO}""",
    ),
    "designs/light_panel": _small(
        "",
        f"""block.resolution=24; elastic.resolution=20; sizes.resolution=20; part.size=[12 mm, 9 mm, 2 mm];
        laid.resolution=16; fixed.voxel=0.5 mm; {_GOO}""",
    ),
    "graded_bar": _small(
        options=f"""tile.graded.trials=1; tile.graded.rounds=1; tile.graded.resolution=32;
        tune.local_porosity.resolution=32; check.local_porosity.resolution=40; check.connectivity.resolution=24;
        {_PICTURE}"""
    ),
    "how_random": _small(
        "cells=[3, 3, 3]; voxels=8",
        ";".join(
            f"{name}.resolution=12" for name in ("paper_set", "wang_set", "free_set", "corner_set", "fresh_cells")
        ),
        "{seed: [1]}",
    ),
    "periodic_vs_stochastic": _small(
        "",
        """tiles.resolution=12; tiles.tolerance=0.05; connect.mbdst.mode=greedy; repeated_picture.resolution=6;
        stochastic_picture.resolution=6; repeated_picture.size=[120, 90]; stochastic_picture.size=[120, 90];
        check.connectivity.resolution=10""",
        "{cells: [[3, 3, 3], [4, 3, 3]]}",
    ),
    "porosity_map": _small("", "check.porosity.resolution=16", "{pores: [20, 60, 100], seed: {from: 1, to: 3}}"),
    "printer": _small("", f"{_ISLANDS}; read.primitive.size=[12 mm, 12 mm, 0.5 mm]; tile.scattered.resolution=16"),
    "property_map": _small(
        "resolution=16", "", "{structure: [wide_16, wide_64, gyroid_1], porosity: [0.7]}", plugins=True
    ),
    "published_curves": _small(
        "resolution=16",
        "tuned.resolution=24; tuned.tolerance=0.02",
        "{structure: [octet, kelvin, simple_cubic, schwarz_p, gyroid]}",
        plugins=True,
    ),
    "quickstart": _small("cell=8 mm", f"tile.scattered.resolution=16; {_PART}"),
    "representative_volume": _small(
        "samples=2; assemblies=[1, 2]",
        """homogenize.realizations.resolution=8; tileset.wang_3color.colors=1; tileset.wang_3color.resolution=12;
        tileset.wang_3color.tolerance=0.05""",
    ),
    "scattered": _small(
        "",
        f"""tile.scattered.cells=[2, 2, 1]; tile.scattered.resolution=12; check.connectivity.resolution=20;
        slice.field.pixel=0.5 mm; slice.field.islands=remove; extract.marching_cubes.resolution=10;
        extract.marching_cubes.islands=remove; {_PICTURE}""",
    ),
    "scattered_part": _small(
        "cell=10 mm",
        f"""{_ISLANDS}; tile.scattered.resolution=12; slice.field.pixel=[0.6 mm, 0.8 mm]; slice.field.layer=0.5 mm;
        {_PICTURE}""",
    ),
    "sizes": _small(options="design.sizes.resolution=32; design.sizes.draws=1; check.sizes.resolution=16"),
    "stiffest": _small(
        "resolution=20",
        "tuned.resolution=32; tuned.tolerance=0.01",
        "{structure: [walls_hyper_mbdst_20, tunnels_hyper_mbdst_20]}",
        plugins=True,
    ),
    "stiffest_grid": _small(
        "",
        "tuned.resolution=32; tuned.tolerance=0.01",
        "{structure: [walls, tunnels], resolution: [20], seed: [1]}",
        plugins=True,
    ),
    "stiffness_map": _small(
        "",
        """elastic.resolution=20; check.connectivity.resolution=12; tune.porosity.resolution=24; tune.porosity.trials=1;
        tune.porosity.tolerance=0.01""",
        "{omega: [30], porosity: [0.3, 0.6], seed: [1]}",
    ),
    "table_mesh_free": _small(
        "",
        """slice.field.resolution=8; slice.field.islands=remove; tileset.wang_3color.resolution=12;
        tileset.wang_3color.tolerance=0.05""",
        "{cells: [[1, 2, 3]]}",
    ),
    "tileset_27": _small(
        "",
        """tileset.wang_3color.resolution=16; tileset.wang_3color.tolerance=0.02; connect.mbdst.mode=greedy;
        write.picture.resolution=8; tile.wang_3color.cells=[3, 3, 3]; assembly.resolution=8;
        assembly.size=[200, 150]""",
    ),
    "walls": _small(
        "pores=40",
        """walls.resolution=32; walls.tolerance=0.005; phases.resolution=40; check.sizes.resolution=24;
        elastic.resolution=20; write.picture.resolution=16; write.picture.image_size=[200, 150];
        extract.marching_cubes.resolution=32""",
    ),
    "walls_stiffness": _small(
        "",
        "tuned.resolution=40; tuned.tolerance=0.01",
        "{structure: [paper, stiff, gyroid], resolution: [32], seed: [1]}",
        plugins=True,
    ),
    "walls_tetrahedra": _small(
        "pores=4; tunnel_radius=0.08", "walls.resolution=40; tetrahedra.residual=1e-4", f"\n{_WALLS}", plugins=True
    ),
    "wang_part": _small(
        "cell=8 mm",
        f"""tileset.wang_3color.colors=2; tileset.wang_3color.resolution=16; tileset.wang_3color.tolerance=0.02;
        tiles_picture.resolution=8; connect.mbdst.mode=greedy; {_PART}""",
    ),
}
"""Those in ``configs/`` by name."""

EXAMPLES: Mapping[str, Small] = {
    "blend": _small("", f"sponge.resolution=12; {_VIEW}", plugins=True),
    "bracket": _small(
        "cell=8 mm",
        """optimize.density.updates=3; optimize.density.trials=1; optimize.density.law_resolution=16;
        tile.scattered.resolution=16; tile.scattered.rounds=0; uniform.resolution=16; tested.resolution=8;
        uniform_tested.resolution=8; slice.field.layer=0.1 mm;
        tested.image_size=[200, 150]; load.case.image_size=[200, 150]""",
    ),
    "crush": _small("", "tune.porosity.resolution=24; crush.voxel.resolution=10; crush.voxel.rate=0.05", plugins=True),
    "elbow": _small(
        "",
        f"""tile.hexahedra.resolution=12; tile.hexahedra.trials=1; tile.hexahedra.rounds=1;
        tune.local_porosity.resolution=20; {_VIEW}""",
    ),
    "finer_pores": _small("", f"tile.scattered.resolution=10; {_VIEW}"),
    "flow": _small("", "homogenize.permeability.resolution=16"),
    "foam_ball": _small("", _VIEW, plugins=True),
    "folded": _small("", "tileset.wang_3color.resolution=12; check.residual_periodicity.resolution=8"),
    "graded_stem": _small("", _VIEW),
    "border": _small(
        "", "tile.scattered.resolution=16; write.picture.resolution=6; write.picture.image_size=[200, 150]"
    ),
    "knot": _small("", f"tile.scattered.resolution=16; {_VIEW}"),
    "lattice_puck": _small("", f"tune.porosity.resolution=24; tune.porosity.tolerance=0.01; {_VIEW}", plugins=True),
    "layers": _small("", "tile.scattered.resolution=16; slice.field.pixel=0.2 mm"),
    "loaded_insole": _small(
        "cell=12 mm",
        """optimize.density.updates=3; optimize.density.trials=1; optimize.density.law_resolution=16;
        tile.scattered.resolution=16; tile.scattered.rounds=0; tested.resolution=8; slice.field.layer=0.2 mm;
        tested.image_size=[200, 150]; load.case.image_size=[200, 150]""",
    ),
    "loaded_stem": _small(
        "cell=10 mm",
        """optimize.density.updates=3; optimize.density.trials=1; optimize.density.law_resolution=16;
        tile.scattered.resolution=16; tile.scattered.rounds=0; tested.resolution=8;
        slice.field.layer=0.5 mm; slice.field.pixel=0.4 mm;
        tested.image_size=[200, 150]; load.case.image_size=[200, 150]""",
    ),
    "modulus": _small("", "tune.porosity.resolution=24; homogenize.voxel.resolution=16"),
    "plate_with_holes": _small("", "tile.scattered.resolution=16; porous.resolution=8"),
    "sheet_cell": _small(
        "",
        f"tune.porosity.resolution=24; homogenize.voxel.resolution=16; homogenize.permeability.resolution=16; {_VIEW}",
    ),
    "single_file_plugin": _small(
        "", "check.connectivity.resolution=12; extract.marching_cubes.resolution=12", plugins=True
    ),
    "skin": _small("", f"tile.scattered.resolution=16; {_VIEW}"),
    "spinodoid": _small("", f"tune.porosity.resolution=24; tune.porosity.tolerance=0.01; {_VIEW}", plugins=True),
    "stiffness_over_porosity": _small(
        "",
        "tune.porosity.resolution=24; elastic.resolution=12",
        "{pores: [20, 50], porosity: [0.5, 0.7], seed: [1]}",
    ),
    "tetrahedra": _small("", "tune.porosity.resolution=24; mesh.isosurface_stuffing.resolution=12", plugins=True),
    "trapped_resin": _small("", "tile.scattered.resolution=16; slice.field.pixel=0.3 mm"),
    "tube": _small("", f"tile.fresh.resolution=12; {_VIEW}"),
    "regions": _small("", f"coarse.resolution=12; fine.resolution=12; {_VIEW}"),
    "two_sets": _small("", f"coarse.resolution=16; fine.resolution=16; tile.joined.resolution=12; {_VIEW}"),
    "walls_cell": _small("", f"tune.porosity.resolution=24; homogenize.voxel.resolution=16; {_VIEW}"),
    "wang_tiles": _small(
        "",
        f"""tileset.wang_3color.colors=2; tileset.wang_3color.resolution=16; tileset.wang_3color.tolerance=0.02;
        {_VIEW}""",
    ),
}
"""Those in ``examples/`` by name."""

SMALL = {**CONFIGS, **EXAMPLES}


def small(name: str, folder: Path) -> tuple[Path, Small]:
    """The file of a configuration with its shorter sweep, and with what it is run, ready to be run in `folder`."""
    wanted = SMALL[name]
    path = ROOT / ("configs" if name in CONFIGS else "examples") / f"{name}.yaml"
    if wanted.sweep:
        head, _, rest = path.read_text(encoding="utf-8").partition("\nsweep:")
        _, after, last = rest.partition("\nafter:")
        path = folder / f"{name}.yaml"
        path.write_text(f"{head}\nsweep: {wanted.sweep}{after}{last}", encoding="utf-8")
    if name == "bunny":
        from sppm_pipeline.method.part import primitive_meshes
        from sppm_pipeline.services.formats import ply

        vertices, faces = primitive_meshes.torus_mesh((3.0, 4.0, 5.0), 2.0, 1.0, 24, 12)
        (folder / "body.ply").write_bytes(b"".join(ply.encode(vertices, faces)))
    return path, wanted._replace(params=tuple(word.replace("{folder}", str(folder)) for word in wanted.params))


def command(name: str, folder: Path) -> list[str]:
    """The words after ``sppm`` that run a configuration at a low resolution; the results are in ``folder/run``."""
    path, wanted = small(name, folder)
    # coarse layers lose more solid as islands than the audit of a real run allows
    words = ["run", str(path), "-o", str(folder / "run"), "-q", "--no-cache", "--audit", "warn"]
    for flag, values in (("-p", wanted.params), ("-s", wanted.options)):
        words += [word for value in values for word in (flag, value)]
    return words


def digests(folder: Path) -> dict[str, str]:
    """Digests of the outputs of a run, by path; numbers of four digits and more in paths are asterisks."""
    found: dict[str, Any] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_dir() or name == "sweep.csv" or path.name == "SHA256SUMS":
            continue
        decode = DECODERS.get(path.suffix)
        if decode is None:
            raise ValueError(f"{name}: no decoder for {path.suffix or 'files without extension'}")
        digest = found.setdefault(re.sub(r"\d{4,}", "*", name), hashlib.sha256())
        digest.update(name.encode())
        for piece in decode(path):
            digest.update(piece)
    return {key: digest.hexdigest()[:16] for key, digest in found.items()}


def surroundings() -> dict[str, str]:
    """The processor, what kernels are compiled for, and libraries: what outputs with an asterisk depend on."""
    import llvmlite.binding as llvm

    from sppm_pipeline.services.jit.machine_code import target

    kernels = os.environ.get("NUMBA_CPU_NAME") or target()
    return {"processor": llvm.get_host_cpu_name(), "kernels": kernels} | {name: version(name) for name in LIBRARIES}


def changes(name: str, folder: Path) -> dict[str, str]:
    """Differences of outputs of a configuration, by path: its results in `folder` against the list."""
    document = json.loads(LIST.read_text(encoding="utf-8"))
    listed, found = document["digests"].get(name, {}), digests(folder)
    told = dict.fromkeys(found.keys() - listed.keys(), "is new") | dict.fromkeys(
        listed.keys() - found.keys(), "is missing"
    )
    alike = document["of"] == surroundings()
    for output in found.keys() & listed.keys():
        if found[output] != listed[output].rstrip("*") and (alike or not listed[output].endswith("*")):
            told[output] = "has changed"
    return dict(sorted(told.items()))


def check(name: str, folder: Path) -> None:
    """Raise an `AssertionError` that says which outputs of a configuration have changed, and what to do."""
    lines = [f"{name}: {output} {what}" for output, what in changes(name, folder).items()]
    assert not lines, "\n".join([*lines, f"if that is wanted: python -m benchmarks.digests --write {name}"])


_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.\d*|\.\d+|\d+(?=[eE]))(?:[eE][-+]?\d+)?")


def rounded(values: Iterable[float]) -> list[float]:
    """Rounded to 6 significant digits of the largest, but not finer than 1e-12."""
    numbers = list(values)
    finite = [abs(value) for value in numbers if math.isfinite(value)]
    if not any(finite):
        return [value + 0.0 for value in numbers]
    digits = min(5 - math.floor(math.log10(max(finite))), 12)
    return [round(value, digits) + 0.0 for value in numbers]  # no -0.0


def steady(value: Any) -> Any:
    """A JSON document whose numbers are rounded: those of a list, and of keys that differ in numbers, together."""
    if isinstance(value, dict):
        groups: dict[str, dict[str, float]] = {}
        made = {}
        for key, entry in value.items():
            if isinstance(entry, float):
                groups.setdefault(re.sub(r"\.\d+", "", key), {})[key] = entry
            else:
                made[key] = steady(entry)
        for group in groups.values():
            made |= dict(zip(group, rounded(group.values()), strict=True))
        return made
    if isinstance(value, list):
        leaves = list(_leaves(value))
        if leaves and all(isinstance(leaf, (int, float)) for leaf in leaves) and any(map(_is_float, leaves)):
            numbers = iter(rounded(map(float, leaves)))
            return _filled(value, numbers)
        return [steady(entry) for entry in value]
    return rounded([value])[0] if isinstance(value, float) else value


def _is_float(value: Any) -> bool:
    return isinstance(value, float)


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, list):
        for entry in value:
            yield from _leaves(entry)
    else:
        yield value


def _filled(value: Any, numbers: Iterator[float]) -> Any:
    return [_filled(entry, numbers) for entry in value] if isinstance(value, list) else next(numbers)


def _canonical(value: Any) -> bytes:
    return json.dumps(steady(value), sort_keys=True).encode()


def _json(path: Path) -> Iterator[bytes]:
    content = json.loads(path.read_text(encoding="utf-8"))
    yield _canonical(_of_record(content) if path.name == "run.json" else content)


def _of_record(record: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a run record that counts."""

    def of_stage(stage: Mapping[str, Any]) -> dict[str, Any]:
        kept = {key: stage[key] for key in ("id", "stage", "runs", "summary") if key in stage}
        return kept | {"inner": [of_stage(inner) for inner in stage.get("inner", ())]}

    rows = [{key: row[key] for key in ("run", "params", "status")} for row in record.get("runs", ())]
    stages = [of_stage(stage) for stage in record.get("stages", ())]
    return {"status": record["status"], "runs": rows, "stages": stages}


def _csv(path: Path) -> Iterator[bytes]:
    """Column by column."""
    rows = list(csv.reader(io.StringIO(path.read_text(encoding="utf-8"))))
    yield f"{len(rows)}".encode()
    for column in zip(*rows, strict=True):
        words: list[Any] = list(column)
        places = [n for n, word in enumerate(words) if _NUMBER.fullmatch(word)]
        for n, number in zip(places, rounded(float(words[n]) for n in places), strict=True):
            words[n] = number
        yield json.dumps(words).encode()


def _text(path: Path) -> Iterator[bytes]:
    text = path.read_text(encoding="utf-8")
    yield _NUMBER.sub(lambda match: repr(rounded([float(match[0])])[0]), text).encode()


def _png(path: Path) -> Iterator[bytes]:
    """Frame by frame."""
    from PIL import Image, ImageSequence

    with Image.open(path) as image:
        yield f"{image.mode} {image.info.get('duration')}".encode()
        for frame in ImageSequence.Iterator(image):
            yield f"{frame.size}".encode()
            yield frame.tobytes()


def _arrays(*arrays: NDArray[Any]) -> Iterator[bytes]:
    """Integers as they are; others rounded to 1e-6 of the largest."""
    for array in arrays:
        yield f"{array.shape}".encode()
        if array.dtype.kind == "f":
            largest = float(np.abs(array).max(initial=0.0)) or 1.0
            array = np.rint(array.astype(float) * (1e6 / largest))
            yield f"{rounded([largest])[0]}".encode()
        yield array.astype("<i8").tobytes()


def _mesh(path: Path) -> Iterator[bytes]:
    from sppm_pipeline.features.files.formats.detect import decode_mesh

    return _arrays(*decode_mesh(path.read_bytes(), path.name))


def _vtk(path: Path) -> Iterator[bytes]:
    """Arrays of a VTK file of XML, raw and uncompressed behind it: 8 bytes for the size in front of each."""
    head, _, data = path.read_bytes().partition(b'<AppendedData encoding="raw">')
    data = data[data.index(b"_") + 1 :]
    yield _NUMBER.sub(lambda match: repr(rounded([float(match[0])])[0]), head.decode()).encode()
    for kind, place in re.findall(r'<DataArray type="(\w+)".*? offset="(\d+)"', head.decode()):
        start = int(place) + 8
        size = int.from_bytes(data[int(place) : start], "little")
        yield from _arrays(np.frombuffer(data[start : start + size], np.dtype(kind.lower()).newbyteorder("<")))


def _bytes(path: Path) -> Iterator[bytes]:
    yield path.read_bytes()


DECODERS: Mapping[str, Callable[[Path], Iterator[bytes]]] = {
    ".json": _json, ".csv": _csv, ".md": _text, ".graphml": _text, ".inp": _text, ".png": _png, ".stl": _mesh,
    ".ply": _mesh, ".3mf": _mesh, ".vti": _vtk, ".vtu": _vtk, ".goo": _bytes, ".sl1": _bytes,
}  # fmt: skip
"""Readers of the content of a file, by its extension."""


def results(names: Iterable[str]) -> Iterator[tuple[str, Path]]:
    """Runs configurations at a low resolution; each with the folder of its results, which is there until the next."""
    from sppm_pipeline.engine.cli.main import main as sppm

    for name in names:
        with tempfile.TemporaryDirectory() as scratch:
            said = io.StringIO()
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                code = sppm(command(name, Path(scratch)))
            if code:
                raise RuntimeError(f"{name}: sppm run ended with {code}:\n{said.getvalue()}")
            yield name, Path(scratch, "run")


def written(document: Mapping[str, Any]) -> None:
    """Put the list into its file."""
    LIST.write_text(json.dumps(document, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def main() -> int:
    """Run and compare, or write the list."""
    parser = argparse.ArgumentParser(description="Compare the results of configurations and examples with the list.")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--write", action="store_true", help="write the list anew; asterisks stay")
    what.add_argument("--mark", action="store_true", help="give an asterisk to outputs that differ")
    parser.add_argument("names", nargs="*", metavar="NAME", help="of these; else of all")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(SMALL):
        parser.error(f"there is no configuration {sorted(unknown)[0]!r}")
    os.environ["SPPM_COMPILE_AHEAD"] = "off"
    document = json.loads(LIST.read_text(encoding="utf-8"))
    old, alike = document["digests"], document["of"] == surroundings()
    if arguments.write and arguments.names and not alike:
        parser.error(f"the list is of {document['of']}, not of {surroundings()}: write all of it")
    if arguments.mark and alike:
        parser.error(
            "this is the processor, and these are the libraries, that the list is of: what differs has changed"
        )
    new, count = {}, 0
    for name, folder in results(arguments.names or sorted(SMALL)):
        if arguments.write:
            marked = {output for output, digest in old.get(name, {}).items() if digest.endswith("*")}
            new[name] = {key: digest + "*" * (key in marked) for key, digest in digests(folder).items()}
            continue
        for output, change in changes(name, folder).items():
            print(f"{name}: {output} {change}")
            count += 1
            if arguments.mark and change == "has changed" and not old[name][output].endswith("*"):
                old[name][output] += "*"
    if arguments.write:
        written({"of": surroundings(), "digests": old | new if arguments.names else new})
        return 0
    if arguments.mark:
        written(document)
        return 0
    compared = "" if alike else f"; outputs with an asterisk were not compared, which are of {document['of']}"
    print(f"{count} outputs differ{compared}")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
