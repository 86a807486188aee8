"""Thousands of damaged copies of the example configurations: no traceback, no hang, always file and line.

    python tests/endurance/mutants.py [COUNT] [DRY_RUNS] [SEED] [EXAMPLE...]

Every example in ``configs/`` is damaged COUNT times (10,000) by bytes, tokens, values and structure and checked in this
process; DRY_RUNS of each (200) also go through ``sppm run --dry-run``. EXAMPLE is a name such as ``quickstart``; all if
omitted. tests/engine/cli/test_mutants.py holds a short form.
"""

from __future__ import annotations

import contextlib
import io
import random
import re
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from sppm_pipeline.engine.cli.main import main as sppm
from sppm_pipeline.engine.plan import plugins, session

ROOT = Path(__file__).resolve().parents[2]
LONGEST = 120.0
"""Seconds after which a check counts as hanging."""

VALUES = [
    "", "~", "true", "no", "0", "-1", "1e300", "1e-300", ".nan", "-.inf", "1" + "0" * 400, "[]", "{}", "[1, [2]]",
    "{a: 1}", "x", "'", '"', "*x", "&x 1", "!!python/none", "${porosity}", "${nothing}", "${", "5 mm", "-3 parsec",
    "../../x", "/etc", '"\\0"', '"\\ud800"', "<<", "|", ">", "? x", "- x", "x: y", "\t", "é", "\U0001f600", "a" * 5000,
    "0x" + "f" * 500, "1:2:3",
]  # fmt: skip
TOKEN = re.compile(r"[\w.$]+|[^\w\s]|\s+")


def mutate(text: str, rng: random.Random) -> bytes:
    """A damaged copy."""
    how = rng.choice(HOWS)
    damaged = how(text, rng)
    while rng.random() < 0.3:
        damaged = rng.choice(HOWS)(damaged.decode("utf-8", "replace"), rng)
    return damaged


def _bytes(text: str, rng: random.Random) -> bytes:
    """Change, drop or insert single bytes."""
    data = bytearray(text.encode())
    for _ in range(rng.randint(1, 8)):
        place = rng.randrange(len(data) + 1)
        kind = rng.random()
        if kind < 0.4 and place < len(data):
            data[place] = rng.randrange(256)
        elif kind < 0.7 and place < len(data):
            del data[place]
        else:
            data.insert(place, rng.choice(b"\x00\t\n \"'{}[]:,&*!|>%@`#-?\xff\xc3" + bytes([rng.randrange(256)])))
    return bytes(data)


def _tokens(text: str, rng: random.Random) -> bytes:
    """Drop, double, swap or replace words."""
    words = TOKEN.findall(text)
    for _ in range(rng.randint(1, 4)):
        if not words:
            break
        i, j = rng.randrange(len(words)), rng.randrange(len(words))
        kind = rng.randrange(4)
        if kind == 0:
            del words[i]
        elif kind == 1:
            words.insert(i, words[j])
        elif kind == 2:
            words[i], words[j] = words[j], words[i]
        else:
            words[i] = rng.choice(VALUES)
    return "".join(words).encode("utf-8", "surrogatepass")


def _values(text: str, rng: random.Random) -> bytes:
    """Put something odd where a value stands."""
    places = [m.span(1) for m in re.finditer(r":\s+([^,}\n]+)", text)]
    for start, end in sorted(rng.sample(places, min(len(places), rng.randint(1, 3))), reverse=True):
        text = text[:start] + rng.choice(VALUES) + text[end:]
    return text.encode("utf-8", "surrogatepass")


def _structure(text: str, rng: random.Random) -> bytes:
    """Drop, double, move or indent lines; cut the file off; repeat it; nest it."""
    lines = text.splitlines(keepends=True) or ["\n"]
    kind = rng.randrange(8)
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    if kind == 0:
        del lines[i : i + rng.randint(1, 4)]
    elif kind == 1:
        lines[i:i] = lines[j : j + rng.randint(1, 4)]
    elif kind == 2:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind == 3:
        lines[i] = " " * rng.randint(1, 6) + lines[i]
    elif kind == 4:
        lines[i] = lines[i].lstrip()
    elif kind == 5:
        lines = lines[:i]
    elif kind == 6:
        lines[i:i] = ["x: " + rng.choice("[{") * rng.choice([1, 40, 4000]) + "\n"]
    else:
        lines = lines * rng.randint(2, 3)
    return "".join(lines).encode("utf-8", "surrogatepass")


HOWS: list[Callable[[str, random.Random], bytes]] = [_bytes, _tokens, _values, _structure]


class Hang(BaseException):
    """A check took too long."""


@contextlib.contextmanager
def watched(seconds: float) -> Iterator[None]:
    """Raise `Hang` in what takes longer."""

    def ring(number: int, frame: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def fault_of(path: Path, *words: str) -> tuple[str | None, int]:
    """What is wrong with how the program took the file, None if nothing; and the exit code."""
    out, err = io.StringIO(), io.StringIO()
    try:
        with watched(LONGEST), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = sppm([*words, str(path), "--no-plugins"])
    except Hang:
        return "hangs", -1
    except BaseException as error:
        return f"{type(error).__name__} left the program: {error!s:.200}", -1
    said = err.getvalue()
    if "Traceback" in said or "internal error" in said:
        return f"exit {code}: {said[:300]}", code
    if code not in (0, 2):
        return f"exit {code}: {said[:300]}", code
    if code == 2:
        errors = [line for line in said.splitlines() if not line.startswith(("  hint:", "sppm: warning:"))]
        placed = [line for line in errors if re.search(rf"{re.escape(str(path))}:\d+:\d+: ", line)]
        counted = [line for line in errors if re.fullmatch(r"sppm: \d+ errors", line)]
        if len(placed) + len(counted) != len(errors) or not placed:
            return f"an error without its place: {said[:300]}", code
        if any(len(line) > 1200 for line in errors):
            return f"a message that is too long: {said[:300]}", code
    return None, code


def torment(folder: Path, example: Path, count: int, dry_runs: int, seed: int) -> tuple[Counter[int], list[str], float]:
    """Check `count` mutants; exit codes, faults, and the longest time."""
    rng = random.Random(f"{seed} {example.stem}")
    text, path = example.read_text(encoding="utf-8"), folder / f"{example.stem}.yaml"
    codes: Counter[int] = Counter()
    faults, longest = [], 0.0
    for number in range(count):
        data = mutate(text, rng)
        path.write_bytes(data)
        words = [["check"]] + ([["run", "-n"]] if number < dry_runs else [])
        for verb in words:
            began = time.perf_counter()
            fault, code = fault_of(path, *verb)
            longest = max(longest, time.perf_counter() - began)
            codes[code] += 1
            if fault is not None:
                faults.append(f"{example.stem} mutant {number}: {fault}")
                (folder / f"fault-{example.stem}-{number}.yaml").write_bytes(data)
    return codes, faults, longest


@contextlib.contextmanager
def loading_once() -> Iterator[None]:
    """Load the built-in stages once for all checks, as nothing changes about them."""
    original, kept = session.load_plugins, {}

    def load(builtins: tuple[str, ...], **how: object) -> plugins.Plugins:
        if list(how.get("files", ())):  # type: ignore[call-overload]
            return original(builtins, **how)  # type: ignore[arg-type]
        if builtins not in kept:
            kept[builtins] = original(builtins, **how)  # type: ignore[arg-type]
        return kept[builtins]

    session.load_plugins = load  # type: ignore[assignment]
    try:
        yield
    finally:
        session.load_plugins = original


def main(arguments: list[str]) -> int:
    count, dry_runs, seed = (int(a) for a in [*arguments[:3], *["10000", "200", "0"][len(arguments) :]])
    examples = {path.stem: path for path in sorted((ROOT / "configs").glob("*.yaml"))}
    folder = Path(tempfile.mkdtemp(prefix="sppm-mutants-"))
    all_faults = []
    for example in [examples[name] for name in arguments[3:] or examples]:
        began = time.perf_counter()
        with loading_once():
            codes, faults, longest = torment(folder, example, count, dry_runs, seed)
        all_faults += faults
        print(f"{example.stem:24s} {count} mutants, exit codes {dict(sorted(codes.items()))}, {len(faults)} faults, "
              f"longest {longest:.2f} s, {time.perf_counter() - began:.0f} s in all", flush=True)  # fmt: skip
        for fault in faults[:20]:
            print("   ", fault.replace("\n", "\n      "))
    print(f"{len(all_faults)} faults; mutants with faults are kept in {folder}")
    return 1 if all_faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
