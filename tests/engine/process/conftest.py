"""Evil functions that the child can import, and eyes for what is left of it."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import psutil
import pytest

from sppm_pipeline.engine.process import ArraySpec, NativeResult, run_native

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="children are contained on Linux and macOS only")

X = {"x": ArraySpec("float64", (3,))}


def alive(pid: int) -> bool:
    """Whether the process runs; one that only waits to be buried does not."""
    try:
        return psutil.Process(pid).status() not in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)
    except psutil.NoSuchProcess:
        return False


def _gone(pids: Sequence[int], seconds: float = 60) -> bool:
    until = time.monotonic() + seconds
    while any(alive(pid) for pid in pids):
        if time.monotonic() > until:
            return False
        time.sleep(0.01)
    return True


@pytest.fixture
def functions() -> Path:
    """The folder of the module ``evil_functions``."""
    return Path(__file__).parent / "functions"


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A temporary folder of our own, in which private folders are made; empty at the end."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


@pytest.fixture
def call(functions: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., NativeResult]:
    """Run one of the evil functions; it returns three numbers called x."""
    monkeypatch.syspath_prepend(functions)

    def run(name: str, options: dict | None = None, **how) -> NativeResult:
        arrays = how.pop("arrays", {})
        settings = {"returns": X, "distribution": "numpy", "seconds": 120.0, "memory": 2**30} | how
        try:
            return run_native(f"evil_functions:{name}", arrays, options, **settings)
        finally:
            assert not list(temporary.iterdir()), "the private folder is still there"

    return run


@pytest.fixture
def gone() -> Callable[..., bool]:
    """Whether all of these processes are gone within some seconds."""
    return _gone


@pytest.fixture
def noted() -> Callable[[Path], list[int]]:
    """The process numbers in a note, once it is there."""

    def wait(note: Path) -> list[int]:
        until = time.monotonic() + 90
        while not note.exists():
            assert time.monotonic() < until, "the child never wrote its note"
            time.sleep(0.01)
        return [int(word) for word in note.read_text(encoding="utf-8").split()]

    return wait


@pytest.fixture
def numbers() -> dict[str, np.ndarray]:
    """Arrays of many kinds, with edge cases of shape."""
    return {
        "x": np.arange(3.0),
        "faces": np.arange(12, dtype=np.int32).reshape(4, 3),
        "none": np.zeros((0, 3)),
        "scalar": np.array(2, np.uint8),
        "columns": np.asfortranarray(np.arange(2000.0).reshape(20, 100)),
        "flags": np.array([True, False]),
        "waves": np.array([1 + 2j]),
    }
