"""Kept machine code: started without Numba, the same to the byte, and left to Numba where anything does not fit."""

import contextlib
import importlib.util
import json
import os
import shutil
import struct
import subprocess
import sys
import zipfile
import zlib
from argparse import Namespace
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest

from sppm_pipeline.engine.cli import installation
from sppm_pipeline.engine.cli.run import _monitor
from sppm_pipeline.services.jit import machine_code
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.jit.compiling import read
from sppm_pipeline.services.jit.linker import symbols_of
from sppm_pipeline.services.jit.machine_code import argument_kind, signature_as_json
from sppm_pipeline.services.private_folder import writers

MODULE = """
from typing import NamedTuple

import numpy as np

from sppm_pipeline.numerics import inline_jit, jit


class Pair(NamedTuple):
    values: np.ndarray
    scale: float


@inline_jit
def _inner(values):
    total = 0.0
    for value in values:
        total += np.sin(value)
    return total


@jit
def several(pair, numbers, flag):
    made = np.empty(numbers.shape[0] + 1, np.float32)
    made[0] = _inner(pair.values) * pair.scale
    made[1:] = numbers[::-1]
    return made, made.sum() > 1, numbers.shape, (2 if flag else 3), -0.0


@jit
def nothing(values, number=4):
    values[0] = number


@jit
def perhaps(values, weights):
    if weights is not None:
        return (values * weights).sum()
    return values.sum()


@jit
def strict(number):
    if number < 0:
        raise ValueError("it must not be negative")
    return np.sqrt(float(number))


@jit
def worded(number):
    if number < 0:
        raise ValueError("it must not be", number)
    return number
"""

CALLS = """
import json, pickle, sys
import numpy as np
import kept

pair = kept.Pair(np.linspace(0, 1, 7), 2.5)
fixed = np.arange(5.0)
fixed.flags.writeable = False
out = []
for numbers in (np.arange(3), fixed, np.arange(12.0)[::2], np.zeros((2, 3, 4), np.int8).T[0, 0]):
    for flag in (True, np.bool_(False)):
        out.append(kept.several(pair, numbers, flag))
box = np.zeros(2)
out.append(kept.nothing(box, 7))
out += [kept.perhaps(np.ones(3), None), kept.perhaps(np.ones(3), np.ones(3))]
out += [box.copy(), kept.strict(4), kept.strict(np.float32(2)), kept.worded(3)]
try:
    kept.strict(-1)
except ValueError as error:
    out.append(error.args)
without = "numba" in sys.modules
kept.nothing(box)
out.append(box.copy())
kept.nothing(box, number=9)
out.append(box.copy())
try:
    kept.strict(2**64)
except OverflowError as error:
    out.append(str(error))
for number in (-3, -4):
    try:
        kept.worded(number)
    except ValueError as error:
        out.append(error.args)
assert pickle.loads(pickle.dumps(kept.strict)) is kept.strict


def text(value):
    if isinstance(value, (tuple, list)):
        return [text(one) for one in value]
    if isinstance(value, np.ndarray):
        return [value.dtype.str, value.shape, value.tobytes().hex()]
    return [type(value).__name__, repr(value)]


print(without)
print(json.dumps(text(out), separators=(",", ":")).replace(" ", "_"))
"""


@pytest.fixture
def program(tmp_path):
    """Runs `CALLS` in a process of its own; whether that has Numba, and all results."""
    (tmp_path / "kept.py").write_text(MODULE)
    (tmp_path / "calls.py").write_text(CALLS)

    def run(script="calls.py", **environment):
        own = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
        own |= {"NUMBA_CACHE_DIR": str(tmp_path / "kernels"), **environment}
        done = subprocess.run(
            [sys.executable, script], cwd=tmp_path, env=own, capture_output=True, text=True, timeout=600
        )
        assert done.returncode == 0, done.stderr
        with_numba, results = done.stdout.split()
        return with_numba == "True", results

    return run


def files(tmp_path, name):
    return sorted((tmp_path / "kernels").rglob(f"{name}-*.code"))


@pytest.mark.skipif(
    not machine_code.usable(), reason="kernels are kept for Linux on x86-64, and versions of Numba that were tried"
)
def test_kept_code_starts_without_numba_and_gives_the_same(program, tmp_path):
    compiled = program()
    assert compiled[0]
    assert len(files(tmp_path, "several")) == 4  # one for each kind of array
    assert not files(tmp_path, "_inner")  # which Python does not call
    assert program() == (False, compiled[1])
    assert program(SPPM_KEPT_KERNELS="off") == compiled
    assert program(NUMBA_OPT="3") == compiled
    damaged, entry, *_ = files(tmp_path, "several")
    cut, (alien, nowhere, *_) = files(tmp_path, "nothing")[0], files(tmp_path, "strict")
    data = damaged.read_bytes()
    damaged.write_bytes(data[:-40] + bytes(40))
    cut.write_bytes(cut.read_bytes()[:30])
    # bits flipped in the names of the entry and of a symbol
    for file, field in ((entry, b'"entry":"'), (files(tmp_path, "worded")[0], b'"symbols":["')):
        data = bytearray(file.read_bytes())
        data[data.index(field) + len(field) + 3] ^= 1
        file.write_bytes(data)
    # an entry that is not there
    write_anew(nowhere, lambda about: about.update(entry="sppm_there_is_no_such_function"))
    assert program() == compiled
    assert program() == (False, compiled[1])  # they were kept anew
    # of all that is kept, one looks for a symbol that nobody has, for which LLVM would end the process
    write_anew(alien, lambda about: about["symbols"].append("sppm_there_is_no_such_function"))
    assert program() == compiled


def write_anew(file, change):
    """Change what is said about machine code."""
    data = file.read_bytes()
    at = len(machine_code._MAGIC)
    (length,) = struct.unpack_from("<I", data, at + 4)
    about = json.loads(data[at + 8 : at + 8 + length])
    change(about)
    head = json.dumps(about).encode()
    whole = struct.pack("<I", len(head)) + head + data[at + 8 + length :]
    file.write_bytes(data[:at] + struct.pack("<I", zlib.crc32(whole)) + whole)


FEW_CALLS = """
import sys
import numpy as np
import kept

box = np.zeros(2)
kept.nothing(box, 7)
results = f"{box[0]},{kept.strict(4)},{kept.worded(3)}"
print("numba" in sys.modules, results)
"""

PRETEND = """
import runpy
import llvmlite.binding as llvm

real = llvm.get_host_cpu_features()
real.update({"avx512f": True, "avx512vl": True, "avx512bw": True, "avx512dq": True, "prefer-256-bit": True})
llvm.get_host_cpu_name, llvm.get_host_cpu_features = lambda: "skylake-avx512", lambda: real
runpy.run_path("calls.py", run_name="__main__")
"""

OTHERS_FIRST = """
import numba
import numpy as np
import kept
from sppm_pipeline.services.jit import machine_code

numba.njit(lambda number: number + 1)(2)
kept.nothing(np.zeros(2), 7)
print("numba" in __import__("sys").modules, machine_code.target() + "," + str(numba.config.CPU_NAME))
"""


@pytest.fixture
def wheels():
    """The script that makes the distribution of machine code."""
    script = Path(__file__).parents[3] / ".ci" / "kernels.py"
    spec = importlib.util.spec_from_file_location("ci_kernels", script)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.skipif(
    not machine_code.usable() or machine_code.target() == "native", reason="machine code is made for x86-64-v3 on Linux"
)
def test_machine_code_from_a_distribution(program, wheels, tmp_path):
    """Started without Numba, whatever the processor; what does not fit is compiled here."""
    (tmp_path / "calls.py").write_text(FEW_CALLS)
    (tmp_path / "pretend.py").write_text(PRETEND)
    site, shipped = tmp_path / "site", tmp_path / "site" / machine_code.SHIPPED

    def kept():
        return {path.name: path.read_bytes() for path in (tmp_path / "kernels").rglob("*.code")}

    def fresh(script="calls.py", **environment):
        shutil.rmtree(tmp_path / "kernels", ignore_errors=True)
        path = os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])
        return program(script, PYTHONPATH=path, PYTHONHASHSEED="0", **environment)

    compiled, made = fresh(), kept()
    assert compiled[0]
    assert len(made) == 3
    assert fresh("pretend.py") == compiled
    assert kept() == made
    wheel = wheels.packed(tmp_path / "dist", made, "1.0")
    assert wheels.packed(tmp_path / "again", dict(reversed(made.items())), "1.0").read_bytes() == wheel.read_bytes()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
        listed = archive.read("sppm_kernels-1.0.dist-info/RECORD").decode()
    assert sorted(line.split(",")[0] for line in listed.splitlines()) == sorted(archive.namelist())
    shipped.chmod(0o755)
    (damaged,) = shipped.glob("worded-*.code")
    damaged.chmod(0o644)
    assert fresh() == (False, compiled[1])
    assert not kept()
    assert fresh(SPPM_TARGET="native") == compiled
    assert kept().keys().isdisjoint(made)
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    assert fresh() == compiled
    assert list(kept()) == [damaged.name]
    assert program(PYTHONPATH=f"{site}{os.pathsep}{os.environ.get('PYTHONPATH', '')}") == (False, compiled[1])
    damaged.write_bytes(whole)
    damaged.chmod(0o666)
    assert fresh() == compiled
    assert list(kept()) == [damaged.name]
    damaged.chmod(0o644)
    shipped.chmod(0o777)
    assert fresh() == compiled
    assert kept().keys() == made.keys()
    shipped.chmod(0o755)
    (tmp_path / "kept.py").write_text(f"{MODULE}# edited\n")
    assert fresh() == compiled
    assert kept().keys().isdisjoint(made)


def test_another_package_that_compiles_first_has_numba_compile_for_this_processor(program, tmp_path):
    (tmp_path / "others_first.py").write_text(OTHERS_FIRST)
    assert program("others_first.py") == (True, "native,None")


def test_refused_machine_code_is_named(tmp_path, monkeypatch, capsys):
    """By runs and by `sppm doctor`."""
    good, bad, open_ = (tmp_path / f"{name}.code" for name in ("good", "bad", "open"))
    whole = struct.pack("<I", 2) + b"{}" + b"code"
    good.write_bytes(machine_code._MAGIC + struct.pack("<I", zlib.crc32(whole)) + whole)
    bad.write_bytes(good.read_bytes()[:-1])
    open_.write_bytes(good.read_bytes())
    open_.chmod(0o666)
    monkeypatch.setattr(machine_code, "refused", {})
    monkeypatch.setattr(machine_code, "shipped", lambda: str(tmp_path))
    found = {(ok, text) for ok, _, text in installation._shipped_kernels()}
    assert found == {
        (True, f"{tmp_path}: 3 kernels"),
        (False, f"{bad} is not used: it is damaged"),
        (False, f"{open_} is not used: other users may write to it (mode 666)"),
    }
    assert machine_code.read(str(good)) == ({}, b"code")
    assert machine_code.read(str(tmp_path / "none.code")) is None
    with contextlib.ExitStack() as stack:
        _monitor(Namespace(log=None, verbose=False, quiet=False), stack)
    assert f"{bad} is not used, its kernels are compiled here: it is damaged" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="has no such owners")
def test_files_of_other_users_are_refused():
    about = os.stat_result((0o644, 0, 0, 1, os.geteuid() + 4321, 0, 0, 0, 0, 0))
    assert writers(about) == f"it belongs to the user {os.geteuid() + 4321}"


@pytest.mark.parametrize(
    ("flags", "environment", "wanted"),
    [
        ("fma avx avx2 bmi1 bmi2 f16c abm movbe xsave avx512f", {}, "x86-64-v3"),
        ("fma avx bmi1 bmi2 f16c abm movbe xsave", {}, "native"),
        ("fma avx avx2 bmi1 bmi2 f16c abm movbe xsave", {"SPPM_TARGET": "Native"}, "native"),
        ("fma avx avx2 bmi1 bmi2 f16c abm movbe xsave", {"NUMBA_CPU_NAME": "znver3"}, "native"),
    ],
)
def test_what_kernels_are_compiled_for(flags, environment, wanted, tmp_path, monkeypatch):
    (tmp_path / "cpuinfo").write_text(f"model name\t: A\nflags\t\t: fpu {flags} sse\n\nflags\t: none\n")
    monkeypatch.setattr(machine_code, "_CPUINFO", str(tmp_path / "cpuinfo"))
    monkeypatch.delenv("SPPM_TARGET", raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert machine_code.target.__wrapped__() == wanted


def test_nothing_half_written_stays_on_a_full_disk(tmp_path, monkeypatch):
    def full(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(machine_code, "_place_of", lambda function, kinds: ("", "kernel.code"))
    monkeypatch.setattr(machine_code, "_of", lambda function: [])
    monkeypatch.setattr(machine_code, "kernel_cache_folder", lambda source: str(tmp_path))
    monkeypatch.setattr(machine_code, "symbols_of", lambda data: ([], set()))
    monkeypatch.setattr(machine_code.os, "replace", full)
    machine_code.keep(full, [], machine_code.Code("entry", "environment", {"environment": []}, b"code"))
    assert list(tmp_path.iterdir()) == []


class Box(NamedTuple):
    values: np.ndarray
    size: int


def frozen(array):
    array.flags.writeable = False
    return array


@pytest.mark.parametrize(
    "value",
    [
        3, -(2**62), True, 2.5, np.float32(1), np.uint8(3), np.bool_(True), np.zeros(3), frozen(np.zeros(3)), None,
        np.zeros((2, 2), np.uint8).T, np.zeros((2, 2, 4), bool)[..., ::2], np.zeros(()), np.zeros((0, 3), np.int16),
        np.zeros((1, 1, 1)), (1, 2), (1, (None, 2.5)), (1, (np.zeros(1), 2.5)), Box(np.zeros((2, 3), np.uint64), 4),
    ],
)  # fmt: skip
def test_kinds_are_those_of_numba(value):
    assert read(signature_as_json(argument_kind(value))) == numba.typeof(value)


def test_a_mapped_file_is_an_array(tmp_path):
    mapped = np.memmap(tmp_path / "values", np.float32, "w+", shape=(2, 3))
    assert signature_as_json(argument_kind(mapped)) == "float32 2 C"
    assert read("float32 2 C") == numba.typeof(mapped)


@pytest.mark.parametrize(
    "value",
    [
        "text", [1, 2], 2**63, ("text", 1), np.zeros(2, ">f8"), np.zeros(2, "f4,i4"), np.zeros(2, complex), 1j,
        np.zeros(17, np.uint8)[1:].view(np.float64), np.ma.zeros(3), np.zeros(2, "M8[s]"), {1: 2},
    ],
)  # fmt: skip
def test_other_kinds_are_left_to_numba(value):
    assert signature_as_json(argument_kind(value)) is None


def test_arrays_that_numba_tells_apart_are_told_apart():
    base = np.zeros((4, 4))
    kinds = [argument_kind(a) for a in (base, frozen(base.copy()), base.T, base[::2], base[0], base.astype(np.float32))]
    assert len(set(kinds)) == len(kinds)


def test_a_kernel_still_is_a_function_that_can_be_looked_at():
    @jit
    def scaled(values, factor=2.0):
        """What it does."""
        return values * factor

    assert scaled.__doc__ == "What it does."
    assert scaled.py_func(3) == 6
    assert scaled(np.ones(2)).tolist() == [2, 2]
    assert scaled(np.ones(2), factor=3.0).tolist() == [3, 3]
    assert numba.typeof(scaled).dispatcher.py_func is scaled.py_func
    assert len(scaled.signatures) == 2


def test_object_files_of_others_are_not_read():
    assert symbols_of(b"\xcf\xfa\xed\xfe" + bytes(100)) is None


@pytest.mark.parametrize(("version", "fits"), [("0.68.0", True), ("0.68.1", True), ("0.69.0", False), ("", False)])
def test_versions_of_numba_that_were_not_tried_start_their_code_themselves(version, fits, monkeypatch):
    monkeypatch.setattr(machine_code, "_version", lambda: version)
    for name in [name for name in os.environ if name.startswith("NUMBA_")]:
        monkeypatch.delenv(name)
    here = sys.platform == "linux" and os.uname().machine == "x86_64"
    why = machine_code.reason_unavailable.__wrapped__()
    assert why == (
        "" if fits and here else f"not tried with Numba {version}" if here else "tried on Linux on x86-64 only"
    )


@pytest.mark.skipif(sys.platform != "linux" or os.uname().machine != "x86_64", reason="says so before it looks further")
@pytest.mark.parametrize(
    ("name", "value", "why"),
    [("SPPM_KEPT_KERNELS", "OFF", "SPPM_KEPT_KERNELS=off"), ("NUMBA_BOUNDSCHECK", "1", "NUMBA_BOUNDSCHECK is set")],
)
def test_settings_of_others_leave_kernels_to_numba(name, value, why, monkeypatch):
    monkeypatch.setenv(name, value)
    assert machine_code.reason_unavailable.__wrapped__() == why


def test_the_version_is_that_of_numba():
    assert machine_code._version() == numba.__version__


def test_functions_that_are_made_anew_in_each_process_are_not_kept():
    def made(held):
        def kernel(value):
            return value + held

        kernel.__qualname__ = "kernel"
        return kernel

    def plain(value):
        return value

    assert machine_code._place_of(made(1), ["int64"]) is None
    assert machine_code._place_of(plain, ["int64"]) is None  # of a function, which may be another one each time
    plain.__qualname__ = "plain"
    assert machine_code._place_of(plain, ["int64"])[1].endswith(".code")
