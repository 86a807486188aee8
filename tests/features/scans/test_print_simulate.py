"""Layers as light makes them, against the closed form of a wall."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from sppm_pipeline.features.scans.stages.print_simulate import PrintSimulate
from sppm_pipeline.method.slicing.slice_stack import ArraySlices
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.plain_context import PlainContext


def mm(value):
    return Length(value, "mm")


def cured(layers, spread, penetration, cure_depth, pixel=0.005, layer=0.05):
    stage = PrintSimulate(spread=mm(spread), penetration=mm(penetration), cure_depth=mm(cure_depth))
    context = PlainContext()
    return stage.run(context, ArraySlices(layers, (pixel, pixel, layer))), context


@pytest.mark.parametrize(("spread", "depth"), [(0.02, 0.1), (0.03, 0.07)])
def test_the_width_of_a_wall_is_that_of_the_closed_form(spread, depth):
    width, n, layers, penetration, layer, pixel = 0.2, 120, 30, 0.05, 0.05, 0.005
    stack = np.zeros((layers, 4, n), np.uint8)
    stack[:, :, n // 2 - 20 : n // 2 + 20] = 255
    # a long wall: blurred along y it would end, so rows are repeated to more than the spread
    image, _ = cured(stack.repeat(16, 1), spread, penetration, depth, pixel, layer)
    top, bottom = image.values[:, 32, -1].sum() * pixel, image.values[:, 32, 0].sum() * pixel
    for measured, seen in ((top, 1), (bottom, layers)):
        dose = sum(math.exp((depth - (j + 0.5) * layer) / penetration) for j in range(seen))

        def light(x, dose=dose):
            return dose * 0.5 * sum(math.erf((width / 2 + s * x) / (math.sqrt(2) * spread)) for s in (1, -1)) - 1

        exact = 2 * brentq(light, 0, 1)
        assert measured == pytest.approx(exact, abs=max(0.02 * exact, 2 * pixel))
    assert bottom > width + 2 * pixel


def test_light_cures_the_void_below_a_ceiling_to_the_depth_of_jacobs():
    stack = np.zeros((20, 9, 9), np.uint8)
    stack[10:] = 255
    image, context = cured(stack, 0.0, 0.1, 0.12, layer=0.01)
    first = int(np.flatnonzero(image.values[4, 4])[0])
    # below many layers: C_d + D_p ln(1 / (1 - q)), counted between middles of layers, of which ten are exposed here
    q = math.exp(-0.1)
    reach = 0.12 + 0.1 * math.log((1 - q**10) / (1 - q))
    assert first == max(0, math.ceil(10 - reach / 0.01 - 0.5))
    assert context.reported["grown"] > 0


def test_without_spread_and_depth_what_is_exposed_is_what_is_built():
    stack = (np.random.default_rng(0).random((6, 8, 10)) < 0.5).astype(np.uint8) * 255
    image, context = cured(stack, 0.0, 0.001, 0.026, layer=0.05)
    assert (stack // 255 == image.values.T).all()
    assert context.reported["grown"] == 0
    assert image.spacing == (0.005, 0.005, 0.05)
    _, context = cured(stack, 0.0, 0.01, 0.01, layer=0.05)
    assert any("less than half a layer" in message for message in context.warnings)
