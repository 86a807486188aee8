"""A well-behaved function: what it takes, what it may return, what it reports."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

from sppm_pipeline import errors
from sppm_pipeline.engine.process import ArraySpec, notify, run_native
from sppm_pipeline.errors import ConfigError, DesignError, InputError, PluginError, SppmError


def test_arrays_and_values_come_back_as_they_were(call, numbers):
    options = {"text": "µ", "list": [1, 2.5, None, True], "map": {"a": {}}}
    returns = {name: ArraySpec(str(array.dtype), (None,) * array.ndim) for name, array in numbers.items()}
    result = call("echo", options, arrays=numbers, returns=returns)
    assert result.values == options
    assert result.arrays.keys() == numbers.keys()
    for name, array in numbers.items():
        assert result.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(result.arrays[name], array)
        result.arrays[name][...] = 0  # ours, not a view of a file


def test_the_child_is_alone(call, temporary, monkeypatch):
    monkeypatch.setenv("LC_ALL", "de_DE.UTF-8")
    values = call("surroundings", threads=3).values
    folder = Path(values["folder"])
    assert folder.is_relative_to(temporary)
    assert values["mode"] == 0o700
    assert values["files"] == []
    assert values["TMPDIR"] == str(folder)
    assert values["OMP_NUM_THREADS"] == values["NUMBA_NUM_THREADS"] == "3"
    assert values["LC_ALL"] == "C.UTF-8"
    assert values["session"] != os.getsid(0)
    assert values["group"] != values["session"]
    assert not {str(folder), ""} & set(values["path"])
    assert os.environ["LC_ALL"] == "de_DE.UTF-8"


def test_progress_is_reported(call):
    told = []
    call("steps", progress=lambda *words: told.append(words))
    assert told == [(float(i), 5.0, "count") for i in range(1, 6)]


def test_long_names_of_steps_are_cut(call):
    with pytest.raises(errors.NativeCrash, match=rf"in step '{'🧊' * 36}'"):
        call("die", {"signal": 6, "step": "🧊" * 1000})


def test_notifying_outside_of_a_child_does_nothing():
    notify("anything", 1, 2)


def test_an_error_of_the_callback_ends_the_child(call):
    def refuse(*words):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        call("steps", progress=refuse)


def test_junk_in_the_pipe_is_skipped(call):
    told = []
    call("junk_in_the_pipe", progress=lambda *words: told.append(words))
    assert told == []


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("nothing", "returned None"),
        ("one dict", "must return a dict of arrays and a dict of values"),
        ("a list", "'x' must be an array of numbers, got a list"),
        ("objects", "an array of object"),
        ("float32", r"'x' is float32 of shape \(3,\), expected float64 of shape \(3\)"),
        ("shape", r"of shape \(3, 1\)"),
        ("length", r"of shape \(4,\)"),
        ("nan", "2 values that are not finite"),
        ("missing", r"must return the arrays \['x'\], returned \[\]"),
        ("too many", r"returned \['x', 'y'\]"),
        ("no JSON", "not JSON serializable"),
        ("nan value", "not JSON compliant"),
    ],
)
def test_what_was_not_specified_is_refused(call, what, words):
    with pytest.raises(PluginError, match=words) as caught:
        call("give", {"what": what})
    assert f"numpy {np.__version__} " in caught.value.message


def test_complex_numbers_are_to_be_finite_as_well():
    assert (
        ArraySpec("complex128", (2,)).problem(np.array([1, complex(0, np.inf)])) == "has 1 values that are not finite"
    )
    assert ArraySpec("complex128", (None,)).problem(np.array([1, 1j])) is None


@pytest.mark.parametrize(
    ("what", "kind", "message", "hint"),
    [
        ("InputError", InputError, "the mesh is flat", "thicken it"),
        ("own", DesignError, "not this one", "but that one"),
        ("several", ConfigError, "2 error(s)", None),
    ],
)
def test_our_own_errors_pass(call, what, kind, message, hint):
    with pytest.raises(SppmError) as caught:
        call("raise_", {"what": what})
    assert type(caught.value) is kind
    assert (caught.value.message, caught.value.hint) == (message, hint)


@pytest.mark.parametrize("what", ["ValueError", "KeyboardInterrupt", "long"])
def test_other_errors_name_the_distribution(call, what):
    with pytest.raises(PluginError, match=rf"numpy {np.__version__} raised \w+: ") as caught:
        call("raise_", {"what": what}, hint="try again")
    assert caught.value.hint == "try again"
    assert len(caught.value.message) < 5000


def test_a_missing_module_is_named(call):
    with pytest.raises(PluginError, match="'pymeshlab', which can't be imported") as caught:
        call("raise_", {"what": "module"})
    assert "pip install numpy" in caught.value.hint


def test_unknown_functions_and_distributions(call):
    with pytest.raises(PluginError, match="AttributeError"):
        call("there_is_none")
    with pytest.raises(PluginError, match=r"^no-such-distribution raised ValueError"):
        call("raise_", {"what": "ValueError"}, distribution="no-such-distribution")


@pytest.mark.parametrize(
    "change",
    [
        {"function": "json"},
        {"function": "json:dumps; import os"},
        {"function": "json.:dumps"},
        {"seconds": 0},
        {"seconds": float("inf")},
        {"seconds": float("nan")},
        {"memory": 0},
        {"options": {"a": object()}},
        {"options": {"a": float("nan")}},
        {"arrays": {"a": [1]}},
        {"arrays": {"a": np.array(["text"])}},
        {"arrays": {"../a": np.zeros(3)}},
    ],
    ids=lambda change: re.sub(r" at 0x\w+", "", str(change)),
)
def test_calls_that_make_no_sense(change, temporary):
    call = {"function": "json:dumps", "arrays": {}, "options": {}, "returns": {}, "distribution": "numpy", "seconds": 5}
    with pytest.raises(ValueError):
        run_native(**(call | change))
    assert not list(temporary.iterdir())


def test_a_full_disk_or_no_process_is_a_lack_of_resources(call, monkeypatch):
    monkeypatch.setattr("sys.executable", "/nowhere/python")
    with pytest.raises(errors.ResourceError, match="No such file"):
        call("echo")
