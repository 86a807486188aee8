"""The audit of a run: the hook, the verdict in record and terminal, the exit code, and what lowers it."""

from __future__ import annotations

import json

import pytest

from sppm_pipeline.engine.cli import run as cli_run
from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.engine.run.events import AuditBreach, audited, breach_error
from sppm_pipeline.engine.run.sweep import run_sweep
from sppm_pipeline.hookspecs import Comparison

AUDITOR = """
from sppm_pipeline import hookimpl
from sppm_pipeline.nouns import Comparison

@hookimpl
def sppm_audit(record):
    value = record["stages"][0]["summary"]["value"]
    return [Comparison("the number", value, 3.0, 0.5), Comparison("itself", value, value, 0)]
"""

RUN = """seed: 1
EXTRA
pipeline:
  - {stage: read.number, value: VALUE}
  - {stage: write.number, path: a.txt}
"""


def config(value, extra=""):
    return RUN.replace("VALUE", str(value)).replace("EXTRA\n", extra)


@pytest.fixture
def audited_work(work):
    auditor = work.write(AUDITOR, "auditor.py")
    session = work.session
    work.session = lambda text, **how: session(text, plugins=[auditor], **how)
    return work


def test_a_run_whose_numbers_agree_passes(audited_work):
    record = audited_work.run(config(3.2))
    assert record["audit"]["verdict"] == "passed"
    assert [one["holds"] for one in record["audit"]["comparisons"]] == [True, True]
    assert "audit" not in record["config"]


def test_a_breach_is_in_the_record_and_a_warning(audited_work):
    record = audited_work.run(config(5))
    text = "the number: 5, expected 3 +- 0.5"
    assert record["audit"]["verdict"] == "breach"
    assert record["warnings"] == [f"audit: {text}"]
    assert json.loads((audited_work.folder / "out" / "run.json").read_text()) == record
    error = breach_error(record)
    assert isinstance(error, AuditBreach)
    assert error.exit_code == 3
    assert text in error.message
    assert breach_error(audited_work.run(config(3), to="other")) is None


def test_the_configuration_may_lower_a_breach(audited_work):
    record = audited_work.run(config(5, "audit: warn\n"))
    assert record["config"]["audit"] == "warn"
    error = audited_work.error(config(5, "audit: quiet\n"))
    assert error.message == "`audit` must be fail or warn, got 'quiet'"


def test_rows_of_a_sweep_are_audited(audited_work):
    session = audited_work.session("params: {v: 0}\nsweep: {v: [3, 7]}\n" + config("'${v}'"))
    record = run_sweep(session, session.plan(), audited_work.folder / "out")
    assert [row["breaches"] for row in record["runs"]] == [[], ["the number: 7, expected 3 +- 0.5"]]
    assert "run 0001: the number: 7" in breach_error(record).message


def test_an_auditor_that_raises_is_a_warning(audited_work):
    audited_work.write(AUDITOR.replace("value = ", "value = 1 / 0; "), "auditor.py")
    record = audited_work.run(config(5))
    assert record["audit"] == {"verdict": "nothing to compare", "comparisons": []}
    assert "sppm_audit raised ZeroDivisionError" in record["warnings"][0]


def test_numbers_that_are_not_finite_agree_with_nothing():
    assert not Comparison("a", float("nan"), float("nan"), 1.0).holds
    assert not Comparison("a", float("inf"), float("inf"), 1.0).holds
    assert Comparison("a", 1.0, 2.0, 1.0).holds
    assert audited({"stages": []}, [], print) == {"verdict": "nothing to compare", "comparisons": []}


def test_the_terminal_shows_the_verdict_and_a_breach_in_red(tmp_path, capsys, monkeypatch):
    good = {"verdict": "passed", "comparisons": [{"text": "a: 1", "holds": True}]}
    bad = {"verdict": "breach", "comparisons": [*good["comparisons"], {"text": "b: 2", "holds": False}]}
    assert list(cli_run.audit_lines(good, color=True)) == ["audit: passed, 1 of 1 comparisons agree"]
    assert list(cli_run.audit_lines(bad, color=True))[1] == "\x1b[31m  b: 2\x1b[0m"
    assert list(cli_run.audit_lines(bad, color=False))[1] == "  b: 2"
    assert not list(cli_run.audit_lines(None, color=True))
    (tmp_path / "auditor.py").write_text(AUDITOR.replace('record["stages"][0]["summary"]["value"]', "7.0"))
    (tmp_path / "a.yaml").write_text(
        "sppm: 1\nplugins: [auditor.py]\npipeline: [{stage: sample.dart_throwing, count: 4}]\n"
    )
    command = ["run", str(tmp_path / "a.yaml"), "-o", str(tmp_path / "out"), "--no-cache"]
    assert main(command) == 3
    shown = capsys.readouterr()
    assert "audit: breach, 1 of 2 comparisons agree\n  the number: 7, expected 3 +- 0.5" in shown.out
    assert "sppm: audit: the number: 7" in shown.err
    (tmp_path / "a.yaml").write_text((tmp_path / "a.yaml").read_text() + "audit: warn\n")
    assert main(command) == 0
