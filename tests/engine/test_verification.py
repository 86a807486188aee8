"""Whatever has changed in a run directory is found, and nothing else is."""

from __future__ import annotations

import json
import shutil
import subprocess

import numpy as np
import pytest

from sppm_pipeline.engine.cache.identity import arithmetic
from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.run import verification
from sppm_pipeline.engine.run.record import versions
from sppm_pipeline.engine.run.sweep import run_sweep
from sppm_pipeline.engine.run.verification import differences, verify_run
from sppm_pipeline.errors import DesignError, InputError

SINGLE = """name: single
seed: 3
pipeline:
  - {stage: sample.random, count: 4}
  - {stage: write.number, path: sub/result.txt}
  - {stage: write.number, id: other, path: other.txt}
  - {stage: write.folder}
"""

SWEEP = SINGLE.replace("seed: 3", "seed: 3\nparams: {count: 1}").replace("count: 4", 'count: "${count}"') + (
    "sweep: {count: [1, 2, 3]}\nafter: [{stage: write.column, column: sample.random.value}]\n"
)

FOLDER = """
from dataclasses import dataclass
from typing import ClassVar
from sppm_pipeline.stage import Context, Stage
from tests.synthetic import Number

@dataclass(frozen=True, kw_only=True)
class WriteFolder(Stage):
    '''Write a folder.'''
    name: ClassVar[str] = "write.folder"
    def run(self, context: Context, number: Number) -> None:
        folder = context.output("layers")
        (folder / "deep").mkdir(parents=True)
        for i in range(4):
            (folder / "deep" / f"{i}.bin").write_bytes(bytes([i]) * 50)
"""


@pytest.fixture(autouse=True)
def unset(monkeypatch):
    """Whoever runs the tests may have set how OpenBLAS computes, which a run records."""
    monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)


@pytest.fixture(params=["single", "sweep"])
def out(work, request):
    plugin = work.write(FOLDER, "folder.py")
    if request.param == "single":
        work.run(SINGLE, plugins=[plugin])
    else:
        session = work.session(SWEEP, plugins=[plugin])
        run_sweep(session, session.plan(), work.folder / "out")
    return work.folder / "out"


def found(out):
    findings, _ = verify_run(out, 2)
    return [(finding.kind, finding.path) for finding in findings]


def every_file(out):
    return sorted(p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file())


def test_what_was_written_is_right(out):
    findings, files = verify_run(out)
    assert findings == []
    assert files == len(every_file(out))
    assert main(["verify", str(out)]) == 0


def test_any_flipped_byte_is_found(out):
    rng = np.random.default_rng(1)
    for name in every_file(out):
        data = (out / name).read_bytes()
        for at in {0, len(data) - 1, *rng.integers(0, len(data), 6).tolist()}:
            changed = bytearray(data)
            changed[at] ^= 1 << int(rng.integers(8))
            (out / name).write_bytes(changed)
            kinds = found(out)
            # a digest in a broken list also makes the folder's content unsure, but never unnoticed
            assert ("changed", name) in kinds, (name, at, kinds)
            assert main(["verify", str(out)]) == 3
        (out / name).write_bytes(data)
    assert found(out) == []


def test_missing_and_extra_files_are_found(out, tmp_path):
    for name in every_file(out):
        if name == "run.json":
            continue
        (out / name).rename(tmp_path / "aside")
        assert ("missing", name) in found(out)
        (tmp_path / "aside").rename(out / name)
    for place in {(out / name).parent for name in every_file(out)}:
        (place / "note.txt").write_text("mine")
        extra = (place / "note.txt").relative_to(out).as_posix()
        assert ("extra", extra) in found(out)
        (place / "note.txt").unlink()
    assert found(out) == []


def test_two_files_that_have_changed_places_are_found(out):
    (deep,) = sorted(out.rglob("deep"))[:1]
    a, b = deep / "0.bin", deep / "1.bin"
    a.rename(deep / "x")
    b.rename(a)
    (deep / "x").rename(b)
    assert {kind for kind, _ in found(out)} == {"changed"}
    assert len(found(out)) == 2


def test_extra_files_can_be_accepted_and_findings_are_json(out, capsys):
    (out / "note.txt").write_text("mine")
    assert main(["verify", str(out), "--json"]) == 3
    (finding,) = json.loads(capsys.readouterr().out)["findings"]
    assert (finding["path"], finding["kind"]) == ("note.txt", "extra")
    assert main(["verify", str(out), "--extra-ok"]) == 0


@pytest.mark.skipif(shutil.which("sha256sum") is None, reason="needs the command sha256sum")
def test_the_list_is_one_that_others_can_check(out):
    for sums in out.rglob("SHA256SUMS"):
        done = subprocess.run(["sha256sum", "-c", "--quiet", sums.name], cwd=sums.parent, check=False)
        assert done.returncode == 0


def test_a_row_of_another_sweep_is_found(work):
    plugin = work.write(FOLDER, "folder.py")
    for to, seed in (("a", 1), ("b", 2)):
        session = work.session(SWEEP, plugins=[plugin], seed=seed)
        run_sweep(session, session.plan(), work.folder / to)
    shutil.rmtree(work.folder / "a" / "runs" / "0001")
    shutil.copytree(work.folder / "b" / "runs" / "0001", work.folder / "a" / "runs" / "0001")
    assert found(work.folder / "a") == [("changed", "runs/0001/run.json")]


def test_runs_that_did_not_end(work):
    text = SINGLE.replace("{stage: write.folder}", "{stage: check.fail, how: design}")
    with pytest.raises(DesignError):
        work.run(text)
    assert found(work.folder / "out") == []  # failed, but all that it says is true
    with pytest.raises(KeyboardInterrupt):
        work.run(text.replace("how: design", "how: interrupt"))
    assert found(work.folder / "out") == [("unfinished", "run.json")]


def test_what_is_no_run(tmp_path):
    with pytest.raises(InputError, match="holds no run"):
        verify_run(tmp_path)
    assert main(["verify", str(tmp_path / "nowhere")]) == 3


def test_what_differs_from_where_a_run_was_made_is_told(out, monkeypatch, capsys):
    assert differences(out) == []
    here = arithmetic()
    assert here["processor"]
    assert json.loads((out / "run.json").read_text())["platform"].items() >= {
        "instructions": here["instructions"], "blas": here["blas"]
    }.items()  # fmt: skip
    monkeypatch.setattr(verification, "arithmetic", lambda: here | {"instructions": "others", "OPENBLAS_CORETYPE": "X"})
    monkeypatch.setattr(verification, "versions", lambda: {**versions(), "numba": "0.1"})
    told = differences(out)
    assert sorted(line.split(" was ")[0] for line in told) == ["OPENBLAS_CORETYPE", "instructions", "numba"]
    assert f"OPENBLAS_CORETYPE was {here.get('OPENBLAS_CORETYPE') or 'not set'}, here it is X" in told
    capsys.readouterr()
    assert main(["verify", str(out)]) == 0  # nothing was changed
    printed = capsys.readouterr().out
    assert "may differ in last digits" in printed
    assert "numba was" in printed
    (out / "run.json").write_text("{}")
    assert differences(out) == []
