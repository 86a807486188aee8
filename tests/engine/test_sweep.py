"""Sweeps: rows, tables, executors, failures."""

from __future__ import annotations

import csv
import hashlib
import json
import socket
import sys
import threading
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace

import pytest

from sppm_pipeline.engine.config.document import plain
from sppm_pipeline.engine.config.parameters import sweep_rows
from sppm_pipeline.engine.plan import session as sessions
from sppm_pipeline.engine.plan.checking import checked
from sppm_pipeline.engine.plan.plugins import load_plugins
from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.engine.run.executors import SerialExecutor, WorkerOptions, make_executor, serve
from sppm_pipeline.engine.run.runner import StepRunner
from sppm_pipeline.engine.run.sweep import run_sweep
from sppm_pipeline.engine.run.sweep_table import csv_text, numbers_of, rows_of
from sppm_pipeline.errors import ConfigError, ConfigErrors, DesignError, NativeCrash, PluginError
from sppm_pipeline.nouns.table import Table

TEXT = """name: sweep
seed: 1
params: {factor: 1.0, limit: 100}
pipeline:
  - {stage: sample.random, count: 3}
  - {stage: field.scale, factor: "${factor}"}
  - {stage: check.limit, maximum: "${limit}"}
  - write.number
sweep:
  factor: [1, 2.5]
  seed: {from: 4, to: 6}
after:
  - {stage: write.column, column: field.scale.value}
"""


def run(work, text=TEXT, *, to="out", workers=1, executor=None, **how):
    session = work.session(text, **how)
    checked(session, folder=None)
    return run_sweep(
        session,
        session.plan(),
        work.folder / to,
        WorkerOptions(workers=workers, executor=executor, threads=2),
        monitor=Monitor(),
    )


def table_of(out):
    return list(csv.DictReader((out / "sweep.csv").read_text().splitlines()))


def rows(work, text):
    configuration = work.session(text).configuration
    found = sweep_rows(configuration.sweep, configuration.params)
    return [{name: plain(entry.node) for name, entry in row.items()} for row in found]


def test_a_grid_changes_its_last_parameter_fastest(work):
    assert rows(work, TEXT) == [{"factor": f, "seed": s} for f in (1, 2.5) for s in (4, 5, 6)]


def test_a_table_is_taken_as_written(work):
    text = TEXT.replace(
        "  factor: [1, 2.5]\n  seed: {from: 4, to: 6}\n", "  - {factor: 3}\n  - {factor: 4, limit: 5}\n"
    )
    assert rows(work, text) == [{"factor": 3}, {"factor": 4, "limit": 5}]


def test_a_range_can_have_steps(work):
    text = TEXT.replace("{from: 4, to: 6}", "{from: 0, to: 10, step: 5}")
    assert [row["seed"] for row in rows(work, text)][:3] == [0, 5, 10]


@pytest.mark.parametrize(
    ("sweep", "words"),
    [
        ("{factro: [1]}", "did you mean 'factor'"),
        ("{factor: []}", "must be a list of values"),
        ("{factor: 3}", "must be a list of values"),
        ("{seed: {from: 5, to: 1}}", "must be a list of values"),
        ("{seed: {from: 1, to: 5, step: 0}}", "must be a list of values"),
        ("{seed: [1, -1]}", "a seed is an integer"),
        ("{seed: [x]}", "a seed is an integer"),
        ("{seed: {from: 1, to: 50000}, factor: {from: 1, to: 50000}}", "at most 100000"),
        ("{}", "no runs"),
        ("[]", "no runs"),
        ("[3]", "a map of parameters"),
        ("[{factro: 1}]", "did you mean 'factor'"),
    ],
)
def test_errors_of_sweeps(work, sweep, words):
    start = TEXT[: TEXT.index("sweep:")]
    with pytest.raises(ConfigError) as caught:
        rows(work, f"{start}sweep: {sweep}\n")
    assert words in str(caught.value)
    assert caught.value.where.line == 10


def test_a_value_that_is_not_allowed_is_found_before_any_work(work):
    with pytest.raises(ConfigErrors) as caught:
        run(work, TEXT.replace("factor: [1, 2.5]", "factor: [1, -2, 3, x]"))
    assert [error.where.column for error in caught.value.errors] == [15, 22]
    assert not (work.folder / "out").exists()


def test_a_sweep_and_its_files(work):
    record = run(work)
    out = work.folder / "out"
    table = table_of(out)
    assert json.loads((out / "sweep.json").read_text())[0]["factor"] == 1
    assert [(row["run"], row["factor"], row["seed"], row["status"]) for row in table] == [
        (f"{i:04}", f, str(s), "done") for i, (f, s) in enumerate((f, s) for f in ("1", "2.5") for s in (4, 5, 6))
    ]
    first = json.loads((out / "runs" / "0000" / "run.json").read_text())
    assert float(table[0]["field.scale.value"]) == first["stages"][1]["summary"]["value"]
    assert first["seed"] == 4
    assert first["config"]["params"] == {"factor": 1, "limit": 100}
    assert "sweep" not in first["config"]
    assert float(table[3]["field.scale.value"]) == pytest.approx(2.5 * float(table[0]["field.scale.value"]))
    total = sum(float(row["field.scale.value"]) for row in table)
    assert record["stages"][0]["summary"] == {"total": pytest.approx(total), "rows": 6}
    assert float((out / "sum.txt").read_text()) == pytest.approx(total)
    assert record["status"] == "done"
    assert [entry["status"] for entry in record["runs"]] == ["done"] * 6
    assert {entry["path"] for entry in record["outputs"]} == {"sweep.csv", "sweep.csv-metadata.json", "sweep.json"}


def test_every_executor_gives_the_same(work):
    for to, workers, executor in (("a", 1, None), ("b", 2, "threads"), ("c", 2, None)):
        run(work, to=to, workers=workers, executor=executor)
    for name in ("sweep.csv", "sweep.json", "sum.txt", "runs/0005/number.txt"):
        first = (work.folder / "a" / name).read_bytes()
        assert (work.folder / "b" / name).read_bytes() == first
        assert (work.folder / "c" / name).read_bytes() == first


def test_a_sweep_can_be_repeated_from_its_record_and_into_its_directory(work):
    run(work, to="a")
    record = (work.folder / "a" / "run.json").read_text()
    (work.folder / "a" / "runs" / "0099").mkdir()
    (work.folder / "a" / "runs" / "0099" / "run.json").write_text((work.folder / "a/runs/0000/run.json").read_text())
    before = (work.folder / "a" / "sweep.csv").read_bytes()
    from sppm_pipeline.engine.plan.session import RunRequest, open_session

    (work.folder / "copy.json").write_text(record)
    session = open_session(RunRequest(str(work.folder / "copy.json"), work.session(TEXT).request.builtins, (), False))
    run_sweep(session, session.plan(), work.folder / "a")
    assert (work.folder / "a" / "sweep.csv").read_bytes() == before
    assert sorted(path.name for path in (work.folder / "a" / "runs").iterdir()) == [f"{i:04}" for i in range(6)]


def test_a_failed_run_is_a_row_with_its_error(work):
    text = TEXT.replace("  factor: [1, 2.5]\n  seed: {from: 4, to: 6}\n", "  limit: [100, -1]\n")
    record = run(work, text)
    assert record["status"] == "failed"
    assert [entry["status"] for entry in record["runs"]] == ["done", "failed"]
    assert record["runs"][1]["error"]["exit_code"] == 3
    table = table_of(work.folder / "out")
    assert "is larger than -1" in table[1]["error"]
    assert table[1]["field.scale.value"] != ""
    assert table[1]["check.limit.value"] == ""
    assert record["stages"][0]["summary"]["rows"] == 2


def test_an_error_of_after_names_its_place(work):
    with pytest.raises(DesignError) as caught:
        run(work, TEXT.replace("write.column, column: field.scale.value", "check.fail, how: design"))
    assert caught.value.where.line == 14
    assert json.loads((work.folder / "out" / "run.json").read_text())["status"] == "failed"
    assert (work.folder / "out" / "sweep.csv").exists()


PLUGIN = """
import os
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from typing import ClassVar
import multiprocessing

from sppm_pipeline.hookspecs import hookimpl
from sppm_pipeline.stage import Context, Stage, option
from tests.synthetic import Number

class Cluster(ThreadPoolExecutor):
    def shutdown(self, wait=True):  # Dask's knows no `cancel_futures` either
        super().shutdown(wait)

@hookimpl
def sppm_executors():
    return {"pool": Cluster, "nonsense": lambda workers: 3}

@dataclass(frozen=True, kw_only=True)
class Die(Stage):
    '''Die as a native library does.'''
    name: ClassVar[str] = "check.die"
    value: int = option(1, help="a number")
    def run(self, context: Context, number: Number) -> Number:
        if self.value < 0:
            os.kill(os.getpid(), -self.value)
        elif self.value == 1000:  # the first time only
            try:
                open(os.path.join(os.path.dirname(__file__), "once"), "x").close()
            except FileExistsError:
                return number
            os.kill(os.getpid(), 9)
        elif self.value:
            os._exit(self.value % 256)
        return number
"""


def test_executors_can_come_from_plugins(work):
    path = work.write(PLUGIN, "plugin.py")
    assert run(work, plugins=[path], executor="pool", workers=2)["status"] == "done"
    with pytest.raises(PluginError, match=r"no concurrent\.futures\.Executor"):
        run(work, plugins=[path], executor="nonsense", to="b")


DEADLY = """params: {v: 0}
pipeline: [{stage: sample.random, count: 3}, field.scale, {stage: check.die, id: grave, value: '${v}'}]
sweep: {v: [0, 11, 0, -11, 256]}
after: [{stage: write.column, column: field.scale.value}]
"""


def test_a_row_that_takes_its_process_down_has_failed_and_the_others_go_on(work):
    path = work.write(PLUGIN, "plugin.py")
    record = run(work, DEADLY, plugins=[path], workers=2)
    assert record["status"] == "failed"
    assert [row["status"] for row in record["runs"]] == ["done", "failed", "done", "failed", "failed"]
    left, killed, quiet = (record["runs"][row]["error"] for row in (1, 3, 4))
    assert (left["kind"], killed["kind"]) == ("PluginError", "NativeCrash")
    assert "run '0001' was ended by its own code (exit code 11)" in left["message"]
    assert "run '0003' was taken down by SIGSEGV" in killed["message"]
    assert "run '0004' was ended by its own code (exit code 0)" in quiet["message"]
    assert [record["runs"][row]["attempts"] for row in (1, 3, 4)] == [3, 3, 3]
    assert all(record["runs"][row]["attempts"] <= 2 for row in (0, 2))  # they may have been at work beside one
    assert [row.get("host") for row in record["runs"]] == [socket.gethostname(), None, socket.gethostname(), None, None]
    for error in (left, killed, quiet):
        assert error["stage"] == "grave"
        assert "plugin.py" in error["message"]
        assert "'check.die'" in error["message"]
        assert ":3:" in error["where"]
    out = work.folder / "out"
    for name, error in (("0001", left), ("0003", killed)):
        alone = json.loads((out / "runs" / name / "run.json").read_text())
        assert (alone["status"], alone["error"]) == ("failed", error)
    table = table_of(out)
    assert [row["error"] for row in table] == ["", left["message"], "", killed["message"], quiet["message"]]
    assert [row["field.scale.value"] != "" for row in table] == [True, False, True, False, False]
    assert record["stages"][0]["summary"]["rows"] == 5


def test_a_row_whose_process_somebody_ends_is_run_again(work):
    path = work.write(PLUGIN, "plugin.py")
    text = DEADLY.replace("[0, 11, 0, -11, 256]", "[1000, 0, 0]")
    record = run(work, text, plugins=[path], executor="processes", workers=2)
    assert [row["status"] for row in record["runs"]] == ["done"] * 3
    assert (work.folder / "once").exists()


def test_workers_that_die_before_their_first_run_end_the_sweep(work):
    path = work.write(
        PLUGIN.replace(
            "import os\n", "import os\nimport multiprocessing\nif multiprocessing.parent_process(): os._exit(3)\n"
        ),
        "plugin.py",
    )
    with pytest.raises(NativeCrash, match="0 of 5 runs had ended"):
        run(work, DEADLY, plugins=[path], executor="processes", workers=2)
    record = json.loads((work.folder / "out" / "run.json").read_text())
    assert record["error"]["exit_code"] == 6
    assert [(row["status"], row["attempts"]) for row in record["runs"]] == [("failed", 0)] * 5
    assert [row["error"] for row in table_of(work.folder / "out")] == [record["error"]["message"]] * 5


class Counted(threading.Condition):
    """What guards a future, and counts how often somebody takes it."""

    taken = 0

    def __init__(self):
        super().__init__()
        take = self.acquire

        def counted(*args):
            Counted.taken += 1
            return take(*args)

        self.acquire = counted

    def __enter__(self):
        Counted.taken += 1
        return super().__enter__()


class OneByOne(Executor):
    """Has all rows before the first is done; the next one is done when somebody has heard of the one before."""

    def __init__(self, count):
        self.futures, self.count = [], count

    def submit(self, fn, task):
        future = Future()
        future._condition = Counted()
        self.futures.append(future)
        if len(self.futures) == self.count:
            self.finish(0)
        return future

    def finish(self, number):
        if number < self.count:
            self.futures[number].set_result({"row": number})


def test_a_row_of_a_long_sweep_costs_what_one_of_a_short_sweep_does():
    taken = []
    for count in (10, 20, 30):
        Counted.taken, order, pool = 0, [], OneByOne(count)

        def ended(number, result, order=order, pool=pool):
            order.append((number, result["row"]))
            pool.finish(number + 1)

        assert serve(pool, dict, {number: {} for number in range(count)}, ended, None, most=99) == (None, [])
        assert order == [(number, number) for number in range(count)]
        taken.append(Counted.taken)
    assert taken[0] > 0
    assert taken[2] - taken[1] == taken[1] - taken[0]


def test_the_rows_of_a_sweep_are_laid_out_once_a_process(work, monkeypatch):
    laid_out = []
    monkeypatch.setattr(sessions, "sweep_rows", lambda *given: laid_out.append(1) or sweep_rows(*given))
    run(work)
    assert len(laid_out) == 2  # of this session, and of that of the executor


def test_rows_are_told_of_as_they_end(work):
    heard = []

    class Heard(Monitor):
        def row_finished(self, done, count, result):
            heard.append((done, len(list((work.folder / "out" / "runs").iterdir()))))

    session = work.session(TEXT)
    run_sweep(session, session.plan(), work.folder / "out", monitor=Heard())
    assert heard == [(row, row) for row in range(1, 7)]


def test_executors_by_name():
    plugins = load_plugins(["sppm_pipeline.engine.run.executors"], distributions=False)
    assert isinstance(make_executor(None, 1, plugins), SerialExecutor)
    with make_executor("threads", 2, plugins) as pool:
        assert isinstance(pool, ThreadPoolExecutor)
    with pytest.raises(ConfigError, match="did you mean 'threads'"):
        make_executor("thread", 1, plugins)


def test_the_serial_executor_keeps_errors_in_futures():
    with SerialExecutor() as pool:
        assert pool.submit(divmod, 7, 2).result() == (3, 1)
        assert isinstance(pool.submit(divmod, 7, 0).exception(), ZeroDivisionError)


def test_tables():
    table = Table({"a": [1, 2], "b": [None, "x, y"]})  # type: ignore[arg-type]
    table.check()
    assert table.rows == 2
    assert table.summary() == {"rows": 2, "columns": ["a", "b"]}
    assert table.digest() == Table({"a": (1, 2), "b": (None, "x, y")}).digest()
    assert rows_of(table.columns)[1] == {"a": 2, "b": "x, y"}
    assert csv_text({**table.columns, "c": ([1], True)}) == 'a,b,c\n1,,[1]\n2,"x, y",true\n'
    with pytest.raises(ValueError, match="different lengths"):
        Table({"a": (1,), "b": ()}).check()


def test_a_parameter_given_on_the_command_line_is_no_axis_any_more(work):
    session = work.session(TEXT, p=("factor=7",))
    found = sweep_rows(session.configuration.sweep, session.configuration.params)
    assert [{name: plain(entry.node) for name, entry in row.items()} for row in found] == [
        {"seed": s} for s in (4, 5, 6)
    ]
    assert session.plan().params["factor"] == 7


def test_a_sweep_without_axes_left_is_a_single_run(work):
    session = work.session(TEXT, p=("factor=7",), seed=3)
    assert session.configuration.sweep is None
    assert session.plan().seed == 3
    assert not session.plan().after


def test_a_parameter_chooses_the_recipe(work):
    text = """params: {which: low}
recipes:
  low: [{stage: sample.random, count: 1}, {stage: field.scale, factor: 1}]
  high: [{stage: sample.random, count: 1}, {stage: field.scale, factor: 1000}]
pipeline:
  - {stage: tune.repeat, recipe: "${which}"}
sweep:
  which: [low, high]
"""
    record = run(work, text)
    values = [float(row["tune.repeat.value"]) for row in table_of(work.folder / "out")]
    assert values[0] != values[1]
    assert record["warnings"] == []
    assert [entry["warnings"] for entry in record["runs"]] == [[], []]
    with pytest.raises(ConfigError, match="no recipe 'hihg'") as caught:
        run(work, text.replace("[low, high]", "[low, hihg]"), to="other")
    assert (caught.value.where.line, caught.value.where.column) == (9, 16)
    assert caught.value.hint.startswith("did you mean 'high'?")


def test_numbers_of_short_lists_get_columns():
    summary = {"C": [[1.0, 2.0], [3.0, None]], "E": [4, 5.0, True], "long": [1] * 7, "said": ["a"], "in": [{"x": 1}]}
    assert numbers_of([{"id": "e", "summary": summary}]) == {
        "e.C.1.1": 1, "e.C.1.2": 2, "e.C.2.1": 3, "e.E.1": 4, "e.E.2": 5, "e.E.3": 1,
    }  # fmt: skip


def test_the_stages_of_after_are_given_the_files_of_the_runs(work, monkeypatch):
    available = {}

    class Noting(StepRunner):
        def __init__(self, *steps, **how):
            available.update(how["available"])
            super().__init__(*steps, **how)

    monkeypatch.setattr("sppm_pipeline.engine.run.sweep.StepRunner", Noting)
    run(work)
    table = available["sweep"]
    assert list(table.files) == ["number.txt"]
    for file, name in zip(table.files["number.txt"], table.columns["run"], strict=True):
        path = work.folder / "out" / "runs" / name / "number.txt"
        assert file.path == str(path)
        assert file.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


FLAKY = (
    PLUGIN
    + """
from concurrent.futures import BrokenExecutor, Executor, Future
from sppm_pipeline.errors import NativeCrash

class Flaky(Executor):
    '''Of rows 1 and 2 it says something else than what they were, and it breaks down at the fourth.'''
    about = "shaky ground"
    made = []
    def __init__(self, workers, where):
        Flaky.made.append((workers, where))
        self.where = where
        self.tasks = 0
    def submit(self, fn, task):
        self.tasks += 1
        future = Future()
        if task["row"] == 1:
            future.set_exception(OSError("lost the line"))
        elif task["row"] == 2:
            future.set_exception(NativeCrash("the worker died"))
        elif task["row"] == 3 and self.where == "edge":
            raise BrokenExecutor("the scheduler is gone")
        else:
            future.set_result(fn(task))
        return future

@hookimpl
def sppm_executors():
    return {"flaky": Flaky}
"""
)


def test_what_an_executor_says_of_a_row_is_recorded_for_that_row(work):
    path = work.write(FLAKY, "flaky.py")
    heard = []

    class Heard(Monitor):
        def sweep_started(self, about, total):
            heard.append((about, total))

    session = work.session(DEADLY.replace("[0, 11, 0, -11, 256]", "[0, 0, 0, 0, 0]"), plugins=[path])
    folder = work.folder / "out"
    record = run_sweep(
        session, session.plan(), folder, WorkerOptions(workers=3, executor="flaky", retries=4), monitor=Heard()
    )
    assert [row["status"] for row in record["runs"]] == ["done", "failed", "failed", "done", "done"]
    lost, crashed = (record["runs"][row]["error"] for row in (1, 2))
    assert "the executor 'flaky' lost run '0001': OSError: lost the line" in lost["message"]
    assert (lost["exit_code"], crashed["exit_code"]) == (4, 6)
    assert "run '0002' was taken down" in crashed["message"]
    made = next(m.Flaky.made for m in list(sys.modules.values()) if hasattr(getattr(m, "Flaky", None), "made"))
    assert made == [(3, "")] + [(1, "")] * 4  # the one that died has been tried again, alone
    assert heard == [("shaky ground", 5)]
    assert record["stages"][0]["summary"]["rows"] == 5


def test_a_sweep_whose_executor_breaks_down_ends_with_a_table(work):
    path = work.write(FLAKY, "flaky.py")
    text = DEADLY.replace("[0, 11, 0, -11, 256]", "[0, 0, 0, 0, 0]")
    record = run(work, text, plugins=[path], executor="flaky:edge", workers=2)
    assert [row["status"] for row in record["runs"]] == ["done", *["failed"] * 4]
    assert [row["error"] for row in table_of(work.folder / "out")][3:] == [record["runs"][3]["error"]["message"]] * 2
    assert record["runs"][3]["error"]["message"] == "the scheduler is gone; 3 of 5 runs had ended"
    assert record["runs"][3]["error"]["exit_code"] == 6


def test_a_place_is_refused_by_executors_that_have_none():
    plugins = load_plugins(["sppm_pipeline.engine.run.executors"], distributions=False)
    with pytest.raises(ConfigError, match="'threads' takes no place, got 'tcp"):
        make_executor("threads:tcp://head:1", 1, plugins)


def test_an_executor_holds_a_bounded_number_of_tasks():
    full = threading.Event()

    class Holding(ThreadPoolExecutor):
        held = most = 0

        def submit(self, fn, task):
            self.held += 1
            self.most = max(self.most, self.held)
            if self.held == 5:
                full.set()
            return super().submit(fn, task)

    def ended(number, result):
        pool.held -= 1

    pool = Holding(2)
    tasks = {number: {} for number in range(23)}
    assert serve(pool, lambda task: {"waited": full.wait(30)}, tasks, ended, None, most=5) == (None, [])
    assert (pool.most, pool.held) == (5, 0)


def test_workers_in_another_folder_find_the_configuration(work, monkeypatch):
    request = replace(work.session(TEXT).request, file="config.yaml")
    monkeypatch.chdir(work.folder)
    here, _ = request.read()
    sent = request.absolute()
    (work.folder / "elsewhere").mkdir()
    monkeypatch.chdir(work.folder / "elsewhere")
    with pytest.raises(ConfigError, match="there is no file"):
        request.read()
    there, _ = sent.read()
    assert there.folder == here.folder == work.folder
    assert there.pipeline == here.pipeline  # with the names by which messages call places
