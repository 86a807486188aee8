import errno
import fcntl
import os
import threading
import time

import pytest

from sppm_pipeline.engine import locks
from sppm_pipeline.engine.locks import CLAIM, FolderLock
from sppm_pipeline.engine.run.outputs import RunFolder
from sppm_pipeline.errors import ResourceError


@pytest.fixture(params=["no fcntl", "no flock on this file system"])
def without_flock(request, monkeypatch):
    """A system or file system without the call."""

    def refused(*args):
        raise OSError(errno.ENOTSUP, os.strerror(errno.ENOTSUP))

    if request.param == "no fcntl":
        monkeypatch.setattr(locks, "fcntl", None)
    else:
        monkeypatch.setattr(fcntl, "flock", refused)


def test_a_claimed_folder_is_nobody_elses_until_it_is_released(tmp_path, without_flock):
    first, second = FolderLock(tmp_path), FolderLock(tmp_path)
    assert first.acquire()
    assert not second.acquire()
    assert f"process {os.getpid()} on " in second.holder
    first.release()
    first.release()
    assert list(tmp_path.iterdir()) == []
    assert second.acquire()
    second.release()


def test_a_claim_is_waited_for_until_it_is_released(tmp_path, without_flock):
    first, second = FolderLock(tmp_path), FolderLock(tmp_path)
    assert first.acquire()
    got = []
    thread = threading.Thread(target=lambda: got.append(second.acquire(wait=True)))
    thread.start()
    thread.join(0.2)
    assert (thread.is_alive(), got) == (True, [])
    first.release()
    thread.join(60)
    assert got == [True]
    second.release()
    assert list(tmp_path.iterdir()) == []


def test_nobody_waits_for_a_claim_without_signs_of_life(tmp_path, without_flock, monkeypatch):
    (tmp_path / CLAIM).write_text("process 1 on another host")
    monkeypatch.setattr(locks, "HEARTBEAT", 0.05)
    lock = FolderLock(tmp_path)
    assert not lock.acquire(wait=True)
    assert lock.holder.startswith("process 1 on another host, last heard of at ")


def test_whoever_claims_gives_signs_of_life(tmp_path, without_flock, monkeypatch):
    monkeypatch.setattr(locks, "HEARTBEAT", 0.01)
    lock = FolderLock(tmp_path)
    assert lock.acquire()
    os.utime(tmp_path / CLAIM, (0, 0))
    end = time.monotonic() + 60
    while (tmp_path / CLAIM).stat().st_mtime == 0 and time.monotonic() < end:
        time.sleep(0.01)
    assert (tmp_path / CLAIM).stat().st_mtime > 0
    lock.release()


def test_a_claim_that_was_left_behind_is_named_and_not_stolen(tmp_path, without_flock):
    folder = RunFolder(tmp_path / "run")
    folder.prepare()
    claim = tmp_path / "run" / CLAIM
    text = claim.read_text()
    folder.discard()
    claim.write_text(text)  # as a killed process leaves it
    os.utime(claim, (0, 0))
    with pytest.raises(ResourceError, match=r"1970-01-01 00:00:00 UTC; if it is gone, remove '.*\.claim'") as caught:
        RunFolder(tmp_path / "run").prepare()
    assert f"process {os.getpid()} on " in caught.value.message
    assert claim.read_text() == text
    claim.unlink()
    again = RunFolder(tmp_path / "run")
    again.prepare()
    again.discard()
    assert list((tmp_path / "run").iterdir()) == []


def test_a_file_without_flock_is_not_claimed(tmp_path, without_flock):
    (tmp_path / "usage").write_text("7")
    lock = FolderLock(tmp_path / "usage")
    assert lock.acquire(wait=True)
    lock.release()
    assert [path.name for path in tmp_path.iterdir()] == ["usage"]


def test_the_claim_of_somebody_else_is_left_alone(tmp_path, without_flock):
    lock = FolderLock(tmp_path)
    assert lock.acquire()
    successor = tmp_path / "new"  # made first, so that it is another file for sure
    successor.write_text("process 1 on another host")
    successor.replace(tmp_path / CLAIM)
    lock.release()
    assert (tmp_path / CLAIM).read_text() == "process 1 on another host"


def test_a_claim_that_could_not_be_written_is_nobodys(tmp_path, without_flock, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    lock = FolderLock(tmp_path)
    with monkeypatch.context() as patched:
        patched.setattr(locks, "_moment", full)
        with pytest.raises(OSError, match="No space"):
            lock.acquire()
    assert list(tmp_path.iterdir()) == []
    assert lock.acquire()
    lock.release()
