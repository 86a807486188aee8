"""The public benchmark: its checkers know exact cases, and a tool is a file with one function."""

from __future__ import annotations

import json
import re

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


def test_what_is_cut_off_a_filled_ball_is_loose():
    fill = bench.load(bench.HERE / "fill" / "check.py")
    body = fill.ball(1.25, 3, 32)
    assert body.sum() / 32**3 == pytest.approx(4 / 3 * np.pi * 1.25**3, rel=2e-3)
    slabs = np.zeros((32, 32, 32), bool)
    slabs[:16] = True  # three slabs, of which the middle one is the largest
    part = body & np.tile(slabs, [3, 3, 3])
    found = fill.check([slabs], [{}], {"radius": 1.25, "cells": 3, "porosity": 0.5})
    assert found["loose share of solid"] == pytest.approx(1 - part[32:64].sum() / part.sum())
    assert found["largest error of porosity"] == pytest.approx(abs(part.sum() / body.sum() - 0.5))
    assert found["empty layers"] == 0
    slabs = np.moveaxis(slabs, 0, 2)
    assert fill.check([slabs], [{}], {"radius": 1.25, "cells": 3, "porosity": 0.5})["empty layers"] > 30


def test_islands_overhang_and_trapped_resin_are_counted():
    defects = bench.load(bench.HERE / "defects" / "check.py")
    table = np.zeros((7, 7, 7), bool)
    table[3, 3, :5] = table[:, :, 5] = True
    assert defects.islands(table) == (0, 0)
    assert defects.overhang(table) == pytest.approx((49 - 5) / (49 + 4))
    table[1, 1:3, 2] = True  # an island of two pixels, begun in air
    assert defects.islands(table) == (1, 2)
    hollow = np.ones((6, 6, 6), bool)
    hollow[2:4, 2:4, 2:4] = False
    assert defects.trapped(hollow) == 1
    hollow[2, 2, 4:] = False
    assert defects.trapped(hollow) == 0
    found = defects.check([table[1:, 1:, 1:]], [{}], {"cells": 2})
    assert found["islands a cell"] == pytest.approx((4 + 4 + 4) / 8)


def test_statistics_of_the_scans_are_known_exactly():
    twin = bench.load(bench.HERE / "twin" / "check.py")
    truth = {"radius": 0.2, "balls": 20}
    draws = [twin.s2(twin.scans.scan(seed, 32, **truth)) for seed in range(40)]
    found = np.array([values for _, values in draws])
    exact = twin.scans.exact_s2(draws[0][0], **truth)
    error = found.std(axis=0) / np.sqrt(len(found))
    assert (np.abs(found.mean(axis=0) - exact) < 4 * error + 2e-3).all()
    one = twin.scans.scan(1, 32, **truth)
    scored = twin.check([one], [{"scan": {"seed": 1, "n": 32}, "seed": 1}], truth)
    assert scored["e of the twin"] == scored["e of the scan"]
    assert scored["is the scan"] == 1


def test_a_twin_is_another_structure_with_the_porosity_of_the_scan():
    twin = bench.load(bench.HERE / "twin" / "check.py")
    scan = twin.scans.scan(3, 16, 0.2, 20)
    made = bench.tools()["spinodoid"].twin(scan, 1)
    assert made.mean() == pytest.approx(scan.mean(), abs=1 / 16**3)
    assert (made != scan).mean() > 0.1


@pytest.mark.filterwarnings("ignore::sppm_pipeline.SppmWarning")
def test_a_tensor_is_compared_in_any_axes():
    tensor = bench.load(bench.HERE / "tensor" / "check.py")
    task = json.loads((bench.HERE / "tensor" / "task.json").read_text(encoding="utf-8"))
    _, straight, turned = (np.array(one["stiffness"]) for one in task["inputs"])
    assert tensor.norm(turned) == pytest.approx(tensor.norm(straight), rel=1e-4)  # the norm does not know the axes
    assert tensor.norm(turned - straight) > 0.1 * tensor.norm(straight)
    layers = np.zeros((8, 8, 8), bool)
    layers[:4] = True
    found = tensor.check([layers], [{"stiffness": task["inputs"][0]["stiffness"], "porosity": 0.5}], {"poisson": 0.3})
    exact = np.zeros((6, 6))  # layers across x: plane stress in y and z, nothing along x
    exact[1:3, 1:3] = 0.5 / (1 - 0.3**2) * np.array([[1, 0.3], [0.3, 1]])
    exact[3, 3] = 0.5 / 2.6
    target = np.array(task["inputs"][0]["stiffness"])
    assert found["mean distance"] == pytest.approx(tensor.norm(exact - target) / tensor.norm(target), rel=1e-3)
    assert found["largest difference of porosity"] == 0


def test_every_task_has_inputs_truth_and_a_checker():
    assert set(bench.tasks()) == {"connected", "defects", "fill", "porosity", "stiffness", "tensor", "twin"}
    for folder in bench.tasks().values():
        task = json.loads((folder / "task.json").read_text(encoding="utf-8"))
        assert task["truth"]
        keys = {"twin": {"scan", "seed"}, "tensor": {"stiffness", "porosity", "seed", "n"}}.get(
            folder.name, {"porosity", "seed", "n"}
        )
        assert all(set(one) == keys for one in task["inputs"])
        assert callable(bench.load(folder / "check.py").check)
        assert f"| `{folder.name}` |" in (bench.HERE / "README.md").read_text(encoding="utf-8")


def test_the_page_has_the_table_of_each_task_as_the_script_writes_it():
    text = (bench.HERE / "README.md").read_text(encoding="utf-8").split(bench.MARK)[1]
    found = re.findall(r"^(\w+)\n\n(.+)\n\|[-|]+\n((?:\|.+\n)+)", text, re.MULTILINE)
    assert [task for task, _, _ in found] == list(bench.tasks())
    for task, _, rows in found:
        shown = re.findall(r"^\| `(\w+)`", rows, re.MULTILINE)
        asks = bench.asked(bench.tasks()[task])[0]
        able = {path.stem for path in (bench.HERE / "tools").glob("*.py") if f"def {asks}(" in path.read_text()}
        assert set(shown) == able
    made = bench.as_table("porosity", {"spinodoid": {"largest error": 0.001, "mean error": 0.0005, "CPU s": 1.0}})
    assert made.strip().splitlines()[2] == next(head for task, head, _ in found if task == "porosity")


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
