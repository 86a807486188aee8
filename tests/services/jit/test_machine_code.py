"""Kept machine code: started without Numba, the same to the byte, and left to Numba where anything does not fit."""

import json
import os
import struct
import subprocess
import sys
import zlib
from typing import NamedTuple

import numba
import numpy as np
import pytest

from sppm_pipeline.services.jit import kernel_signatures, machine_code
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.jit.machine_code import argument_kind, signature_as_json, symbols_of

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

    def run(**environment):
        own = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
        own |= {"NUMBA_CACHE_DIR": str(tmp_path / "kernels"), **environment}
        done = subprocess.run(
            [sys.executable, "calls.py"], cwd=tmp_path, env=own, capture_output=True, text=True, timeout=600
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
    assert signature_as_json(argument_kind(value)) == kernel_signatures.signature_as_json(numba.typeof(value))


def test_a_mapped_file_is_an_array(tmp_path):
    mapped = np.memmap(tmp_path / "values", np.float32, "w+", shape=(2, 3))
    assert signature_as_json(argument_kind(mapped)) == "float32 2 C"
    assert kernel_signatures.signature_as_json(numba.typeof(mapped)) == "float32 2 C"


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
    assert numba.typeof(scaled).dispatcher is scaled.dispatcher
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
