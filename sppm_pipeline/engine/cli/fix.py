"""``sppm fix``: former names of stages and options in a configuration become the current ones, in place."""

from __future__ import annotations

import difflib
import json
import re
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from sppm_pipeline.engine.cli.arguments import add_configuration, open_from
from sppm_pipeline.errors import ConfigError

if TYPE_CHECKING:
    from sppm_pipeline.engine.config.configuration import Configuration, StageEntry
    from sppm_pipeline.engine.config.document import Node
    from sppm_pipeline.engine.plan.planning import Plan
    from sppm_pipeline.engine.plan.registry import Registry
    from sppm_pipeline.engine.plan.wiring import Step
    from sppm_pipeline.errors import Position

Edit = tuple[int, int, str]
"""Characters of the text from, to, and what stands there instead."""


def configure_fix(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    add_configuration(parser)
    parser.add_argument("-n", "--dry-run", action="store_true", help="show what would change, and write nothing")


def execute_fix(args: Namespace) -> int:
    """Rewrite the file if the plan stays the same."""
    from sppm_pipeline.engine.files import write_whole
    from sppm_pipeline.engine.plan.session import open_session

    session = open_from(args)
    path = session.configuration.file
    text = path.read_bytes().decode("utf-8")  # keeps the ends of its lines
    if path.suffix == ".json":
        raise ConfigError(f"{str(path)!r} is a record, which names stages as they are called now")
    before = session.plan()
    fixed = text
    for begin, end, new in sorted(_edits(text, session.configuration, before, session.registry), reverse=True):
        fixed = fixed[:begin] + new + fixed[end:]
    request = replace(session.request, text=fixed, folder=str(path.parent), trusted=True)
    after = open_session(request).plan()
    if _steps(before) != _steps(after):
        raise ConfigError(
            f"the plan of {str(path)!r} would change with the names, so nothing is written",
            hint="`sppm check` names each former name; please report this file",
        )
    print("".join(difflib.unified_diff(text.splitlines(True), fixed.splitlines(True), str(path), "fixed")), end="")
    if fixed == text:
        print(f"{path}: no former names")
    elif not args.dry_run:
        write_whole(path, fixed)
        print(f"{path}: written; `sppm check` reads it without these warnings")
    return 0


def _steps(plan: Plan) -> list[tuple[object, ...]]:
    """What a plan does, without how it was written."""
    groups = {"": plan.steps, "after": plan.after, **plan.recipes}
    return [
        (name, step.id, step.stage, dict(step.inputs), dict(step.recipes)) for name, g in groups.items() for step in g
    ]


def _edits(text: str, configuration: Configuration, plan: Plan, registry: Registry) -> Iterator[Edit]:
    from sppm_pipeline.engine.config.configuration import stage_entries

    starts = [0, *(found.end() for found in re.finditer(r"\n", text))]
    lists: list[tuple[str | None, Node | None, tuple[Step, ...]]] = [
        (None, configuration.pipeline, tuple(plan.steps)),
        (None, configuration.after, tuple(plan.after)),
        *((name, entry.node, tuple(plan.recipes.get(name, ()))) for name, entry in configuration.recipes.items()),
    ]
    for name, node, steps in lists:
        if node is None or not isinstance(node.value, list) or not steps:
            continue
        entries, _ = stage_entries(node, name)
        for entry, item, step in zip(entries, node.value, steps, strict=True):
            yield from _of_entry(text, starts, entry, item, step, registry)


def _of_entry(
    text: str, starts: list[int], entry: StageEntry, item: Node, step: Step, registry: Registry
) -> Iterator[Edit]:
    from sppm_pipeline.engine.config.document import plain
    from sppm_pipeline.engine.config.options import current_name

    def token(where: Position, word: str) -> tuple[int, int, str]:
        """Where a word stands, and in which quotes."""
        begin = starts[where.line - 1] + where.column - 1
        quote = text[begin] if text[begin] in "'\"" else ""
        if text[begin + len(quote) :].startswith(word):
            return begin, begin + len(word) + 2 * len(quote), quote
        raise ConfigError(f"{word!r} is written in another way than can be replaced", where=entry.where)

    names = {}
    for written, found in entry.options.items():
        if (now := current_name(type(step.stage), written)) != written:
            begin, end, quote = token(found.where, written)
            yield begin, end, f"{quote}{now}{quote}"
        names[now] = found
    if entry.name not in registry.aliases:
        return
    begin, end, quote = token(entry.stage.where, entry.name)
    more = {} if entry.explicit_id else {"id": entry.id}
    more |= {name: plain(one.node) for name, one in step.entry.options.items() if name not in names}
    pairs = [f"{quote}{name}{quote}: {_scalar(value)}" for name, value in more.items()]
    stage = f"{quote}{step.stage.name}{quote}"
    if item.value == entry.name:
        yield begin, end, "{" + ", ".join([f"stage: {stage}", *pairs]) + "}"
        return
    yield begin, end, stage
    key = item.value["stage"].where
    line = text[starts[key.line - 1] : starts[key.line - 1] + key.column - 1]
    if pairs and re.fullmatch(r"[\s-]*", line):  # a block, whose lines begin at the column of its first key
        stop = text.find("\n", end)
        stop = len(text) if stop < 0 else stop
        yield stop, stop, "".join(f"\n{' ' * len(line)}{pair}" for pair in pairs)
    elif pairs:
        yield end, end, "".join(f", {pair}" for pair in pairs)


def _scalar(value: object) -> str:
    """A value in YAML's flow style; words that YAML takes for text stay bare."""
    bare = isinstance(value, str) and re.fullmatch(r"[A-Za-z][\w./-]*(#\d+)?", value)
    return (
        str(value) if bare and value not in ("true", "false", "null", "yes", "no", "on", "off") else json.dumps(value)
    )
