"""The cache as one run sees it: which results are there already, and which are worth keeping."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.cache.housekeeping import account
from sppm_pipeline.engine.cache.identity import has_files
from sppm_pipeline.engine.cache.keys import InputFiles, differences, ingredients_of, key_of
from sppm_pipeline.engine.cache.store import Entry, Store
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.nouns.storage import DamagedError, NotStorable, stored_bytes

if TYPE_CHECKING:
    from sppm_pipeline.engine.run.outputs import RunFolder

STORE_RATE = 4e8
"""Bytes a second that are written and hashed, at least."""

LOAD_RATE = 8e8
"""Bytes a second that are read and hashed, at least."""

MAX_OVERHEAD = 0.04
"""Share of a run's time that may be spent on keeping results: with twice as much, more results of fast stages are kept,
and a run takes 4 % longer."""

MIN_SECONDS = 0.02
"""Seconds from which a result is kept: to load one takes about 5 ms. Not sensitive: only speed."""

SECONDS_PER_FILE = 3e-4
"""Seconds that one more file costs."""

SECONDS_OF_FACTS = 2e-3
"""Seconds that it costs to keep what the record says of a stage."""

MIN_DURABLE_SECONDS = 1.0
"""Seconds; what took longer is kept so that it survives a power cut."""


Warn = Callable[[str | None, str], None]


class CacheSession:
    """Finds and keeps the results of one run.

    `warn` is called, with a stage id or None and a message, once if nothing can be kept and for every damaged entry.
    The ingredients of the last keys are remembered under the name of the configuration, `about`, if there is one.
    """

    def __init__(
        self,
        store: Store,
        warn: Warn,
        *,
        seed: int,
        recipes: Mapping[str, Sequence[Step]],
        about: str = "",
    ) -> None:
        self.store = store
        self._warn = warn
        self._seed = seed
        self._recipes = recipes
        self._about = about
        self._started = time.perf_counter()
        self._spent = 0.0
        self._broken = False
        self._facts: list[tuple[str, dict[str, Any]]] = []
        self._files = InputFiles()
        self._ingredients: dict[str, dict[str, Any] | None] = {}
        self._described: dict[str, dict[str, Any] | None] = {}
        self._keys: dict[str, str | None] = {}
        self._entries: dict[str, Entry] = {}

    def given(self, id_: str, digest: str) -> None:
        """A result that is there before the first stage, by the digest of its content."""
        self._keys[id_] = f"content {digest}"

    def entry(self, id_: str) -> Entry | None:
        """The entry of a step that `look_up` found or `keep` kept."""
        return self._entries.get(id_)

    def ingredients(self, id_: str) -> dict[str, Any] | None:
        """Ingredients of the key of a step that was looked up, without the seed; None if they are unknown."""
        return self._described.get(id_)

    def look_up(self, step: Step, path: tuple[str, ...]) -> Entry | None:
        """The entry of a step, if there is one; its sources must have been looked up or kept before."""
        started = time.perf_counter()
        try:
            entry = self._look_up(step, path)
        except OSError:  # an input file that can't be read; the stage will say so
            self._ingredients[step.id] = self._described[step.id] = None
            entry = None
        if entry is not None:
            self._entries[step.id] = entry
            self._keys[step.id] = entry.key
        self._spent += time.perf_counter() - started
        return entry

    def _look_up(self, step: Step, path: tuple[str, ...]) -> Entry | None:
        self._ingredients[step.id] = self._keys[step.id] = None
        sources = {port: self._keys.get(source) if source else None for port, source in step.inputs.items()}
        ingredients = self._described[step.id] = ingredients_of(step, self._recipes, path, sources, self._files)
        if ingredients is None or any(source and sources[port] is None for port, source in step.inputs.items()):
            return None  # the dependencies of the result are unknown, or it is made of something that has no key
        self._ingredients[step.id] = ingredients
        # whether a stage draws random numbers is known only after a run: results without any have no seed in their key
        for key in (key_of(ingredients), key_of(ingredients | {"seed": self._seed})):
            try:
                entry = self.store.find(key)
            except DamagedError as error:
                self.damaged(step.id, error)
                continue
            if entry is not None:
                return entry
        return None

    def damaged(self, id_: str, error: Exception) -> None:
        """Report a damaged entry and remove it; the stage is run again."""
        self._warn(id_, f"a kept result is damaged and is made again ({error})")
        entry = self._entries.pop(id_, None)
        if entry is not None:
            self.store.remove(entry.key)

    def load(self, id_: str) -> Any:
        """The artifact of a kept step, or None if it has to be made again."""
        entry = self._entries.get(id_)
        if entry is None or not entry.has_value:
            return None
        try:
            return self.store.load(entry)
        except DamagedError as error:
            self.damaged(id_, error)
        except OSError:
            self._entries.pop(id_, None)
        return None

    def same_as(self, id_: str) -> str | None:
        """The port whose artifact a kept step has passed on."""
        entry = self._entries.get(id_)
        port: str | None = entry.manifest["same_as"] if entry is not None else None
        return port

    def restore(
        self, step: Step, folder: RunFolder, outputs: Sequence[Mapping[str, Any]], checkpoint: Callable[[], None]
    ) -> bool:
        """Write the outputs of a kept step into the run directory; False if they have to be made again."""
        entry = self._entries.get(step.id)
        if entry is None or not entry.has_outputs:
            return False
        try:
            self.store.restore(entry, lambda name: folder.claim(step.address, name))
            checkpoint()
            if folder.commit() == outputs:
                return True
            raise DamagedError("its outputs are not those that were recorded")
        except DamagedError as error:
            self.damaged(step.id, error)
        except OSError:
            self._entries.pop(step.id, None)
        folder.restart(step.address)
        return False

    def keep(
        self,
        step: Step,
        facts: Mapping[str, Any],
        made: Any,
        inputs: Mapping[str, Any],
        *,
        outputs: Sequence[tuple[str, Path]],
        seconds: float,
        drew: bool,
    ) -> None:
        """Keep what a step made: always the facts of the run record, and the artifact and the files if that is cheap
        against making them, which took `seconds`. `drew` says whether the seed had a part in it.
        """
        ingredients = self._ingredients.get(step.id)
        if ingredients is None:
            return
        started = time.perf_counter()
        try:
            key = key_of(ingredients | {"seed": self._seed} if drew else ingredients)
            self._keys[step.id] = key
            # a file that was changed while the stage ran may not be what it has read
            if self._broken or not self._files.unchanged():
                return
            manifest: dict[str, Any] = {
                "stage": step.stage.name,
                "id": step.id,
                "seconds": round(seconds, 6),
                "random": drew,
                "facts": dict(facts),
                "same_as": next((port for port, given in inputs.items() if made is not None and given is made), None),
            }
            value = None if made is None or manifest["same_as"] else made
            worth = seconds >= MIN_SECONDS
            if value is not None and not (worth and self._affordable(_bytes_of(value), 2, seconds)):
                value = None
            size, count = _size_of(outputs) if worth else (0, 0)
            if not (outputs and worth and self._affordable(size, count, seconds)):
                outputs = ()
            if value is None and not outputs:
                self._facts.append((key, manifest))
                return
            self.store.put(key, manifest, value=value, outputs=outputs, durable=seconds > MIN_DURABLE_SECONDS)
            entry = self.store.find(key, touch=False)
            if entry is not None:
                self._entries[step.id] = entry
        except (OSError, DamagedError) as error:
            self._give_up(error)
        finally:
            self._spent += time.perf_counter() - started
        self._keep_facts()

    def _keep_facts(self) -> None:
        """Keep what waits, the stages that took longest first, as far as the share of the run's time goes.

        A run of a few milliseconds, of which a sweep may have thousands, would otherwise take longer for being kept.
        """
        # the longest last, where `pop` takes them
        self._facts.sort(key=lambda waiting: waiting[1]["seconds"])
        while self._facts and MAX_OVERHEAD * (time.perf_counter() - self._started) - self._spent >= SECONDS_OF_FACTS:
            started = time.perf_counter()
            try:
                self.store.put(*self._facts.pop())
            except OSError as error:
                self._give_up(error)
            self._spent += time.perf_counter() - started

    def _give_up(self, error: Exception) -> None:
        """Report, once, that nothing can be kept."""
        self._broken = True
        # nothing more is kept, so that these need not wait in memory
        self._facts.clear()
        detail = error.strerror if isinstance(error, OSError) else error
        self._warn(
            None, f"the cache {str(self.store.root)!r} can't be written ({detail}); results of this run are not kept"
        )

    def keep_again(self, step: Step, made: Any, inputs: Mapping[str, Any], seconds: float) -> None:
        """Keep the artifact of a step of which only the facts were kept, if that is worth it now."""
        entry = self._entries.get(step.id)
        # outputs are on the disk already, and would be lost by putting an entry without them
        if entry is not None and not entry.has_outputs:
            self.keep(step, entry.facts, made, inputs, outputs=(), seconds=seconds, drew=entry.manifest["random"])

    def _affordable(self, size: int | None, files: int, seconds: float) -> bool:
        """True if storing fits into the share of the run's time, and loading would save time."""
        if size is None or size > self.store.cap / 4:
            return False
        cost = size / STORE_RATE + files * SECONDS_PER_FILE
        left = MAX_OVERHEAD * (time.perf_counter() - self._started) - self._spent
        # a result that takes half as long to load as to make is not worth its space
        return cost <= max(left, MAX_OVERHEAD * seconds) and size / LOAD_RATE + files * SECONDS_PER_FILE <= seconds / 2

    def close(self) -> None:
        """Remember what the keys were made of, and keep the cache within its cap."""
        try:
            self._keep_facts()
            if self._about and not self._broken and any(self._ingredients.values()):
                stages = {id_: found for id_, found in self._ingredients.items() if found is not None}
                # without it `reasons_of` could not say what has changed
                text = {"about": self._about, "seed": self._seed, "stages": stages}
                self.store.write_text(recent_name(self._about), text)
            self.store.clear_leftovers()
            account(self.store)
        except OSError:
            pass  # nothing of the run depends on it
        finally:
            self.store.close()


def recent_name(about: str) -> str:
    """Name of the file of the cache with the ingredients of a configuration's last run."""
    return f"recent/{hashlib.sha256(about.encode()).hexdigest()[:32]}.json"


def _bytes_of(value: Any) -> int | None:
    try:
        return stored_bytes(value)
    except NotStorable:
        return None


def _size_of(outputs: Sequence[tuple[str, Path]]) -> tuple[int, int]:
    """Bytes and number of files; links are not followed, as their targets do not belong to the run."""
    size = count = 0
    for _, path in outputs:
        for file in path.rglob("*") if path.is_dir() else [path]:
            about = os.lstat(file)
            if os.path.islink(file):
                return 1 << 62, 0
            size, count = size + about.st_size, count + 1
    return size, count


def reasons_of(plan: Plan, store: Store, about: str) -> dict[str, tuple[bool, str]]:
    """For each stage of the pipeline, whether its result is kept, and in words since when or why not; `about` as for
    `CacheSession`.
    """
    cache = CacheSession(store, lambda stage, message: None, seed=plan.seed, recipes=plan.recipes)
    recent = store.read_text(recent_name(about)) or {}
    before: Mapping[str, Any] = recent.get("stages", {})
    found: dict[str, tuple[bool, str]] = {}
    for step in plan.steps:
        entry = cache.look_up(step, (step.id,))
        if entry is not None:
            found[step.id] = True, f"kept; it took {entry.manifest['seconds']:.3g} s"
            continue
        now = cache.ingredients(step.id)
        again = [source for source in step.inputs.values() if source and not found[source][0]]
        if not has_files(type(step.stage)):
            why = "it runs every time, as no file holds its code"
        elif not step.stage.cacheable:
            why = "it runs every time, as its result depends on more than can be known"
        elif step.id not in before:
            why = "no run of this configuration is known that had it"
        elif again:
            # the keys of what runs again are not known yet, so that only its own changes can be listed
            own = [text for text in differences(before[step.id], now or {}) if not text.startswith("its input")]
            why = "; ".join([*own, *(f"{source!r} runs again" for source in dict.fromkeys(again))])
        elif now is None:
            why = "an input file can't be read"
        else:
            own = list(differences(before[step.id], now))
            if recent.get("seed") != plan.seed:
                own.append(f"the seed has changed from {recent.get('seed')} to {plan.seed}")
            why = "; ".join(own) or "its result is not in the cache, or not any more"
        found[step.id] = False, why
    store.close()
    return found
