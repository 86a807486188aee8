"""The stages there are, by name; a stage's module is imported when the stage is first used."""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
from collections.abc import Iterator

from sppm_pipeline.built_in import PLUGIN_OF, install_words
from sppm_pipeline.engine.config.options import options_of
from sppm_pipeline.engine.config.problems import shown
from sppm_pipeline.engine.plan.installed import normal
from sppm_pipeline.engine.plan.plugins import (
    Plugin,
    Plugins,
    imported,
    incomplete_stages,
    installed_plugins,
    stage_classes,
)
from sppm_pipeline.engine.plan.ports import signature_of
from sppm_pipeline.errors import ConfigError, PluginError, Position, meant, near_names
from sppm_pipeline.stage import FAMILIES, Stage, StageAlias


class Registry:
    """Stages of all plugins."""

    def __init__(self, plugins: Plugins) -> None:
        self.plugins = plugins
        self._owners = {name: plugin for plugin in plugins.plugins for name in plugin.stages}
        self._classes: dict[str, type[Stage]] = {}
        self.aliases: dict[str, StageAlias] = {
            former: alias if isinstance(alias, StageAlias) else StageAlias(alias)
            for plugin in plugins.plugins
            for former, alias in plugin.aliases.items()
        }
        """Former stage names and what they stand for now."""
        self.presets = {name: preset for plugin in plugins.plugins for name, preset in plugin.presets.items()}
        """Recipes by name."""

    def __contains__(self, name: str) -> bool:
        return self.current(name) in self._owners

    def current(self, name: str) -> str:
        """The current name of a stage that may be named by a former one."""
        return self.aliases[name].name if name in self.aliases else name

    def __iter__(self) -> Iterator[str]:
        """Names of all stages, by family in the order of a pipeline, then by name."""
        order = list(FAMILIES)
        return iter(
            sorted(self._owners, key=lambda n: (order.index(f) if (f := n.split(".")[0]) in order else len(order), n))
        )

    def sound(self, family: str = "") -> Iterator[str]:
        """Names of the stages, or those of a family, that can be loaded; those of a broken plugin are left out."""
        for name in self:
            if family in ("", name.partition(".")[0]):
                with contextlib.suppress(PluginError):
                    self.get(name)
                    yield name

    def owner(self, name: str) -> Plugin:
        """The plugin that supplies the stage."""
        return self._owners[self.current(name)]

    def get(self, name: str, where: Position | None = None) -> type[Stage]:
        """The class of a stage, by its current or a former name.

        Raises `ConfigError` if nothing supplies it, `PluginError` if a plugin that could not be loaded may supply it,
        its module can't be imported, or the class breaks the contract.
        """
        name = self.current(name)
        if name not in self._owners:
            hint, near = self._hint(name)
            # a name that resembles none is that of a stage which a plugin supplies, if one that failed may do so
            broken = self.plugins.failed() or self._incomplete()
            kind = PluginError if broken and not near else ConfigError
            raise kind(f"there is no stage {shown(name)}", where=where, hint=hint)
        if name not in self._classes:
            self._classes[name] = self._load(name)
        return self._classes[name]

    def _hint(self, name: str) -> tuple[str, bool]:
        """Hint for an unknown name, and whether it is that of a known plugin, or resembles a known one."""
        if name in PLUGIN_OF and not any(one.distribution == PLUGIN_OF[name] for one in self.plugins.plugins):
            return self._not_there(PLUGIN_OF[name]), True
        family, _, word = name.partition(".")
        siblings = [known for known in self if known.startswith(f"{family}.")]
        near = [f"{family}.{found}" for found in near_names(word, [known.partition(".")[2] for known in siblings])]
        near = near or self._writing(siblings, word) or ([] if siblings else near_names(name, self))
        if near:
            hints = [meant(near)]
        elif siblings:
            hints = [f"stages of this family: {', '.join(siblings)}"]
        else:
            hints = ["`sppm stages` lists all stages"]
        hints += [f"{plugin} could not be loaded and may supply it" for plugin in self.plugins.failed()]
        hints += (incomplete := self._incomplete())
        if self.plugins.disabled:
            hints.append("installed plugins are switched off by --no-plugins")
        elif not (near or incomplete):
            hints.append("a plugin that supplies it may not be installed; `sppm plugins` lists those that are")
        return "; ".join(hints), bool(near)

    def _not_there(self, distribution: str) -> str:
        """Hint for a stage of a known plugin that was not loaded."""
        if any(normal(found.distribution or "") == distribution for found, _ in installed_plugins()):
            why = "switched off by --no-plugins" if self.plugins.disabled else "not among those of --allow-plugins"
            return f"part of the plugin {distribution}, which is {why}"
        return f"part of the plugin {distribution}, which is not installed: {install_words(distribution)}"

    def _incomplete(self) -> list[str]:
        return [lack for module in self.plugins.single_files() for lack in incomplete_stages(module)]

    def _writing(self, names: list[str], ending: str) -> list[str]:
        """The built-in stage that writes files of this ending, if it is one: for `write.nrrd` it is `write.voxels`."""
        found = [
            name
            for name in names
            if self.owner(name).builtin
            and any(f".{ending.lower()}" in option.spec.suffixes for option in options_of(self.get(name)).values())
        ]
        return found if len(found) == 1 else []

    def _load(self, name: str) -> type[Stage]:
        owner = self._owners[name]
        target = imported(owner, f"the stage {name!r}", owner.stages[name], whole=True)
        if inspect.ismodule(target):
            module, target = target, next((cls for cls in stage_classes(target) if cls.name == name), None)
            if target is None:
                hint = "say which class it is, as 'module:name'"
                raise PluginError(f"{owner}: {module.__name__} has no stage of the name {name!r}", hint=hint)
        problem = None
        if not inspect.isclass(target) or not issubclass(target, Stage):
            problem = "is no subclass of Stage"
        elif inspect.isabstract(target):
            problem = f"does not implement {', '.join(sorted(target.__abstractmethods__))}"
        elif getattr(target, "name", None) != name:
            problem = f"has the name {getattr(target, 'name', None)!r}"
        elif "." not in name or name.startswith(".") or name.endswith("."):
            problem = "must be named family.name"
        elif "__dataclass_fields__" not in vars(target) or not dataclasses.is_dataclass(target):
            problem = "must be decorated with @dataclass(frozen=True, kw_only=True)"
        if problem is not None:
            raise PluginError(f"{owner}: the class of the stage {name!r} {problem}")
        if not owner.builtin:
            try:
                options_of(target)
                signature_of(target)
            except PluginError as error:
                raise PluginError(f"{owner}: the stage {name!r}: {error.message}", hint=error.hint) from error
        cls: type[Stage] = target
        return cls
