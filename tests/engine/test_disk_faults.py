"""Each call that may fail on a disk fails once: nothing is claimed that is not there, and the exit code is 5."""

from __future__ import annotations

import _pyio
import builtins
import errno
import io
import json
import os
import re
from pathlib import Path

import pytest

import sppm_pipeline.engine.run as run_package
from sppm_pipeline.engine.files import digest_of, sync, sync_file_system, write_whole
from sppm_pipeline.engine.run import outputs
from sppm_pipeline.engine.run.outputs import RunFolder
from sppm_pipeline.engine.run.verification import verify_run
from sppm_pipeline.errors import ResourceError, SppmError

PIPELINE = """name: faults
seed: 3
pipeline:
  - {stage: sample.random, count: 2}
  - {stage: write.number, id: one, path: a/one.txt}
  - {stage: write.number, id: two, path: two.txt}
"""

CALLS = ("open", "write", "fsync", "replace", "rename")


class FailingDisk:
    """Lets the n-th call of one kind that concerns a folder fail, and counts them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path, call: str, at: int, number: int) -> None:
        self.seen = 0
        self._folder, self._call, self._at, self._number = str(folder), call, at, number
        plain_open = builtins.open

        def opened(file, mode="r", *args, **kwargs):
            # Python's own implementation writes through `os`, where its calls can fail
            ours = isinstance(file, (str, os.PathLike)) and self._inside(os.fspath(file))
            writes = set(mode) & set("wxa+")
            return (_pyio.open if ours and writes else plain_open)(file, mode, *args, **kwargs)

        monkeypatch.setattr(builtins, "open", opened)
        monkeypatch.setattr(io, "open", opened)
        for name in CALLS:
            monkeypatch.setattr(os, name, self._failing(name, getattr(os, name)))

    def _inside(self, path: str) -> bool:
        return os.path.abspath(path).startswith(self._folder)

    def _failing(self, name, function):
        def call(first, *args, **kwargs):
            place = first
            if isinstance(first, int):
                place = os.readlink(f"/proc/self/fd/{first}")
            if name == self._call and self._inside(os.fspath(place)):
                self.seen += 1
                if self.seen == self._at:
                    raise OSError(self._number, os.strerror(self._number), os.fspath(place))
            return function(first, *args, **kwargs)

        return call


def check_claims(folder: Path) -> str | None:
    """The status on disk; every file that the record accounts for is there to the byte, and no other is."""
    if not (folder / "run.json").exists():
        assert not [file for file in folder.rglob("*") if file.is_file()] if folder.exists() else True
        return None
    record = json.loads((folder / "run.json").read_text())
    outputs = [output for stage in record["stages"] for output in stage.get("outputs", ())]
    for output in outputs:
        assert digest_of(folder / output["path"]) == output["sha256"]
    if record["status"] == "done":
        assert verify_run(folder)[0] == []
        assert len(outputs) == 2
    known = {output["path"] for output in outputs} | set(record.get("earlier", ())) | {"run.json", "SHA256SUMS"}
    there = {file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file()}
    assert there <= known
    return record["status"]


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC])
@pytest.mark.parametrize("call", CALLS)
def test_the_nth_call_fails(work, call, number):
    faults = 0
    for at in range(1, 200):
        to = f"{call}-{number}-{at}"
        with pytest.MonkeyPatch.context() as patch:
            disk = FailingDisk(patch, work.folder / to, call, at, number)
            failed = None
            try:
                work.run(PIPELINE, to=to)
            except SppmError as error:
                failed = error
        status = check_claims(work.folder / to)
        if disk.seen < at:
            assert failed is None
            assert status == "done"
            break
        faults += 1
        assert failed is not None, (call, at)
        assert failed.exit_code == 5, failed
        assert status in ("failed", "running", None)
    # no file of a run is renamed otherwise than by `replace`
    assert faults >= {"open": 8, "write": 5, "fsync": 8, "replace": 5, "rename": 0}[call]


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOTSUP])
def test_a_file_system_that_cannot_sync_is_no_fault(work, monkeypatch, number):
    def unable(descriptor):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", unable)
    assert work.run(PIPELINE)["status"] == "done"


@pytest.mark.parametrize("number", [errno.EMFILE, errno.ENFILE, errno.EIO])
def test_a_sync_that_found_no_descriptor_is_done_again(tmp_path, monkeypatch, number):
    """The stages' are free by then; any other error is the disk's."""
    path, asked = tmp_path / "file", []
    path.write_bytes(b"kept")

    def scarce(file):
        asked.append(file)
        if len(asked) == 1:
            raise OSError(number, os.strerror(number), file)
        sync(file)

    monkeypatch.setattr(outputs, "sync", scarce)
    files = outputs.WrittenFiles(2)
    files.sync(path)
    if number == errno.EIO:
        with pytest.raises(OSError, match="Input/output"):
            files.settle()
        assert asked == [str(path)]
    else:
        files.settle()
        assert asked == [str(path)] * 2
    files.close()


def test_folders_are_synced_after_their_names_have_changed(tmp_path, monkeypatch):
    events = []
    fsync, replace = os.fsync, os.replace
    noted = lambda descriptor: (events.append(os.readlink(f"/proc/self/fd/{descriptor}")), fsync(descriptor))  # noqa: E731
    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(os, "replace", lambda a, b: (events.append(f"-> {b}"), replace(a, b)))
    folder = RunFolder(tmp_path / "new" / "run")
    folder.prepare()
    staged = folder.claim("s", "deep/tree")
    staged.mkdir()
    (staged / "inner").mkdir()
    (staged / "inner" / "x").write_text("x")
    folder.commit()
    folder.settle()
    write_whole(folder.path / "run.json", "{}")
    folder.discard()
    run = tmp_path / "new" / "run"
    moved = events.index(f"-> {run / 'deep' / 'tree'}")
    for path in (tmp_path, tmp_path / "new", run, run / "deep", run / "deep/tree", run / "deep/tree/inner"):
        assert str(path) in events[moved:]
    assert events[-2:] == [f"-> {run / 'run.json'}", str(run)]


@pytest.mark.parametrize("whole", [True, False])
def test_many_files_are_synced_at_once(tmp_path, monkeypatch, whole):
    monkeypatch.setattr(outputs, "MAX_SYNCED", 3)
    synced, whole_systems = [], []
    monkeypatch.setattr(outputs, "sync", synced.append)
    monkeypatch.setattr(outputs, "sync_file_system", lambda path: (whole_systems.append(path), whole)[1])
    files = outputs.WrittenFiles(2)
    for name in "abcde":
        (tmp_path / name).write_text(name)
        files.sync(tmp_path / name)
    files.settle()
    files.close()
    assert len(whole_systems) == 1
    assert sorted(map(str, synced)) == [str(tmp_path / name) for name in ("abc" if whole else "abcde")]


@pytest.mark.skipif(os.uname().sysname != "Linux", reason="syncfs(2) is Linux's")
def test_a_whole_file_system_is_synced(tmp_path):
    assert sync_file_system(tmp_path)
    with pytest.raises(FileNotFoundError):
        sync_file_system(tmp_path / "missing")


def test_a_failed_sync_is_raised(tmp_path, monkeypatch):
    def failing(descriptor):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", failing)
    with pytest.raises(OSError, match="Input/output error"):
        sync(tmp_path)
    with pytest.raises(ResourceError, match="Input/output error"):
        write_whole(tmp_path / "a", "text")


def test_one_module_changes_files_of_runs():
    calls = r"os\.(replace|rename|truncate|link|symlink)\(|\.(write_bytes|rename|hardlink_to|symlink_to)\("
    for file in Path(run_package.__file__).parent.glob("*.py"):
        assert not re.search(calls, file.read_text()), file
