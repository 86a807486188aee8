"""What the machine has to spare."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from sppm_pipeline.data.voxels import Voxels
from sppm_pipeline.errors import ResourceError
from sppm_pipeline.process import memory
from sppm_pipeline.process.resources import MEMORY
from sppm_pipeline.stages.homogenize.voxel import HomogenizeVoxel
from sppm_pipeline.testing.plain_context import PlainContext


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """Files as Linux has them; those not named are missing."""

    def make(**files):
        for name, text in files.items():
            (tmp_path / name.replace("_", ".")).write_text(text)
        monkeypatch.setattr(memory, "MEMINFO", tmp_path / "meminfo")
        monkeypatch.setattr(memory, "STATUS", tmp_path / "status")
        monkeypatch.setattr(memory, "CGROUP", tmp_path)
        return memory.available_memory(None)

    return make


def test_the_least_of_machine_and_control_group(machine):
    assert machine() is None
    assert machine(meminfo="MemTotal: 9 kB\nMemAvailable:   4000 kB\n") == 4_096_000
    assert machine(memory_max="max\n", memory_current="5\n") == 4_096_000
    assert machine(memory_max="3000\n", memory_current="1000\n") == 2000
    assert machine(memory_stat="anon 7\ninactive_file 500\n") == 2500
    assert machine(memory_current="9000\n") == 0


def test_unreadable_files_say_nothing(machine):
    assert machine(meminfo="MemAvailable:\n", memory_max="?", memory_current="") is None


@pytest.mark.skipif(sys.platform == "win32", reason="no such limit")
def test_a_limit_of_the_address_space(machine, monkeypatch):
    import resource

    monkeypatch.setattr(resource, "getrlimit", lambda _: (10_000_000, 20_000_000))
    assert machine(meminfo="MemAvailable: 999999 kB\n", status="VmSize:   4000 kB\n") == 10_000_000 - 4_096_000


def test_refusal_names_both_numbers(monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda limit: 1_500_000_000)
    memory.require_memory(1.4e9, "a thing", "do less", limit=None)
    with pytest.raises(ResourceError, match=r"a thing needs about 1.6 GB of memory; 1.5 GB") as error:
        memory.require_memory(1.6e9, "a thing", "do less", limit=None)
    assert error.value.hint == "do less"
    monkeypatch.setattr(memory, "available_memory", lambda limit: None)
    memory.require_memory(1e18, "a thing", "do less", limit=None)


def test_the_limit_of_the_user_counts_what_is_held_already(machine, monkeypatch):
    machine(meminfo="MemAvailable: 4000000 kB\n", status="VmRSS:   1000000 kB\n")
    assert memory.available_memory(3_000_000_000) == 3_000_000_000 - 1_024_000_000
    assert memory.available_memory(1000) == 0
    assert memory.available_memory(10**12) == 4_096_000_000
    assert memory.child_memory(1_500_000_000) == 476_000_000
    assert memory.child_memory(None) is None
    memory.require_memory(1.9e9, "a thing", "do less", limit=3_000_000_000)
    with pytest.raises(ResourceError, match=r"1.98 GB are available \(--memory allows 3 GB in all\)"):
        memory.require_memory(2e9, "a thing", "do less", limit=3_000_000_000)


def test_stages_see_the_limit_of_the_run_and_homogenizers_keep_it(machine, monkeypatch):
    machine(status="VmRSS:   100000 kB\n")
    assert PlainContext().memory_limit is None
    monkeypatch.setenv(MEMORY, "500000000")
    context = PlainContext()
    assert context.memory_limit == 500_000_000
    voxels = Voxels(np.ones((110, 110, 110), np.uint8), (1.0,) * 3, True, (True,) * 3)
    small = Voxels(np.ones((2, 2, 2), np.uint8), (1.0,) * 3, True, (True,) * 3)
    with pytest.raises(ResourceError, match=r"homogenizing 110 x 110 x 110 voxels .*--memory allows 0\.5 GB"):
        HomogenizeVoxel(precision="double").cell_of(context, voxels)
    assert HomogenizeVoxel().cell_of(context, small).shape == (2, 2, 2)
