"""Which stages call which kernels, what compiling them costs, and the list by which they are compiled ahead.

Runs configurations at a low resolution with an empty folder of kernels, and prints the functions that take longest to
compile, with and without the functions that they call. With --write, the list of the program is written again.

Usage: python -m benchmarks.kernel_list [--write] [NAME...]
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.measure import table

CONFIGS = Path(__file__).parent.parent / "configs"

SMALL: dict[str, tuple[list[str], list[str]]] = {
    "quickstart": (
        ["cell=8 mm"],
        ["tile.scattered.resolution=16", "slice.field.pixel=0.5 mm", "fill.implicit.islands=remove",
         "part_picture.resolution=8", "part_picture.image_size=[200, 150]", "extract.marching_cubes.resolution=12"],
    ),
    "cell": (
        ["pores=40"],
        ["tune.porosity.resolution=32", "tune.porosity.trials=1", "check.connectivity.resolution=24",
         "write.picture.resolution=16", "write.picture.image_size=[200, 150]", "extract.marching_cubes.resolution=24"],
    ),
    "wang_part": (
        ["cell=8 mm"],
        ["tileset.wang_3color.colors=2", "tileset.wang_3color.resolution=16", "tileset.wang_3color.tolerance=0.02",
         "tiles_picture.resolution=8", "slice.field.pixel=0.5 mm", "fill.implicit.islands=remove",
         "part_picture.resolution=8", "part_picture.image_size=[200, 150]", "extract.marching_cubes.resolution=12",
         "connect.mbdst.mode=greedy"],
    ),
    "table_mesh_free": (
        ["cells=[3, 2, 2]"],
        ["slice.field.resolution=8", "slice.field.islands=remove", "tileset.wang_3color.resolution=12",
         "tileset.wang_3color.tolerance=0.05"],
    ),
    "scattered": (
        [],
        ["tile.scattered.cells=[2, 2, 1]", "tile.scattered.resolution=12", "check.connectivity.resolution=20",
         "slice.field.pixel=0.5 mm", "slice.field.islands=remove", "extract.marching_cubes.resolution=10",
         "extract.marching_cubes.islands=remove", "write.picture.resolution=8",
         "write.picture.image_size=[200, 150]"],
    ),
    "porosity_map": (["pores=40"], ["check.porosity.resolution=16"]),
    "stiffness_map": ([], ["homogenize.voxel.resolution=12", "check.connectivity.resolution=12"]),
    "printer": (
        [],
        ["read.primitive.size=[12 mm, 12 mm, 0.5 mm]", "tile.scattered.resolution=16", "fill.implicit.islands=remove"],
    ),
    "walls": (
        ["pores=40"],
        ["walls.resolution=32", "walls.tolerance=0.005", "phases.resolution=40", "check.sizes.resolution=24",
         "elastic.resolution=20", "write.picture.resolution=16", "write.picture.image_size=[200, 150]",
         "extract.marching_cubes.resolution=32"],
    ),
}  # fmt: skip
"""Configuration -> parameters and options with which it is small and calls what it calls at full size."""


class Calls:
    """The kernels that Python calls while a configuration runs, and the time of compiling them."""

    def __init__(self) -> None:
        self.found: dict[str, dict[str, Any]] = {}
        self.costs: dict[str, list[float]] = {}
        self.unlisted: set[str] = set()
        self._stage = ""

    @contextlib.contextmanager
    def heard(self) -> Iterator[None]:
        """Listen to Numba and to the stages of runs."""
        from numba.core import event
        from numba.core.dispatcher import Dispatcher

        import sppm_pipeline.services.jit.compiling  # noqa: F401 - so that Numba is ready
        from sppm_pipeline.engine.run import runner
        from sppm_pipeline.services.jit.compiled import Kernel
        from sppm_pipeline.services.jit.machine_code import argument_kind, signature_as_json

        calls, open_ones = self, []
        original, original_step = Dispatcher._compile_for_args, runner.run_step
        original_call = Kernel.__call__

        def call(self: Kernel, *args: Any, **named: Any) -> Any:
            return self.dispatcher(*args, **named)  # it is Numba that is listened to

        def compile_for_args(self: Any, *args: Any, **named: Any) -> Any:
            place = f"{self.py_func.__module__}:{self.py_func.__qualname__}"
            before = time.process_time()
            made = original(self, *args, **named)
            seconds = time.process_time() - before
            if not place.startswith("sppm_pipeline."):
                return made
            try:
                signature = [signature_as_json(argument_kind(value)) for value in args]
                if None in signature:
                    raise ValueError(f"kernels are not compiled ahead for {args}")
                getattr(sys.modules[self.py_func.__module__], self.py_func.__qualname__)
            except (ValueError, AttributeError) as error:
                calls.unlisted.add(f"{place}: {error}")
                return made
            entry = calls.found.setdefault(place, {"kernel": place, "seconds": 0.0, "stages": [], "signatures": []})
            if signature not in entry["signatures"]:
                entry["signatures"].append(signature)
                entry["seconds"] += seconds
            if calls._stage not in entry["stages"]:
                entry["stages"].append(calls._stage)
            return made

        def step(step: Any, *args: Any) -> Any:
            if step.owner.builtin and "/" not in step.address:
                calls._stage = step.stage.name
                # By type: isinstance asks a weak proxy of a library for the object behind it, which may be gone.
                for kernel in [o for o in gc.get_objects() if issubclass(type(o), Dispatcher)]:
                    kernel._reset_overloads()  # so that a call from this stage is heard as well
            return original_step(step, *args)

        class Listener(event.Listener):
            def on_start(self, event: Any) -> None:
                open_ones.append([event.data["dispatcher"].py_func, time.process_time(), 0.0])

            def on_end(self, event: Any) -> None:
                function, begun, below = open_ones.pop()
                seconds = time.process_time() - begun
                if open_ones:
                    open_ones[-1][2] += seconds
                cost = calls.costs.setdefault(f"{function.__module__}:{function.__qualname__}", [0, 0.0, 0.0])
                cost[0] += 1
                cost[1] += seconds - below
                cost[2] += seconds

        Dispatcher._compile_for_args, runner.run_step = compile_for_args, step
        Kernel.__call__ = call  # type: ignore[method-assign]
        try:
            with event.install_listener("numba:compile", Listener()):
                yield
        finally:
            Dispatcher._compile_for_args, runner.run_step = original, original_step
            Kernel.__call__ = original_call  # type: ignore[method-assign]


def run_small(name: str, scratch: Path) -> set[str]:
    """Run a configuration; the stages that it has."""
    from sppm_pipeline.engine.config.parameters import Overrides
    from sppm_pipeline.engine.plan.kernels import stages_of
    from sppm_pipeline.engine.plan.session import RunRequest, open_session
    from sppm_pipeline.engine.run.runner import run_plan

    path = scratch / f"{name}.yaml"
    path.write_text((CONFIGS / f"{name}.yaml").read_text(encoding="utf-8").split("\nsweep:")[0], encoding="utf-8")
    parameters, options = SMALL[name]
    overrides = Overrides(tuple(parameters), tuple(options), None)
    plan = open_session(RunRequest(str(path), distributions=False, overrides=overrides)).plan()
    run_plan(plan, scratch / name, threads=1)
    return stages_of(plan)


def listed(names: list[str], scratch: Path) -> tuple[list[dict[str, Any]], Calls]:
    """The entries of the list from some configurations, in the order of the first calls."""
    calls, entries = Calls(), {}
    with calls.heard():
        for name in names:
            before, calls.found = calls.found, {}
            company = run_small(name, scratch)
            for place, new in calls.found.items():
                entry = entries.setdefault(place, {**new, "with": sorted(company)})
                entry["with"] = sorted(company.intersection(entry["with"]))
                entry["stages"] = sorted({*entry["stages"], *new["stages"]})
                fresh = [one for one in new["signatures"] if one not in entry["signatures"]]
                entry["signatures"] = entry["signatures"] + fresh
                entry["seconds"] += new["seconds"] if fresh else 0.0
            calls.found = before
    return [{**entry, "seconds": round(entry["seconds"], 2)} for entry in entries.values()], calls


def main() -> None:
    write, names = "--write" in sys.argv, [name for name in sys.argv[1:] if name != "--write"]
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = str(Path(folder) / "kernels")
        entries, calls = listed(names or list(SMALL), Path(folder))
    rows = [[name, *cost] for name, cost in calls.costs.items()]
    rows.sort(key=lambda row: -row[3])
    table("compiling", ["function", "times", "CPU s alone", "CPU s with those it calls"], rows[:40])
    total = sum(row[2] for row in rows)
    print(f"{sum(row[1] for row in rows)} compilations of {len(rows)} functions, {total:.1f} CPU s")
    for text in sorted(calls.unlisted):
        print(f"not on the list: {text}")
    if write:
        from sppm_pipeline.engine.plan.kernels import LIST

        lines = ",\n".join(json.dumps(entry) for entry in entries)
        LIST.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main()
