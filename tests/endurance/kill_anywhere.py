"""Kill runs anywhere, run the same command again, and compare every byte with a run that nobody disturbed.

    python tests/endurance/kill_anywhere.py --kills 150 --concurrent 8

A process is killed at a random time, or just before its n-th change to the disk (see `hooks/sitecustomize.py`): the
whole group, the supervising parent alone, or the working child alone. Now and then the second run is killed as well.
Then the run directory has to be what it is in an undisturbed run, without a leftover in it or in the cache, and no
process may be left. At last many runs share one cache while some are killed.

Ends with 0 if nothing was found, else with 1 and a line for each finding.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import psutil

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from pipelines import PIPELINES  # noqa: E402 - found beside this file, however it is started

TIMES = ("started", "seconds", "peak_memory_mb", "sha256", "threads")


class Bench:
    """A folder in which runs are started, killed and compared."""

    def __init__(self, root: Path, seed: int) -> None:
        self.root = root
        self.random = random.Random(seed)
        self.findings: list[str] = []
        self.kills = 0
        self.changes: dict[str, int] = {}
        self.seconds: dict[str, float] = {}
        self.reference: dict[str, dict[str, bytes]] = {}
        for name, (text, _) in PIPELINES.items():
            (root / f"{name}.yaml").write_text(text, encoding="utf-8")

    def start(self, name: str, out: str, cache: str | None, **environment: str) -> subprocess.Popen[str]:
        """Start a run in a process group of its own."""
        caching = ["--no-cache"] if cache is None else ["--cache", cache]
        path = os.pathsep.join(filter(None, [str(HERE / "hooks"), os.environ.get("PYTHONPATH")]))
        return subprocess.Popen(
            [sys.executable, "-m", "sppm_pipeline", "run", f"{name}.yaml", "-o", out, "-q", "--threads", "1",
             "--no-plugins", *PIPELINES[name][1], *caching],
            cwd=self.root, env={**os.environ, **environment, "PYTHONPATH": path, "ENDURANCE": str(self.root)},
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip

    def measure(self, names: Sequence[str]) -> None:
        """Run each pipeline undisturbed, twice: for its files, and for its time and its changes to the disk."""
        for name in names:
            _, err = (process := self.start(name, f"ref-{name}", None)).communicate()
            assert process.returncode == 0, err
            self.reference[name] = self.files(f"ref-{name}")
            shutil.rmtree(self.root / f"ref-{name}")
            began = time.monotonic()
            process = self.start(name, "timed", str(self.root / "timed-cache"), COUNT_INTO=str(self.root / "count"))
            _, err = process.communicate()
            assert process.returncode == 0, err
            self.seconds[name] = time.monotonic() - began
            self.changes[name] = max(int(path.read_text()) for path in self.root.glob("count-*"))
            self.compare(name, "timed", "timed-cache", "first run with a cache")
            for path in self.root.glob("count-*"):
                path.unlink()
            shutil.rmtree(self.root / "timed")
            shutil.rmtree(self.root / "timed-cache")

    def files(self, out: str) -> dict[str, bytes]:
        """All files of a run directory, records without their times."""
        folder = self.root / out
        found = {}
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                data = path.read_bytes()
                found[path.relative_to(folder).as_posix()] = timeless(data) if path.name == "run.json" else data
        return found

    def compare(self, name: str, out: str, cache: str, what: str) -> None:
        """Every byte as in the undisturbed run, and nothing left over."""
        found, wanted = self.files(out), self.reference[name]
        for file in sorted({*found, *wanted}):
            if found.get(file) != wanted.get(file):
                kind = "missing" if file not in found else "extra" if file not in wanted else "different"
                self.findings.append(f"{what}: {name}: {file} is {kind}")
        left = [p.name for p in (self.root / cache / "tmp").glob("*")]
        if left:
            self.findings.append(f"{what}: {name}: left in the cache: {left}")

    def processes(self) -> list[int]:
        """Processes of this bench that are still there."""
        return [
            process.pid
            for process in psutil.process_iter(["environ", "status"])
            if (process.info["environ"] or {}).get("ENDURANCE") == str(self.root)
            and process.info["status"] != psutil.STATUS_ZOMBIE
        ]

    def kill_one(self, name: str, out: str, cache: str) -> str:
        """Start a run and kill it somewhere; what was done."""
        self.kills += 1
        if self.random.random() < 0.5:
            at = self.random.randint(1, self.changes[name])
            self.start(name, out, cache, KILL_AT=str(at)).communicate()
            return f"killed before change {at}"
        after = self.random.uniform(0.0, self.seconds[name])
        whom = self.random.choice(["group", "parent", "child"])
        process = self.start(name, out, cache)
        time.sleep(after)
        try:
            if whom == "group":
                os.killpg(process.pid, signal.SIGKILL)
            elif whom == "parent":
                os.kill(process.pid, signal.SIGKILL)
            else:
                psutil.Process(process.pid).children()[0].kill()
        except (OSError, IndexError, psutil.NoSuchProcess):
            whom = f"{whom}, which had ended"
        process.communicate()
        return f"killed after {after:.2f} s ({whom})"

    def settled(self, what: str) -> None:
        """No process may be left a moment after a kill."""
        deadline = time.monotonic() + 5
        while (left := self.processes()) and time.monotonic() < deadline:
            time.sleep(0.02)
        if left:
            self.findings.append(f"{what}: processes left: {left}")
            for pid in left:
                os.kill(pid, signal.SIGKILL)

    def finish(self, name: str, out: str, cache: str, what: str) -> None:
        """The same command once more, and its result compared."""
        process = self.start(name, out, cache)
        _, err = process.communicate()
        if process.returncode != 0 or "damaged" in err:
            self.findings.append(f"{what}: {name}: the run after it ended with {process.returncode}: {err.strip()}")
        self.compare(name, out, cache, what)
        self.settled(what)

    def verify(self, out: str, what: str) -> None:
        """`sppm verify` has to agree."""
        words = [sys.executable, "-m", "sppm_pipeline", "verify", out]
        done = subprocess.run(words, cwd=self.root, capture_output=True, text=True, check=False)
        if done.returncode:
            self.findings.append(f"{what}: {done.stdout.strip()} {done.stderr.strip()}")

    def one_after_the_other(self, names: Sequence[str], kills: int) -> None:
        """Kill, run again, compare."""
        number = 0
        while self.kills < kills:
            name = names[number % len(names)]
            number += 1
            cache = "cache" if self.random.random() < 0.3 else f"cache-{number}"
            out = f"out-{name}" if self.random.random() < 0.5 else f"out-{number}"
            what = self.kill_one(name, out, cache)
            self.settled(what)
            while self.random.random() < 0.3:
                what += ", " + self.kill_one(name, out, cache)
                self.settled(what)
            self.finish(name, out, cache, what)
            self.verify(out, what)
            if cache != "cache":
                shutil.rmtree(self.root / cache)
            if number % 5 == 0:
                shutil.rmtree(self.root / "cache", ignore_errors=True)
            shutil.rmtree(self.root / out) if out == f"out-{number}" else None
            print(f"{self.kills:4d} kills, {len(self.findings)} findings; last: {name} {what}", flush=True)

    def at_the_same_time(self, names: Sequence[str], runs: int) -> None:
        """Many runs on one cache, some of them killed; then all once more, at the same time."""
        cache = "shared"
        first = [self.start(names[i % len(names)], f"many-{i}", cache) for i in range(runs)]
        victims = self.random.sample(range(runs), runs // 2)
        for i in victims:
            time.sleep(self.random.uniform(0, 2 * max(self.seconds.values()) / runs))
            os.killpg(first[i].pid, signal.SIGKILL)
            self.kills += 1
        for i, process in enumerate(first):
            _, err = process.communicate()
            if i not in victims and process.returncode:
                self.findings.append(f"at the same time: run {i} ended with {process.returncode}: {err.strip()}")
        second = [self.start(names[i % len(names)], f"many-{i}", cache) for i in range(runs)]
        for i, process in enumerate(second):
            _, err = process.communicate()
            if process.returncode or "damaged" in err:
                self.findings.append(f"at the same time: run {i} ended with {process.returncode}: {err.strip()}")
        for i in range(runs):
            self.compare(names[i % len(names)], f"many-{i}", cache, "at the same time")
            self.verify(f"many-{i}", "at the same time")
        self.settled("at the same time")
        words = [sys.executable, "-m", "sppm_pipeline", "cache", "verify", "--cache", cache]
        done = subprocess.run(words, cwd=self.root, capture_output=True, text=True, check=False)
        if done.returncode:
            self.findings.append(f"at the same time: the cache is damaged: {done.stdout}")
        shutil.rmtree(self.root / cache)
        for i in range(runs):
            shutil.rmtree(self.root / f"many-{i}")
        print(f"{runs} runs on one cache: {len(self.findings)} findings", flush=True)


def timeless(data: bytes) -> bytes:
    """A run record without what differs from run to run."""
    record = json.loads(data)

    def strip(entry: object) -> object:
        if isinstance(entry, list):
            return [strip(item) for item in entry]
        if isinstance(entry, dict):
            # the digest of a row's record differs with the times in it
            return {key: strip(item) for key, item in entry.items() if key not in (*TIMES, "cached", "record")}
        return entry

    return json.dumps(strip(record)).encode()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the bench."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=150)
    parser.add_argument("--concurrent", type=int, default=8, help="runs on one cache; 0 for none")
    parser.add_argument("--rounds", type=int, default=3, help="how often runs are started at the same time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=sorted(PIPELINES), action="append")
    parsed = parser.parse_args(arguments)
    names = parsed.only or list(PIPELINES)
    with tempfile.TemporaryDirectory(prefix="sppm-endurance-") as folder:
        bench = Bench(Path(folder), parsed.seed)
        bench.measure(names)
        for name in names:
            print(f"{name}: {bench.seconds[name]:.2f} s, {bench.changes[name]} changes to the disk", flush=True)
        bench.one_after_the_other(names, parsed.kills)
        for _ in range(parsed.rounds if parsed.concurrent else 0):
            bench.at_the_same_time(names, parsed.concurrent)
    for finding in bench.findings:
        print(finding)
    print(f"{bench.kills} kills, {len(bench.findings)} findings")
    return 1 if bench.findings else 0


if __name__ == "__main__":
    sys.exit(main())
