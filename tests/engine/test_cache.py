"""Kept results: when they are used, when they must not be, and that nothing damaged ever is."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sppm_pipeline.engine.cache import housekeeping, session
from sppm_pipeline.engine.cache.housekeeping import contents, damaged_entries, parse_size, prune
from sppm_pipeline.engine.cache.keys import differences
from sppm_pipeline.engine.cache.session import reasons_of
from sppm_pipeline.engine.cache.store import Store
from sppm_pipeline.engine.files import digest_of
from sppm_pipeline.engine.locks import FolderLock
from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.engine.run.executors import WorkerOptions
from sppm_pipeline.engine.run.outputs import RunFolder
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.engine.run.sweep import run_sweep
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.nouns.storage import DamagedError
from tests.synthetic import Number

STAGES = Path(__file__).with_name("slow_stages.py")
SLOW = 0.05
"""Seconds that stages are said to take: enough for their results to be worth keeping."""

TEXT = """name: cached
seed: 3
params: {count: 1000, by: 1.0}
pipeline:
  - {stage: sample.draw, count: "${count}"}
  - {stage: field.shift, by: "${by}"}
  - check.look
  - write.numbers
"""


class Telling(Monitor):
    def __init__(self):
        self.warnings = []

    def warning(self, stage, message):
        self.warnings.append((stage, message))


class Lab:
    """Runs configurations with one cache, and knows which stages have really run."""

    def __init__(self, work, monkeypatch):
        self.work = work
        self.cache = work.folder / "cache"
        self.log = work.folder / "ran.txt"
        self.plugin = work.folder / "stages.py"
        self.plugin.write_text(STAGES.read_text())
        self.monitor = Telling()
        monkeypatch.setenv("RAN", str(self.log))
        # as if all stages but one took long, so that what is kept does not depend on how busy the machine is
        monkeypatch.setattr(session, "MAX_OVERHEAD", 1000.0)
        keep = session.CacheSession.keep

        def timed(self, step, *args, seconds, **how):
            keep(self, step, *args, seconds=0.0 if step.stage.name == "field.shift" else SLOW, **how)

        monkeypatch.setattr(session.CacheSession, "keep", timed)

    def run(self, text=TEXT, *, to="out", cap=None, cache=True, until=None, **how):
        self.log.write_text("")
        self.monitor = Telling()
        store = Store(self.cache, **({} if cap is None else {"cap": cap})) if cache else None
        plan = self.work.plan(text, plugins=[self.plugin], **how)
        folder = self.work.folder / to
        return run_plan(plan, folder, threads=1, monitor=self.monitor, store=store, about="test", until=until)

    @property
    def ran(self):
        return self.log.read_text().split()

    def files(self, to="out"):
        folder = self.work.folder / to
        return {
            p.relative_to(folder).as_posix(): p.read_bytes()
            for p in sorted(folder.rglob("*"))
            if p.is_file() and p.name != "run.json"
        }


@pytest.fixture
def lab(work, monkeypatch):
    return Lab(work, monkeypatch)


def without_times(record):
    text = json.dumps({k: v for k, v in record.items() if k not in ("started", "seconds", "peak_memory_mb", "sha256")})
    record = json.loads(text)
    for stage in record["stages"]:
        for name in ("seconds", "peak_memory_mb", "cached"):
            stage.pop(name, None)
        for inner in stage.get("inner", ()):
            inner.pop("seconds")
    return record


ALL = ["sample.draw", "field.shift", "check.look", "write.numbers"]


def test_the_second_run_runs_nothing_and_says_the_same(lab):
    cold = lab.run()
    assert lab.ran == ALL
    warned, files = lab.monitor.warnings, lab.files()
    assert not any(stage.get("cached") for stage in cold["stages"])
    warm = lab.run()
    assert lab.ran == []
    assert all(stage["cached"] for stage in warm["stages"])
    assert without_times(warm) == without_times(cold)
    assert [list(stage) for stage in without_times(warm)["stages"]] == [list(s) for s in without_times(cold)["stages"]]
    assert lab.monitor.warnings == warned == [("check.look", "these are numbers")]
    assert lab.files() == files
    assert not list((lab.cache / "tmp").iterdir())


def test_without_a_cache_everything_runs_and_the_files_are_the_same(lab):
    lab.run()
    lab.run(to="bare", cache=False)
    assert lab.ran == ALL
    assert lab.files("bare") == lab.files()


@pytest.mark.parametrize(
    ("how", "runs"),
    [
        ({"p": ["by=2.0"]}, ["field.shift", "check.look", "write.numbers"]),
        ({"p": ["count=999"]}, ALL),
        ({"seed": 4}, ALL),
        ({"s": ["write.numbers.path=other"]}, ["field.shift", "write.numbers"]),
    ],
    ids=["option", "first option", "seed", "last option"],
)
def test_what_depends_on_a_change_runs_again_and_nothing_else(lab, how, runs):
    lab.run()
    lab.run(**how)
    # the quick stage is not worth keeping: it runs again where its result is needed
    assert sorted(lab.ran) == sorted(runs)
    changed = lab.files()
    lab.run(to="fresh", cache=False, **how)
    assert lab.files("fresh") == changed
    lab.run()
    assert lab.ran == []


def test_a_run_into_another_directory_takes_its_files_from_the_cache(lab):
    lab.run()
    lab.run(to="other")
    assert lab.ran == []
    assert lab.files("other") == lab.files()


@pytest.mark.parametrize("harm", ["remove", "flip", "cut", "extra", "folder", "link", "swap"])
def test_outputs_that_are_not_as_written_are_put_right(lab, harm):
    lab.run()
    before = lab.files()
    out = lab.work.folder / "out"
    file, inner = out / "numbers.txt", out / "numbers" / "deep" / "2.txt"
    match harm:
        case "remove":
            inner.unlink()
        case "flip":
            data = bytearray(file.read_bytes())
            data[100] ^= 1
            file.write_bytes(data)
        case "cut":
            file.write_bytes(file.read_bytes()[:-1])
        case "extra":
            (out / "numbers" / "deep" / "9.txt").write_text("more")
        case "folder":
            shutil.rmtree(out / "numbers")
            (out / "numbers").write_text("a file")
        case "link":
            file.rename(out / "elsewhere")
            file.symlink_to(out / "elsewhere")
        case "swap":
            data = inner.read_bytes()
            (out / "numbers" / "deep" / "1.txt").replace(inner)
            (out / "numbers" / "deep" / "1.txt").write_bytes(data)
    lab.run()
    assert lab.ran == []
    (out / "elsewhere").unlink(missing_ok=True)
    assert lab.files() == before


def test_every_damaged_file_of_the_cache_is_noticed(lab):
    lab.run()
    before = lab.files()
    intact = lab.work.folder / "intact"
    shutil.copytree(lab.cache, intact)
    rng = np.random.default_rng(2)
    names = [p.relative_to(intact) for p in sorted((intact / "entries").rglob("*")) if p.is_file()]
    assert {name.name for name in names} >= {"manifest.json", "value.json", "small.npy", "outputs.bin"}
    for number, name in enumerate(names):
        for change in ("flip", ("cut", "empty", "remove")[number % 3]):
            shutil.rmtree(lab.cache)
            shutil.copytree(intact, lab.cache)
            shutil.rmtree(lab.work.folder / "out")
            path = lab.cache / name
            data = bytearray(path.read_bytes())
            data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
            match change:
                case "flip":
                    path.write_bytes(data)
                case "cut":
                    path.write_bytes(path.read_bytes()[: len(data) // 2])
                case "empty":
                    path.write_bytes(b"")
                case "remove":
                    path.unlink()
            # the last stage writes another output, so that everything it needs is read
            lab.run(s=["write.numbers.path=again"])
            needed = name.name not in ("outputs.bin",)
            told = [message for _, message in lab.monitor.warnings if "damaged" in message]
            assert bool(told) <= needed
            lab.run()
            assert lab.files() == before, (name, change)
    assert damaged_entries(Store(lab.cache)) == []


def test_verifying_the_cache_finds_and_removes_what_is_damaged(lab):
    lab.run()
    store = Store(lab.cache)
    before = {entry.key for entry in contents(store)}
    (victim,) = lab.cache.rglob("outputs.bin")
    data = bytearray(victim.read_bytes())
    data[-1] ^= 4
    victim.write_bytes(data)
    ((key, why),) = damaged_entries(store)
    assert "outputs.bin" in why
    assert {entry.key for entry in contents(store)} == before - {key}
    store.close()


def test_a_stage_without_random_numbers_is_kept_for_all_seeds(lab):
    (lab.work.folder / "in.txt").write_text("1 2 3")
    text = "seed: 1\npipeline: [{stage: read.numbers, path: in.txt}, check.look, {stage: sample.draw}]\n"
    lab.run(text)
    lab.run(text, seed=2)
    assert lab.ran == ["sample.draw"]


def test_input_files_count_by_their_content(lab):
    path = lab.work.folder / "in.txt"
    path.write_text("1 2 3")
    text = "pipeline: [{stage: read.numbers, path: in.txt}, check.look]\n"
    lab.run(text)
    os.utime(path, (1, 1))
    lab.run(text)
    assert lab.ran == []
    path.write_text("1 2 4")
    os.utime(path, (1, 1))
    record = lab.run(text)
    assert lab.ran == ["read.numbers", "check.look"]
    assert record["stages"][0]["summary"]["sum"] == 7


def test_an_input_file_that_changes_while_it_is_read_is_not_kept(lab):
    path = lab.work.folder / "in.txt"
    path.write_text("1 2 3")
    source = lab.plugin.read_text().replace(
        "        return Numbers(np.array(self.path.read_text().split(), float))",
        "        read = self.path.read_text()\n        self.path.write_text('7')\n"
        "        return Numbers(np.array(read.split(), float))",
    )
    assert source != lab.plugin.read_text()
    lab.plugin.write_text(source)
    text = "pipeline: [{stage: read.numbers, path: in.txt}]\n"
    lab.run(text)
    path.write_text("1 2 3")
    lab.run(text)
    assert lab.ran == ["read.numbers"]


def test_an_edited_plugin_and_a_new_version_run_again(lab):
    lab.run()
    lab.plugin.write_text(lab.plugin.read_text().replace("+ self.by", "+ 2 * self.by"))
    lab.run()
    assert lab.ran == ALL
    lab.plugin.write_text(
        lab.plugin.read_text().replace('"check.look"\n', '"check.look"\n    version: ClassVar[int] = 2\n')
    )
    lab.run()
    assert lab.ran == ALL


RECIPE = """seed: 3
recipes:
  r: [{stage: sample.draw, count: 10}, {stage: field.shift, by: 1.0}]
pipeline:
  - {stage: tune.again, recipe: r}
  - check.look
"""


def test_recipes_are_part_of_the_key(lab):
    cold = lab.run(RECIPE)
    assert lab.ran == ["tune.again", *["r.sample.draw", "r.field.shift"] * 2, "check.look"]
    warm = lab.run(RECIPE)
    assert lab.ran == []
    assert without_times(warm) == without_times(cold)
    assert warm["stages"][0]["inner"][0]["runs"] == 2
    lab.run(RECIPE.replace("by: 1.0", "by: 1.5"))
    assert "tune.again" in lab.ran


def test_stages_that_must_not_be_kept(lab):
    text = "pipeline: [read.clock, check.look, sample.draw]\n"
    first = lab.run(text)
    second = lab.run(text)
    assert lab.ran == ["read.clock", "check.look"]
    assert first["stages"][1]["summary"] != second["stages"][1]["summary"]


def test_nouns_that_can_not_be_written_are_made_again_when_needed(lab):
    text = "seed: 1\npipeline: [sample.draw, fill.closed, write.numbers]\n"
    lab.run(text)
    lab.run(text)
    assert lab.ran == []
    lab.run(text, s=["write.numbers.path=again"])
    assert lab.ran == ["fill.closed", "write.numbers"]


def test_until_shares_results_with_the_whole_run(lab):
    lab.run(until="field.shift")
    lab.run()
    assert lab.ran == ["field.shift", "check.look", "write.numbers"]


def test_a_failed_run_keeps_what_had_ended(lab):
    bad = TEXT.replace("  - check.look\n", "  - {stage: check.fail, how: design}\n  - check.look\n")
    with pytest.raises(Exception, match="impossible"):
        lab.run(bad)
    assert lab.ran == ["sample.draw", "field.shift"]
    lab.run(TEXT)
    assert lab.ran == ["field.shift", "check.look", "write.numbers"]


def test_a_cache_that_can_not_be_written_is_told_of_once_and_does_no_harm(lab):
    lab.cache.write_text("a file")
    record = lab.run()
    assert record["status"] == "done"
    (told,) = [message for _, message in lab.monitor.warnings if "cache" in message]
    assert "can't be written" in told
    assert lab.ran == ALL


def test_the_least_recently_used_makes_way(lab):
    for count in (10, 20, 30, 40):
        lab.run(p=[f"count={count}"], to=f"out{count}", until="sample.draw")
    store = Store(lab.cache)
    keys = [entry.key for entry in contents(store)]
    for age, key in enumerate(reversed(keys)):
        os.utime(store.place(key) / "manifest.json", (10_000 - age, 10_000 - age))
    lab.run(p=["count=10"], until="sample.draw")  # used again
    assert lab.ran == []
    one = contents(store)[0].bytes
    removed, left = prune(store, 2 * one + one // 2)
    assert (removed, left) == (2, 2 * one)
    lab.run(p=["count=10"], until="sample.draw")
    assert lab.ran == []
    store.close()


def test_the_cap_is_kept(lab):
    for count in range(2000, 2012):
        lab.run(p=[f"count={count}"], cap=120_000, until="sample.draw")
    assert 0 < sum(entry.bytes for entry in contents(Store(lab.cache))) <= 150_000
    huge = lab.run(p=["count=1000000"], cap=120_000)
    assert huge["status"] == "done"


def test_leftovers_of_the_dead_are_removed_and_those_of_the_living_are_not(lab):
    lab.run()
    for name in ("dead", "alive"):
        (lab.cache / "tmp" / name / "x").mkdir(parents=True)
    lock = FolderLock(lab.cache / "tmp" / "alive")
    assert lock.acquire()
    prune(Store(lab.cache), 10**9)
    assert [p.name for p in (lab.cache / "tmp").iterdir()] == ["alive"]
    lock.release()
    prune(Store(lab.cache), 10**9)
    assert not list((lab.cache / "tmp").iterdir())


def test_two_that_make_the_same_entry_do_not_disturb_each_other(tmp_path):
    a, b = Store(tmp_path / "c"), Store(tmp_path / "c")
    facts = {"facts": {}, "ingredients": {}}
    a.put("ab" * 32, facts)
    b.put("ab" * 32, facts, value=np.arange(5))  # holds more, so it takes the place
    a.put("ab" * 32, facts)
    entry = a.find("ab" * 32)
    assert entry.has_value
    assert a.load(entry).tolist() == [0, 1, 2, 3, 4]
    b.remove("ab" * 32)
    assert a.find("ab" * 32) is None
    with pytest.raises(OSError):
        a.load(entry)
    for store in (a, b):
        store.close()
    assert not list((tmp_path / "c" / "tmp").iterdir())


@pytest.mark.parametrize("durable", [True, False])
def test_a_durable_entry_is_on_the_disk_before_it_gets_its_name(tmp_path, monkeypatch, durable):
    """Otherwise the name may outlive the content when the machine stops."""
    synced, seen = set(), []
    fsync, rename = os.fsync, os.rename

    def noted(descriptor):
        synced.add((os.fstat(descriptor).st_ino, os.fstat(descriptor).st_size))
        fsync(descriptor)

    def renamed(source, target):
        seen.append(
            {(file.name, (file.stat().st_ino, file.stat().st_size) in synced) for file in Path(source).iterdir()}
        )
        rename(source, target)

    (tmp_path / "written").write_bytes(b"bytes")
    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(os, "rename", renamed)
    store = Store(tmp_path / "cache")
    store.put("0" * 64, {"facts": {}}, value=Number(3.0), outputs=[("a", tmp_path / "written")], durable=durable)
    assert seen == [{(name, durable) for name in ("manifest.json", "outputs.bin", "value.json")}]
    store.close()


@pytest.mark.parametrize(
    ("text", "size"),
    [("5GB", 5 * 10**9), ("800 MB", 8 * 10**8), ("2GiB", 2**31), ("17", 17), ("1.5k", 1500), ("0", 0)],
)
def test_sizes(text, size):
    assert parse_size(text) == size


@pytest.mark.parametrize("text", ["", "GB", "-1", "5 parsecs", "nan", "inf", "5,5GB"])
def test_sizes_that_are_none(text):
    with pytest.raises(ValueError, match="expected a size"):
        parse_size(text)


def test_the_digest_of_a_folder_is_that_of_its_names_and_files(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x").write_text("1")
    first = digest_of(tmp_path / "a")
    (tmp_path / "a" / "x").rename(tmp_path / "a" / "y")
    assert digest_of(tmp_path / "a") != first


# --- why a stage would run -----------------------------------------------------------------------------------------


def why(lab, text=TEXT, **how):
    plan = lab.work.plan(text, plugins=[lab.plugin], **how)
    found = reasons_of(plan, Store(lab.cache), "test")
    return {id_: None if kept else words for id_, (kept, words) in found.items()}


def test_what_is_kept_is_told(lab):
    assert set(why(lab).values()) == {"no run of this configuration is known that had it"}
    lab.run()
    assert set(why(lab).values()) == {None}
    prune(Store(lab.cache), 0)
    lab.run(cache=False)
    assert why(lab)["sample.draw"] == "no run of this configuration is known that had it"


def test_the_option_that_has_changed_is_named(lab):
    lab.run()
    found = why(lab, p=["by=2.5"])
    assert found["sample.draw"] is None
    assert found["field.shift"] == "option 'by' has changed from 1.0 to 2.5"
    assert found["check.look"] == "'field.shift' runs again"
    found = why(lab, p=["by=2.5", "count=7"])
    assert found["sample.draw"] == "option 'count' has changed from 1000 to 7"
    assert found["field.shift"] == "option 'by' has changed from 1.0 to 2.5; 'sample.draw' runs again"
    assert why(lab, seed=9)["sample.draw"] == "the seed has changed from 3 to 9"


def test_files_code_versions_and_recipes_that_have_changed_are_named(lab):
    path = lab.work.folder / "in.txt"
    path.write_text("1 2")
    text = "pipeline: [{stage: read.numbers, path: in.txt}, read.clock]\n"
    lab.run(text)
    assert why(lab, text)["read.clock"].startswith("it runs every time")
    path.write_text("1 3")
    assert why(lab, text)["read.numbers"] == "the content of the file of option 'path' has changed"
    path.unlink()
    assert why(lab, text)["read.numbers"] == "an input file can't be read"
    lab.run(RECIPE)
    changed = RECIPE.replace("by: 1.0", "by: 1.5")
    assert why(lab, changed)["tune.again"] == (
        "in the recipe 'r', stage 'field.shift': option 'by' has changed from 1.0 to 1.5"
    )
    shorter = RECIPE.replace(", {stage: field.shift, by: 1.0}", "")
    assert why(lab, shorter)["tune.again"] == "the recipe 'r' has other stages"
    lab.plugin.write_text(lab.plugin.read_text() + "\n# a remark\n")
    assert why(lab, RECIPE)["check.look"] == "the code of stages.py has changed; 'tune.again' runs again"


def test_versions_of_libraries_are_told():
    before = {"stage": "s", "version": 1, "environment": {"numpy": "1"}}
    assert list(differences(before, {**before, "version": 2, "environment": {"numpy": "2"}})) == [
        "the version of the stage has changed from 1 to 2",
        "numpy has changed from 1 to 2",
    ]


# --- sweeps --------------------------------------------------------------------------------------------------------

SWEEP = TEXT.replace("  - check.look\n", "") + "sweep: {count: [10, 20, 30]}\n"


def sweep(lab, text=SWEEP, **how):
    lab.log.write_text("")
    session = lab.work.session(text, plugins=[lab.plugin], **how)
    run_sweep(session, session.plan(), lab.work.folder / "out", WorkerOptions(cache=lab.cache))
    return lab.files()


@pytest.mark.parametrize("share", [0.0, 1000.0], ids=["nothing kept", "everything kept"])
def test_finished_rows_are_taken_as_they_are(lab, share, monkeypatch):
    monkeypatch.setattr(session, "MAX_OVERHEAD", share)
    before = sweep(lab)
    assert lab.ran == ["sample.draw", "field.shift", "write.numbers"] * 3
    assert bool(contents(Store(lab.cache))) == bool(share)
    assert sweep(lab) == before
    assert lab.ran == []
    # a row that was harmed, one that is gone, and one that is new
    out = lab.work.folder / "out" / "runs"
    (out / "0000" / "numbers.txt").write_text("harmed")
    shutil.rmtree(out / "0001")
    assert sweep(lab) == before
    assert lab.ran == ([] if share else ["sample.draw", "field.shift", "write.numbers"] * 2)
    sweep(lab, SWEEP.replace("30]", "30, 40]"))
    assert lab.ran == ["sample.draw", "field.shift", "write.numbers"]
    sweep(lab, SWEEP.replace("30]", "40]"))
    assert sorted(path.name for path in out.iterdir()) == ["0000", "0001", "0002"]


def test_a_row_of_other_options_is_not_taken(lab, monkeypatch):
    monkeypatch.setattr(session, "MAX_OVERHEAD", 0.0)
    sweep(lab)
    sweep(lab, p=["by=3.0"])
    assert len(lab.ran) == 9
    sweep(lab, seed=8)
    assert len(lab.ran) == 9


def test_what_costs_too_much_to_keep_is_not_kept(lab, monkeypatch):
    monkeypatch.setattr(session, "MAX_OVERHEAD", 0.0)
    lab.run()
    assert contents(Store(lab.cache)) == []
    assert lab.run()["status"] == "done"
    assert lab.ran == ALL


def test_a_cache_that_others_can_write_is_refused_or_passed_over(tmp_path, monkeypatch):
    exposed = tmp_path / "exposed"
    exposed.mkdir()
    exposed.chmod(0o777)
    with pytest.raises(ConfigError, match=r"can't be trusted: other users may write to it \(mode 777\)"):
        housekeeping.cache_folder(exposed)
    monkeypatch.setenv("SPPM_CACHE", str(exposed))
    with pytest.raises(ConfigError, match="can't be trusted"):
        housekeeping.cache_folder()
    monkeypatch.delenv("SPPM_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    (tmp_path / "home/sppm/results").mkdir(parents=True)
    (tmp_path / "home/sppm/results").chmod(0o777)
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(housekeeping.tempfile, "gettempdir", lambda: str(tmp_path / "tmp"))
    shared = housekeeping.cache_folder()
    assert shared.parent == tmp_path / "tmp"
    assert shared.stat().st_mode & 0o777 == 0o700
    shared.chmod(0o777)
    own = housekeeping.cache_folder()
    assert own not in (shared, tmp_path / "home/sppm/results")
    assert own.stat().st_mode & 0o777 == 0o700


@pytest.fixture
def stored(tmp_path):
    """A store with one entry, that holds a file."""
    (tmp_path / "a.txt").write_text("content")
    store = Store(tmp_path / "store")
    store.put("k1" * 32, {"facts": {}}, outputs=[("a.txt", tmp_path / "a.txt")])
    yield store
    store.close()


def test_a_restored_file_has_the_digest_that_was_stored(stored, tmp_path):
    entry = stored.find("k1" * 32)
    stored.restore(entry, lambda name: tmp_path / "restored.txt")
    assert (tmp_path / "restored.txt").read_text() == "content"
    (entry.folder / "outputs.bin").write_text("CONTENT")
    with pytest.raises(DamagedError, match=r"the SHA-256 of 'a\.txt' differs"):
        stored.restore(entry, lambda name: tmp_path / "restored.txt")


@pytest.mark.parametrize("sound", [True, False])
def test_restored_outputs_are_those_that_the_record_names(stored, tmp_path, sound):
    folder = RunFolder(tmp_path / "run")
    folder.prepare()
    recorded = {"path": "a.txt", "bytes": 7, "sha256": digest_of(tmp_path / "a.txt") if sound else "0" * 64}
    damaged = []
    step = SimpleNamespace(id="s", address="s")
    cache = SimpleNamespace(
        _entries={"s": stored.find("k1" * 32)}, store=stored, damaged=lambda id_, error: damaged.append(str(error))
    )
    restored = session.CacheSession.restore(cache, step, folder, [recorded], lambda: None)
    folder.discard()
    assert restored is sound
    assert damaged == ([] if sound else ["its outputs are not those that were recorded"])


def test_an_entry_in_the_place_of_another_is_damaged(stored):
    """Its manifest is sealed and sound, but says whose it is."""
    other = stored.place("k2" * 32)
    shutil.copytree(stored.place("k1" * 32), other)
    with pytest.raises(DamagedError, match="it is another entry's"):
        stored.find("k2" * 32)
    assert not other.exists()
    assert stored.find("k1" * 32) is not None
