"""``sppm new``: a first pipeline, or the skeleton of a plugin distribution that works and is tested."""

from __future__ import annotations

import json
import keyword
import re
from argparse import ArgumentParser, Namespace
from pathlib import Path

from sppm_pipeline.errors import ConfigError

_PLACE = "jittered_grid"

SCHEMA = "sppm.schema.json"
"""Name of the schema beside new pipelines, by which editors check and complete them."""


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("kind", choices=("pipeline", "plugin"), help="what to write")
    parser.add_argument("name", metavar="NAME", help="name of the design or of the distribution")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", default=Path(), help="folder to write into; here")


def execute(args: Namespace) -> int:
    """Write it."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", args.name):
        raise ConfigError(f"a name consists of letters, digits, _ and - and starts with a letter, got {args.name!r}")
    return _pipeline(args.name, args.output) if args.kind == "pipeline" else _plugin(args.name, args.output)


def _pipeline(name: str, folder: Path) -> int:
    from sppm_pipeline.engine.plan.plugins import allowed_plugins, load_plugins
    from sppm_pipeline.engine.plan.registry import Registry
    from sppm_pipeline.engine.plan.schema import configuration_schema

    path, schema = folder / f"{name}.yaml", folder / SCHEMA
    _write(path, _PIPELINE.replace("@name@", name).replace("@schema@", SCHEMA))
    if not schema.exists():
        _write(
            schema,
            json.dumps(
                configuration_schema(Registry(load_plugins(allowed=allowed_plugins(None)))),
                indent=1,
                ensure_ascii=False,
            )
            + "\n",
        )
    print(f"{path}\nnext: sppm check {path}, then sppm run {path}; editors complete options by {schema}")
    return 0


def _plugin(name: str, folder: Path) -> int:
    distribution = name.lower().replace("_", "-")
    package = distribution.replace("-", "_")
    if keyword.iskeyword(package) or package in ("sppm", "sppm_pipeline"):
        raise ConfigError(f"{name!r} can't be the name of a Python package of yours", hint=f"try sppm-{distribution}")
    root = folder / distribution
    if root.exists():
        raise ConfigError(f"{str(root)!r} exists already; nothing is overwritten")
    files = {
        "pyproject.toml": _PYPROJECT,
        "README.md": _README,
        f"{package}/__init__.py": _INIT,
        f"{package}/{_PLACE}.py": _SAMPLER,
        f"tests/test_{_PLACE}.py": _TEST,
        "example.yaml": _EXAMPLE,
    }
    family = package.removeprefix("sppm_")
    for file, text in files.items():
        filled = text.replace("@distribution@", distribution).replace("@package@", package)
        _write(root / file, filled.replace("@stage@", f"sample.{family}"))
    print(f"{root}\nnext: pip install -e {root}, then sppm stages sample.{family}, and pytest {root}")
    return 0


def _write(path: Path, text: str) -> None:
    if path.exists():
        raise ConfigError(f"{str(path)!r} exists already; nothing is overwritten")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


_PIPELINE = """\
# yaml-language-server: $schema=@schema@
# One periodic cell: pores on mirrored faces and inside, tunnels between them, a field, its surface.
# Try: sppm explain @name@.yaml, sppm run @name@.yaml -p porosity=0.6
sppm: 1
name: @name@
seed: 1
params:
  porosity: 0.5
recipes:
  cell:
    - {stage: sample.mirrored_faces, count: 12, spacing: 0.2}
    - {stage: sample.dart_throwing, count: 20, spacing: 0.2}
    - {stage: connect.mbdst, degree: [3, 5]}
    - {stage: field.gaussian, pore_radius: 0.11, tunnel_radius: 0.03}
pipeline:
  - {stage: tune.porosity, recipe: cell, target: "${porosity}"}
  - {stage: check.connectivity}
  - {stage: extract.marching_cubes, resolution: 48}
  - {stage: write.mesh, path: @name@.ply}
"""

_PYPROJECT = """\
[build-system]
requires = ["setuptools>=68"]
build-backend = "setuptools.build_meta"

[project]
name = "@distribution@"
version = "0.1.0"
description = "A sampler for sppm_pipeline: pores on a jittered grid"
requires-python = ">=3.11"
dependencies = ["sppm-pipeline>=0.1"]

# this line is what makes the program find the plugin
[project.entry-points.sppm]
@package@ = "@package@"

[tool.setuptools.packages.find]
include = ["@package@*"]
"""

_INIT = '''\
"""A sampler for sppm_pipeline: pores on a jittered grid."""

from __future__ import annotations

from sppm_pipeline.hookspecs import hookimpl


@hookimpl
def sppm_stages() -> dict[str, str]:
    """Our stages, by the place of their class, which is imported only when it is used."""
    return {"@stage@": "@package@.jittered_grid:JitteredGrid"}
'''

_SAMPLER = '''\
"""``@stage@``: pores on a regular grid, each moved by chance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.families import InteriorBox, Sampler
from sppm_pipeline.stage import option


@dataclass(frozen=True, kw_only=True)
class JitteredGrid(Sampler):
    """Put one pore into each of n x n x n boxes, somewhere around its middle."""

    name: ClassVar[str] = "@stage@"

    n: int = option(3, help="boxes along an edge of the cell", minimum=1, maximum=100)
    jitter: float = option(
        0.5, help="how far a pore may stray; 0: the middle of its box, 1: anywhere in it", minimum=0, maximum=1
    )

    def throw(self, rng: np.random.Generator, box: InteriorBox) -> NDArray[np.float64]:
        """Pores of one interior, (n^3, 3), cell sizes."""
        corners = np.stack(np.meshgrid(*[np.arange(self.n)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        within = 0.5 + self.jitter * (rng.random(corners.shape) - 0.5)
        return box.lower + (corners + within) / self.n * (box.upper - box.lower)
'''

_TEST = '''\
"""The sampler keeps the contract of samplers, and its own promises."""

from __future__ import annotations

import numpy as np
from @package@.jittered_grid import JitteredGrid

from sppm_pipeline.testing.contracts import SamplerContract
from sppm_pipeline.testing.plain_context import PlainContext


class TestJitteredGrid(SamplerContract):
    def stages(self):
        return [JitteredGrid(), JitteredGrid(n=1, jitter=1.0)]


def test_without_jitter_pores_lie_in_the_middle_of_their_boxes():
    pores = JitteredGrid(n=2, jitter=0.0).run(PlainContext(), None)
    assert sorted(np.unique(pores.centers)) == [0.25, 0.75]
    assert len(pores.centers) == 8
'''

_README = """\
# @distribution@

A sampler for `sppm_pipeline`: pores on a regular grid, each moved by chance.

    pip install -e .
    sppm stages @stage@
    sppm run example.yaml
    pytest

| file | what it is |
|---|---|
| `pyproject.toml` | the entry point in the group `sppm`, by which the program finds the package |
| `@package@/__init__.py` | the hook `sppm_stages`: name of the stage -> place of its class |
| `@package@/jittered_grid.py` | the stage: its options, and one method that throws the pores |
| `tests/test_jittered_grid.py` | the contract that every sampler keeps, and what this one promises besides |
| `example.yaml` | a pipeline that uses it |
"""

_EXAMPLE = """\
sppm: 1
name: jittered
seed: 1
pipeline:
  - {stage: @stage@, n: 3, jitter: 0.6}
  - {stage: connect.mbdst, degree: [3, 5]}
  - {stage: field.gaussian, pore_radius: 0.11, tunnel_radius: 0.03}
  - {stage: extract.marching_cubes, resolution: 48}
  - {stage: write.mesh, path: cell.ply}
"""
