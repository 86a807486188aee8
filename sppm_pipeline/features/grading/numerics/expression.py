"""Formulas as text: a small language of arithmetic, parsed here and nowhere else, evaluated on arrays.

What it means is what Python means by the same text, with three differences: every number is a float64, so that nothing
can grow beyond it; truth is 1 and falsehood 0, also of ``and`` and ``or``; and both branches of a condition are
evaluated. The parser knows numbers, names, operators and calls of the functions below, and there is nothing else that a
text could reach. Text and result are bounded in length, depth and number of operations before anything is computed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import ConfigError

LONGEST, DEEPEST, MOST = 1000, 40, 200
"""Characters, depth, and operations of a formula."""

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


_COMPARISONS: Mapping[str, Callable[[Values, Values], Values]] = {
    "<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal, "!=": np.not_equal,
}  # fmt: skip
_BINARY: Mapping[str, tuple[int, Callable[[Values, Values], Values]]] = {
    "+": (1, np.add), "-": (1, np.subtract), "*": (2, np.multiply), "/": (2, np.divide), "%": (2, np.mod),
}  # fmt: skip
"""Operator -> how tightly it binds, and what it does."""

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|(?P<name>[A-Za-z_]\w*)|(?P<sign>\*\*|[<>=!]=|[-+*/%<>(),]))",
    re.ASCII,
)


class Token(NamedTuple):
    """A word of a formula.

    Attributes
    ----------
    kind : str
        "number", "name", "sign" or "end".
    text : str
    at : int
        Its first character, from 0.
    """

    kind: str
    text: str
    at: int


class Operation(NamedTuple):
    """One step of a compiled formula, on a stack of values.

    Attributes
    ----------
    takes : int
        How many values it takes from the stack.
    make : function, float64, or str
        What computes the new value of them; a number or the name of a variable if it takes none.
    """

    takes: int
    make: Any


def tokens_of(text: str) -> list[Token]:
    """The words of a formula.

    Raises
    ------
    ConfigError
        With the position of what is no word.
    """
    if len(text) > LONGEST:
        raise ConfigError(
            f"the formula has {len(text)} characters; the limit is {LONGEST}", hint="write it as several maps"
        )
    found, at, end = [], 0, len(text.rstrip())
    while at < end:
        match = _TOKEN.match(text, at)
        if match is None:
            place = at + len(text[at:]) - len(text[at:].lstrip())
            raise fault(text, place, f"{text[place]!r} has no meaning in a formula", _HINTS.get(text[place]))
        kind = match.lastgroup or ""
        found.append(Token(kind, match[kind], match.start(kind)))
        at = match.end()
    return [*found, Token("end", "", end)]


_HINTS = {
    "=": "compare by ==",
    "^": "powers are written **",
    "&": "write `and`",
    "|": "write `or`",
    "!": "write `not`",
    "[": "there are no lists",
    ".": "names have no dots",
}


def fault(text: str, at: int, what: str, hint: str | None = None) -> ConfigError:
    """An error that names the position in a formula, counted from 1, and shows what stands there."""
    shown = "".join(c if c.isprintable() else "?" for c in text[max(0, at - 20) : at + 20])
    place = f"at character {at + 1}" if at < len(text.rstrip()) else "at its end"
    return ConfigError(f"`formula` is wrong {place}, near {shown!r}: {what}", hint=hint)


def brief(word: str) -> str:
    """A word as messages show it."""
    return repr(word) if len(word) <= 40 else f"{word[:37]!r}..."


class _Parser:
    """Precedence climbing; what has been read is compiled to operations in the order in which they are computed."""

    def __init__(self, text: str, names: Iterable[str]) -> None:
        self.text, self.names = text, frozenset(names)
        self.tokens, self.next = tokens_of(text), 0
        self.made: list[Operation] = []
        self.depth = 0
        self.used: dict[str, int] = {}

    @property
    def token(self) -> Token:
        return self.tokens[self.next]

    def fault(self, what: str, token: Token | None = None, hint: str | None = None) -> ConfigError:
        return fault(self.text, (token or self.token).at, what, hint)

    def took(self, *texts: str) -> bool:
        """Whether the next word is one of these; it is then passed."""
        if self.token.kind in ("sign", "name") and self.token.text in texts:
            self.next += 1
            return True
        return False

    def need(self, text: str) -> None:
        if not self.took(text):
            found = brief(self.token.text) if self.token.kind != "end" else "nothing"
            raise self.fault(f"expected {text!r}, got {found}")

    def add(self, count: int, make: Any) -> None:
        if len(self.made) >= MOST:
            raise self.fault(f"the formula has more than {MOST} operations", hint="write it as several maps")
        self.made.append(Operation(count, make))

    def deeper(self, read: Callable[[], None]) -> None:
        self.depth += 1
        if self.depth > DEEPEST:
            raise self.fault(f"the formula is nested more than {DEEPEST} deep", hint="write it as several maps")
        read()
        self.depth -= 1

    def formula(self) -> None:
        self.condition()
        if self.token.kind != "end":
            raise self.fault(f"expected an operator, got {brief(self.token.text)}", hint=_HINTS.get(self.token.text))

    def condition(self) -> None:
        self.either()
        if self.took("if"):
            self.either()
            self.need("else")
            self.deeper(self.condition)
            self.add(3, lambda yes, test, no: np.where(test != 0, yes, no))

    def either(self) -> None:
        self.both()
        while self.took("or"):
            self.both()
            self.add(2, lambda a, b: _truth((a != 0) | (b != 0)))

    def both(self) -> None:
        self.negation()
        while self.took("and"):
            self.negation()
            self.add(2, lambda a, b: _truth((a != 0) & (b != 0)))

    def negation(self) -> None:
        if self.took("not"):
            self.deeper(self.negation)
            self.add(1, lambda a: _truth(a == 0))
        else:
            self.comparison()

    def comparison(self) -> None:
        self.sum(1)
        signs = []
        while self.token.kind == "sign" and self.token.text in _COMPARISONS:
            signs.append(self.token.text)
            self.next += 1
            self.sum(1)
        if signs:
            self.add(len(signs) + 1, _chain([_COMPARISONS[sign] for sign in signs]))

    def sum(self, tightest: int) -> None:
        self.signed()
        while self.token.kind == "sign" and self.token.text in _BINARY and _BINARY[self.token.text][0] >= tightest:
            binds, make = _BINARY[self.token.text]
            self.next += 1
            if self.token.text == "/" and make is np.divide:
                raise self.fault("// is not allowed", hint="write floor(a / b)")
            self.sum(binds + 1)
            self.add(2, make)

    def signed(self) -> None:
        if self.took("-"):
            self.deeper(self.signed)
            self.add(1, np.negative)
        elif self.took("+"):
            self.deeper(self.signed)
        else:
            self.atom()
            if self.took("**"):
                self.deeper(self.signed)
                self.add(2, np.power)

    def atom(self) -> None:
        token = self.token
        self.next += 1
        if token.kind == "number":
            if self.token.kind == "name" and self.token.at == token.at + len(token.text):
                raise self.fault(f"{brief(token.text + self.token.text)} is no number", token)
            self.add(0, np.float64(token.text))
        elif token.kind == "sign" and token.text == "(":
            self.deeper(self.condition)
            self.need(")")
        elif token.kind == "name" and token.text not in WORDS:
            self.name(token)
        else:
            self.next -= 1
            found = brief(token.text) if token.kind != "end" else "nothing"
            raise self.fault(f"expected a number, a name or a bracket, got {found}", token)

    def name(self, token: Token) -> None:
        called = self.token.kind == "sign" and self.token.text == "("
        if token.text in FUNCTIONS:
            if not called:
                raise self.fault(f"{brief(token.text)} is a function", token, f"write {token.text}(...)")
            self.call(token)
        elif called:
            raise self.fault(f"there is no function {brief(token.text)}", token, nearest(token.text, FUNCTIONS))
        elif token.text in CONSTANTS:
            self.add(0, CONSTANTS[token.text])
        elif token.text in self.names:
            self.used.setdefault(token.text, token.at)
            self.add(0, token.text)
        else:
            raise self.fault(
                f"there is no name {brief(token.text)}", token, nearest(token.text, [*self.names, *CONSTANTS])
            )

    def call(self, token: Token) -> None:
        make, wanted, what = FUNCTIONS[token.text]
        self.need("(")
        count = 0
        while not self.took(")"):
            if count:
                self.need(",")
            self.deeper(self.condition)
            count += 1
        if count != wanted if wanted > 0 else count < -wanted:
            raise self.fault(f"{token.text} takes {what}; got {count} value(s)", token)
        self.add(count, make)


def _chain(makes: list[Callable[[Values, Values], Values]]) -> Callable[..., Values]:
    """A comparison of several values in a row, each with the next."""
    return lambda *v: _truth(reduce(np.logical_and, (make(v[i], v[i + 1]) for i, make in enumerate(makes))))


def nearest(word: str, known: Iterable[str]) -> str:
    """What a name may have been meant to be."""
    known = sorted(known)
    close = [name for name in known if name.lower() == word.lower()] or get_close_matches(word, known, 1)
    return f"did you mean {close[0]!r}?" if close else "known are " + ", ".join(known)


class Expression:
    """A formula, parsed and compiled.

    Parameters
    ----------
    text : str
    names : iterable of str
        Variables that it may use.

    Attributes
    ----------
    text : str
    used : mapping of str to int
        The variables that it uses, and the position of the first use, from 0.

    Raises
    ------
    ConfigError
        With the position of what is wrong.
    """

    def __init__(self, text: str, names: Iterable[str]) -> None:
        parser = _Parser(text, names)
        parser.formula()
        self.text = text
        self.used: Mapping[str, int] = parser.used
        self._program = tuple(parser.made)

    def evaluate(self, values: Mapping[str, NDArray[np.float64]], count: int) -> NDArray[np.float64]:
        """Its value at `count` points.

        Parameters
        ----------
        values : mapping of str to (count,) float64
            The variables that it uses.
        count : int

        Returns
        -------
        (count,) float64
            Not finite where the formula is not defined.
        """
        made = np.empty(count)
        with np.errstate(all="ignore"):
            for start in range(0, count, BLOCK):
                own = slice(start, min(start + BLOCK, count))
                made[own] = self._value({name: values[name][own] for name in self.used})
        return made

    def _value(self, values: Mapping[str, NDArray[np.float64]]) -> Values:
        stack: list[Values] = []
        for count, make in self._program:
            if count:
                taken = stack[-count:]
                del stack[-count:]
                stack.append(make(*taken))
            else:
                stack.append(values[make] if isinstance(make, str) else make)
        return stack[-1]
