"""The language of formulas: what it means, and that no text does harm."""

import random
import time

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.services.expression import CONSTANTS, FUNCTIONS, MAX_DEPTH, MAX_LENGTH, Expression

POINTS = np.linspace(-3, 3, 7)
VALUES = {"x": POINTS, "y": POINTS[::-1] ** 2, "z": np.arange(7.0)}

FORMULAS = [
    "1", "x", "-x**2", "2**-1", "2**3**2", "x - y - z", "x / (y + 1) / 2", "-x % 3", "x + y*z - 3*(x - 1)", "+x", "--x",
    "1 < 2 < 3", "x < y <= z", "x != 0", "not x > 1", "x if x > 0 else -x", "1 if x < -1 else 2 if x < 1 else 3",
    "x > 0 and y > 1", "x > 0 or y > 1 and z < 2", "not (x > 0) or z == 1", "sin(x)*cos(y) - tan(z/9)", "exp(-x**2)",
    "log(y + 1)", "sqrt(abs(x))", "floor(x * 1.5)", "tanh(x)", "atan2(y, x)", "hypot(x, y)", "min(x, y)",
    "max(x, y, z, 1)", "clip(x, -1, 1.5)", "where(x > 0, y, z)", "step(1, x)", "smoothstep(-1, 2, x)",
    "mix(x, y, 0.25)", "pi * 1e-1 + .5 + 2.", "(x)", "x*-y", "2*x**2*3",
]  # fmt: skip
"""Formulas that Python understands as well."""


def one(name, *values):
    """A function for one point by Python's own arithmetic."""
    import math

    plain = {
        "abs": abs, "min": min, "max": max, "clip": lambda x, low, high: min(max(x, low), high),
        "where": lambda c, a, b: a if c else b, "step": lambda edge, x: float(x >= edge),
        "mix": lambda a, b, t: a + t * (b - a),
    }  # fmt: skip
    if name == "smoothstep":
        low, high, x = values
        t = min(max((x - low) / (high - low), 0), 1)
        return 3 * t**2 - 2 * t**3
    return plain.get(name, getattr(math, name, None))(*values)


@pytest.mark.parametrize("text", FORMULAS)
def test_a_formula_means_what_python_means(text):
    made = Expression(text, VALUES).evaluate(VALUES, 7)
    names = {name: lambda *v, name=name: one(name, *v) for name in FUNCTIONS} | CONSTANTS
    expected = [eval(text, {}, names | {n: float(v[k]) for n, v in VALUES.items()}) for k in range(7)]
    np.testing.assert_allclose(made, np.array(expected, float), rtol=1e-14, atol=1e-15)


def test_numbers_do_not_grow_and_both_branches_may_be_undefined():
    assert np.isinf(Expression("9**9**9**9", ()).evaluate({}, 2)).all()
    assert np.isnan(Expression("0/0", ()).evaluate({}, 1)).all()
    np.testing.assert_array_equal(Expression("007*x", VALUES).evaluate(VALUES, 7), 7 * POINTS)
    made = Expression("sqrt(x) if x > 0 else log(-x) if x < 0 else 0", VALUES).evaluate(VALUES, 7)
    assert np.isfinite(made).all()


def test_values_do_not_depend_on_the_number_of_points():
    x = np.linspace(-2, 9, 40_001)
    expression = Expression("exp(sin(x)) * tanh(x) ** 2", ("x",))
    whole = expression.evaluate({"x": x}, len(x))
    np.testing.assert_array_equal(whole[17:20_000:3], expression.evaluate({"x": x[17:20_000:3]}, len(x[17:20_000:3])))


WRONG = {
    "": 0, "x +": 3, "x + + ": 6, "(x": 0, "x)": 1, "x y": 2, "2x": 0, "1e5e5": 0, "x // 2": 2, "x = 2": 2, "x ^ 2": 2,
    "q": 0, "1 + porosty": 4, "foo(x)": 0, "sin": 0, "sin()": 0, "sin(x, y)": 0, "min(x)": 0, "clip(x, 1)": 0, "x()": 0,
    "pi(1)": 0, "x if y": 0, "if": 0, "x and": 5, "not": 3, "a.b": 1, "x.y": 1, "'text'": 0, "[x]": 0, "{}": 0,
    "x[0]": 1, "lambda: x": 6, "x := 3": 2, "__import__('os')": 11, "().__class__": 2, "x; y": 1, "1j": 0, "0x10": 0,
    "x if y else": 11, "\u00e4": 0, "x\x00": 1, "max(x,)": 0, "x, y": 0, "*x": 0, "x < not y": 4, "1_000": 0,
    "f'{x}'": 1,
    "x == y = z": 7, "__import__(x)": 0, "()": 0, "min(x y)": 4, "2*1e999": 2, "x is y": 0, "f(x=y)": 3,
}  # fmt: skip
"""Texts that are no formulas, and the position of what is wrong."""


@pytest.mark.parametrize("text", WRONG)
def test_errors_name_the_position(text):
    with pytest.raises(ConfigError) as caught:
        Expression(text, ("x", "y", "porosity"))
    at = WRONG[text]
    place = "at its end" if at >= len(text.rstrip()) else f"at character {at + 1},"
    assert place in caught.value.message, caught.value.message
    assert "\n" not in caught.value.message


def test_misspelt_names_are_explained():
    for text, meant in (("1 + porosty", "porosity"), ("smothstep(0, 1, x)", "smoothstep")):
        with pytest.raises(ConfigError) as caught:
            Expression(text, ("x", "porosity"))
        assert f"did you mean {meant!r}" in str(caught.value)


BOMBS = [
    "(" * 1000, "((" * 499 + "x", "-" * 999 + "x", "not " * 249 + "x", "x**" * 330 + "x", "x if x else " * 80 + "x",
    "sin(" * 200 + "x" + ")" * 200, "min(" + "x," * 480 + "x)", "1" * 1000, "1e" + "9" * 900, "x<" * 490 + "x",
    "9**" * 330 + "9", "{" * 1000, "[" * 1000, "f(**" * 240, "lambda:" * 140 + "x", "x" * 1000, "+" * 1000,
    " " * 999 + "x", "x or " * 190 + "x", "a." * 490 + "a", "\t\n" * 400, "((((((((((x" + "))" * 400,
    "x" * MAX_LENGTH + "x",
]  # fmt: skip


def harmless(text):
    """Compile and evaluate; how long it took."""
    started = time.thread_time()
    try:
        made = Expression(text, VALUES).evaluate(VALUES, 7)
        assert made.shape == (7,)
    except ConfigError as error:
        message = str(error)
    else:
        message = ""
    took = time.thread_time() - started
    assert len(message) < 400, text
    return took


def test_no_text_hangs_or_fails_in_another_way():
    rng = random.Random(5)
    alphabet = "xyz0123456789.+-*/%<>=!(), \t\n\0e_'\"[]{}:;@#\\~^&|\u00e4\U0001f600"
    words = [
        *FUNCTIONS,
        *CONSTANTS,
        "and",
        "or",
        "not",
        "if",
        "else",
        "**",
        "==",
        "9**9",
        "lambda",
        "__class__",
        "1e308",
        "q",
    ]
    texts = list(BOMBS)
    while len(texts) < 10_000:
        text = rng.choice(FORMULAS)
        for _ in range(rng.randint(1, 6)):
            at = rng.randint(0, len(text))
            insert = rng.choice(words) if rng.random() < 0.4 else rng.choice(alphabet)
            text = rng.choice((
                text[:at] + insert + text[at:], text[:at] + text[at + 1 :], text + insert + text, text[at:] + text[:at],
                f"({text})", f"{text} {insert} {rng.choice(FORMULAS)}",
            ))[:1200]  # fmt: skip
        texts.append(text)
    slow = [text for text in texts if harmless(text) > 0.01]
    # what takes long each time is slow; a pause of the machine is not
    assert not [text for text in slow if min(harmless(text) for _ in range(3)) > 0.01]


def test_bounds_of_size():
    deep = MAX_DEPTH - 1
    assert Expression("(" * deep + "x" + ")" * deep, ("x",)).evaluate(VALUES, 7)[0] == -3
    for text in (BOMBS[-1], "(" * (MAX_DEPTH + 1) + "x" + ")" * (MAX_DEPTH + 1), "x+" * 300 + "x"):
        with pytest.raises(ConfigError, match=r"limit|deep|more than"):
            Expression(text, ("x",))
