"""The ports of a stage, read from the annotated signature of its `run`."""

from __future__ import annotations

import functools
import inspect
import itertools
import sys
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sppm_pipeline.errors import PluginError
from sppm_pipeline.stage import Recipe, Stage


@dataclass(frozen=True)
class Port:
    """An input of a stage."""

    name: str
    types: tuple[type, ...]  # the artifacts it takes; empty for a recipe
    optional: bool
    many: bool = False  # whether it takes the results of one or more stages, as a tuple in the order of `from`

    @property
    def is_recipe(self) -> bool:
        """True if it is handed a recipe and not an artifact."""
        return not self.types

    def place(self, number: int) -> str:
        """The name under which one of many inputs is kept until the stage is called; counted from 0."""
        return f"{self.name}[{number}]"


@dataclass(frozen=True)
class Signature:
    """Inputs and results of a stage."""

    ports: tuple[Port, ...]
    makes: tuple[type, ...]  # one of these is made; empty if nothing is
    as_recipe: bool  # whether it makes what its recipe makes (the result is annotated ``Any``)
    as_port: str | None = None  # the port whose artifact it passes on (both annotated with the same type variable)

    def gathered(self, inputs: Mapping[str, Any]) -> dict[str, Any]:
        """Inputs by port: those of ports that take many as tuples."""
        found = dict(inputs)
        for port in self.ports:
            if port.many:
                places = itertools.takewhile(found.__contains__, map(port.place, itertools.count()))
                found[port.name] = tuple(found.pop(place) for place in list(places))
        return found


@functools.cache
def signature_of(cls: type[Stage]) -> Signature:
    """The signature of ``cls.run``; `PluginError` if an annotation is missing or can't be resolved, or a parameter
    can't be a port.
    """
    name = f"{cls.__qualname__}.run"
    parameters = list(inspect.signature(cls.run).parameters.values())[1:]
    try:
        hints = typing.get_type_hints(cls.run)
    except Exception as error:
        raise PluginError(
            f"the annotations of {name} can't be resolved: {error}",
            hint="import the artifacts for real, not under TYPE_CHECKING",
        ) from error
    if not parameters or parameters[0].name != "context":
        raise PluginError(f"the first parameter of {name} must be `context`")
    ports = []
    for parameter in parameters[1:]:
        if parameter.kind not in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY):
            raise PluginError(f"{name} can't have the parameter {parameter}: each port needs a name")
        if parameter.name not in hints:
            raise PluginError(f"the port {parameter.name!r} of {name} has no annotation")
        ports.append(_port(parameter.name, hints[parameter.name], name))
    if "return" not in hints:
        raise PluginError(f"{name} does not say what it makes", hint="annotate the result, with None if it is nothing")
    result = hints["return"]
    if result is Any:
        if not any(port.is_recipe for port in ports):
            raise PluginError(f"{name} makes Any, which only a stage with a recipe may", hint="name the type it makes")
        return Signature(tuple(ports), (), True)
    makes = _members(result, f"the result of {name}")
    same = [port.name for port in ports if isinstance(result, typing.TypeVar) and hints[port.name] is result]
    as_port = same[0] if same else None
    return Signature(tuple(ports), () if makes == (types.NoneType,) else makes, False, as_port)


def _port(port: str, hint: Any, name: str) -> Port:
    elements = typing.get_args(hint) if typing.get_origin(hint) is tuple else ()
    many = len(elements) == 2 and elements[1] is Ellipsis
    members = _members(elements[0] if many else object if hint is Any else hint, f"the port {port!r} of {name}")
    optional = types.NoneType in members
    artifacts = tuple(member for member in members if member is not types.NoneType)
    if Recipe in artifacts:
        if artifacts != (Recipe,):
            raise PluginError(f"the port {port!r} of {name} must take either a recipe or artifacts")
        return Port(port, (), optional)
    if not artifacts:
        raise PluginError(f"the port {port!r} of {name} takes nothing")
    if many and optional:
        raise PluginError(f"the port {port!r} of {name} takes one or more artifacts, of which none is None")
    return Port(port, artifacts, optional, many)


def _members(hint: Any, what: str) -> tuple[type, ...]:
    if isinstance(hint, typing.TypeVar):
        hint = typing.Union[hint.__constraints__] if hint.__constraints__ else _bound(hint)  # noqa: UP007
    members = typing.get_args(hint) if typing.get_origin(hint) in (typing.Union, types.UnionType) else (hint,)
    members = tuple(types.NoneType if member is None else member for member in members)
    for member in members:
        if not isinstance(member, type) or typing.get_origin(member) is not None:
            raise PluginError(f"{what} must be annotated with artifacts (classes), got {hint}")
    return members


def _bound(variable: typing.TypeVar) -> Any:
    """The bound of a type variable, also if it was written in quotes."""
    bound = variable.__bound__
    if isinstance(bound, typing.ForwardRef):
        bound = getattr(sys.modules[variable.__module__], bound.__forward_arg__, bound)
    return bound or object


def fits(made: tuple[type, ...], port: Port) -> bool:
    """True if whatever a stage makes can go into `port`."""
    wanted = (*port.types, types.NoneType) if port.optional else port.types
    return bool(made) and made != (types.NoneType,) and all(issubclass(member, wanted) for member in made)


def port_words(port: Port) -> str:
    """The artifacts of a port in words."""
    return f"{'one or more of ' if port.many else ''}{artifact_words(port.types)}"


def artifact_words(artifacts: tuple[type, ...]) -> str:
    """``SurfaceMesh or ScalarField``; "nothing" for none."""
    words = ["a recipe" if n is Recipe else "anything" if n is object else n.__name__ for n in artifacts]
    return " or ".join("nothing" if word == "NoneType" else word for word in words) or "nothing"
