"""The folder of compiled kernels: one for each state of the sources, writable, pruned."""

import os
import shutil
import time
from pathlib import Path

import pytest

from sppm_pipeline.numerics import kernel_cache
from sppm_pipeline.numerics.kernel_cache import KEPT_STATES, kernel_cache_folder


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A user of its own: numba's folder, the user's cache and the temporary folder."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(kernel_cache.tempfile, "gettempdir", lambda: str(tmp_path / "tmp"))
    return tmp_path


@pytest.fixture
def sources(tmp_path, monkeypatch):
    """A copy of a package with one kernel."""
    package = tmp_path / "package"
    for room in ("numerics/deep", "formats", "stages"):
        (package / room).mkdir(parents=True)
        (package / room / "a.py").write_text("x = 1\n")
    monkeypatch.setattr(kernel_cache, "__file__", str(package / "numerics" / "kernel_cache.py"))
    return package


def test_the_same_sources_have_the_same_folder(place, sources):
    first = kernel_cache_folder()
    assert first.is_dir()
    assert first.parent == place / "numba" / "sppm-kernels"
    assert kernel_cache_folder() == first


def test_any_change_of_numerics_or_formats_starts_a_folder(place, sources):
    seen = {kernel_cache_folder()}
    (sources / "numerics/deep/a.py").write_text("x = 2 \n")
    seen.add(kernel_cache_folder())
    os.utime(sources / "formats/a.py", (1, 1))
    seen.add(kernel_cache_folder())
    (sources / "formats/b.py").write_text("")
    seen.add(kernel_cache_folder())
    assert len(seen) == 4
    (sources / "stages/a.py").write_text("no kernels here")
    (sources / "formats/notes.txt").write_text("nor here")
    assert kernel_cache_folder() in seen


def test_places_in_turn(place, sources, monkeypatch):
    def blocked(name):
        shutil.rmtree(place / name, ignore_errors=True)
        (place / name).write_text("a file where a folder should be")

    blocked("numba")
    assert kernel_cache_folder().parent == place / "home/sppm/kernels"
    blocked("home")
    assert kernel_cache_folder().parent.parent == place / "tmp"
    blocked("tmp")
    monkeypatch.setattr(kernel_cache.tempfile, "mkdtemp", lambda prefix: str(place / prefix))
    assert kernel_cache_folder() == place / "sppm-kernels-"
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.delenv("HOME", raising=False)
    assert kernel_cache_folder() == place / "sppm-kernels-"


def test_a_folder_that_cannot_be_written_is_passed_over(place, sources, monkeypatch):
    first = kernel_cache_folder()
    real = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != first and real(path, mode))
    assert kernel_cache_folder().parent == place / "home/sppm/kernels"


def test_old_states_are_removed_the_newest_stay(place, sources):
    base = place / "numba" / "sppm-kernels"
    old = []
    for age in range(KEPT_STATES + 3):
        folder = base / f"state{age}"
        folder.mkdir(parents=True)
        (folder / "kernel.nbc").write_text("x")
        os.utime(folder, (time.time() - 1000 * (age + 1),) * 2)
        old.append(folder)
    current = kernel_cache_folder()
    assert current.is_dir()
    assert [f.exists() for f in old] == [True] * KEPT_STATES + [False] * 3
