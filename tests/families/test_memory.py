"""What the machine has to spare."""

from __future__ import annotations

import sys

import pytest

from sppm_pipeline.errors import ResourceError
from sppm_pipeline.families import memory


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """Files as Linux has them; those not named are missing."""

    def make(**files):
        for name, text in files.items():
            (tmp_path / name.replace("_", ".")).write_text(text)
        monkeypatch.setattr(memory, "MEMINFO", tmp_path / "meminfo")
        monkeypatch.setattr(memory, "STATUS", tmp_path / "status")
        monkeypatch.setattr(memory, "CGROUP", tmp_path)
        return memory.available_memory()

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
    monkeypatch.setattr(memory, "available_memory", lambda: 1_500_000_000)
    memory.require_memory(1.4e9, "a thing", "do less")
    with pytest.raises(ResourceError, match=r"a thing needs about 1.6 GB of memory; 1.5 GB") as error:
        memory.require_memory(1.6e9, "a thing", "do less")
    assert error.value.hint == "do less"
    monkeypatch.setattr(memory, "available_memory", lambda: None)
    memory.require_memory(1e18, "a thing", "do less")
