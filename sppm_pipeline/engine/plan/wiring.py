"""Wiring stages by type: which earlier stage each port takes its artifact from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sppm_pipeline.engine.config.configuration import StageEntry
from sppm_pipeline.engine.config.document import Node, plain
from sppm_pipeline.engine.config.problems import Problems, did_you_mean, listed, shown
from sppm_pipeline.engine.plan.plugins import Plugin
from sppm_pipeline.engine.plan.ports import Port, Signature, artifact_words, fits, port_words, signature_of
from sppm_pipeline.errors import Position, WiringError
from sppm_pipeline.stage import Stage


@dataclass(frozen=True)
class Draft:
    """A stage entry whose stage is known; not wired yet.

    Attributes
    ----------
    entry : StageEntry
    cls : type of Stage
    stage : Stage or None
        None if its options are wrong.
    owner : Plugin
    """

    entry: StageEntry
    cls: type[Stage]
    stage: Stage | None
    owner: Plugin


@dataclass(frozen=True)
class Step:
    """A stage with its options and the sources of its ports.

    Attributes
    ----------
    entry : StageEntry
    stage : Stage
    owner : Plugin
        Who supplies the stage.
    signature : Signature
    inputs : mapping of port to id
        The earlier stage that each port takes its artifact from; None for an optional port left open. A port that
        takes many has an entry for each, under the names `Port.place`.
    recipes : mapping of port to name
    makes : tuple of type
        What it makes, recipes taken into account.
    """

    entry: StageEntry
    stage: Stage
    owner: Plugin
    signature: Signature
    inputs: Mapping[str, str | None]
    recipes: Mapping[str, str]
    makes: tuple[type, ...]

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


def last_uses(steps: Sequence[Step]) -> list[set[str]]:
    """For each step the ids whose results nobody needs after it."""
    last: dict[str, int] = {}
    for number, step in enumerate(steps):
        last[step.id] = number
        for source in step.inputs.values():
            if source is not None:
                last[source] = number
    return [{id_ for id_, at in last.items() if at == number} for number in range(len(steps))]


def recipe_order(drafts: Mapping[str, Sequence[Draft | None]], problems: Problems) -> list[str]:
    """Names of the recipes, each after those that it uses; a cycle is reported and cut."""
    order: list[str] = []
    path: list[str] = []

    def visit(name: str) -> None:
        path.append(name)
        for draft in drafts[name]:
            for used, where in recipe_names(draft.entry.recipes if draft else None):
                if used in path:
                    circle = " -> ".join([*path[path.index(used) :], used])
                    problems.add(
                        WiringError(f"recipes can't repeat each other in a circle: {circle}", where=where, stage=name)
                    )
                elif used in drafts and used not in order:
                    visit(used)
        path.pop()
        order.append(name)

    for name in drafts:
        if name not in order:
            visit(name)
    return order


def recipe_names(node: Node | None) -> list[tuple[str, Position]]:
    """Names that the key `recipe` of an entry mentions."""
    if node is None:
        return []
    nodes = [entry.node for entry in node.value.values()] if isinstance(node.value, dict) else [node]
    return [(node.value, node.where) for node in nodes if isinstance(node.value, str)]


def wire(
    drafts: Sequence[Draft | None],
    recipes: Mapping[str, tuple[type, ...] | None],
    problems: Problems,
    *,
    given: Mapping[str, tuple[type, ...]] | None = None,
    inside: Mapping[str, Sequence[Step]] | None = None,
) -> tuple[list[Step], tuple[type, ...] | None]:
    """Find the source of each port.

    Parameters
    ----------
    drafts : sequence of Draft or None
        In order; None stands for a stage that is unknown, after which nothing is said about missing inputs.
    recipes : mapping of recipe name to the artifacts it makes
        None if that is not known.
    problems : Problems
    given : mapping of id to artifacts, optional
        What is there before the first stage.
    inside : mapping of recipe name to sequence of Step, optional
        The stages of the recipes.

    Returns
    -------
    steps : list of Step
        Complete if no problem was reported.
    makes : tuple of type or None
        What the last stage makes; None if that is not known.
    """
    made: dict[str, tuple[type, ...] | None] = dict(given or {})
    later = [draft.entry.id for draft in drafts if draft is not None]
    steps: list[Step] = []
    makes: tuple[type, ...] | None = ()
    for number, draft in enumerate(drafts):
        if draft is None:
            made[f"?{number}"] = makes = None
            continue
        signature = signature_of(draft.cls)
        later.remove(draft.entry.id)
        chosen = _chosen_sources(draft, signature, made, later, problems)
        inputs = _sources(draft, signature, chosen, made, problems)
        handed = _handed_recipes(draft, signature, recipes, problems)
        if signature.as_recipe and draft.cls.returns is not None:
            makes = _last_of(draft, next(iter(handed.values()), None), inside or {}, problems)
        elif signature.as_recipe:
            makes = next((recipes.get(name) for name in handed.values()), None)
        elif signature.as_port is not None and (source := inputs[signature.as_port]) is not None:
            makes = made[source]
        else:
            makes = signature.makes
        made[draft.entry.id] = makes
        if draft.stage is not None:
            steps.append(Step(draft.entry, draft.stage, draft.owner, signature, inputs, handed, makes or ()))
    return steps, makes


def makes_kind(step: Step, kind: type) -> bool:
    """Whether whatever a stage makes is of a type."""
    return bool(step.makes) and all(issubclass(member, kind) for member in step.makes)


def _last_of(
    draft: Draft, recipe: str | None, inside: Mapping[str, Sequence[Step]], problems: Problems
) -> tuple[type, ...] | None:
    """What the last stage of a recipe that makes an artifact of the type `Stage.returns` makes."""
    kind = draft.cls.returns
    if recipe is None or not inside.get(recipe) or kind is None:
        return None
    found = [step.makes for step in inside[recipe] if makes_kind(step, kind)]
    if not found:
        message = f"no stage of the recipe {recipe!r} makes a {kind.__name__}"
        problems.add(WiringError(message, where=draft.entry.where, stage=draft.entry.address))
    return found[-1] if found else None


def _chosen_sources(
    draft: Draft,
    signature: Signature,
    made: Mapping[str, tuple[type, ...] | None],
    later: Sequence[str],
    problems: Problems,
) -> dict[str, str]:
    """What `from` says: port or place -> id; ids that do not exist or do not fit are reported and left out."""
    node, entry = draft.entry.sources, draft.entry
    if node is None:
        return {}
    ports = {port.name: port for port in signature.ports if not port.is_recipe}
    requested: list[tuple[str | None, Position, Node]]
    if isinstance(node.value, dict):
        requested = [(port, e.where, one) for port, e in node.value.items() for one in _each(e.node)]
    else:
        requested = [(None, node.where, one) for one in _each(node)]
    chosen: dict[str, str] = {}
    count: dict[str, int] = {}
    for port, where, source in requested:

        def refuse(message: str, hint: str | None, place: Position) -> None:
            problems.add(WiringError(message, where=place, hint=hint, stage=entry.address))

        if port is not None and port not in ports:
            refuse(f"{draft.cls.name} has no port {port!r}", did_you_mean(port, ports), where)
        elif not isinstance(source.value, str):
            refuse(
                f"`from` takes the id of a stage, a list of ids or a map of ports to them, got {shown(plain(source))}",
                None,
                source.where,
            )
        elif source.value not in made:
            if source.value in later or source.value == entry.id:
                refuse(f"{source.value!r} does not come before this stage", "move it up", source.where)
            else:
                known = [id_ for id_ in made if not id_.startswith("?")]
                hint = did_you_mean(source.value, known) or "ids are the names of the stages unless given"
                refuse(f"there is no earlier stage {shown(source.value)}", hint, source.where)
        else:
            artifacts = made[source.value]
            candidates = [ports[port]] if port is not None else list(ports.values())
            fitting = [p.name for p in candidates if artifacts is None or fits(artifacts, p)]
            if len(fitting) == 1 and ports[fitting[0]].many:
                count[fitting[0]] = number = count.get(fitting[0], -1) + 1
                chosen[ports[fitting[0]].place(number)] = source.value
            elif len(fitting) == 1 and fitting[0] in chosen:
                refuse(f"the port {fitting[0]!r} takes one artifact, and two are given", None, source.where)
            elif len(fitting) == 1:
                chosen[fitting[0]] = source.value
            elif fitting:
                refuse(
                    f"{source.value!r} fits the ports {listed(fitting)}",
                    f"say which: from: {{{fitting[0]}: {source.value}}}",
                    source.where,
                )
            else:
                wanted = "; ".join(f"{p.name} takes {port_words(p)}" for p in candidates) or "it has no ports"
                refuse(f"{source.value!r} makes {artifact_words(artifacts or ())}, but {wanted}", None, source.where)
    return chosen


def _sources(
    draft: Draft,
    signature: Signature,
    chosen: Mapping[str, str],
    made: Mapping[str, tuple[type, ...] | None],
    problems: Problems,
) -> dict[str, str | None]:
    """The source of each port: as chosen, else the nearest earlier stage that makes the artifact."""
    inputs: dict[str, str | None] = {}
    entry = draft.entry
    unknown = any(artifacts is None for artifacts in made.values())
    for port in signature.ports:
        if port.is_recipe:
            continue
        if port.many:
            given = {place: id_ for place, id_ in chosen.items() if place.partition("[")[0] == port.name}
            fitting = [id_ for id_, artifacts in made.items() if artifacts is not None and fits(artifacts, port)]
            inputs |= given or {port.place(number): id_ for number, id_ in enumerate(fitting)}
            if not given and not fitting and not unknown and not _is_requested(draft, port):
                problems.add(_nothing_for(draft, port, made))
            continue
        source: str | None = chosen.get(port.name) or _nearest(port, made)
        taken_by = next((name for name, other in inputs.items() if other == source and source is not None), None)
        if taken_by is not None and port.name not in chosen:
            # one artifact for two ports is never what was meant silently
            if port.optional:
                source = None
            elif not _is_requested(draft, port):
                problems.add(
                    WiringError(
                        f"the ports {taken_by!r} and {port.name!r} would both take the result of {source!r}",
                        where=entry.where,
                        stage=entry.address,
                        hint=f"say which stage serves which port: from: {{{taken_by}: ..., {port.name}: ...}}",
                    )
                )
        if source is None and not port.optional and not unknown and not _is_requested(draft, port):
            problems.add(_nothing_for(draft, port, made))
        inputs[port.name] = source
    return inputs


def _is_requested(draft: Draft, port: Port) -> bool:
    """Whether `from` spoke of this port, so that what is wrong has been said."""
    node = draft.entry.sources
    return node is not None and (not isinstance(node.value, dict) or port.name in node.value)


def _each(node: Node) -> list[Node]:
    """The nodes of a list, or the one that is none; a list without any stays, to be refused."""
    return list(node.value) if isinstance(node.value, list) and node.value else [node]


def _nothing_for(draft: Draft, port: Port, made: Mapping[str, tuple[type, ...] | None]) -> WiringError:
    return WiringError(
        f"the port {port.name!r} needs {port_words(port)}, which no earlier stage makes",
        where=draft.entry.where,
        stage=draft.entry.address,
        hint=_made_before(made),
    )


def _nearest(port: Port, made: Mapping[str, tuple[type, ...] | None]) -> str | None:
    for id_ in reversed(list(made)):
        artifacts = made[id_]
        if artifacts is not None and fits(artifacts, port):
            return id_
    return None


def _made_before(made: Mapping[str, tuple[type, ...] | None]) -> str:
    there = [f"{artifact_words(artifacts)} by {id_}" for id_, artifacts in made.items() if artifacts]
    return f"made before: {', '.join(there)}" if there else "nothing is made before this stage"


def _handed_recipes(
    draft: Draft, signature: Signature, recipes: Mapping[str, tuple[type, ...] | None], problems: Problems
) -> dict[str, str]:
    """What `recipe` says: port -> name of a recipe."""
    ports = [port for port in signature.ports if port.is_recipe]
    entry, node = draft.entry, draft.entry.recipes

    def refuse(message: str, hint: str | None, where: Position) -> None:
        problems.add(WiringError(message, where=where, hint=hint, stage=entry.address))

    if node is None:
        if missing := [port.name for port in ports if not port.optional]:
            hint = f"give `recipe: NAME`; recipes: {', '.join(recipes)}" if recipes else "add `recipes:` to the file"
            refuse(f"{draft.cls.name} repeats a recipe, but none is given for {listed(missing)}", hint, entry.where)
        return {}
    if not ports:
        refuse(f"{draft.cls.name} takes no recipe", None, node.where)
        return {}
    if isinstance(node.value, dict):
        requested = {name: e.node for name, e in node.value.items()}
    elif len(ports) == 1:
        requested = {ports[0].name: node}
    else:
        names = [port.name for port in ports]
        refuse(f"{draft.cls.name} takes {len(ports)} recipes", f"give a map: {', '.join(names)}", node.where)
        return {}
    handed: dict[str, str] = {}
    for name, one in requested.items():
        if name not in [port.name for port in ports]:
            refuse(f"{draft.cls.name} has no port {name!r} for a recipe", None, one.where)
        elif not isinstance(one.value, str):
            refuse(f"`recipe` takes the name of a recipe, got {shown(plain(one))}", None, one.where)
        elif one.value not in recipes:
            near = did_you_mean(one.value, recipes) if recipes else "the file has no `recipes`"
            near = f"{near}; `sppm stages` lists presets"
            refuse(f"there is no recipe {shown(one.value)}", near, one.where)
        else:
            handed[name] = one.value
    for port in ports:
        if port.name not in requested and not port.optional:
            refuse(f"no recipe is given for the port {port.name!r}", None, node.where)
    return handed
