"""Fields of plugins: what a formula returns is looked at when the stage has made its field, not layers later."""

from dataclasses import dataclass

import numpy as np
import pytest

from sppm_pipeline.fields.formula import FormulaField


@dataclass(frozen=True, eq=False, kw_only=True)
class Given(FormulaField):
    """A field of any function."""

    f: object

    def evaluate(self, x, y, z):
        return self.f(x, y, z)


WRONG = {
    "axes in another order": (
        lambda x, y, z: (x + y + z).T,
        r"shape \(z, y, x\) = \(3, 4, 2\).* got float64 \(2, 4, 3\)",
    ),
    "truth values": (lambda x, y, z: x + y + z < 1, "bool"),
    "nothing": (lambda x, y, z: None, "object"),
    "a hole": (lambda x, y, z: np.where(x + y + z > 0.5, np.nan, x), "finite numbers, got nan"),
}


@pytest.mark.parametrize("how", WRONG)
def test_a_formula_that_returns_something_else_is_found_before_it_is_used(how):
    f, said = WRONG[how]
    with pytest.raises(ValueError, match=said):
        Given(f=f).check()


def test_a_formula_may_return_as_little_as_it_depends_on():
    for f in (
        lambda x, y, z: x + y * z,
        lambda x, y, z: np.cos(z),
        lambda x, y, z: 0.5,
        lambda x, y, z: np.where(x, 1, -1),
    ):
        Given(f=f).check()
    with pytest.raises(ValueError, match="`edge_mm` of a field is a length above 0"):
        Given(f=lambda x, y, z: x, edge=-1.0).check()
    with pytest.raises(ValueError, match="3 whole numbers above 0"):
        Given(f=lambda x, y, z: x, region=(0, 1, 1)).check()
