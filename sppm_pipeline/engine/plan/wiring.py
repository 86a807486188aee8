"""Wiring stages by type: which earlier stage each port takes its artifact from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from sppm_pipeline.engine.config.configuration import StageEntry
from sppm_pipeline.engine.config.document import Node, plain
from sppm_pipeline.engine.config.problems import Problems, shown
from sppm_pipeline.engine.plan.plugins import Plugin
from sppm_pipeline.engine.plan.ports import Port, Signature, artifact_words, fits, port_words, signature_of
from sppm_pipeline.errors import Position, WiringError, did_you_mean, listed
from sppm_pipeline.stage import Stage


@dataclass(frozen=True)
class Draft:
    """A stage entry whose stage is known; not wired yet."""

    entry: StageEntry
    cls: type[Stage]
    stage: Stage | None  # None if its options are wrong
    owner: Plugin


@dataclass(frozen=True)
class Step:
    """A stage with its options and the sources of its ports."""

    entry: StageEntry
    stage: Stage
    owner: Plugin  # who supplies the stage
    signature: Signature
    # the earlier stage that each port takes its artifact from; None for an optional port left open. A port that takes
    # many has an entry for each, under the names `Port.place`.
    inputs: Mapping[str, str | None]
    recipes: Mapping[str, str]  # name of a recipe by port
    makes: tuple[type, ...]  # recipes taken into account

    @property
    def id(self) -> str:
        """The id within its pipeline or recipe."""
        return self.entry.id

    @property
    def address(self) -> str:
        """The id, with the recipe in front."""
        return self.entry.address

    @property
    def where(self) -> Position:
        """The place of the stage in the configuration."""
        return self.entry.where

    def sources(self, port: Port) -> list[str]:
        """The stages that a port takes its artifacts from."""
        return [
            source
            for place, source in self.inputs.items()
            if source is not None and place.partition("[")[0] == port.name
        ]


class Wired(NamedTuple):
    """The stages of a pipeline or recipe, wired."""

    steps: tuple[Step, ...]  # complete if nothing was wrong
    makes: tuple[type, ...] | None  # what the last stage makes; None if that is not known


Made = Mapping[str, tuple[type, ...] | None]
"""Artifacts by the id of the stage that makes them, in order; None where that is not known."""


def last_uses(steps: Sequence[Step]) -> list[set[str]]:
    """For each step the ids whose results no later step needs."""
    last: dict[str, int] = {}
    for number, step in enumerate(steps):
        last[step.id] = number
        for source in step.inputs.values():
            if source is not None:
                last[source] = number
    return [{id_ for id_, at in last.items() if at == number} for number in range(len(steps))]


def recipe_order(drafts: Mapping[str, Sequence[Draft | None]]) -> tuple[list[str], Problems]:
    """Names of the recipes, each after those that it uses; a cycle is refused and cut."""
    order: list[str] = []
    path: list[str] = []
    problems: Problems = []

    def visit(name: str) -> None:
        path.append(name)
        for draft in drafts[name]:
            for used, where in recipe_names(draft.entry.recipes if draft else None):
                if used in path:
                    circle = " -> ".join([*path[path.index(used) :], used])
                    message = f"recipes can't repeat each other in a circle: {circle}"
                    problems.append(WiringError(message, where=where, stage=name))
                elif used in drafts and used not in order:
                    visit(used)
        path.pop()
        # after all that it uses, which `visit` has put there
        order.append(name)

    for name in drafts:
        if name not in order:
            visit(name)
    return order, problems


def recipe_names(node: Node | None) -> list[tuple[str, Position]]:
    """Names that the key `recipe` of an entry mentions."""
    if node is None:
        return []
    nodes = [entry.node for entry in node.value.values()] if isinstance(node.value, dict) else [node]
    return [(node.value, node.where) for node in nodes if isinstance(node.value, str)]


def wire(
    drafts: Sequence[Draft | None],
    recipes: Mapping[str, Wired],
    given: Made | None = None,
) -> tuple[Wired, Problems]:
    """Find the source of each port.

    A draft that is None stands for a stage that is unknown, after which nothing is said about missing inputs; `given`
    is there before the first stage, by id.
    """
    made: dict[str, tuple[type, ...] | None] = dict(given or {})
    later = [draft.entry.id for draft in drafts if draft is not None]
    steps: list[Step] = []
    makes: tuple[type, ...] | None = ()
    problems: Problems = []
    for number, draft in enumerate(drafts):
        if draft is None:
            # "?" is in no id, so that the place of an unknown stage hides no other
            made[f"?{number}"] = makes = None
            continue
        signature = signature_of(draft.cls)
        later.remove(draft.entry.id)
        chosen, amiss = _chosen_sources(draft, signature, made, later)
        inputs, unmade = _sources(draft, signature, chosen, made)
        handed, unknown = _handed_recipes(draft, signature, recipes)
        problems += [*amiss, *unmade, *unknown]
        repeated = recipes[next(iter(handed.values()))] if handed else Wired((), None)
        kind = draft.cls.returns
        if signature.as_recipe and kind is not None:
            found = [step.makes for step in repeated.steps if makes_kind(step, kind)]
            if repeated.steps and not found:
                message = f"no stage of the recipe {next(iter(handed.values()))!r} makes a {kind.__name__}"
                problems.append(WiringError(message, where=draft.entry.where, stage=draft.entry.address))
            makes = found[-1] if found else None
        elif signature.as_recipe:
            makes = repeated.makes
        elif signature.as_port is not None and (source := inputs[signature.as_port]) is not None:
            makes = made[source]
        else:
            makes = signature.makes
        made[draft.entry.id] = makes
        if draft.stage is not None:
            problems += _unmet(draft, inputs, steps)
            steps.append(Step(draft.entry, draft.stage, draft.owner, signature, inputs, handed, makes or ()))
    return Wired(tuple(steps), makes), problems


def _unmet(draft: Draft, inputs: Mapping[str, str | None], steps: Sequence[Step]) -> Problems:
    """An error for each port whose source, as it is configured, lacks what the stage requires."""
    stages = {step.id: step.stage for step in steps}
    return [
        WiringError(
            f"what {inputs[port]!r} makes has no {attribute.replace('_', ' ')}",
            hint=advice, where=draft.entry.where, stage=draft.entry.address,
        )
        for port, (attribute, advice) in draft.cls.requires.items()
        if getattr(stages.get(inputs.get(port) or ""), attribute, True) is False
    ]  # fmt: skip


def makes_kind(step: Step, kind: type) -> bool:
    """True if whatever a stage makes is of a type."""
    return bool(step.makes) and all(issubclass(member, kind) for member in step.makes)


def _chosen_sources(
    draft: Draft, signature: Signature, made: Made, later: Sequence[str]
) -> tuple[dict[str, str], Problems]:
    """The key `from`: port or place -> id; ids that do not exist or do not fit are refused and left out."""
    node, entry = draft.entry.sources, draft.entry
    if node is None:
        return {}, []
    ports = {port.name: port for port in signature.ports if not port.is_recipe}
    requested: list[tuple[str | None, Position, Node]]
    if isinstance(node.value, dict):
        requested = [(port, e.where, one) for port, e in node.value.items() for one in _each(e.node)]
    else:
        requested = [(None, node.where, one) for one in _each(node)]
    chosen: dict[str, str] = {}
    count: dict[str, int] = {}
    problems: Problems = []
    for port, where, source in requested:
        place, hint = source.where, None
        artifacts = made.get(source.value) if isinstance(source.value, str) else None
        candidates = list(ports.values()) if port is None else [ports[port]] if port in ports else []
        fitting = [p.name for p in candidates if artifacts is None or fits(artifacts, p)]
        if port is not None and port not in ports:
            message, hint, place = f"{draft.cls.name} has no port {port!r}", did_you_mean(port, ports), where
        elif not isinstance(source.value, str):
            message = (
                f"`from` takes the id of a stage, a list of ids or a map of ports to them, got {shown(plain(source))}"
            )
        elif source.value not in made and (source.value in later or source.value == entry.id):
            message, hint = f"{source.value!r} does not come before this stage", "move it up"
        elif source.value not in made:
            message = f"there is no earlier stage {shown(source.value)}"
            hint = did_you_mean(source.value, [id_ for id_ in made if not id_.startswith("?")])
            hint = hint or "ids are the names of the stages unless given"
        elif len(fitting) > 1:
            message = f"{source.value!r} fits the ports {listed(fitting)}"
            hint = f"say which: from: {{{fitting[0]}: {source.value}}}"
        elif not fitting:
            wanted = "; ".join(f"{p.name} takes {port_words(p)}" for p in candidates) or "it has no ports"
            message = f"{source.value!r} makes {artifact_words(artifacts or ())}, but {wanted}"
        elif ports[fitting[0]].many:
            count[fitting[0]] = number = count.get(fitting[0], -1) + 1
            chosen[ports[fitting[0]].place(number)] = source.value
            continue
        elif fitting[0] in chosen:
            message = f"the port {fitting[0]!r} takes one artifact, and two are given"
        else:
            chosen[fitting[0]] = source.value
            continue
        problems.append(WiringError(message, where=place, hint=hint, stage=entry.address))
    return chosen, problems


def _sources(
    draft: Draft, signature: Signature, chosen: Mapping[str, str], made: Made
) -> tuple[dict[str, str | None], Problems]:
    """The source of each port: as chosen, else the nearest earlier stage that makes the artifact."""
    inputs: dict[str, str | None] = {}
    entry, node = draft.entry, draft.entry.sources
    unknown = any(artifacts is None for artifacts in made.values())
    problems: Problems = []
    for port in signature.ports:
        if port.is_recipe:
            continue
        # if `from` spoke of this port, what is wrong has been said
        said = node is not None and (not isinstance(node.value, dict) or port.name in node.value)
        # in order, so that the last is the nearest
        fitting = [id_ for id_, artifacts in made.items() if artifacts is not None and fits(artifacts, port)]
        found: dict[str, str | None]
        if port.many:
            found = {place: id_ for place, id_ in chosen.items() if place.partition("[")[0] == port.name}
            found = found or {port.place(number): id_ for number, id_ in enumerate(fitting)}
            lacking = not found
        else:
            source = chosen.get(port.name) or (fitting[-1] if fitting else None)
            taken_by = next((name for name, other in inputs.items() if other == source and source is not None), None)
            if taken_by is not None and port.name not in chosen:
                # one artifact for two ports is never what was meant silently
                if port.optional:
                    source = None
                elif not said:
                    message = f"the ports {taken_by!r} and {port.name!r} would both take the result of {source!r}"
                    hint = f"say which stage serves which port: from: {{{taken_by}: ..., {port.name}: ...}}"
                    problems.append(WiringError(message, where=entry.where, hint=hint, stage=entry.address))
            found = {port.name: source}
            lacking = source is None and not port.optional
        if lacking and not unknown and not said:
            there = ", ".join(f"{artifact_words(types)} by {id_}" for id_, types in made.items() if types)
            message = f"the port {port.name!r} needs {port_words(port)}, which no earlier stage makes"
            hint = f"made before: {there}" if there else "nothing is made before this stage"
            problems.append(WiringError(message, where=entry.where, hint=hint, stage=entry.address))
        inputs |= found
    return inputs, problems


def _each(node: Node) -> list[Node]:
    """The nodes of a list, or the one that is none; a list without any stays, to be refused."""
    return list(node.value) if isinstance(node.value, list) and node.value else [node]


def _handed_recipes(
    draft: Draft, signature: Signature, recipes: Mapping[str, Wired]
) -> tuple[dict[str, str], Problems]:
    """The key `recipe`: port -> name of a recipe."""
    ports = {port.name: port for port in signature.ports if port.is_recipe}
    needed = [name for name, port in ports.items() if not port.optional]
    entry, node = draft.entry, draft.entry.recipes
    handed: dict[str, str] = {}
    problems: Problems = []

    def refuse(message: str, hint: str | None, where: Position) -> None:
        problems.append(WiringError(message, where=where, hint=hint, stage=entry.address))

    if node is None:
        if needed:
            hint = f"give `recipe: NAME`; recipes: {', '.join(recipes)}" if recipes else "add `recipes:` to the file"
            refuse(f"{draft.cls.name} repeats a recipe, but none is given for {listed(needed)}", hint, entry.where)
    elif not ports:
        refuse(f"{draft.cls.name} takes no recipe", None, node.where)
    elif len(ports) > 1 and not isinstance(node.value, dict):
        refuse(f"{draft.cls.name} takes {len(ports)} recipes", f"give a map: {', '.join(ports)}", node.where)
    else:
        written = isinstance(node.value, dict)
        requested = {name: e.node for name, e in node.value.items()} if written else dict.fromkeys(ports, node)
        for name, one in requested.items():
            if name not in ports:
                refuse(f"{draft.cls.name} has no port {name!r} for a recipe", None, one.where)
            elif not isinstance(one.value, str):
                refuse(f"`recipe` takes the name of a recipe, got {shown(plain(one))}", None, one.where)
            elif one.value not in recipes:
                near = did_you_mean(one.value, recipes) if recipes else "the file has no `recipes`"
                refuse(f"there is no recipe {shown(one.value)}", f"{near}; `sppm stages` lists presets", one.where)
            else:
                handed[name] = one.value
        for name in needed:
            if name not in requested:
                refuse(f"no recipe is given for the port {name!r}", None, node.where)
    return handed, problems
