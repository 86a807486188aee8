"""The wiring of a plan as text, as a DOT graph and as a Mermaid diagram."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from sppm_pipeline.engine.plan.planning import SWEEP_ID, Plan
from sppm_pipeline.engine.plan.ports import artifact_words
from sppm_pipeline.engine.plan.wiring import Step


def wiring_text(plan: Plan) -> str:
    """Every stage, what it makes, and where each port comes from."""
    lines = []
    for title, steps in _groups(plan):
        lines.append(title)
        width = max((len(_title(step)) for step in steps), default=0)
        for number, step in enumerate(steps, 1):
            lines.append(f"  {number:2d} {_title(step):{width}s} -> {artifact_words(step.makes)}")
            for port in step.signature.ports:
                if port.is_recipe:
                    name = step.recipes.get(port.name)
                    lines.append(f"       {port.name}: " + (f"repeats the recipe {name}" if name else "(no recipe)"))
                else:
                    source = step.inputs.get(port.name)
                    lines.append(f"       {port.name}: " + (f"from {source}" if source else "(open)"))
    return "\n".join(lines) + "\n"


def _groups(plan: Plan) -> Iterator[tuple[str, Sequence[Step]]]:
    for name, steps in plan.recipes.items():
        yield f"recipe {name}", steps
    yield f"pipeline {plan.name}", plan.steps
    if plan.after:
        yield "after the sweep", plan.after


def _title(step: Step) -> str:
    return step.id if step.id == step.stage.name else f"{step.id} ({step.stage.name})"


def _edges(plan: Plan) -> Iterator[tuple[str, str, str, bool]]:
    """(from, to, label, dashed): artifacts along solid edges, recipes along dashed ones."""
    for _, steps in _groups(plan):
        made = {step.id: artifact_words(step.makes) for step in steps} | {SWEEP_ID: "Table"}
        is_after = steps is plan.after
        for step in steps:
            for port, source in step.inputs.items():
                if source is not None:
                    here = step.entry.recipe
                    yield _key(here, source, is_after), _key(here, step.id, is_after), f"{port}: {made[source]}", False
            for port, recipe in step.recipes.items():
                last = plan.recipes[recipe][-1]
                yield _key(recipe, last.id, False), _key(step.entry.recipe, step.id, is_after), port, True


def _key(recipe: str | None, id_: str, is_after: bool) -> str:
    return f"{'after:' if is_after else ''}{recipe + '/' if recipe else ''}{id_}"


def dot_graph(plan: Plan) -> str:
    """A graph for Graphviz."""
    lines = ["digraph sppm {", "  rankdir=LR;", "  node [shape=box, fontname=sans];"]
    for number, (title, steps) in enumerate(_groups(plan)):
        lines += [f"  subgraph cluster_{number} {{", f"    label={_quoted(title)};"]
        if steps is plan.after:
            lines.append(f"    {_quoted('after:' + SWEEP_ID)} [label=sweep];")
        lines += [
            f"    {_quoted(_key(step.entry.recipe, step.id, steps is plan.after))} [label={_quoted(_title(step))}];"
            for step in steps
        ]
        lines.append("  }")
    for source, target, label, dashed in _edges(plan):
        style = ", style=dashed" if dashed else ""
        lines.append(f"  {_quoted(source)} -> {_quoted(target)} [label={_quoted(label)}{style}];")
    return "\n".join([*lines, "}"]) + "\n"


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def mermaid_graph(plan: Plan) -> str:
    """A diagram for Mermaid."""
    keys: dict[str, str] = {}
    lines = ["flowchart LR"]
    for title, steps in _groups(plan):
        lines.append(f'  subgraph {_mermaid_key(keys, title)}["{title}"]')
        if steps is plan.after:
            lines.append(f'    {_mermaid_key(keys, "after:" + SWEEP_ID)}["sweep"]')
        for step in steps:
            key = _mermaid_key(keys, _key(step.entry.recipe, step.id, steps is plan.after))
            lines.append(f'    {key}["{_title(step).replace("#", "#35;")}"]')
        lines.append("  end")
    for source, target, label, dashed in _edges(plan):
        arrow = "-.->" if dashed else "-->"
        lines.append(f'  {_mermaid_key(keys, source)} {arrow}|"{label}"| {_mermaid_key(keys, target)}')
    return "\n".join(lines) + "\n"


def _mermaid_key(keys: dict[str, str], name: str) -> str:
    """Mermaid's keys are plain words."""
    return keys.setdefault(name, f"n{len(keys)}")
