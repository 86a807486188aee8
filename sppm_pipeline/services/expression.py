"""Formulas as text: arithmetic in Python's grammar, evaluated on arrays; Python parses the text, and never runs it.

A formula means what Python means by the same text, with three differences: every number is a float64, so that nothing
can grow beyond it; truth is 1 and falsehood 0, also of ``and`` and ``or``; and both branches of a condition are
evaluated. Numbers, known names, operators and calls of the functions below are taken from the syntax tree, and
everything else is refused. Length, depth and number of operations are bounded before anything is computed.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Mapping
from functools import partial, reduce
from itertools import accumulate
from typing import Any

import numpy as np

from sppm_pipeline.errors import ConfigError, did_you_mean
from sppm_pipeline.services.arrays import F64

MAX_LENGTH, MAX_DEPTH, MAX_OPERATIONS = 1000, 40, 200
"""Characters, depth of brackets, and numbers, names and operations of a formula."""

BLOCK = 1 << 14
"""Points that are evaluated together, so that what is computed on the way stays in the processor's cache."""

Values = Any
"""float64: one for all points, or (n,)."""


def _smoothstep(low: Values, high: Values, x: Values) -> Values:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


FUNCTIONS: Mapping[str, tuple[Callable[..., Values], int, str]] = {
    "sin": (np.sin, 1, "x in radians"),
    "cos": (np.cos, 1, "x in radians"),
    "tan": (np.tan, 1, "x in radians"),
    "exp": (np.exp, 1, "x"),
    "log": (np.log, 1, "x; the natural logarithm"),
    "sqrt": (np.sqrt, 1, "x"),
    "abs": (np.abs, 1, "x"),
    "floor": (np.floor, 1, "x"),
    "tanh": (np.tanh, 1, "x"),
    "atan2": (np.arctan2, 2, "y, x; radians from -pi to pi"),
    "hypot": (np.hypot, 2, "x, y"),
    "min": (lambda *v: reduce(np.minimum, v), -2, "two or more values"),
    "max": (lambda *v: reduce(np.maximum, v), -2, "two or more values"),
    "clip": (lambda x, low, high: np.minimum(np.maximum(x, low), high), 3, "x, low, high"),
    "where": (lambda c, a, b: np.where(c != 0, a, b), 3, "condition, value if true, value if false"),
    "step": (lambda edge, x: np.where(x >= edge, 1.0, 0.0), 2, "edge, x; 0 below the edge, 1 from it on"),
    "smoothstep": (_smoothstep, 3, "low, high, x; 0 to 1 with horizontal ends"),
    "mix": (lambda a, b, t: a * (1.0 - t) + b * t, 3, "a, b, t"),
}
"""Name -> function, number of arguments (negative: at least so many), and what they are."""

CONSTANTS = {"pi": np.float64(np.pi)}
WORDS = frozenset({"and", "or", "not", "if", "else"})


def _truth(value: Values) -> Values:
    return np.where(value, 1.0, 0.0)


def _chain(makes: list[Callable[[Values, Values], Values]], *v: Values) -> Values:
    """A comparison of several values in a row, each with the next."""
    return _truth(reduce(np.logical_and, (make(v[i], v[i + 1]) for i, make in enumerate(makes))))


_OPERATORS: Mapping[type[ast.AST], Callable[..., Values]] = {
    ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide, ast.Mod: np.mod,
    ast.Pow: np.power, ast.USub: np.negative, ast.UAdd: np.positive, ast.Not: lambda a: _truth(a == 0),
    ast.And: lambda *v: _truth(reduce(np.logical_and, [a != 0 for a in v])),
    ast.Or: lambda *v: _truth(reduce(np.logical_or, [a != 0 for a in v])),
    ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater, ast.GtE: np.greater_equal, ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
}  # fmt: skip

_NUMBER = re.compile(r"(?<![\w.])\.?\d(?:[eE][-+]|[\w.])*", re.ASCII)  # and what looks like one
_NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*", re.ASCII)
_MEANINGLESS = re.compile(r"[^\w\s+\-*/%<>=!().,]|(?<![<>=!])=(?!=)|!(?!=)|//|(?<!\d)\.(?!\d)", re.ASCII)
_HINTS = {
    "=": "compare by ==", "^": "powers are written **", "&": "write `and`", "|": "write `or`", "!": "write `not`",
    "[": "there are no lists", ".": "names have no dots", "//": "write floor(a / b)",
}  # fmt: skip


def names_in(text: str) -> set[str]:
    """The names that a text holds, of variables, functions, and ``and``, ``or``, ..."""
    return set(_NAME.findall(text[:MAX_LENGTH]))


def fault(text: str, at: int, what: str, hint: str | None = None) -> ConfigError:
    """An error that names the position in a formula, counted from 1, and shows what stands there."""
    shown = "".join(c if c.isprintable() else "?" for c in text[max(0, at - 20) : at + 20])
    place = f"at character {at + 1}" if at < len(text.rstrip()) else "at its end"
    return ConfigError(f"`formula` is wrong {place}, near {shown!r}: {what}", hint=hint)


def brief(word: str) -> str:
    """A word as messages show it."""
    return repr(word) if len(word) <= 40 else f"{word[:37]!r}..."


def _parsed(text: str) -> ast.expr:
    """The syntax tree of a formula; columns are those of the text without white space in front."""
    if len(text) > MAX_LENGTH:
        raise ConfigError(
            f"the formula has {len(text)} characters; the limit is {MAX_LENGTH}", hint="write it as several maps"
        )
    if match := _MEANINGLESS.search(text):
        raise fault(text, match.start(), f"{match[0]!r} has no meaning in a formula", _HINTS.get(match[0]))
    source = re.sub(r"\s", " ", text)
    for match in _NUMBER.finditer(text):
        number = match[0]
        if not re.fullmatch(r"(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", number, re.ASCII):
            raise fault(text, match.start(), f"{brief(number)} is no number")
        if np.isinf(float(number)):
            raise fault(text, match.start(), f"{brief(number)} is beyond the largest number, 1.8e308")
        if number.isdigit():  # Python reads no zeros in front
            source = source[: match.start()] + (number.lstrip("0") or "0").ljust(len(number)) + source[match.end() :]
    # counted before parsing: nested brackets could exhaust the parser's stack
    for at, depth in enumerate(accumulate((c == "(") - (c == ")") for c in text)):
        if depth > MAX_DEPTH:
            raise fault(text, at, f"the formula is nested more than {MAX_DEPTH} deep", "write it as several maps")
    try:
        return ast.parse(source.lstrip(), mode="eval").body
    except SyntaxError as error:
        at = error.offset - 1 + len(source) - len(source.lstrip()) if error.offset else len(text)
        found = re.match(r"\w+|\*\*|.|$", source[at:])
        what = error.msg
        if what == "invalid syntax":
            before = re.search(r"(\w+|\S)\s*$", source[:at])
            complete = before is not None and before[1] not in WORDS and (before[1] == ")" or before[1][0].isalnum())
            wanted = "an operator" if complete else "a number, a name or a bracket"
            what = f"expected {wanted}, got {brief(found[0]) if found and found[0] else 'nothing'}"
        elif what.startswith("invalid syntax"):
            what = "an operator or a comma is missing"
        raise fault(text, at, what) from None
    except (RecursionError, MemoryError):
        raise fault(text, 0, "the formula is nested too deep", "write it as several maps") from None


class Expression:
    """A formula, parsed and compiled, with the variables `names` that it may use; `ConfigError` states the position of
    what is wrong. `used` are the variables that it uses, each with the position of its first use, from 0.
    """

    def __init__(self, text: str, names: Iterable[str]) -> None:
        self.text = text
        self.used: dict[str, int] = {}
        # how many values each operation takes from the stack, and what computes the new one of them, or is it
        self._program: list[tuple[int, Any]] = []
        self._left = MAX_OPERATIONS
        self._compile(_parsed(text), frozenset(names))

    def _compile(self, node: ast.expr, names: frozenset[str]) -> None:
        """Append the operations of a node, in the order in which they are computed."""
        make: Any = None
        of: list[ast.expr] = []
        at = node.col_offset + len(self.text) - len(self.text.lstrip())
        wrong = partial(fault, self.text, at)
        self._left -= 1
        if self._left < 0:
            raise wrong(f"the formula has more than {MAX_OPERATIONS} operations", "write it as several maps")
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                make = np.float64(value)
            case ast.Name(id=name) if name in FUNCTIONS:
                raise wrong(f"{brief(name)} is a function", f"write {name}(...)")
            case ast.Name(id=name) if name in CONSTANTS:
                make = CONSTANTS[name]
            case ast.Name(id=name) if name in names:
                self.used.setdefault(name, at)
                make = name
            case ast.Name(id=name):
                raise wrong(f"there is no name {brief(name)}", did_you_mean(name, [*names, *CONSTANTS]))
            case ast.UnaryOp(op=op, operand=value):
                make, of = _OPERATORS.get(type(op)), [value]
            case ast.BinOp(left=left, op=op, right=right):
                make, of = _OPERATORS.get(type(op)), [left, right]
            case ast.BoolOp(op=op, values=of):
                make = _OPERATORS.get(type(op))
            case ast.Compare(left=left, ops=ops, comparators=others) if all(type(op) in _OPERATORS for op in ops):
                make, of = partial(_chain, [_OPERATORS[type(op)] for op in ops]), [left, *others]
            case ast.IfExp(body=yes, test=test, orelse=no):
                make, of = lambda yes, test, no: np.where(test != 0, yes, no), [yes, test, no]
            case ast.Call(func=ast.Name(id=name), args=of, keywords=[]) if name in FUNCTIONS:
                make, wanted, what = FUNCTIONS[name]
                if len(of) != wanted if wanted > 0 else len(of) < -wanted:
                    raise wrong(f"{name} takes {what}; got {len(of)} value(s)")
            case ast.Call(func=ast.Name(id=name)):
                raise wrong(f"there is no function {brief(name)}", did_you_mean(name, FUNCTIONS))
        if make is None:
            what = (ast.get_source_segment(self.text.strip(), node) or "").strip()
            raise wrong(
                f"{brief(what)} has no meaning in a formula", "it knows numbers, names, operators and functions"
            )
        for operand in of:
            self._compile(operand, names)
        self._program.append((len(of), make))

    def evaluate(self, values: Mapping[str, F64], count: int) -> F64:
        """Its value at `count` points; not finite where the formula is not defined."""
        made = np.empty(count)
        # values that are not finite are found, and named with their place, by the map
        with np.errstate(all="ignore"):
            for start in range(0, count, BLOCK):
                own = slice(start, min(start + BLOCK, count))
                made[own] = self._value({name: values[name][own] for name in self.used})
        return made

    def _value(self, values: Mapping[str, F64]) -> Values:
        stack: list[Values] = []
        for count, make in self._program:
            if count:
                taken = stack[-count:]
                del stack[-count:]
                stack.append(make(*taken))
            else:
                stack.append(values[make] if isinstance(make, str) else make)
        return stack[-1]
