"""Stages and plans in words and as diagrams, as the command line and the references print them."""

from __future__ import annotations

import ast
import importlib.util
import inspect
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from sppm_pipeline.engine.config.options import Option, allowed_words, options_of, plain_option
from sppm_pipeline.engine.plan.planning import SWEEP_ID, Plan, step_options
from sppm_pipeline.engine.plan.ports import artifact_words, port_words, signature_of
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.errors import PluginError
from sppm_pipeline.stage import FAMILIES, Stage


def purpose_of(cls: type[Stage]) -> str:
    """The first sentence of a stage's docstring."""
    first = _first_paragraph(inspect.getdoc(cls) if cls.__doc__ else None)
    # a dataclass without a docstring gets its signature as one
    return "" if first.startswith(f"{cls.__name__}(") else first


def purpose_in_source(name: str, registry: Registry) -> str | None:
    """`purpose_of` a built-in stage, read in its module without importing it; None of others, which may be broken.

    A hundred modules take three times as long to import as to parse.
    """
    place = registry.owner(name).stages[name]
    if not registry.owner(name).builtin or not isinstance(place, str):
        return None
    spec = importlib.util.find_spec(place)
    read = getattr(spec.loader, "get_source", None) if spec else None
    source: str = (read(place) if read else None) or ""
    for node in ast.parse(source).body:
        if isinstance(node, ast.ClassDef) and f"name: ClassVar[str] = {name!r}" in map(ast.unparse, node.body):
            return _first_paragraph(ast.get_docstring(node))
    return None


def _first_paragraph(text: str | None) -> str:
    return (text or "").split("\n\n")[0].replace("\n", " ").strip()


def makes_words(cls: type[Stage]) -> str:
    """What a stage makes, in words; "nothing" for nothing."""
    signature = signature_of(cls)
    if signature.as_recipe and cls.returns is not None:
        return f"the last {cls.returns.__name__} that its recipe makes"
    return "what its recipe makes" if signature.as_recipe else artifact_words(signature.makes)


def stage_data(cls: type[Stage], registry: Registry) -> dict[str, Any]:
    """All that is known about a stage, JSON-ready."""
    owner = registry.owner(cls.name)
    return {
        "name": cls.name,
        "purpose": purpose_of(cls),
        "ports": [
            {"port": p.name, "takes": "a recipe" if p.is_recipe else port_words(p), "optional": p.optional}
            for p in signature_of(cls).ports
        ],
        "makes": makes_words(cls),
        "options": [
            {
                "name": option.name,
                "allowed": allowed_words(option),
                "unit": option.spec.unit,
                "required": option.required,
                "default": None if option.required else plain_option(option.default),
                "help": option.spec.help,
            }
            for option in options_of(cls).values()
        ],
        "version": cls.version,
        "from": str(owner),
        "module": cls.__module__,
    }


def stage_text(cls: type[Stage], registry: Registry) -> str:
    """The reference of one stage."""
    data = stage_data(cls, registry)
    lines = [cls.name, "=" * len(cls.name), "", inspect.getdoc(cls) or "", ""]
    lines += [f"takes   {p['port']}: {p['takes']}{' (optional)' if p['optional'] else ''}" for p in data["ports"]]
    lines += [
        f"makes   {data['makes']}",
        f"from    {data['from']}, {data['module']}",
        "",
        "Options" if data["options"] else "No options",
    ]
    for option in options_of(cls).values():
        lines += [f"  {option.name}: {option_words(option)}", f"      {option.spec.help}"]
    return "\n".join(lines) + "\n"


def option_words(option: Option) -> str:
    """What an option takes, and its default as YAML has it."""
    if option.required:
        return f"{allowed_words(option)}; required"
    value = plain_option(option.default)
    return f"{allowed_words(option)}; default {repr(value) if value == '' else value_words(value)}"


def value_words(value: Any) -> str:
    """A value as YAML has it."""
    return "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


GROUPS = {
    "everyday": "Everyday: a part from mesh to printer", "paper": "Paper: the method, step by step",
    "research": "Research: properties, tests and images",
}  # fmt: skip


def group_of(name: str, registry: Registry) -> str:
    """The group in which a stage is listed: that which the module of its plugin has in ``GROUPS``."""
    groups: Mapping[str, str] = getattr(registry.owner(name).module, "GROUPS", {})
    found = next((groups[key] for key in (name, name.split(".")[0], "") if key in groups), "research")
    return found if found in GROUPS else "research"


def grouped_list(registry: Registry) -> str:
    """All stages by group and family."""
    names = {group: [name for name in registry if group_of(name, registry) == group] for group in GROUPS}
    parts = [f"{GROUPS[group]}\n\n{stage_list(registry, some)}" for group, some in names.items() if some]
    return "\n".join(parts)


def stage_list(registry: Registry, names: Sequence[str]) -> str:
    """Stages by family, one line each."""
    lines: list[str] = []
    family = None
    width = max((len(name) for name in names), default=0)
    for name in names:
        if name.split(".")[0] != family:
            family = name.split(".")[0]
            lines += ["", f"{family}: {FAMILIES[family]}" if family in FAMILIES else f"{family}:"]
        note = "" if registry.owner(name).builtin else f"  [{registry.owner(name)}]"
        try:
            purpose = purpose_in_source(name, registry) or purpose_of(registry.get(name))
        except PluginError as error:
            purpose = f"BROKEN: {error.message}"
        lines.append(f"  {name:{width}s}  {purpose}{note}")
    return "\n".join(lines[1:]) + "\n"


def preset_list(registry: Registry) -> str:
    """Presets, one line each."""
    width = max((len(name) for name in registry.presets), default=0)
    lines = [f"  {name:{width}s}  {preset.help}" for name, preset in sorted(registry.presets.items())]
    return "\n".join(["", "presets, for `recipe: NAME` or `recipes: {cell: {preset: NAME, ...}}`:", *lines, ""])


def preset_text(name: str, registry: Registry) -> str:
    """A preset with its parameters and stages, as a configuration would have them."""
    preset = registry.presets[name]
    lines = [name, "=" * len(name), "", preset.help, "", "Parameters" if preset.params else "No parameters"]
    lines += [f"  {key}: default {value_words(value)}" for key, value in preset.params.items()]
    return "\n".join([*lines, "", "Stages", *(f"  - {_flow(entry)}" for entry in preset.stages), ""])


def _flow(value: Any) -> str:
    """A value in YAML's flow style."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_flow, value)) + "]"
    return f'"{value}"' if isinstance(value, str) and "$" in value else str(value)


def explain_plan(plan: Plan, reasons: Mapping[str, tuple[bool, str]] | None = None) -> str:
    """Description of each stage of a plan, with its options, inputs and the path of its random numbers; `reasons` say
    whether results are in the cache, see `reasons_of`.
    """
    lines = [f"{plan.name}: seed {plan.seed}"]
    if plan.params:
        lines.append("parameters: " + ", ".join(f"{name} = {value}" for name, value in plan.params.items()))
    for name, steps in plan.recipes.items():
        lines += ["", f"Recipe {name}, repeated by the stages that name it:"]
        for step in steps:
            lines += _explained(step, f"<stage>/{name}@<attempt>/{step.id}")
    lines += ["", "Pipeline:"]
    for step in plan.steps:
        lines += _explained(step, step.id)
        if reasons is not None:
            kept, words = reasons[step.id]
            lines.append(f"      result {words}" if kept else f"      would run: {words}")
    if plan.after:
        lines += ["", "After the sweep:"]
        for step in plan.after:
            lines += _explained(step, step.id)
    return "\n".join(lines) + "\n"


def _explained(step: Step, path: str) -> list[str]:
    lines = [f"  {_title(step)}: {purpose_of(type(step.stage))}"]
    for port in step.signature.ports:
        if port.is_recipe:
            lines.append(f"      {port.name}: recipe {step.recipes.get(port.name, '(none)')}")
        else:
            lines.append(f"      {port.name}: {', '.join(step.sources(port)) or '(open)'}")
    lines.append(f"      makes {artifact_words(step.makes)}; random numbers from seed and {path!r}")
    for name, value in step_options(step).items():
        mark = "" if name in step.entry.options else " (default)"
        lines.append(f"      {name} = {value_words(value)}{mark}")
    return lines


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
                    sources = ", ".join(step.sources(port))
                    lines.append(f"       {port.name}: " + (f"from {sources}" if sources else "(open)"))
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
                # what a recipe makes is what its last stage makes
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
