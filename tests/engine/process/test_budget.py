"""One budget of memory: the minimum of user, address space, control groups and machine, the same for all who ask."""

from __future__ import annotations

import os
import resource
import shutil
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest

from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.process import budget, native
from sppm_pipeline.errors import ResourceError
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.features.surface.solids import ManifoldLimits, manifold_combine
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.testing.plain_context import PlainContext

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc and control groups")

GB = 10**9
RESIDENT, ADDRESSES, FREE = 10**8 // 4096 * 4096, 4 * 10**8 // 4096 * 4096, 8 * GB // 1024 * 1024
"""Of this process: what it holds, its address space; of the machine: what it can hand out."""


class Container:
    """A /proc and control groups as the kernel shows them, in a folder; files that are not written are missing."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.proc = root / "proc"
        own = self.proc / str(os.getpid())
        own.mkdir(parents=True)
        (self.proc / "self").mkdir()
        shutil.copy("/proc/self/stat", own / "stat")
        shutil.copy("/proc/stat", self.proc / "stat")
        page = resource.getpagesize()
        (own / "statm").write_text(f"{ADDRESSES // page} {RESIDENT // page} 0 0 0 0 0\n")
        free = FREE // 1024
        (self.proc / "meminfo").write_text(
            f"MemTotal: {2 * free} kB\nMemFree: {free} kB\nMemAvailable: {free} kB\nBuffers: 0 kB\nCached: 0 kB\n"
            "Shmem: 0 kB\nActive: 0 kB\nInactive: 0 kB\nSReclaimable: 0 kB\nSlab: 0 kB\n"
        )
        self._mounts = ["22 1 0:5 / /proc rw - proc proc rw", "23 1 8:1 / / rw - ext4 /dev/sda1 rw", "not a mount"]

    def groups(self, *lines: str) -> None:
        """The groups that this process is in."""
        (self.proc / "self" / "cgroup").write_text("".join(f"{line}\n" for line in lines))

    def mount(self, kind: str, options: str = "rw", *, root: str = "/", name: str = "sys/fs/cgroup") -> Path:
        """A hierarchy, of which what lies below `root` is seen."""
        top = self.root / name
        top.mkdir(parents=True, exist_ok=True)
        shown = str(top).replace(" ", r"\040")
        self._mounts.append(f"31 23 0:26 {root} {shown} rw,nosuid shared:9 - {kind} cgroup {options}")
        (self.proc / "self" / "mountinfo").write_text("\n".join(self._mounts))
        return top

    @staticmethod
    def group(folder: Path, **files: int | str) -> None:
        """Files of a group; ``memory_max=5`` is ``memory.max``."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, value in files.items():
            (folder / name.replace("memory_", "memory.", 1)).write_text(f"{value}\n")


@pytest.fixture
def container(tmp_path, monkeypatch):
    monkeypatch.setattr(psutil, "PROCFS_PATH", str(tmp_path / "proc"))
    monkeypatch.delenv(budget.MEMORY, raising=False)
    budget._plan.cache_clear()
    yield Container(tmp_path)
    budget._plan.cache_clear()


def left() -> list[int]:
    return list(budget.control_groups())


def test_without_groups_it_is_the_machine(container):
    assert left() == []
    assert budget.allowed_memory() == (RESIDENT + FREE, "the free memory of this machine")
    assert budget.available_memory() == FREE


def test_version_2(container):
    container.groups("0::/app")
    top = container.mount("cgroup2", root="/")
    container.group(top / "app", memory_max=3 * GB, memory_current=GB, memory_stat="anon 7\ninactive_file 500")
    assert left() == [2 * GB + 500]
    assert budget.allowed_memory() == (RESIDENT + 2 * GB + 500, "the memory left in this container")
    container.group(top / "app", memory_high=2 * GB)
    assert left() == [GB + 500]
    container.group(top / "app", memory_high="max", memory_max="max")
    assert left() == []
    container.group(top / "app", memory_max=GB, memory_current=2 * GB)
    assert left() == [0]
    assert budget.available_memory() == 0


def test_version_1(container):
    container.groups("3:cpu,memory:/app", "1:name=systemd:/else")
    top = container.mount("cgroup", "rw,cpu,memory", name="sys/fs/cgroup/memory")
    container.mount("cgroup", "rw,freezer", name="sys/fs/cgroup/freezer")
    container.group(top / "app", memory_limit_in_bytes=3 * GB, memory_usage_in_bytes=GB)
    assert left() == [2 * GB]
    container.group(top / "app", memory_stat="inactive_file 3\ntotal_inactive_file 500")
    assert left() == [2 * GB + 500]
    container.group(top / "app", memory_limit_in_bytes=2**63 - 4096)
    assert left() == []


def test_the_controller_of_memory_may_be_in_either_version_of_a_hybrid(container):
    container.groups("4:memory:/one", "0::/two")
    first = container.mount("cgroup", "rw,memory", name="sys/fs/cgroup/memory")
    second = container.mount("cgroup2", name="sys/fs/cgroup/unified")
    container.group(first / "one", memory_limit_in_bytes=3 * GB, memory_usage_in_bytes=GB)
    container.group(second / "two")
    assert left() == [2 * GB]
    container.group(first / "one", memory_limit_in_bytes=2**63 - 4096)
    container.group(second / "two", memory_max=5 * GB, memory_current=GB)
    assert left() == [4 * GB]


def test_groups_above_limit_the_sum_of_those_below(container):
    container.groups("0::/slice/service/job")
    top = container.mount("cgroup2")
    container.group(top / "slice" / "service" / "job", memory_max=9 * GB, memory_current=0)
    container.group(top / "slice" / "service", memory_max="max", memory_current=0)
    container.group(top / "slice", memory_max=4 * GB, memory_current=3 * GB)
    container.group(top, memory_max=7 * GB, memory_current=0)
    container.group(top.parent, memory_max=1, memory_current=0)  # above what is mounted there are no groups
    assert left() == [9 * GB, GB, 7 * GB]
    assert budget.available_memory() == GB


@pytest.mark.parametrize(
    ("path", "root", "place"),
    [
        ("/docker/0f/job", "/docker/0f", "job"),  # only the container's part of the hierarchy is mounted
        ("/docker/0f", "/docker/0f", "."),
        ("/", "/", "."),
        ("/../../user", "/", "."),  # our group lies outside of the namespace that is shown
        ("/elsewhere", "/docker/0f", "."),
    ],
)
def test_where_the_own_group_is_mounted(container, path, root, place):
    container.groups(f"0::{path}")
    top = container.mount("cgroup2", root=root, name="a folder with blanks")
    container.group(top / place, memory_max=3 * GB, memory_current=GB)
    assert left() == [2 * GB]


def test_unreadable_files_say_nothing(container):
    container.groups("0::/app", "nonsense", "")
    top = container.mount("cgroup2")
    container.group(top / "app", memory_max="?", memory_current=1)
    assert left() == []
    container.group(top / "app", memory_max=3 * GB, memory_current="")
    assert left() == []
    container.group(top / "app", memory_current=GB, memory_stat="inactive_file\ninactive_file many\n\n")
    assert left() == [2 * GB]
    (container.proc / "self" / "mountinfo").write_bytes(b"\xff\xfe - cgroup2\n")
    assert left() == []


def test_without_proc_it_is_what_the_machine_has(container):
    shutil.rmtree(container.proc)
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert budget.allowed_memory() == (total, "the free memory of this machine")


def test_a_limit_of_the_address_space(container, monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (GB, 2 * GB))
    assert budget.available_memory() == GB - ADDRESSES
    assert budget.allowed_memory() == (RESIDENT + GB - ADDRESSES, "the address space left to this process")


def test_the_limit_of_the_user_counts_what_is_held_already(container):
    assert budget.available_memory(3 * GB) == 3 * GB - RESIDENT
    assert budget.available_memory(1000) == 0
    assert budget.available_memory(10**12) == FREE
    assert budget.child_memory(GB) == GB - RESIDENT
    assert budget.child_memory(1000) == budget.MINIMUM_CHILD
    budget.require_memory(2.89e9, "a thing", "do less", limit=3 * GB)
    with pytest.raises(ResourceError, match=r"2\.9 GB are available \(--memory allows 3 GB in all\)"):
        budget.require_memory(2.91e9, "a thing", "do less", limit=3 * GB)


def test_refusal_names_both_numbers(container):
    container.groups("0::/")
    container.group(container.mount("cgroup2"), memory_max=2 * GB, memory_current=GB // 2)
    budget.require_memory(1.4e9, "a thing", "do less", limit=None)
    with pytest.raises(ResourceError, match=r"a thing needs about 1\.6 GB of memory; 1\.5 GB are available\n") as error:
        budget.require_memory(1.6e9, "a thing", "do less", limit=None)
    assert error.value.hint == "do less"


LARGE = """sppm: 1
pipeline:
  - {stage: sample.elimination, count: 30}
  - {stage: connect.mst}
  - {stage: field.gaussian, pore_radius: 0.1, tunnel_radius: 0.04}
  - {stage: extract.voxels, resolution: 1024}
"""


@pytest.mark.parametrize("requested", [None, 600_000_000])
def test_all_who_ask_get_one_answer_in_a_container(container, monkeypatch, tmp_path, capsys, requested):
    """The refusal by estimates, planning stages, checking stages, native children and Booleans."""
    container.groups("0::/box/job")
    top = container.mount("cgroup2", root="/box")
    container.group(top / "job", memory_max="max", memory_current=0)
    container.group(top, memory_max=2 * GB, memory_current=3 * GB // 2, memory_stat=f"inactive_file {GB // 10}")
    if requested is not None:
        monkeypatch.setenv(budget.MEMORY, str(requested))
    available = 6 * GB // 10 if requested is None else requested - RESIDENT
    context = PlainContext()
    assert budget.available_memory() == budget.available_memory(context.memory_limit) == available
    assert context.memory == available + RESIDENT
    assert context.memory_limit == requested

    # what a stage may hold beside what is held already
    budget.require_memory(available, "a thing", "do less", limit=context.memory_limit)
    with pytest.raises(ResourceError):
        budget.require_memory(available + 1, "a thing", "do less", limit=context.memory_limit)

    # what a run may hold in all
    limit, source = budget.allowed_memory()
    assert limit == available + RESIDENT
    (tmp_path / "large.yaml").write_text(LARGE)
    assert main(["estimate", str(tmp_path / "large.yaml"), "-o", str(tmp_path / "out"), "--no-plugins"]) == 5
    assert f"{source} is {budget.format_bytes(limit)}" in capsys.readouterr().err

    # what a child may hold
    given = []

    def job(folder, function, arrays, options, returns, memory):
        given.append(memory)
        raise OSError("far enough")

    monkeypatch.setattr(native, "_write_job", job)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    mesh = (np.zeros((3, 3)), np.zeros((1, 3), np.int32))
    limits = ManifoldLimits(1.0, budget.child_memory(context.memory_limit))
    for call in (
        lambda: native.run_native("json:dumps", {}, returns={}, distribution="numpy", seconds=1),
        lambda: manifold_combine(mesh, mesh, "union", ("one", "other"), limits),
        lambda: manifold_combine(mesh, mesh, "union", ("one", "other"), ManifoldLimits(1.0)),
    ):
        with pytest.raises(ResourceError, match="far enough"):
            call()
    assert given == [available] * 3


def test_stages_see_the_limit_of_the_run_and_homogenizers_keep_it(container, monkeypatch):
    assert PlainContext().memory_limit is None
    assert PlainContext().memory == budget.DEFAULT_PLAN
    monkeypatch.setenv(budget.MEMORY, "500000000")
    context = PlainContext()
    assert context.memory_limit == context.memory == 500_000_000
    voxels = Voxels(np.ones((160, 160, 160), np.uint8), (1.0,) * 3, True, (True,) * 3)
    small = Voxels(np.ones((2, 2, 2), np.uint8), (1.0,) * 3, True, (True,) * 3)
    with pytest.raises(ResourceError, match=r"homogenizing 160 x 160 x 160 voxels .*--memory allows 0\.5 GB"):
        HomogenizeVoxel(precision="double").cell_of(context, voxels)
    assert HomogenizeVoxel().cell_of(context, small).shape == (2, 2, 2)


def test_environment_of_a_child_is_that_of_the_parent_with_pins():
    environment = native.child_environment({"HOME": "/home", "LC_ALL": "fr", "OMP_NUM_THREADS": "64"}, Path("/work"), 2)
    assert environment["HOME"] == "/home"
    assert environment["LC_ALL"] == "C.UTF-8"
    assert environment["OMP_NUM_THREADS"] == "2"
    assert environment["TMPDIR"] == "/work"
