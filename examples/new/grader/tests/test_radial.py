"""The grader keeps the contract of stages, and its own promises."""

from __future__ import annotations

import numpy as np
from my_plugin.radial import GradeRadial

import sppm_pipeline as sppm
from sppm_pipeline.nouns import Grading, Place
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext

BALL = sppm.read.primitive(shape="ball", size=["8 mm", "8 mm", "8 mm"])


class TestGradeRadial(StageContract):
    def stages(self):
        return [
            GradeRadial(of="porosity", inside=0.8, outside=0.5),
            GradeRadial(of="pore_radius", measure="um", inside=300, outside=500),
        ]

    def inputs(self):
        return {"part": BALL}


def test_the_values_on_the_axis_half_way_and_outside():
    made = GradeRadial(of="porosity", inside=0.8, outside=0.5).run(PlainContext(), None, BALL)
    axis = (BALL.lower + BALL.upper) / 2
    points = axis + np.array([[0, 0, 3], [2, 0, 0], [0, 4, 1], [40, 0, 0]])
    assert np.allclose(made.law("porosity").at(Place(Grading(), points)), [0.8, 0.65, 0.5, 0.5], atol=0.01)


def test_radii_become_millimeters():
    made = GradeRadial(of="pore_radius", measure="um", inside=300, outside=500).run(PlainContext(), None, BALL)
    assert made.law("pore_radius").ends == (0.3, 0.5)
