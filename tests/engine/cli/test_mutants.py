"""Hundreds of damaged copies of the example configurations; tests/endurance/mutants.py makes tens of thousands."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def mutants():
    spec = importlib.util.spec_from_file_location("endurance_mutants", ROOT / "tests" / "endurance" / "mutants.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("example", sorted((ROOT / "configs").glob("*.yaml")), ids=lambda path: path.stem)
def test_damaged_configurations_are_refused_with_their_place(mutants, example, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with mutants.loading_once():
        codes, faults, _ = mutants.torment(tmp_path, example, 10, 1, 1)
    assert faults == []
    assert codes[2] > 5


def test_undamaged_ones_pass(mutants, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for example in (ROOT / "configs").glob("*.yaml"):
        if "pip install ./plugins/" in example.read_text(encoding="utf-8"):
            continue  # some of its stages come from a distribution, and mutants load none
        # the mesh of the bunny is the user's to bring, and this is told
        assert mutants.fault_of(example, "check") == (None, 2 if example.stem == "bunny" else 0), example.stem


def test_the_judge_sees_what_is_wrong(mutants, tmp_path, monkeypatch):
    path = tmp_path / "f.yaml"
    for broken, words in (
        (lambda arguments: 1 / 0, "ZeroDivisionError left the program"),
        (lambda arguments: 1, "exit 1"),
        (lambda arguments: print("sppm: no place", file=sys.stderr) or 2, "without its place"),
        (lambda arguments: print("Traceback", file=sys.stderr) or 2, "Traceback"),
    ):
        monkeypatch.setattr(mutants, "sppm", broken)
        assert words in mutants.fault_of(path, "check")[0]
    monkeypatch.setattr(mutants, "LONGEST", 0.05)
    monkeypatch.setattr(mutants, "sppm", lambda arguments: __import__("time").sleep(5))
    assert mutants.fault_of(path, "check")[0] == "hangs"
