"""Tetrahedral meshes: what they promise about themselves."""

import numpy as np
import pytest
from sppm_tetrahedra.volume_mesh import VolumeMesh

CORNER = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 3.0]])


def test_one_tetrahedron():
    mesh = VolumeMesh(CORNER, np.array([[0, 1, 2, 3]]), box=np.array([[0, 0, 0], [2, 2, 4.0]]))
    mesh.check()
    assert mesh.volume == pytest.approx(2.0)
    assert mesh.summary()["porosity"] == pytest.approx(1 - 2 / 16)
    assert mesh.materials.tolist() == [1]
    assert mesh.summary()["order"] == 1


@pytest.mark.parametrize(
    "changed",
    [
        {"nodes": np.full((4, 3), np.nan)},
        {"cells": np.array([[0, 1, 2]])},
        {"cells": np.array([[0, 1, 2, 4]])},
        {"cells": np.array([[0, 1, 2, -1]])},
        {"box": np.array([[0, 0, 0], [1, 0, 1.0]])},
        {"matched": True},
        {"materials": np.array([1, 1])},
    ],
)
def test_contradictions_are_refused(changed):
    with pytest.raises(ValueError):
        VolumeMesh(**{"nodes": CORNER, "cells": np.array([[0, 1, 2, 3]]), **changed}).check()
