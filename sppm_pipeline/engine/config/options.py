"""From the values of a document to the options of a stage, with bounds, and every error at its place."""

from __future__ import annotations

import dataclasses
import functools
import math
import re
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.config.configuration import RESERVED
from sppm_pipeline.engine.config.document import DECIMALS, Entry, Override, plain
from sppm_pipeline.engine.config.names import fits_suffix, output_parts, suffix_words
from sppm_pipeline.engine.config.problems import Problems, shown
from sppm_pipeline.errors import ConfigError, PluginError, did_you_mean
from sppm_pipeline.nouns.length import CELL_UNIT, UNITS_IN_MM, Length, parse_length
from sppm_pipeline.stage import OptionSpec, Stage

SMALLEST_MM, LARGEST_MM = 1e-6, 1e6
"""A length with a unit lies between a nanometre and a kilometre; anything else is a typing error."""

_COMMA = re.compile(r"[-+]?[0-9]*,[0-9]+\s*[A-Za-zµ]*")
_AFTER_COMMA = re.compile(r"[0-9]+(?:\s*[A-Za-zµ]+)?")  # what is left in a map of a number with a comma
_PERCENT = re.compile(r"[0-9]+(?:\.[0-9]*)?\s*%")

Folder = typing.Callable[[Any], Path]
"""From a value's position to the folder that a relative path written there starts from."""


@dataclass(frozen=True)
class Option:
    """An option as its stage declares it."""

    name: str
    kind: Any  # bool, int, float, str, Path, Length, a tuple of those, or a union
    spec: OptionSpec
    default: Any  # `dataclasses.MISSING` if the option is required

    @property
    def required(self) -> bool:
        """True if it must be given."""
        return self.default is dataclasses.MISSING


@functools.cache
def options_of(cls: type[Stage]) -> dict[str, Option]:
    """The options a stage declares, in the order of its fields; `PluginError` if a field is not declared with `option`
    or has a type that YAML can't express.
    """
    try:
        hints = typing.get_type_hints(cls)
    except Exception as error:
        raise PluginError(
            f"the annotations of {cls.__qualname__} can't be resolved: {error}",
            hint="import the types of options for real, not under TYPE_CHECKING",
        ) from error
    result = {}
    for field in dataclasses.fields(cls):
        spec = field.metadata.get("option")
        if not isinstance(spec, OptionSpec):
            raise PluginError(
                f"the field {field.name!r} of {cls.__qualname__} is not declared with `option(...)`",
                hint=f"write `{field.name}: {field.type} = sppm.option(DEFAULT, help='what it is')`",
            )
        if field.name in RESERVED:
            raise PluginError(f"{cls.__qualname__} can't have an option called {field.name!r}, which YAML needs itself")
        default = field.default
        if field.default_factory is not dataclasses.MISSING:
            # options are frozen values, so that one default serves all stages of the class
            default = field.default_factory()
        _check_kind(hints[field.name], f"{cls.__qualname__}.{field.name}")
        result[field.name] = Option(field.name, hints[field.name], spec, default)
    formers = [option.spec.formerly for option in result.values() if option.spec.formerly is not None]
    if clash := [name for name in formers if name in result or formers.count(name) > 1]:
        raise PluginError(f"{cls.__qualname__} declares {clash[0]!r} both as an option and as a former name of another")
    return result


def current_name(cls: type[Stage], name: str) -> str:
    """The current name of an option that may be named by a former one."""
    return next((option.name for option in options_of(cls).values() if option.spec.formerly == name), name)


def with_current_names(
    cls: type[Stage], given: Mapping[str, Entry], *, stage: str
) -> tuple[tuple[dict[str, Entry], list[str]], Problems]:
    """The written options under their current names, and the former names that were used.

    An override replaces what the file says under either name; an option written twice in the same place is refused.
    """
    result: dict[str, Entry] = {}
    former = []
    problems: Problems = []
    for name, entry in given.items():
        current = current_name(cls, name)
        if current != name:
            former.append(name)
        other = result.get(current)
        if other is not None and isinstance(other.where, Override) == isinstance(entry.where, Override):
            message = f"the option {current!r} is given twice, also by its former name; first at {other.where}"
            problems.append(ConfigError(message, where=entry.where, stage=stage))
        elif other is None or isinstance(entry.where, Override):
            result[current] = entry
    return (result, former), problems


def _members(kind: Any) -> tuple[Any, ...]:
    """The members of a union, None last; other types alone."""
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        members = typing.get_args(kind)
        return tuple(sorted(members, key=lambda member: member is types.NoneType))
    return (kind,)


def _check_kind(kind: Any, name: str) -> None:
    for member in _members(kind):
        if typing.get_origin(member) is tuple:
            for element in typing.get_args(member):
                if element is not Ellipsis:
                    _check_kind(element, name)
        elif member not in (bool, int, float, str, Path, Length, types.NoneType):
            raise PluginError(
                f"the option {name} has the type {member}, which a configuration can't express",
                hint="use bool, int, float, str, Path, Length, a tuple of them, or any of these | None",
            )


def parse_options(
    cls: type[Stage], given: Mapping[str, Entry], where: Any, folder: Folder, *, stage: str
) -> tuple[dict[str, Any], Problems]:
    """Values for the constructor of `cls`, complete if nothing is wrong.

    `where` is the place of the stage, shown for options that are missing; `folder` leads from a value's position to the
    folder that relative paths start from.
    """
    declared = options_of(cls)
    values = {}
    problems: Problems = []
    for name, entry in given.items():
        if name not in declared:
            hint = did_you_mean(name, declared) if declared else f"{cls.name} has no options"
            if _AFTER_COMMA.fullmatch(name):
                hint = DECIMALS
            message = f"{cls.name} has no option {name!r}"
            problems.append(ConfigError(message, where=entry.where, hint=hint, stage=stage))
            continue
        try:
            values[name] = parse_typed(declared[name], plain(entry.node), folder(entry.node.where))
        except ValueError as error:
            hint = hint_of(declared[name], entry.node.value)
            problems.append(ConfigError(f"option {name!r}: {error}", where=entry.node.where, hint=hint, stage=stage))
    for option in declared.values():
        if option.required and option.name not in given:
            message = f"the option {option.name!r} is missing: {allowed_words(option)}"
            problems.append(ConfigError(message, where=where, hint=option.spec.help, stage=stage))
    return values, problems


def parse_typed(option: Option, value: Any, folder: Path) -> Any:
    """`value` as the option's type, within its bounds; else `ValueError` with the value and what is allowed.

    Values that have the type already (`Length`, `Path`, tuples) pass, so that stages may set options of recipes.
    """
    members = _members(option.kind)
    if value is None:
        if types.NoneType in members:
            return None
        raise ValueError(f"expected {allowed_words(option)}, got nothing")
    meant = []  # what those members say that are lists as the value is one, or are none
    for member in members:
        if member is not types.NoneType:
            try:
                return _parse(member, value, option, folder)
            except ValueError as error:
                if (typing.get_origin(member) is tuple) == isinstance(value, (list, tuple)):
                    meant.append(error)
    raise meant[0] if len(meant) == 1 else ValueError(f"expected {allowed_words(option)}, got {shown(value)}")


def _parse(kind: Any, value: Any, option: Option, folder: Path) -> Any:
    spec = option.spec
    if typing.get_origin(kind) is tuple:
        return _parse_tuple(kind, value, option, folder)
    if kind is Length:
        return _parse_length(value, option)
    if kind is bool and isinstance(value, bool):
        return value
    if kind in (int, float) and isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            number = kind(value)
        except (OverflowError, ValueError):  # an integer of a nan or an infinity, a float of too large a number
            raise _refused(option, value) from None
        # YAML has .inf and .nan, which no option means and no bound refuses
        if kind is float and not math.isfinite(number):
            raise _refused(option, value, ", which is not finite")
        if (kind is float or number == value) and _in_bounds(number, spec):
            return number
    if kind is Path and isinstance(value, (str, Path)) and str(value) and "\0" not in str(value):
        # an absolute path stays: `/` drops what is in front of it
        return folder / Path(value).expanduser()
    if kind is not str or not isinstance(value, str):
        raise _refused(option, value)
    if spec.choices and value not in spec.choices:
        hint = did_you_mean(value, spec.choices)
        raise _refused(option, value, f"; {hint}" if hint and hint.startswith("did") else "")
    if spec.output:
        try:
            output_parts(value)
        except ConfigError as error:
            raise ValueError(error.message) from None
        if not fits_suffix(value, spec.suffixes):
            raise _refused(option, value)
    return value


def _refused(option: Option, value: Any, more: str = "") -> ValueError:
    return ValueError(f"expected {allowed_words(option)}, got {shown(value)}{more}")


def _in_bounds(number: float, spec: OptionSpec) -> bool:
    return not (
        (spec.minimum is not None and number < spec.minimum)
        or (spec.maximum is not None and number > spec.maximum)
        or (spec.above is not None and number <= spec.above)
        or (spec.below is not None and number >= spec.below)
    )


def _parse_length(value: Any, option: Option) -> Length:
    """A length; bounds hold in the option's own unit, or in mm for a size that is given in a physical unit instead."""
    try:
        length = parse_length(value)
    except OverflowError:
        raise _refused(option, value) from None
    except ValueError as error:
        raise _refused(option, value, f"; {error}") from None
    spec, scale = option.spec, 1.0
    if length.unit == CELL_UNIT:
        if spec.unit != "cell size":
            raise _refused(option, value, "; only lengths of a cell can be given in cell sizes")
    elif length.unit is not None and spec.unit in UNITS_IN_MM:
        scale = UNITS_IN_MM[length.unit] / UNITS_IN_MM[spec.unit]
    elif length.unit is not None:
        # upper bounds count in cell sizes, and the size of the cell in mm is not known yet
        spec = OptionSpec("", minimum=spec.minimum, above=spec.above)
    if not _in_bounds(length.value * scale, spec):
        raise _refused(option, value)
    if length.unit in UNITS_IN_MM and length.value and not SMALLEST_MM <= abs(length.mm()) <= LARGEST_MM:
        more = f"; a length with a unit lies between {SMALLEST_MM:g} mm and {LARGEST_MM:g} mm"
        raise _refused(option, value, more)
    return length


def _parse_tuple(kind: Any, value: Any, option: Option, folder: Path) -> tuple[Any, ...]:
    elements = typing.get_args(kind)
    variadic = len(elements) == 2 and elements[1] is Ellipsis
    if not isinstance(value, (list, tuple)) or (not variadic and len(value) != len(elements)):
        raise _refused(option, value)
    # tuple[X, ...] takes a list of any length
    kinds = [elements[0]] * len(value) if variadic else elements
    result = []
    for number, (element, item) in enumerate(zip(kinds, value, strict=True), 1):
        part = dataclasses.replace(option, kind=element)
        try:
            result.append(parse_typed(part, item, folder))
        except ValueError as error:
            raise ValueError(f"element {number}: {error}") from None
    return tuple(result)


_WORDS = {
    bool: ("true or false", "true-or-false words"),
    int: ("an integer", "integers"),
    float: ("a number", "numbers"),
    str: ("a string", "strings"),
    Path: ("a path", "paths"),
    Length: ("a length", "lengths"),
    types.NoneType: ("nothing", "nothing"),
}


def type_words(kind: Any, *, plural: bool = False) -> str:
    """A type as users say it: "an integer", "a list of 3 numbers"."""
    members = [member for member in _members(kind) if member is not types.NoneType]
    return " or ".join(_member_words(member, plural) for member in members)


def _member_words(kind: Any, plural: bool) -> str:
    if typing.get_origin(kind) is not tuple:
        return _WORDS[kind][plural]
    elements = typing.get_args(kind)
    artifact = "lists" if plural else "a list"
    if len(elements) == 2 and elements[1] is Ellipsis:
        return f"{artifact} of {type_words(elements[0], plural=True)}"
    if len(set(elements)) == 1:
        return f"{artifact} of {len(elements)} {type_words(elements[0], plural=True)}"
    return f"{artifact} of {', '.join(type_words(element) for element in elements)}"


def hint_of(option: Option, value: Any) -> str:
    """Hint for a value that was refused: how null is written, if that was meant, else the help of the option."""
    if (
        isinstance(value, str)
        and value.lower() in ("none", "nothing", "nil", "~")
        and types.NoneType in _members(option.kind)
    ):
        return "for no value write null, or leave the option out"
    if isinstance(value, str) and {int, float, Length} & set(_members(option.kind)):
        text = value.strip()
        whole = not {float, Length} & set(_members(option.kind))
        if _COMMA.fullmatch(text) and not whole:
            return f"{DECIMALS}; {option.spec.help}"
        if text.startswith("$") and (name := text.strip("${}")):
            return f'a parameter is written "${{{name}}}", with the quotes and braces'
        if _PERCENT.fullmatch(text) and not whole:
            return f"write {float(text.rstrip('% ')) / 100:g}, a share of 1; {option.spec.help}"
    below = (option.spec.maximum, option.spec.below)
    # a share written in percent; up to 2 it may as well be a share that is too large
    if 1.0 in below and float in _members(option.kind) and type(value) in (int, float) and 2 < value < 100:
        return f"write {value / 100:g} for {value:g} %; {option.spec.help}"
    return option.spec.help


def allowed_words(option: Option) -> str:
    """Type, unit and bounds of an option as users say them: "a number in mm, above 0, at most 5"."""
    spec = option.spec
    if spec.choices:
        words = ", ".join(spec.choices)
        return f"one of {words}" if option.kind in (str, str | None) else f"{type_words(option.kind)} ({words})"
    if spec.suffixes:
        return suffix_words(spec.suffixes)
    parts = [type_words(option.kind) + (f" in {spec.unit}" if spec.unit else "")]
    for bound, word in (
        (spec.minimum, "at least"), (spec.above, "above"), (spec.maximum, "at most"), (spec.below, "below")
    ):  # fmt: skip
        if bound is not None:
            parts.append(f"{word} {bound:g}")
    return ", ".join(parts)


def plain_option(value: Any) -> Any:
    """An option's value as YAML and JSON can hold it; `parse_typed` reads it back to the same value."""
    if isinstance(value, Length):
        return f"{value.value!r} {value.unit}" if value.unit else value.value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, tuple):
        return [plain_option(item) for item in value]
    return value
