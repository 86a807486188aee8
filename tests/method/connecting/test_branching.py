"""Exact graphs without a solver are those with it."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.method.connecting import exact
from sppm_pipeline.method.connecting.bounded import spanning_subgraph
from sppm_pipeline.method.connecting.exact import shortest_choice
from sppm_pipeline.method.connecting.program import Program
from sppm_pipeline.method.connecting.trees import edge_lengths
from sppm_pipeline.services.metric import stretched_metric


def by_the_solver(monkeypatch, *arguments, **options):
    with monkeypatch.context() as patch:
        patch.setattr(exact, "shortest_choice", lambda program, incumbent, slack: None)
        return spanning_subgraph(*arguments, **options)


@pytest.mark.parametrize(
    ("degree", "n", "options"),
    [
        ((3, 5), 70, {}),
        ((3, 5), 40, {"periodic": True}),
        ((3, 3), 30, {}),
        ((4, 6), 50, {"periodic": (1, 0, 1)}),
        ((2, 4), 20, {}),
        ((1, 2), 20, {}),
        ((1, 3), 30, {"clearance": 0.02}),
        ((3, 5), 25, {"clearance": 0.04}),
        ((3, 4), 40, {"two_edge_connected": True}),
        ((3, 5), 13, {"periodic": (1, 1, 0)}),
    ],
)
def test_graphs_are_those_of_the_solver(monkeypatch, degree, n, options):
    for seed in (1, 2):
        points = np.random.default_rng(seed).random((n, 3))
        ours = spanning_subgraph(points, degree, **options)
        theirs = by_the_solver(monkeypatch, points, degree, **options)
        assert np.array_equal(ours[0], theirs[0])
        assert np.array_equal(ours[1], theirs[1])


def test_in_a_metric_too(monkeypatch):
    points = np.random.default_rng(5).random((40, 3))
    metric = stretched_metric(np.linspace(0.5, 2.0, 40), np.random.default_rng(6).normal(size=(40, 3)))
    ours = spanning_subgraph(points, (3, 5), metric=metric)
    theirs = by_the_solver(monkeypatch, points, (3, 5), metric=metric)
    assert np.array_equal(ours[0], theirs[0])


def test_cells_of_the_paper_are_solved_without_the_solver(monkeypatch):
    def refuse(*arguments):
        raise AssertionError("the solver was asked")

    monkeypatch.setattr(exact, "_relaxed", refuse)
    for seed in range(3):
        spanning_subgraph(np.random.default_rng(seed).random((70, 3)), (3, 5))


def two_triangles() -> Program:
    """Two triangles and a long edge between them, one edge at least at every corner: relaxed, each goes by halves."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0.8, 0], [9, 0, 0], [10, 0, 0], [9.5, 0.8, 0]], float)
    edges = np.array([[0, 1], [0, 2], [1, 2], [1, 3], [3, 4], [3, 5], [4, 5]])
    return Program(points, edges, np.zeros((7, 3), int), 1, 2, tree=False, connected=np.arange(6))


def test_a_row_of_parity_makes_an_odd_cycle_whole():
    program = two_triangles()
    choice = shortest_choice(program, None, 1e-9)
    lengths = program.cost[choice]
    assert np.count_nonzero(choice[:3]) == np.count_nonzero(choice[4:]) == 2
    assert lengths.sum() == pytest.approx(4 * np.sqrt(0.25 + 0.64))
    assert len(program.rows().counts) > 6 + 1


def test_what_takes_too_long_or_is_too_large_is_left_to_the_solver(monkeypatch):
    monkeypatch.setattr(exact, "_PROGRAMS", 1)
    assert shortest_choice(two_triangles(), None, 1e-9) is None
    monkeypatch.undo()
    monkeypatch.setattr(exact, "_LARGEST", 10)
    assert shortest_choice(two_triangles(), None, 1e-9) is None


@pytest.mark.parametrize(
    ("shape", "degree", "options"),
    [
        ((3, 3, 3), (3, 5), {}),
        ((4, 4, 2), (3, 5), {"periodic": True}),
        ((5, 5, 1), (2, 3), {"two_edge_connected": True}),
        ((4, 3, 3), (3, 3), {}),
        ((6, 4, 1), (2, 4), {"periodic": True, "two_edge_connected": True}),
    ],
)
def test_where_edges_of_grids_are_equally_long_no_choice_of_the_solver_is_shorter(monkeypatch, shape, degree, options):
    grid, solved = np.argwhere(np.ones(shape)) / max(shape), []

    def noted(*arguments):
        solved.append(shortest_choice(*arguments))
        return solved[-1]

    for seed in range(3):
        points = np.random.default_rng(seed).permutation(grid)[: len(grid) // 2 * 2 - 2 * seed]
        with monkeypatch.context() as patch:
            patch.setattr(exact, "shortest_choice", noted)
            ours = spanning_subgraph(points, degree, **options)
        theirs = by_the_solver(monkeypatch, points, degree, **options)
        assert edge_lengths(points, *ours).sum() == pytest.approx(edge_lengths(points, *theirs).sum(), rel=1e-9)
    assert sum(choice is not None for choice in solved) >= 2


@pytest.mark.parametrize("seed", [3, 6, 18])
def test_branching_goes_on_where_all_that_is_undecided_has_no_length(monkeypatch, seed):
    rng = np.random.default_rng(seed)
    points = rng.random((5, 3))[rng.integers(0, 5, 17)]
    found = []
    with monkeypatch.context() as patch:
        patch.setattr(exact, "shortest_choice", lambda *given: found.append(shortest_choice(*given)) or found[-1])
        ours = spanning_subgraph(points, (2, 3), k=9, two_edge_connected=True)
    theirs = by_the_solver(monkeypatch, points, (2, 3), k=9, two_edge_connected=True)
    assert [choice is not None for choice in found] == [True]
    assert edge_lengths(points, *ours).sum() == pytest.approx(edge_lengths(points, *theirs).sum(), rel=1e-9)
