"""Memory that is left, and the child's share of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from sppm_pipeline.process import limits


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"/proc/meminfo": ["MemTotal: 4096 kB", "MemAvailable: 2048 kB"]}, 2048 * 1024),
        ({"/sys/fs/cgroup/memory.max": ["5000"], "/sys/fs/cgroup/memory.current": ["2000"]}, 3000),
        ({"/sys/fs/cgroup/memory.max": ["2000"], "/sys/fs/cgroup/memory.current": ["5000"]}, 0),
        (
            {
                "/proc/meminfo": ["MemAvailable: 1 kB"],
                "/sys/fs/cgroup/memory.max": ["max"],
                "/sys/fs/cgroup/memory.current": ["5000"],
            },
            1024,
        ),
    ],
)
def test_the_least_of_what_machine_and_group_allow(monkeypatch, files, expected):
    monkeypatch.setattr(limits, "_lines", lambda path: files.get(path, []))
    assert limits.available_memory() == expected
    assert limits.default_memory() == limits.LEAST_MEMORY


def test_without_any_file_it_is_the_machine(monkeypatch):
    monkeypatch.setattr(limits, "_lines", lambda path: [])
    assert limits.available_memory() > 2**20


def test_environment_is_that_of_the_parent_with_pins():
    environment = limits.child_environment({"HOME": "/home", "LC_ALL": "fr", "OMP_NUM_THREADS": "64"}, Path("/work"), 2)
    assert environment["HOME"] == "/home"
    assert environment["LC_ALL"] == "C.UTF-8"
    assert environment["OMP_NUM_THREADS"] == "2"
    assert environment["TMPDIR"] == "/work"
