"""The folders of compiled kernels: one for each state of a module and of what it imports, writable, pruned."""

import functools
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sppm_pipeline.services.jit import kernel_cache
from sppm_pipeline.services.jit.compiled import inline_jit, specialized
from sppm_pipeline.services.jit.kernel_cache import KEPT_STATES, kernel_cache_folder, kernel_cache_root


@pytest.fixture(autouse=True)
def fresh():
    """Nothing remembered from the modules of the program, and nothing left for them."""
    forget()
    yield
    forget()


def forget():
    for name in (
        "kernel_cache_root",
        "_temporary",
        "_read",
        "_state",
        "_package_of",
        "_root_of",
        "_release",
        "_inlined",
    ):
        getattr(kernel_cache, name).cache_clear()


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
    forget()
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
    package = Path(kernel_cache.__file__).parents[2]
    reached = kernel_cache._read(str(package / "method/kernels/splat.py"))[1]
    assert str(package / "method/kernels/rows.py") in reached


def test_places_in_turn(place, monkeypatch):
    def root():
        forget()
        return kernel_cache_root()

    def blocked(name):
        shutil.rmtree(place / name, ignore_errors=True)
        (place / name).write_text("a file where a folder should be")

    blocked("numba")
    assert root() == place / "home/sppm/kernels"
    blocked("home")
    assert root().parent == place / "tmp"
    blocked("tmp")
    monkeypatch.setattr(kernel_cache, "temporary_folder", lambda prefix: place / prefix)
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


def _by_another(folder):
    """As if another user had made the folder."""
    folder.mkdir(parents=True)
    os.chown(folder, 12345, 12345)


def _open(folder):
    folder.mkdir(parents=True)
    folder.chmod(0o777)


def _linked(folder):
    folder.parent.mkdir(parents=True, exist_ok=True)
    (folder.parent / "elsewhere").mkdir()
    folder.symlink_to("elsewhere")


@pytest.mark.parametrize("made", [_by_another, _open, _linked])
def test_machine_code_comes_from_no_folder_that_others_can_write(place, monkeypatch, made):
    """The names of these folders are known, and whoever made one first would have its code run."""
    if made is _by_another and os.geteuid() != 0:
        monkeypatch.setattr(os, "geteuid", lambda: 54321)
        made = lambda folder: folder.mkdir(parents=True)  # noqa: E731
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.delenv("HOME", raising=False)
    (place / "tmp").mkdir(exist_ok=True)
    for folder in kernel_cache._bases():
        made(folder)
    root = kernel_cache_root()
    assert root not in kernel_cache._bases()
    assert root.stat().st_mode & 0o777 == 0o700
    assert set(kernel_cache.passed_over()) == {str(folder) for folder in kernel_cache._bases()}


def test_a_folder_that_others_may_replace_is_passed_over(place):
    (place / "numba").mkdir()
    (place / "numba").chmod(0o777)
    assert kernel_cache_root() == place / "home/sppm/kernels"
    assert "other users may replace it" in kernel_cache.passed_over()[str(place / "numba/sppm-kernels")]
    (place / "numba").chmod(0o1777)
    kernel_cache_root.cache_clear()
    assert kernel_cache_root() == place / "numba/sppm-kernels"


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


def test_how_kernels_are_compiled_is_part_of_their_state_and_how_they_are_kept_is_not():
    package = Path(kernel_cache.__file__).parents[2]
    reached, waiting = set(), [str(package / "method/kernels/splat.py")]
    while waiting:
        if (file := waiting.pop()) not in reached:
            reached.add(file)
            waiting += kernel_cache._read(file)[1]
    assert str(package / "services/jit/compiling.py") in reached
    assert str(package / "services/jit/machine_code.py") not in reached


RELATIVE = {
    "plug/__init__.py": "from .kernels import main  # the public face\n",
    "plug/kernels.py": "from .inner import a\nfrom . import beside, \\\n    far\n"
    "import plug.plain\nimport plug.named as n, math\n",
    "plug/inner.py": "",
    "plug/beside.py": "",
    "plug/far/__init__.py": "from ..deep.down import b\n",
    "plug/deep/__init__.py": "",
    "plug/deep/down.py": "from ... import above\n",
    "plug/plain.py": "def f():\n    from other import c\n",
    "plug/named.py": "import lone\n",
    "plug/alone.py": "",
    "other/__init__.py": "from other.consts import c\n",
    "other/consts.py": "c = 1\n",
    "lone.py": "",
}


@pytest.mark.parametrize(
    ("changed", "counts"),
    [
        ("plug/inner", True), ("plug/beside", True), ("plug/far/__init__", True), ("plug/deep/down", True),
        ("plug/plain", True), ("plug/named", True), ("other/__init__", True), ("other/consts", True), ("lone", True),
        ("plug/alone", False), ("plug/__init__", False),
    ],
)  # fmt: skip
def test_every_way_of_importing_is_followed(place, monkeypatch, changed, counts):
    (place / "far").mkdir()
    for name, text in RELATIVE.items():
        file = place / ("far" if name.startswith(("other", "lone")) else "near") / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    monkeypatch.syspath_prepend(str(place / "far"))
    before = folder_of(place / "near/plug/kernels.py")
    with next(place.glob(f"*/{changed}.py")).open("a") as file:
        file.write("y = 2\n")
    assert (folder_of(place / "near/plug/kernels.py") != before) == counts


def test_sources_in_other_encodings_are_read(place):
    (place / "old.py").write_bytes("# coding: latin-1\nfrom other import (\n    a,  # für\n)\n".encode("latin-1"))
    assert folder_of(place / "old.py").is_dir()


def test_kernels_of_plugins_are_as_new_as_those_of_the_program(place, monkeypatch):
    (place / "file.py").write_text("from sppm_pipeline import jit\n")
    (place / "free.py").write_text("import sppm_pipelines\n")
    before, free = folder_of(place / "file.py"), folder_of(place / "free.py")
    monkeypatch.setattr(kernel_cache, "_inlined", functools.cache(lambda: "another version"))
    assert folder_of(place / "file.py") != before
    assert folder_of(place / "free.py") == free


def test_of_installed_packages_the_release_counts_and_what_may_hold_kernels(place, monkeypatch):
    root = place / "site-packages"
    (root / "big").mkdir(parents=True)
    (root / "big/__init__.py").write_text("from big.part import c\n")
    (root / "big/part.py").write_text("c = 1\n")
    (root / "quick.py").write_text("import numba\nfrom big.part import c\n")
    (root / "Big-1.0.dist-info").mkdir()
    (root / "quick-1.0.dist-info").mkdir()
    (place / "one.py").write_text("import big\n")
    (place / "two.py").write_text("import quick\n")
    monkeypatch.syspath_prepend(str(root))

    def folders():
        return folder_of(place / "one.py"), folder_of(place / "two.py")

    before = folders()
    (root / "big/part.py").write_text("c = 2\n")
    after = folders()
    assert (after[0] == before[0], after[1] == before[1]) == (True, False)
    (root / "Big-1.0.dist-info").rename(root / "Big-2.0.dist-info")
    assert folders()[0] != after[0]


PROFILE = """
import numpy as np

from sppm_pipeline.numerics import inline_jit

POWER = 3


def called(x):
    return x


def exponent(x):
    return called(x) ** POWER
"""


def test_a_specialized_copy_is_named_after_the_state_of_what_it_is_given(place):
    def add(x):
        return x

    def name():
        forget()
        found = {}
        exec(compile(PROFILE, str(place / "profile.py"), "exec"), found)
        return specialized(add, "power", exponent=inline_jit(found["exponent"])).__qualname__

    bare = name()  # there is no file
    (place / "profile.py").write_text(PROFILE)
    first = name()
    assert first == name() != bare
    for old, new in (("POWER = 3", "POWER = 5"), ("return x\n", "return 2 * x\n")):
        (place / "profile.py").write_text(PROFILE.replace(old, new))
        assert name() not in (first, bare)


def test_where_no_folder_can_be_made_there_is_one_a_process_that_goes_with_it(place, sources):
    (place / "numba/sppm-kernels").mkdir(parents=True)
    for stem in ("outer", "alone"):
        (place / "numba/sppm-kernels" / stem).write_text("a file where a folder should be")
    own = place / "own"
    own.mkdir()
    program = (
        "from sppm_pipeline.services.jit.kernel_cache import kernel_cache_folder\n"
        f"for name in ('room/outer', 'alone', 'alone'): print(kernel_cache_folder(f'{sources}/pack/{{name}}.py'))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "TMPDIR": str(own)},
        capture_output=True,
        text=True,
        check=True,
    )
    outer, alone, again = map(Path, done.stdout.split())
    assert alone == again
    assert alone != outer
    assert alone.parents[1] == outer.parents[1]
    assert alone.parents[2] == own
    assert list(own.iterdir()) == []


def test_a_folder_that_another_process_removes_meanwhile_does_not_matter(place, sources, monkeypatch):
    def gone(*args):
        raise FileNotFoundError(2, "No such file or directory")

    monkeypatch.setattr(kernel_cache, "_prune", gone)
    assert kernel_cache_folder(str(sources / "pack/alone.py")).parents[1] == place / "numba/sppm-kernels"
