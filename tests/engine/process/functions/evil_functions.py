"""Functions for the child: a few good ones, and all that native code has ever done to its caller."""

from __future__ import annotations

import collections
import ctypes
import itertools
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from sppm_pipeline import errors
from sppm_pipeline.engine.process import exchange, notify

X = {"x": np.zeros(3)}


def echo(arrays, options):
    return dict(arrays), dict(options)


def surroundings(arrays, options):
    here = Path.cwd()
    names = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "TMPDIR", "LC_ALL")
    values = {name: os.environ[name] for name in names}
    handler = signal.getsignal(signal.SIGPIPE) is not None
    numbers = {"session": os.getsid(0), "group": os.getpgid(0), "mode": here.parent.stat().st_mode & 0o777}
    return X, values | numbers | {"folder": str(here), "files": os.listdir(), "path": sys.path, "handler": handler}


def steps(arrays, options):
    for i in range(5):
        notify("count", i + 1, 5)
    notify("rest")
    return X, {}


def die(arrays, options):
    notify(options.get("step", "close holes"), 1e300, 1.1e300)
    print("a last word")
    sys.stdout.flush()
    os.kill(os.getpid(), options["signal"])
    time.sleep(60)


def segfault(arrays, options):
    notify("read the mesh", 1, 2)
    ctypes.string_at(8)


def abort(arrays, options):
    os.write(2, options.get("words", "").encode())
    os.abort()


def loop(arrays, options):
    notify("loop")
    while True:
        pass


def loop_with_lock(arrays, options):
    """As a loop in C does: no other thread of this process runs any more, and no signal handler."""
    collections.deque(itertools.repeat(None), maxlen=0)


def stop_itself(arrays, options):
    os.kill(os.getpid(), signal.SIGSTOP)


def descendants(arrays, options):
    """A child, a child in a session of its own, and an orphan in another session; then what `options` say."""
    pids = [os.getpid(), os.getppid()]
    pids.append(subprocess.Popen(["sleep", "300"]).pid)
    pids.append(subprocess.Popen(["sleep", "300"], start_new_session=True).pid)
    orphan = "import subprocess; print(subprocess.Popen(['sleep', '300'], start_new_session=True).pid, flush=True)"
    started = subprocess.Popen([sys.executable, "-c", orphan], stdout=subprocess.PIPE, text=True)
    pids.append(int(started.stdout.readline()))
    part = Path(options["note"] + ".part")
    part.write_text(" ".join(map(str, pids)), encoding="utf-8")
    part.rename(options["note"])
    if options["then"] == "hang":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        loop_with_lock(arrays, options)
    if options["then"] == "crash":
        os.abort()
    return X, {}


def hog(arrays, options):
    notify("fill memory")
    kept = [np.ones(2**23) for _ in range(10**6)]
    return X, {"kept": len(kept)}


def hog_in_a_child(arrays, options):
    code = "x = [b'1' * 2**26 for _ in range(10**4)]"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    return X, {"error": done.stderr.splitlines()[-1]}


def leave(arrays, options):
    sys.exit(options["code"])


def leave_at_once(arrays, options):
    os._exit(options["code"])


def talk(arrays, options):
    block = b"\x1b[31mred\r\xff" * 2**17
    for _ in range(options["blocks"]):
        os.write(1, block)
        os.write(2, block)
    os.write(2, b"\nthe end\x07\n" + b"w" * 5000 + b"\n")
    os.abort()


def litter(arrays, options):
    Path("__tracked_surface.stl").write_text("junk", encoding="utf-8")
    Path("folder").mkdir()
    Path("folder", "file").write_text("junk", encoding="utf-8")
    Path("folder").chmod(0)
    return X, {}


def lose_signal_handlers(arrays, options):
    ctypes.pythonapi.PyOS_setsig.restype = ctypes.c_void_p
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGCHLD, signal.SIGPIPE):
        ctypes.pythonapi.PyOS_setsig(number, ctypes.c_void_p(0))
    return X, {}


def close_everything(arrays, options):
    os.closerange(0, 64)
    notify("nobody hears this", 1, 1)
    return X, {}


def delete_working_folder(arrays, options):
    shutil.rmtree(Path.cwd())
    return X, {}


def delete_private_folder(arrays, options):
    shutil.rmtree(Path.cwd().parent)
    return X, {}


def junk_in_the_pipe(arrays, options):
    for line in (
        b"\xff\n",
        b"[1, 2, 3]\n",
        b'["a", NaN, 1]\n',
        b'["a"]\n',
        b"{}\n",
        b"[" * 100_000 + b"\n",
        b"x" * 99_999,
    ):
        os.write(exchange._channel, line)
    return X, {}


def kill_the_supervisor(arrays, options):
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(60)


def give(arrays, options):
    return {
        "nothing": None,
        "one dict": X,
        "a list": ({"x": [1.0, 2.0, 3.0]}, {}),
        "objects": ({"x": np.array([None, 1, 2])}, {}),
        "float32": ({"x": np.zeros(3, np.float32)}, {}),
        "shape": ({"x": np.zeros((3, 1))}, {}),
        "length": ({"x": np.zeros(4)}, {}),
        "nan": ({"x": np.array([1.0, np.nan, np.inf])}, {}),
        "missing": ({}, {}),
        "too many": (X | {"y": np.zeros(3)}, {}),
        "no JSON": (X, {"a": object()}),
        "nan value": (X, {"a": float("nan")}),
    }[options["what"]]


def raise_(arrays, options):
    class Own(errors.DesignError):
        pass

    first = errors.ConfigError("first")
    raise {
        "ValueError": ValueError("no such option"),
        "InputError": errors.InputError("the mesh is flat", hint="thicken it"),
        "own": Own("not this one", hint="but that one"),
        "several": errors.ConfigErrors([first, first]),
        "KeyboardInterrupt": KeyboardInterrupt(),
        "long": RuntimeError("x" * 10**6),
        "module": ModuleNotFoundError("No module named 'pymeshlab'", name="pymeshlab"),
    }[options["what"]]
