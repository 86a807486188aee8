"""Evil functions: each ends as the fitting error, soon, and nothing of it is left."""

from __future__ import annotations

import signal
import threading
import time

import numpy as np
import pytest

from sppm_pipeline.engine.process import native, stop_all
from sppm_pipeline.errors import NativeCrash, PluginError, ResourceError


@pytest.mark.parametrize("name", ["SIGSEGV", "SIGABRT", "SIGFPE", "SIGILL", "SIGBUS", "SIGTERM"])
def test_signals_are_named(call, name):
    with pytest.raises(NativeCrash) as caught:
        call("die", {"signal": int(signal.Signals[name])})
    error = caught.value
    assert error.exit_code == 6
    assert error.message.startswith(f"numpy {np.__version__} died by {name} (")
    assert "in step 'close holes'" in error.message
    assert error.message.endswith("its output: a last word")
    assert error.hint


def test_segmentation_fault(call):
    with pytest.raises(NativeCrash, match=r"SIGSEGV \(segmentation fault\) in step 'read the mesh'") as caught:
        call("segfault", hint="repair the mesh")
    assert caught.value.hint == "repair the mesh"


def test_killed_from_outside_counts_as_memory_used_up(call):
    with pytest.raises(ResourceError, match="SIGKILL"):
        call("die", {"signal": int(signal.SIGKILL)})


@pytest.mark.parametrize("name", ["loop", "loop_with_lock", "stop_itself"])
def test_time_limit(call, name):
    with pytest.raises(ResourceError, match=r"used up its 0\.7 s"):
        call(name, seconds=0.7)


@pytest.mark.parametrize("then", ["return", "crash", "hang"])
def test_no_descendant_is_left(call, tmp_path, gone, noted, then):
    note = tmp_path / "note"
    options = {"note": str(note), "then": then}
    if then == "return":
        call("descendants", options)
    elif then == "crash":
        with pytest.raises(NativeCrash):
            call("descendants", options)
    else:
        stopper = threading.Thread(target=lambda: (noted(note), stop_all()))
        stopper.start()
        with pytest.raises(ResourceError, match="interrupted"):
            call("descendants", options)
        stopper.join()
    pids = noted(note)
    assert len(set(pids)) == 5
    assert gone(pids, 0.1), "all are gone before the call returns"


def test_memory_limit(call):
    with pytest.raises(ResourceError, match=r"ran out of memory; its limit was 0\.25 GiB in step 'fill memory'"):
        call("hog", memory=2**28)


def test_memory_limit_of_processes_that_it_starts(call):
    assert call("hog_in_a_child", memory=2**28).values == {"error": "MemoryError"}


@pytest.mark.parametrize("words", ["terminate called after throwing an instance of 'std::bad_alloc'", "Out of memory"])
def test_libraries_that_abort_without_memory(call, words):
    with pytest.raises(ResourceError, match="ran out of memory"):
        call("abort", {"words": words})
    with pytest.raises(NativeCrash, match="SIGABRT"):
        call("abort", {"words": "assertion failed"})


@pytest.mark.parametrize("code", [0, 3])
def test_leaving(call, code):
    with pytest.raises(PluginError, match=rf"called sys.exit\({code}\)"):
        call("leave", {"code": code})
    with pytest.raises(PluginError, match=f"ended with exit code {code} without a result"):
        call("leave_at_once", {"code": code})


def test_a_gigabyte_of_output_is_swallowed(call):
    with pytest.raises(NativeCrash) as caught:
        call("talk", {"blocks": 500}, seconds=60)
    lines = caught.value.message.splitlines()
    assert len(lines) < 10
    assert lines[-2].endswith("the end?")
    assert max(map(len, lines)) < 200
    assert all(line.isprintable() for line in lines)


@pytest.mark.parametrize(
    "name", ["litter", "lose_signal_handlers", "close_everything", "delete_working_folder", "junk_in_the_pipe"]
)
def test_harmless_evil_gives_its_result(call, name, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    before = signal.getsignal(signal.SIGINT)
    assert call(name).arrays["x"].shape == (3,)
    assert not list((tmp_path / "here").iterdir())
    assert signal.getsignal(signal.SIGINT) is before


def test_a_lost_folder_is_a_lost_result(call):
    with pytest.raises(PluginError, match="without a result"):
        call("delete_private_folder")


def test_a_killed_supervisor_is_no_hang(call):
    with pytest.raises(PluginError, match="ended without a result"):
        call("kill_the_supervisor")


def test_other_threads_are_stopped(call):
    raised = []

    def work():
        try:
            call("loop")
        except ResourceError as error:
            raised.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    until = time.monotonic() + 60
    while not native._running and time.monotonic() < until:
        time.sleep(0.01)
    stop_all()
    thread.join(60)
    assert not thread.is_alive()
    assert "interrupted" in raised[0].message
    assert not native._running
    assert call("echo", arrays={"x": np.zeros(3)}).values == {}
