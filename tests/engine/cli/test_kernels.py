"""Compiling ahead: the list of kernels, what a plan needs of it, and the child processes."""

from __future__ import annotations

import importlib
import inspect
import io
import multiprocessing
import operator
import re
import subprocess
import sys
import threading
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core import types

from sppm_pipeline.engine.cli.kernels import _why, compile_apart, compile_first
from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.cli.progress import ProgressLines
from sppm_pipeline.engine.plan.kernels import Kernel, kernels_of, listed_kernels, missing, stages_of
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.method.sampling.cell_list import CellList
from sppm_pipeline.services.jit import kernel_cache
from sppm_pipeline.services.jit.compiling import read
from sppm_pipeline.services.jit.machine_code import argument_kind, signature_as_json, usable

CONFIGS = Path(__file__).parents[3] / "configs"
SORT = "sppm_pipeline.services.mesh.measures:_insertion_sort"


def frozen(array):
    array.flags.writeable = False
    return array


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (3, "int64"),
        (True, "bool"),
        (np.float32(1), "float32"),
        (np.zeros((2, 2), np.uint8).T, "uint8 2 F"),
        (np.zeros((2, 2, 4), bool)[..., ::2], "bool 3 A"),
        (frozen(np.zeros(3)), "float64 1 C readonly"),
        ((1, 2), ["", "int64", "int64"]),
        ((1, (np.zeros(1), 2.5)), ["", "int64", ["", "float64 1 C", "float64"]]),
        (
            CellList(*[np.zeros(1)] * 9, 0.5),
            ["sppm_pipeline.method.sampling.cell_list.CellList", *["float64 1 C"] * 9, "float64"],
        ),
    ],
)
def test_types_survive_being_written(value, text):
    assert signature_as_json(argument_kind(value)) == text
    assert read(text) == numba.typeof(value)


def test_what_kernels_do_not_take_is_refused():
    with pytest.raises(ValueError, match="there is no number 'int65'"):
        read("int65 1 C")


def test_every_kernel_of_the_list_is_there_and_takes_what_is_listed():
    kernels = listed_kernels()
    assert len(kernels) > 40
    assert len({k.place for k in kernels}) == len(kernels)
    for kernel in kernels:
        module, _, name = kernel.place.partition(":")
        parameters = inspect.signature(getattr(importlib.import_module(module), name).py_func).parameters
        assert kernel.signatures
        assert kernel.stages
        for signature in kernel.signatures:
            assert len(signature) == len(parameters), kernel.place
            assert all(isinstance(read(kind), types.Type) for kind in signature)


def test_a_plan_gets_the_kernels_of_its_stages_in_company_they_were_seen_in():
    one = Kernel("m:one", 1, ("write.png", "write.mesh"), ("field.gaussian",), [])
    other = Kernel("m:other", 1, ("write.png",), ("field.tpms", "write.png"), [])
    assert kernels_of({"field.gaussian", "write.png"}, [one, other]) == [one]
    assert kernels_of({"field.tpms", "field.gaussian", "write.png"}, [one, other]) == [one, other]
    assert kernels_of({"field.gaussian", "read.mesh"}, [one, other]) == []


@pytest.fixture
def empty(tmp_path, monkeypatch):
    """Nothing is compiled yet."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    kernel_cache.kernel_cache_root.cache_clear()
    yield
    monkeypatch.undo()
    kernel_cache.kernel_cache_root.cache_clear()


CALL = """
import sys
import numpy as np
from sppm_pipeline.services.mesh.measures import _insertion_sort
_insertion_sort(np.zeros(3, np.uint64))
print("numba" in sys.modules)
print(dict(_insertion_sort.stats.cache_misses), len(_insertion_sort.stats.cache_hits))
"""


class Told:
    """What was told of compiling."""

    def __init__(self):
        self.numbers, self.failed = [], []

    def compiling(self, *numbers):
        self.numbers.append(numbers)

    def not_compiled(self, *why):
        self.failed.append(why)


def test_children_compile_what_a_later_process_finds(empty, monkeypatch):
    good = next(k for k in listed_kernels() if k.place == SORT)._replace(seconds=3.0)
    gone = Kernel("sppm_pipeline.services.mesh.measures:_no_more", 1.0, ("write.png",), (), [["int64"]])
    assert missing([good]) == [good]
    told = Told()
    compile_apart([gone, good], told, 1)
    # shares of the time that they take, the longest first; the second may end before the first was reported
    assert told.numbers in ([(0, 2, 0.0), (1, 2, 0.75), (2, 2, 1.0)], [(0, 2, 0.0), (2, 2, 1.0)])
    assert [(place, "_no_more" in why, "\n" in why) for place, why in told.failed] == [(gone.place, True, False)]
    deadline = time.monotonic() + 60
    while multiprocessing.active_children() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not multiprocessing.active_children()
    assert missing([good]) == []
    by_numba = ["True", "{}", "1"]
    for switch, expected in (("on", ["False", "{}", "0"] if usable() else by_numba), ("off", by_numba)):
        monkeypatch.setenv("SPPM_KEPT_KERNELS", switch)
        found = subprocess.run([sys.executable, "-c", CALL], capture_output=True, text=True, check=True)
        assert found.stdout.split() == expected


def test_doctor_compiles_what_is_missing(empty, monkeypatch, capsys):
    one = [k for k in listed_kernels() if k.place.endswith("encoding:_largest_bits")]
    monkeypatch.setattr("sppm_pipeline.engine.plan.kernels.listed_kernels", lambda: one)
    monkeypatch.setattr("sppm_pipeline.services.jit.machine_code.reason_unavailable", lambda: "")
    main(["doctor"])
    assert "empty; 1 of 1 that are common are not, which `sppm doctor --kernels` compiles" in capsys.readouterr().out
    main(["doctor", "--kernels"])
    found = capsys.readouterr().out
    assert "1 kernels compiled" in found
    assert "that are common are not" not in found
    assert missing(one) == []
    assert "Numba starts them" not in found
    place = "sppm_pipeline.services.jit.machine_code.reason_unavailable"
    monkeypatch.setattr(place, lambda: "not tried with Numba 0.99")
    main(["doctor"])
    assert "; Numba starts them (not tried with Numba 0.99), which takes longer" in capsys.readouterr().out
    one[0] = one[0]._replace(place=one[0].place + "_no_more")
    assert main(["doctor", "--kernels"]) == 1
    assert re.search(r"BAD +kernel +\S+_largest_bits_no_more: AttributeError", capsys.readouterr().out)


def test_what_children_could_not_compile_is_told_to_those_who_want_to_know(cell_plan, monkeypatch):
    monkeypatch.setattr("sppm_pipeline.engine.cli.kernels._compile", operator.truediv)  # raises in the child
    stream, log = io.StringIO(), io.StringIO()
    lines = ProgressLines(stream, quiet=True, log=log)
    compile_first(cell_plan, lines, 2)
    lines.close()
    said = [line for line in log.getvalue().splitlines() if "not compiled: sppm_pipeline." in line]
    assert len(said) == len(missing(kernels_of(stages_of(cell_plan), listed_kernels()))) > 10
    assert all(": TypeError: unsupported operand" in line for line in said)
    assert stream.getvalue() == ""
    assert _why(BrokenProcessPool("about the pool")) == "a compiling process died"


@pytest.fixture
def cell_plan(monkeypatch):
    """A plan of which much is on the list, and nothing kept."""
    monkeypatch.delenv("SPPM_COMPILE_AHEAD")
    monkeypatch.setattr("sppm_pipeline.engine.plan.kernels.is_kept", lambda place, count: False)
    return open_session(RunRequest(str(CONFIGS / "cell.yaml"), distributions=False)).plan()


def test_a_system_without_child_processes_runs_without_them(cell_plan, monkeypatch):
    def refuse(*args, **options):
        raise NotImplementedError("no semaphores")

    monkeypatch.setattr("concurrent.futures.ProcessPoolExecutor", refuse)
    told = Told()
    compile_first(cell_plan, told, 2)
    assert told.numbers == told.failed == []


def test_what_a_plan_needs_is_compiled_unless_it_is_switched_off(cell_plan, monkeypatch):
    begun = []
    monkeypatch.setattr("sppm_pipeline.engine.cli.kernels.compile_apart", lambda *given: begun.append(given))
    told = Told()
    compile_first(cell_plan, told, 1)  # which would have nothing to share
    assert begun == []
    compile_first(cell_plan, told, 4)
    ((kernels, progress, processes),) = begun
    assert (progress, processes) == (told, 4)
    assert {"sample.dart_throwing", "connect.mbdst"} <= {stage for k in kernels for stage in k.stages}
    monkeypatch.setenv("SPPM_COMPILE_AHEAD", "off")
    compile_first(cell_plan, told, 4)
    assert len(begun) == 1


def test_nothing_is_compiled_ahead_that_nobody_would_find(monkeypatch):
    monkeypatch.setattr("sppm_pipeline.engine.plan.kernels.kernel_cache_lasts", lambda: False)
    assert missing(listed_kernels()) == []


def test_one_process_at_a_time_saves_kernels_of_a_module(tmp_path):
    order = []

    def second():
        with kernel_cache.saving(tmp_path):
            order.append("second")

    thread = threading.Thread(target=second)
    with kernel_cache.saving(tmp_path):
        thread.start()
        time.sleep(0.1)
        order.append("first")
    thread.join()
    assert order == ["first", "second"]
