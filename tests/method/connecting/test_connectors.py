from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.connecting.clearance import nearest_connectors, segment_distance


def connectors_by_sorting(face, interior, clearance):
    joined: list[int] = []
    for p in face:
        ranking = np.argsort(((interior - p) ** 2).sum(axis=1), kind="stable")[:2].tolist()

        def free(choice, p=p):
            return all(
                other == choice or segment_distance(p, interior[choice], q, interior[other], np.zeros(3)) >= clearance
                for q, other in zip(face, joined, strict=False)
            )

        joined.append(next((choice for choice in ranking if free(choice)), ranking[0]))
    return joined


@settings(max_examples=60, deadline=None, derandomize=True)
@given(f=st.integers(0, 12), n=st.integers(1, 15), seed=st.integers(0, 100), clearance=st.sampled_from([0, 0.05, 0.3]))
def test_matches_the_obvious_way(f, n, seed, clearance):
    rng = np.random.default_rng(seed)
    face, interior = rng.random((f, 3)) * [0, 1, 1], rng.random((n, 3))
    assert nearest_connectors(face, interior, clearance=clearance).tolist() == connectors_by_sorting(
        face, interior, clearance
    )


def test_takes_the_second_nearest_where_the_nearest_would_come_too_close():
    face = [[0.0, 0.0, 0.0], [0.03, 0.0, 0.0]]
    interior = [[0.0, 0.0, 0.09], [0.015, 0.0, 0.091], [0.06, 0.04, 0.078]]
    assert nearest_connectors(face, interior, clearance=0.0).tolist() == [0, 1]
    # the tunnels to 0 and 1 end 0.015 apart, those to 0 and 2 are nowhere nearer than their feet, 0.03
    assert nearest_connectors(face, interior, clearance=0.025).tolist() == [0, 2]
    # now both are too close: the nearest it is
    assert nearest_connectors(face, interior, clearance=0.035).tolist() == [0, 1]
    # a tunnel to the same pore is never too close
    assert nearest_connectors(face, interior[:2], clearance=0.025).tolist() == [0, 0]


def test_without_an_interior_there_is_nothing_to_join():
    with pytest.raises(DesignError, match="2 face pores"):
        nearest_connectors(np.zeros((2, 3)), np.zeros((0, 3)), clearance=0.1)
    assert nearest_connectors(np.zeros((0, 3)), np.zeros((0, 3)), clearance=0.1).shape == (0,)
