"""Running out of disk, permissions, descriptors or listeners: one clear line, exit 5, nothing half-written.

Each case is a child process under a real limit of the system.
"""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

PART = """sppm: 1
name: part
pipeline:
  - {stage: read.primitive, shape: torus_knot, size: [9 mm, 9 mm, 9 mm], facets: 200}
  - {stage: write.mesh, path: part.stl}
"""
LAYERS = """sppm: 1
name: layers
pipeline:
  - {stage: sample.elimination, count: 30, edge: 9 mm}
  - {stage: connect.mst}
  - {stage: field.gaussian, pore_radius: 1 mm, tunnel_radius: 0.4 mm}
  - {stage: slice.field, pixel: 0.15 mm}
  - {stage: write.png, path: slices}
"""


@pytest.fixture
def here(tmp_path):
    (tmp_path / "part.yaml").write_text(PART)
    (tmp_path / "layers.yaml").write_text(LAYERS)
    return tmp_path


def sppm(*words: str, cwd: Path, before=None, **how) -> subprocess.CompletedProcess:
    how = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **how}
    command = [sys.executable, "-m", "sppm_pipeline.engine.cli.main", *words, "--no-plugins"]
    return subprocess.run(command, cwd=cwd, preexec_fn=before, text=True, timeout=600, check=False, **how)


def one_line(done: subprocess.CompletedProcess, *words: str) -> None:
    lines = done.stderr.splitlines()
    assert done.returncode == 5, done.stderr
    assert "Traceback" not in done.stderr
    assert sum(line.startswith("sppm: ") for line in lines) == 1, done.stderr
    assert len(lines) <= 2, done.stderr
    assert all(word in done.stderr for word in words), done.stderr


def left(folder: Path) -> list[str]:
    """What lies in a run directory, its record apart."""
    return sorted(path.name for path in folder.iterdir() if path.name != "run.json") if folder.exists() else []


@pytest.mark.parametrize(("name", "limit"), [("part", 200_000), ("layers", 300)])
def test_a_limit_of_the_size_of_files(here, name, limit):
    sppm("run", f"{name}.yaml", "-q", "-o", "warm", cwd=here)  # so that no compiled kernel has to be kept

    def before():
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    done = sppm("run", f"{name}.yaml", "-q", "-o", "out", cwd=here, before=before)
    one_line(done, "File too large")
    assert left(here / "out") == []


def test_a_limit_below_the_record_itself(here):
    done = sppm("run", "part.yaml", "-q", "-o", "out", cwd=here,
                before=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)))  # fmt: skip
    one_line(done, "File too large")
    assert not (here / "out").exists() or os.listdir(here / "out") == []


@pytest.mark.parametrize("limit", [4, 5, 6, 7, 8, 10])
def test_a_limit_of_open_files(here, limit):
    """Python itself may be unable to start; once it runs, it says what is missing."""
    done = sppm("run", "layers.yaml", "-q", "-o", "out", cwd=here,
                before=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit)))  # fmt: skip
    if done.returncode == 0:
        assert left(here / "out") == ["SHA256SUMS", "slices", "slices-overview.png"]
        return
    assert left(here / "out") == []
    if "sppm: " in done.stderr:
        one_line(done, "Too many open files")
    else:
        assert limit < 5, done.stderr


GREEDY = '''
import os
from dataclasses import dataclass
from typing import ClassVar
from sppm_pipeline.stage import Context, Stage

@dataclass(frozen=True, kw_only=True)
class Greedy(Stage):
    """Take all descriptors there are, half a file written."""
    name: ClassVar[str] = "write.greedy"
    def run(self, context: Context) -> None:
        folder = context.output("half")
        (folder / "deeper").mkdir(parents=True)
        (folder / "deeper" / "half.txt").write_text("half")
        while True:
            os.dup(0)
'''


def test_a_stage_that_leaves_no_descriptor(here):
    """Nobody can write or list a folder any more but the parent of the process that runs."""
    (here / "greedy.py").write_text(GREEDY)
    (here / "greedy.yaml").write_text("sppm: 1\npipeline: [write.greedy]\n")
    done = sppm("run", "greedy.yaml", "-q", "-o", "out", "--plugin", "greedy.py", cwd=here,
                before=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64)))  # fmt: skip
    one_line(done, "Too many open files")
    assert left(here / "out") == []
    assert json.loads((here / "out" / "run.json").read_text())["status"] == "failed"


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 300 kB."""
    place = tmp_path / "small"
    place.mkdir()
    mount = shutil.which("mount")
    if mount is None or subprocess.run([mount, "-t", "tmpfs", "-o", "size=300k", "tmpfs", place], check=False,
                                       capture_output=True).returncode:  # fmt: skip
        pytest.skip("no right to mount a small file system")
    yield place
    subprocess.run(["umount", "--lazy", place], check=False)  # a store may have a file open


@pytest.mark.parametrize("name", ["part", "layers"])
def test_a_full_disk(here, small_disk, name):
    # the estimate would refuse the run at once; here the disk fills up while it goes on
    code = (
        "import sys; from sppm_pipeline.engine.plan import estimate; estimate.free_disk = lambda folder: None\n"
        "from sppm_pipeline.engine.cli.main import leave; sys.argv = ['sppm', *sys.argv[1:]]; leave()"
    )
    (small_disk / "filler").write_bytes(b"x" * 200_000)
    words = ["run", f"{name}.yaml", "-q", "-o", str(small_disk / "out"), "--no-plugins"]
    done = subprocess.run([sys.executable, "-c", code, *words], cwd=here, capture_output=True, text=True, check=False)
    one_line(done, "stage 'write.", "No space left on device", "hint: make room on the disk")
    assert left(small_disk / "out") == []


def test_a_full_disk_of_the_cache(here, small_disk, monkeypatch):
    """The result is what was asked for, and it is there."""
    (small_disk / "filler").write_bytes(b"x" * 300_000)
    monkeypatch.setenv("SPPM_CACHE", str(small_disk / "cache"))
    done = sppm("run", "part.yaml", "-o", "out", cwd=here)
    assert done.returncode == 0, done.stderr
    assert "part.stl" in left(here / "out")
    from sppm_pipeline.engine.cache.store import Store
    from sppm_pipeline.engine.plan.estimate import Seen, remember

    remember(Store(small_disk / "cache"), [("write.mesh", Seen(2.0, 1.0, 1e8, 1e8))])  # which is not worth an error
    assert not (small_disk / "cache").exists() or not any((small_disk / "cache").glob("*.json"))


def test_a_full_disk_is_estimated(here, small_disk):
    done = sppm("run", "part.yaml", "-q", "-o", str(small_disk / "out"), cwd=here)
    one_line(done, "would be written", "free where")
    assert not (small_disk / "out").exists()


def test_a_read_only_disk(here, small_disk):
    if subprocess.run(["mount", "-o", "remount,ro", small_disk], check=False, capture_output=True).returncode:
        pytest.skip("can't be made read-only")
    one_line(sppm("run", "layers.yaml", "-q", "-o", str(small_disk / "out"), cwd=here), "Read-only file system")


@pytest.mark.skipif(os.geteuid() == 0, reason="permissions do not bind root")
def test_a_folder_without_permission(here):
    (here / "closed").mkdir(mode=0o500)
    one_line(sppm("run", "part.yaml", "-q", "-o", "closed/out", cwd=here), "Permission denied")


@pytest.fixture
def open_place():
    """A folder that everybody can enter and read, which those of pytest are not."""
    with tempfile.TemporaryDirectory() as place:
        os.chmod(place, 0o755)
        yield Path(place)


@pytest.mark.skipif(os.geteuid() != 0, reason="needs the right to become somebody else")
@pytest.mark.parametrize("verb", ["run", "check"])
def test_somebody_without_permissions(open_place, tmp_path, verb):
    """In a child that gives up being root after it has loaded the program."""
    (open_place / "part.yaml").write_text(PART)
    (open_place / "secret.yaml").write_text(PART)
    (open_place / "secret.yaml").chmod(0o600)
    name = "secret" if verb == "check" else "part"
    code = (
        "import os, sys; from sppm_pipeline.engine.cli.main import main\n"
        "assert main(['run', 'part.yaml', '--no-plugins', '-q', '-o', sys.argv.pop(1)]) == 0\n"
        "os.setgroups([]); os.setgid(65534); os.setuid(65534)\n"
        "sys.exit(main(sys.argv[1:]))"
    )
    words = [verb, f"{name}.yaml", "--no-plugins", *(["-q"] if verb == "run" else [])]
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "out"), *words],
        cwd=open_place,
        capture_output=True,
        text=True,
        check=False,
    )
    one_line(done, "Permission denied")


@pytest.mark.parametrize("words", [["schema"], ["run", "part.yaml"]])
def test_nobody_listens(here, words):
    """Whoever read the results has gone; whoever read the messages, too."""
    done = sppm(*words, cwd=here, stdout=broken_pipe())
    assert (done.returncode, done.stderr.count("Traceback")) == (0, 0)
    assert "rror" not in done.stderr
    assert sppm(*words, cwd=here, stderr=broken_pipe()).returncode == 0
    assert sppm(*words, cwd=here, stdout=broken_pipe(), stderr=broken_pipe()).returncode == 0


def test_nobody_hears_the_error(here):
    assert sppm("check", "missing.yaml", cwd=here, stderr=broken_pipe()).returncode == 2


def broken_pipe() -> int:
    read, write = os.pipe()
    os.close(read)
    return write


@pytest.mark.parametrize("closed", [[1], [2], [0, 1, 2]])
@pytest.mark.parametrize("words", [["run", "part.yaml"]])
def test_streams_that_were_never_open(here, words, closed):
    def before():
        for number in closed:
            os.close(number)

    done = sppm(*words, cwd=here, before=before)
    assert done.returncode == 0
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_behind_stdout(here):
    with open("/dev/full", "w") as full:
        done = sppm("schema", cwd=here, stdout=full)
    one_line(done, "No space left on device")
    with open("/dev/full", "w") as full:
        assert sppm("run", "part.yaml", cwd=here, stderr=full).returncode == 0


@pytest.mark.parametrize(
    "number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.EMFILE, errno.ENAMETOOLONG]
)
def test_errors_of_the_system_in_a_stage(tmp_path, monkeypatch, capsys, number):
    from sppm_pipeline.engine.cli.main import main
    from sppm_pipeline.method.part import primitive_meshes

    def fails(*args, **kwargs):
        raise OSError(number, os.strerror(number), "place")

    monkeypatch.setattr(primitive_meshes, "torus_knot_mesh", fails)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "part.yaml").write_text(PART)
    assert main(["run", "part.yaml", "-q", "--no-plugins"]) == 5
    err = capsys.readouterr().err
    assert err.startswith("sppm: part.yaml:4:13: stage 'read.primitive': ")
    assert os.listdir(tmp_path / "runs" / "part") == ["run.json"]


def test_too_little_address_space(here):
    """Memory that is refused while a stage works, where nothing was estimated."""
    code = (
        "import resource, sys; from sppm_pipeline.engine.plan import checking\n"
        "checking.unfit_problems = lambda *a, **k: []\n"
        "import sppm_pipeline.method.stages.extract_voxels, sppm_pipeline.method.stages.field_gaussian, numba\n"
        "resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30))\n"
        "from sppm_pipeline.engine.cli.main import leave; sys.argv = ['sppm', *sys.argv[1:]]; leave()"
    )
    (here / "large.yaml").write_text(  # one byte for each of a thousand million voxels, at once
        LAYERS[: LAYERS.index("  - {stage: slice")] + "  - {stage: extract.voxels, resolution: 1024}\n"
    )
    words = ["run", "large.yaml", "-q", "-o", "out", "--no-plugins", "--threads", "1"]
    done = subprocess.run([sys.executable, "-c", code, *words], cwd=here, capture_output=True, text=True, check=False)
    one_line(done, "not enough memory", "stage 'extract.voxels'")
    assert left(here / "out") == []
