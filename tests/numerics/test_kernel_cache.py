"""The folders of compiled kernels: one for each state of a module and of what it imports, writable, pruned."""

import os
import shutil
import time
from pathlib import Path

import pytest

from sppm_pipeline.numerics import kernel_cache
from sppm_pipeline.numerics.kernel_cache import KEPT_STATES, kernel_cache_folder, kernel_cache_root


@pytest.fixture(autouse=True)
def fresh():
    """Nothing remembered from the modules of the program, and nothing left for them."""
    kernel_cache_root.cache_clear()
    kernel_cache._read.cache_clear()
    kernel_cache._state.cache_clear()
    yield
    kernel_cache_root.cache_clear()
    kernel_cache._read.cache_clear()
    kernel_cache._state.cache_clear()


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A user of its own: numba's folder, the user's cache and the temporary folder."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(kernel_cache.tempfile, "gettempdir", lambda: str(tmp_path / "tmp"))
    return tmp_path


SOURCES = {
    "pack/__init__.py": "",
    "pack/room/__init__.py": "",
    "pack/room/outer.py": "import math\nfrom pack.room.middle import (\n    a,\n    b,\n)\nfrom elsewhere import c\n",
    "pack/room/middle.py": "def f():\n    from pack.deep import inner  # late\n",
    "pack/deep/__init__.py": "",
    "pack/deep/inner.py": "from pack.room.outer import x\n",
    "pack/alone.py": "x = 1\n",
}


@pytest.fixture
def sources(tmp_path):
    """A package: outer needs middle, which needs inner, which needs outer; alone stands alone."""
    for name, text in SOURCES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def folder_of(file):
    kernel_cache._read.cache_clear()
    kernel_cache._state.cache_clear()
    return kernel_cache_folder(str(file))


def test_the_same_sources_have_the_same_folder(place, sources):
    first = folder_of(sources / "pack/room/outer.py")
    assert first.is_dir()
    assert first.parent == place / "numba" / "sppm-kernels" / "outer"
    assert folder_of(sources / "pack/room/outer.py") == first


@pytest.mark.parametrize("changed", ["room/outer", "room/middle", "deep/inner"])
def test_a_change_of_what_a_module_reaches_starts_a_folder(place, sources, changed):
    outer, alone = sources / "pack/room/outer.py", sources / "pack/alone.py"
    before, apart = folder_of(outer), folder_of(alone)
    with (sources / f"pack/{changed}.py").open("a") as file:
        file.write("y = 2\n")
    after = folder_of(outer)
    assert after != before
    assert after.parent == before.parent
    assert folder_of(alone) == apart


def test_a_change_of_what_a_module_does_not_reach_keeps_it(place, sources):
    outer = sources / "pack/room/outer.py"
    before = folder_of(outer)
    (sources / "pack/alone.py").write_text("x = 2\n")
    (sources / "pack/notes.txt").write_text("nothing of interest")
    assert folder_of(outer) == before


def test_the_kernels_of_the_program_reach_what_they_inline():
    """The row sums are inlined by the splatting kernels, so they are part of their state."""
    package = Path(kernel_cache.__file__).parent
    reached = kernel_cache._read(str(package / "kernels/splat.py"))[1]
    assert str(package / "kernels/rows.py") in reached


def test_places_in_turn(place, monkeypatch):
    def root():
        kernel_cache_root.cache_clear()
        return kernel_cache_root()

    def blocked(name):
        shutil.rmtree(place / name, ignore_errors=True)
        (place / name).write_text("a file where a folder should be")

    blocked("numba")
    assert root() == place / "home/sppm/kernels"
    blocked("home")
    assert root().parent == place / "tmp"
    blocked("tmp")
    monkeypatch.setattr(kernel_cache.tempfile, "mkdtemp", lambda prefix: str(place / prefix))
    assert root() == place / "sppm-kernels-"
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.delenv("HOME", raising=False)
    assert root() == place / "sppm-kernels-"


def test_a_folder_that_cannot_be_written_is_passed_over(place, monkeypatch):
    first = kernel_cache_root()
    kernel_cache_root.cache_clear()
    real = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != first and real(path, mode))
    assert kernel_cache_root() == place / "home/sppm/kernels"


def test_old_states_are_removed_the_newest_stay(place, sources):
    base = place / "numba" / "sppm-kernels" / "alone"
    old = []
    for age in range(KEPT_STATES + 3):
        folder = base / f"state{age}"
        folder.mkdir(parents=True)
        (folder / "kernel.nbc").write_text("x")
        os.utime(folder, (time.time() - 1000 * (age + 1),) * 2)
        old.append(folder)
    current = folder_of(sources / "pack/alone.py")
    assert current.is_dir()
    assert [f.exists() for f in old] == [True] * KEPT_STATES + [False] * 3
