"""Files appear whole or not at all, and never outside of the run directory."""

from __future__ import annotations

import hashlib
import os

import pytest

from sppm_pipeline.engine.files import digest_of, sync, write_whole
from sppm_pipeline.engine.run.outputs import RunFolder
from sppm_pipeline.engine.strict_json import json_text
from sppm_pipeline.errors import ConfigError, PluginError, ResourceError

RECORD = {"sppm_run": 1, "config": {}}


def folder_in(tmp_path):
    folder = RunFolder(tmp_path / "run")
    folder.prepare()
    return folder


@pytest.mark.parametrize(
    "name",
    ["/etc/x", "../x", "a/../../x", "..", "", ".", "a\0b", "C:/x", "C:x", "\\x", "run.json", "RUN.json", "sweep.csv",
     ".staging-1/x", "a\\..\\..\\x"],
)  # fmt: skip
def test_names_that_are_refused(tmp_path, name):
    with pytest.raises(ConfigError):
        folder_in(tmp_path).claim("s", name)


def test_a_link_does_not_lead_out(tmp_path):
    folder = folder_in(tmp_path)
    (tmp_path / "run" / "link").symlink_to(tmp_path)
    with pytest.raises(ConfigError, match="through a link"):
        folder.claim("s", "link/x")


@pytest.mark.parametrize(("a", "b"), [("x", "x"), ("x", "X"), ("x", "x/y"), ("x/y", "x"), ("x/y", "./x//y")])
def test_two_stages_never_write_the_same(tmp_path, a, b):
    folder = folder_in(tmp_path)
    folder.claim("s", a)
    with pytest.raises(ConfigError, match="collides"):
        folder.claim("t", b)


def test_two_stages_can_share_a_folder(tmp_path):
    folder = folder_in(tmp_path)
    folder.claim("s", "x/a").write_text("1")
    folder.claim("t", "x/b").write_text("2")
    assert [output["path"] for output in folder.commit()] == ["x/a", "x/b"]
    assert (tmp_path / "run" / "x" / "b").read_text() == "2"


def test_a_stage_can_ask_twice(tmp_path):
    folder = folder_in(tmp_path)
    assert folder.claim("s", "x") == folder.claim("s", "x")


def test_outputs_appear_when_committed(tmp_path):
    folder = folder_in(tmp_path)
    staged = folder.claim("s", "deep/file.txt")
    staged.write_text("hello")
    assert not (tmp_path / "run" / "deep").exists()
    (output,) = folder.commit()
    assert (tmp_path / "run" / "deep" / "file.txt").read_text() == "hello"
    assert output == {"path": "deep/file.txt", "bytes": 5, "sha256": hashlib.sha256(b"hello").hexdigest()}
    assert folder.commit() == []
    folder.discard()
    assert sorted(os.listdir(tmp_path / "run")) == ["deep"]


def test_folders_are_described_by_all_their_files(tmp_path):
    folder = folder_in(tmp_path)
    staged = folder.claim("s", "slices")
    staged.mkdir()
    for i in range(3):
        (staged / f"{i}.png").write_bytes(bytes([i] * 10))
    (output,) = folder.commit()
    assert (output["files"], output["bytes"]) == (3, 30)
    before = digest_of(tmp_path / "run" / "slices")
    assert before == output["sha256"]
    (tmp_path / "run" / "slices" / "2.png").rename(tmp_path / "run" / "slices" / "3.png")
    assert digest_of(tmp_path / "run" / "slices") != before


def test_an_output_that_was_not_written_is_an_error(tmp_path):
    folder = folder_in(tmp_path)
    folder.claim("s", "x")
    with pytest.raises(PluginError, match="announced but not written"):
        folder.commit()


def test_a_repeated_stage_starts_afresh(tmp_path):
    folder = folder_in(tmp_path)
    folder.claim("r.s", "x").mkdir()
    folder.restart("r.s")
    folder.claim("r.s", "x").mkdir()


def test_what_is_not_from_a_run_is_left_alone(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.tex").write_text("precious")
    with pytest.raises(ConfigError, match="not empty"):
        folder_in(tmp_path)
    assert (tmp_path / "run" / "thesis.tex").read_text() == "precious"


@pytest.mark.parametrize("text", ["{}", "[]", "", '{"config": {"sppm_runs": 1}}'])
def test_a_foreign_run_json_is_no_run(tmp_path, text):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text(text)
    with pytest.raises(ConfigError, match="not empty"):
        folder_in(tmp_path)


def test_a_file_is_no_run_directory(tmp_path):
    (tmp_path / "run").write_text("x")
    with pytest.raises(ConfigError, match="is a file"):
        folder_in(tmp_path)


def test_the_files_of_an_earlier_run_are_replaced_and_others_kept(tmp_path):
    run = tmp_path / "run"
    (run / "old").mkdir(parents=True)
    (run / "old" / "a.png").write_text("a")
    (run / "note.txt").write_text("mine")
    outside = tmp_path / "outside.txt"
    outside.write_text("precious")
    outputs = [{"path": "old"}, {"path": "../outside.txt"}, {"path": str(outside)}, {"path": 3}, {}]
    (run / "run.json").write_text(json_text({**RECORD, "stages": [{"outputs": outputs}]}))
    folder = folder_in(tmp_path)
    assert sorted(path.name for path in run.iterdir()) == ["note.txt", "old", "run.json"]  # until this run has ended
    assert folder.earlier == {"old"}
    folder.settle()
    assert sorted(path.name for path in run.iterdir()) == ["note.txt", "run.json"]
    assert outside.read_text() == "precious"


def test_a_run_directory_is_for_one_run_at_a_time(tmp_path):
    folder = folder_in(tmp_path)
    with pytest.raises(ResourceError, match="another run is writing"):
        RunFolder(tmp_path / "run").prepare()
    folder.discard()
    folder_in(tmp_path).discard()


def test_what_is_there_already_is_recognized_to_the_byte(tmp_path):
    folder = folder_in(tmp_path)
    folder.claim("s", "a.txt").write_text("hello")
    folder.claim("s", "slices").mkdir()
    (tmp_path / "run" / ".staging-x").mkdir()
    (folder.claim("s", "slices") / "0.png").write_text("0")
    outputs = folder.commit()
    folder.discard()
    (tmp_path / "run" / "run.json").write_text(json_text(RECORD))

    def held():
        again = folder_in(tmp_path)
        try:
            return again.holds("s", outputs)
        finally:
            again.discard()

    assert held()
    for change in (
        lambda: (tmp_path / "run" / "a.txt").write_text("hullo"),
        lambda: (tmp_path / "run" / "a.txt").unlink(),
        lambda: (tmp_path / "run" / "slices" / "1.png").write_text(""),
        lambda: (tmp_path / "run" / "slices" / "0.png").write_text("1"),
    ):
        before = {p: p.read_bytes() for p in (tmp_path / "run").rglob("*") if p.is_file()}
        change()
        assert not held()
        for extra in [p for p in (tmp_path / "run").rglob("*") if p.is_file() and p not in before]:
            extra.unlink()
        for path, data in before.items():
            path.write_bytes(data)
    assert held()


def test_what_dead_processes_left_is_removed(tmp_path):
    run = tmp_path / "run"
    (run / ".staging-999999999" / "x").mkdir(parents=True)
    folder_in(tmp_path)  # killed before its first record was written
    assert (run / ".staging-999999999").exists() is False


def test_a_directory_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ResourceError):
        RunFolder(tmp_path / "file" / "run").prepare()


def test_text_files_are_whole_or_absent(tmp_path, monkeypatch):
    path = tmp_path / "a.json"
    write_whole(path, "old")

    def full(number):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ResourceError, match="No space left"):
        write_whole(path, "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.json"]


@pytest.mark.parametrize("durable", [True, False])
def test_a_durable_file_is_on_the_disk_before_it_gets_its_name(tmp_path, monkeypatch, durable):
    """Otherwise the name may outlive the content when the machine stops."""
    done, fsync, rename = [], os.fsync, os.replace

    def synced(descriptor):
        done.append(("sync", os.fstat(descriptor).st_ino, os.fstat(descriptor).st_size))
        fsync(descriptor)

    def replaced(source, target):
        done.append(("rename", os.stat(source).st_ino, os.stat(source).st_size))
        rename(source, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", replaced)
    write_whole(tmp_path / "a.json", "content", durable=durable)
    found = (tmp_path / "a.json").stat()
    steps = ["sync", "rename"] if durable else ["rename"]
    assert done[: len(steps)] == [(step, found.st_ino, len("content")) for step in steps]
    assert [(step, inode) for step, inode, _ in done[len(steps) :]] == [("sync", tmp_path.stat().st_ino)] * durable


def test_files_of_a_run_are_synced(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: synced.append(os.fstat(descriptor).st_ino))
    (tmp_path / "a").write_bytes(b"a")
    sync(tmp_path / "a")
    assert synced == [(tmp_path / "a").stat().st_ino]


@pytest.mark.parametrize("changed", [False, True])
def test_a_digest_that_a_writer_tells_counts_until_the_file_changes(tmp_path, changed):
    folder = folder_in(tmp_path)
    path = folder.claim("s", "a/x.bin")
    path.write_bytes(b"one")
    folder.hashed("a/x.bin", "0" * 64)
    if changed:
        path.write_bytes(b"three")
    (found,) = folder.commit()
    assert found["sha256"] == (hashlib.sha256(b"three").hexdigest() if changed else "0" * 64)


def test_temporary_files_go_with_the_run(tmp_path):
    folder = folder_in(tmp_path)
    (folder.temporary() / "x").write_bytes(b"x")
    folder.discard()
    assert [p.name for p in (tmp_path / "run").iterdir()] == []


@pytest.mark.parametrize("linked", [True, False])
def test_recorded_outputs_behind_a_link_are_left_alone(tmp_path, linked):
    """A record may have been changed by hand, or the folder have become a link to another since."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "mine.txt").write_text("mine")
    run = tmp_path / "run"
    run.mkdir()
    if linked:
        (run / "sub").symlink_to(outside)
    else:
        (run / "sub").mkdir()
        (run / "sub" / "mine.txt").write_text("old")
    outputs = [{"path": "sub/mine.txt"}, {"path": "../outside/mine.txt"}]
    (run / "run.json").write_text(json_text({"sppm_run": 1, "stages": [{"outputs": outputs}]}))
    folder = RunFolder(run)
    folder.prepare()
    assert folder.earlier == (set() if linked else {"sub/mine.txt"})
    folder.settle()
    folder.discard()
    assert (outside / "mine.txt").read_text() == "mine"
    assert (run / "sub").exists() is linked
