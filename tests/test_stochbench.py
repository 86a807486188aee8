"""The public benchmark: its checkers know exact cases, and a tool is a file with one function."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks.stochbench import __main__ as bench

CONNECTED = bench.load(bench.HERE / "connected" / "check.py")


def test_pieces_are_joined_across_the_borders_of_the_cell():
    phase = np.zeros((6, 6, 6), bool)
    phase[:1] = phase[-1:] = True  # one slab, cut by the border
    assert CONNECTED.pieces(phase) == 1
    assert not CONNECTED.is_whole(np.roll(phase, 3, 0))  # the same slab in the middle: the faces along x are void
    assert CONNECTED.is_whole(np.ones((4, 4, 4), bool))
    phase[3, 3, 3] = True
    assert CONNECTED.pieces(phase) == 2
    assert CONNECTED.check([~phase], [{}], {})["pieces of void"] == 2


def test_porosity_is_counted():
    cell = np.zeros((4, 4, 4), bool)
    cell[:1] = True
    found = bench.load(bench.HERE / "porosity" / "check.py").check([cell], [{"porosity": 0.7}], {})
    assert found["largest error"] == pytest.approx(0.05)


def test_every_task_has_inputs_truth_and_a_checker():
    assert set(bench.tasks()) == {"connected", "porosity", "stiffness"}
    for folder in bench.tasks().values():
        task = json.loads((folder / "task.json").read_text(encoding="utf-8"))
        assert task["truth"]
        assert all(set(one) == {"porosity", "seed", "n"} for one in task["inputs"])
        assert callable(bench.load(folder / "check.py").check)
        assert f"| `{folder.name}` |" in (bench.HERE / "README.md").read_text(encoding="utf-8")


def test_tools_are_short_and_give_periodic_cells_of_the_asked_porosity():
    assert {"spinodoid", "sppm_paper", "sppm_stiff"} <= set(bench.tools())
    assert all(len(path.read_text().splitlines()) <= 60 for path in (bench.HERE / "tools").glob("*.py"))
    make = bench.tools()["spinodoid"].make
    cell = make(0.7, 1, 16)
    assert cell.mean() == pytest.approx(0.3, abs=1 / 16**3)
    assert (make(0.7, 1, 16) == cell).all()
    assert (make(0.7, 2, 16) != cell).any()


def test_a_cell_of_the_wrong_shape_is_refused(tmp_path):
    (tmp_path / "wrong.py").write_text(
        "import numpy\n\ndef make(porosity, seed, n):\n    return numpy.ones((n, n), bool)\n"
    )
    with pytest.raises(ValueError, match="must be"):
        bench.run(bench.load(tmp_path / "wrong.py"), bench.tasks()["porosity"])
