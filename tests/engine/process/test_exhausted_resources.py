"""Which errors say that a resource of the machine is exhausted, and clearing up when nearly all are."""

from __future__ import annotations

import contextlib
import errno
import os
import resource
import sys

import pytest

from sppm_pipeline.engine.cli import main as cli
from sppm_pipeline.engine.files import clear
from sppm_pipeline.engine.process.budget import exhausted_resource


def chained(error: Exception, cause: Exception) -> Exception:
    error.__cause__ = cause
    return error


EMFILE = os.strerror(errno.EMFILE)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MemoryError(), "not enough memory"),
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "place"), f"{os.strerror(errno.ENOSPC)}: 'place'"),
        (OSError(errno.EMFILE, EMFILE), EMFILE),
        (RuntimeError("can't start new thread"), "no more threads can be started"),
        (ImportError(f"/lib/x.so: cannot open shared object file: {EMFILE}", name="x"), f"can't load 'x': {EMFILE}"),
        (ImportError("x.so: failed to map segment from shared object"),
         f"a library can't be loaded: {os.strerror(errno.ENOMEM)}"),
        (chained(ImportError("the advice of a library", name="x"), ImportError(f"y.so: {EMFILE}", name="y")),
         f"can't load 'x': can't load 'y': {EMFILE}"),
        (chained(ImportError("advice", name="x"), PermissionError(errno.EACCES, "Permission denied", "x.py")),
         "can't load 'x': Permission denied: 'x.py'"),
        (ModuleNotFoundError("No module named 'tempfile'", name="tempfile"),
         "can't load 'tempfile', a part of Python: its installation is incomplete or may not be read"),
    ],
)  # fmt: skip
def test_what_is_missing(error, words):
    assert exhausted_resource(error) == words
    assert cli._report(error, False) == 5


@pytest.mark.parametrize(
    "error",
    [
        ValueError("Too many open files"),
        RuntimeError("dictionary changed size"),
        OSError(errno.ENOENT, "No such file or directory"),
        ImportError("cannot import name 'a' from 'b'", name="b"),
        ModuleNotFoundError("No module named 'sppm_pipeline.nothing'", name="sppm_pipeline.nothing"),
        chained(ImportError("x", name="x"), ValueError("y")),
    ],
)
def test_what_is_another_error(error):
    assert exhausted_resource(error) is None


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
@pytest.mark.parametrize("free", [0, 1])
def test_a_folder_is_cleared_with_one_descriptor(tmp_path, free):
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "file").touch()
    place = tmp_path / "place"
    (place / "a" / "b").mkdir(parents=True)
    (place / "a" / "b" / "file").touch()
    (place / "a" / "link").symlink_to(tmp_path / "kept")
    spare = os.open(os.devnull, os.O_RDONLY)
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    highest = max(map(int, os.listdir("/proc/self/fd")))  # other tests may have left gaps between descriptors
    resource.setrlimit(resource.RLIMIT_NOFILE, (highest + 5, before[1]))
    taken = []
    try:
        with contextlib.suppress(OSError):
            while True:
                taken.append(os.dup(0))
        if free:
            os.close(taken.pop())
        clear(place)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
        for descriptor in [*taken, spare]:
            os.close(descriptor)
    assert place.exists() == (not free)
    assert (tmp_path / "kept" / "file").exists()


def test_of_a_link_the_link_is_cleared(tmp_path):
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "kept")
    clear(tmp_path / "link")
    clear(tmp_path / "nothing")
    assert not os.path.lexists(tmp_path / "link")
    assert (tmp_path / "kept" / "file").exists()
