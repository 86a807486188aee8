"""Promises of every stage, as a suite to inherit from; see `sppm_pipeline.testing.contracts`."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sppm_pipeline.engine.config.options import options_of, parse_typed, plain_option
from sppm_pipeline.engine.files import digest_of
from sppm_pipeline.engine.plan.ports import signature_of
from sppm_pipeline.engine.strict_json import json_text, jsonable
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.stage import Stage
from sppm_pipeline.testing.plain_context import PlainContext


class StageContract:
    """Expectations of the engine on any stage."""

    @abstractmethod
    def stages(self) -> Sequence[Stage]:
        """Instances to be tested, with options that differ."""

    def inputs(self) -> Mapping[str, Any]:
        """An artifact for each port that the stage needs."""
        return {}

    def palette(self) -> Palette:
        """Number of interiors and colors that are asked for."""
        return Palette()

    def _run(self, stage: Stage, given: Mapping[str, Any] | None = None, **how: Any) -> tuple[Any, PlainContext]:
        context = PlainContext(**{"seed": 5, **how}, palette=self.palette())
        open_ports = {port.name: None for port in signature_of(type(stage)).ports if port.optional}
        return stage.run(context, **{**open_ports, **(self.inputs() if given is None else given)}), context

    def _digest(self, stage: Stage, **how: Any) -> tuple[str | None, str, str]:
        return self._digest_and_context(stage, **how)[0]

    def _digest_and_context(self, stage: Stage, **how: Any) -> tuple[tuple[str | None, str, str], PlainContext]:
        made, context = self._run(stage, **how)
        own = made.digest() if isinstance(made, Artifact) else None
        return (own, digest_of(context.directory), json_text(jsonable(context.reported))), context

    def test_has_a_name_of_family_and_word(self) -> None:
        """``family.name``, both in lower case."""
        for stage in self.stages():
            family, dot, word = stage.name.partition(".")
            assert dot, f"{stage.name!r} must be family.name"
            assert family.isidentifier()
            assert f"_{word}".isidentifier()  # it may begin with a digit
            assert stage.name == stage.name.lower()

    def test_says_what_it_does(self) -> None:
        """A docstring and a sentence for each option."""
        for stage in self.stages():
            assert (type(stage).__doc__ or "").strip()
            assert not (type(stage).__doc__ or "").startswith(f"{type(stage).__name__}("), "the docstring is missing"
            assert all(option.spec.help for option in options_of(type(stage)).values())

    def test_is_frozen(self) -> None:
        """Options can't be changed after they were checked."""
        for stage in self.stages():
            parameters = stage.__dataclass_params__  # type: ignore[attr-defined]
            assert parameters.frozen
            assert all(field.kw_only for field in dataclasses.fields(stage))

    def test_options_survive_a_run_record(self) -> None:
        """Written as JSON and read again, options are the same."""
        for stage in self.stages():
            for name, option in options_of(type(stage)).items():
                value = getattr(stage, name)
                # a run is repeated from its record, so what is written there must give the same stage
                assert parse_typed(option, plain_option(value), Path()) == value, name

    def test_declares_its_ports(self) -> None:
        """The signature of `run` can be read."""
        for stage in self.stages():
            names = {port.name for port in signature_of(type(stage)).ports}
            # a port that was renamed would otherwise be tested with its default
            assert set(self.inputs()) <= names

    def test_makes_what_it_announces_and_changes_nothing_else(self) -> None:
        """The type of the result; its parts agree with each other.

        Inputs stay as they are, as stages share artifacts, and NumPy's global random numbers, as those of a stage come
        from the context.
        """
        for stage in self.stages():
            given = self.inputs()
            artifacts = {name: value.digest() for name, value in given.items() if isinstance(value, Artifact)}
            numbers = np.random.get_state(legacy=False)["state"]  # noqa: NPY002 - the point of the test
            made, _ = self._run(stage, given)
            after = np.random.get_state(legacy=False)["state"]  # noqa: NPY002
            assert np.array_equal(numbers["key"], after["key"])
            assert numbers["pos"] == after["pos"]
            assert {name: given[name].digest() for name in artifacts} == artifacts
            signature = signature_of(type(stage))
            if not signature.as_recipe:
                assert isinstance(made, signature.makes or type(None))
            if isinstance(made, Artifact):
                made.check()
                # summaries go into run.json
                json_text(jsonable(made.summary()))

    def test_same_seed_same_result(self) -> None:
        """Same result in a second run, for any number of threads, and whether workers do what it maps."""
        for stage in self.stages():
            first, context = self._digest_and_context(stage)
            # an odd number: work that is divided unevenly shows sums in another order
            assert self._digest(stage, threads=3) == first
            if context.asked_for_workers:
                assert self._digest(stage, workers=2) == first
