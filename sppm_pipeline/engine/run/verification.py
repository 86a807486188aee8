"""Verification of a run directory: it still holds what its record says, to the byte."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.cache.identity import arithmetic, installed_version
from sppm_pipeline.engine.config.document import RECORD_KEY
from sppm_pipeline.engine.config.names import REPORT
from sppm_pipeline.engine.files import digest_of, files_in, tree_digest
from sppm_pipeline.engine.run.outputs import RECORD, SUMS, SWEEP_RUNS
from sppm_pipeline.engine.run.record import versions
from sppm_pipeline.engine.strict_json import BrokenSealError, read_sealed
from sppm_pipeline.errors import InputError

_LINE = re.compile(r"([0-9a-f]{64})  (.+)")


@dataclass(frozen=True)
class Finding:
    """One thing that is not as it should be: `kind` is "changed", "missing", "extra" or "unfinished"."""

    path: str
    kind: str
    detail: str


def verify_run(path: Path, threads: int = 1) -> tuple[list[Finding], int]:
    """Check the record, every output, and that there is nothing else; of a sweep, all its runs.

    Returns the findings in the order of their paths, and how many files were read; `InputError` if there is no run.
    """
    if not (path / RECORD).is_file():
        raise InputError(f"{str(path)!r} holds no run: there is no {RECORD}", hint="name the directory of a run")
    with ThreadPoolExecutor(max(1, threads)) as pool:
        found, files = _verify(path, "", pool, None)
    order = {"unfinished": 0, "missing": 1, "changed": 2, "extra": 3}
    return sorted(found, key=lambda f: (f.path, order[f.kind])), files


def finished_run(path: Path, key: str) -> dict[str, Any] | None:
    """The record of a run that has ended well and has this key, if all that it wrote is there to the byte."""
    try:
        record = read_sealed((path / RECORD).read_bytes())
    except (OSError, ValueError):
        return None
    if record.get("key") != key or record.get("status") != "done":
        return None
    return record if not verify_run(path)[0] else None


def differences(path: Path) -> list[str]:
    """Differences between this machine and that of the run that may change the last digits of a repeat.

    A record that can't be read has none to tell.
    """
    try:
        record = read_sealed((path / RECORD).read_bytes())
    except (OSError, ValueError):
        return []
    then, now = record.get("platform", {}), arithmetic()
    names = dict.fromkeys((*(name for name in then if name.isupper()), *now))
    pairs = [(name, then.get(name), now.get(name)) for name in names if name.isupper() or name in then]
    known = versions()
    pairs += [(name, was, known.get(name, installed_version(name))) for name, was in record.get("versions", {}).items()]
    # a run from the cache has compiled nothing, and so may this process
    optional = {"numba_target"}
    return [
        f"{name} was {was or 'not set'}, here it is {here or 'not there'}"
        for name, was, here in pairs
        if was != here and not (name in optional and None in (was, here))
    ]


def _verify(path: Path, prefix: str, pool: ThreadPoolExecutor, seal: str | None) -> tuple[list[Finding], int]:
    """Check one run directory; `prefix` is where it lies in that of its sweep, `seal` the digest of its record."""
    try:
        record = read_sealed((path / RECORD).read_bytes())
        if RECORD_KEY not in record:
            raise BrokenSealError("it is no record of a run")
        # a row that was run again by itself is not part of the table any more
        if seal is not None and record["sha256"] != seal:
            raise BrokenSealError("it is not the record that belongs to this sweep")
    except (BrokenSealError, ValueError) as error:
        return [Finding(prefix + RECORD, "changed", f"{error}; the rest can't be judged")], 1
    found: list[Finding] = []
    if record["status"] not in ("done", "failed"):
        found.append(Finding(prefix + RECORD, "unfinished", f"the run is {record['status']}"))
    outputs = [out for stage in record["stages"] for out in stage.get("outputs", ())] + record.get("outputs", [])
    sums, problem = _read_sums(path, record.get("sums"))
    if problem is not None:
        found.append(Finding(prefix + SUMS, *problem))
    wanted: dict[str, str | None] = {}
    for output in outputs:
        name = output["path"]
        if "files" not in output:
            wanted[name] = output["sha256"]
            continue
        inside = {n.removeprefix(f"{name}/"): digest for n, digest in sums.items() if n.startswith(f"{name}/")}
        # the list names the file of a folder that has changed, the digest of the folder only that one has
        if len(inside) == output["files"] and tree_digest(inside) == output["sha256"]:
            wanted |= {f"{name}/{n}": digest for n, digest in inside.items()}
        else:
            # without a sound list only the folder as a whole can be judged
            there = files_in(path / name) if (path / name).is_dir() else []
            wanted |= dict.fromkeys(f"{name}/{n}" for n in there)
            if tree_digest({n: digest_of(path / name / n) for n in there}) != output["sha256"]:
                found.append(Finding(prefix + name, "changed", "its files are not those that were written"))
    found += _compare(path, prefix, wanted, pool)
    runs = record.get("runs", [])
    known = {RECORD, SUMS, REPORT, *wanted} | {name for name in record.get("earlier", ()) if record["status"] != "done"}
    files = len(wanted) + 2
    for run in runs:
        place = f"{SWEEP_RUNS}/{run['run']}"
        if not (path / place / RECORD).is_file():
            found.append(Finding(f"{prefix}{place}/{RECORD}", "missing", ""))
        else:
            inner, count = _verify(path / place, f"{prefix}{place}/", pool, run.get("record"))
            found, files = found + inner, files + count
    own = {f"{SWEEP_RUNS}/{run['run']}/" for run in runs}
    for name in files_in(path):
        covered = any(name.startswith(f"{earlier}/") for earlier in record.get("earlier", ()))
        if name not in known and not covered and not any(name.startswith(run) for run in own):
            found.append(Finding(prefix + name, "extra", "no stage has written it"))
    return found, files


def _read_sums(path: Path, listed: Mapping[str, Any] | None) -> tuple[dict[str, str], tuple[str, str] | None]:
    """The list of digests, and what is wrong with it."""
    try:
        data = (path / SUMS).read_bytes()
    except FileNotFoundError:
        return {}, None if listed is None else ("missing", "")
    if listed is None:
        return {}, ("extra", "the record does not list it")
    matches = (_LINE.fullmatch(line) for line in data.decode("utf-8", "replace").splitlines())
    sums = {match[2]: match[1] for match in matches if match}
    intact = hashlib.sha256(data).hexdigest() == listed["sha256"]
    return sums, None if intact else ("changed", "its content does not fit its digest")


def _compare(path: Path, prefix: str, wanted: Mapping[str, str | None], pool: ThreadPoolExecutor) -> Iterable[Finding]:
    def look(name: str) -> Finding | None:
        file, digest = path / name, wanted[name]
        if not file.is_file():
            return Finding(prefix + name, "missing", "")
        if digest is not None and digest_of(file) != digest:
            return Finding(prefix + name, "changed", "its content does not fit its digest")
        return None

    return [finding for finding in pool.map(look, wanted) if finding is not None]
