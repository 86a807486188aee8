"""Services that a running stage may use."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sppm_pipeline.nouns.palette import Palette


class Context(ABC):
    """Services that a running stage may use; the engine implements them.

    Attributes
    ----------
    threads : int
        How many threads the stage may use; results must not depend on it.
    palette : Palette
        How many interiors and face colors are wanted; one of each outside tile sets.
    memory : int
        Bytes that a stage which can choose should plan with; results must not depend on it.
    memory_limit : int or None
        Bytes that the whole process may take, if the user set a limit (``--memory``); see `process.budget`.
    workers : int
        Processes that `map` hands work to, here or on other machines; 0 if it is done in this one.
    worker_threads : int
        Threads that a function may use which `map` calls.
    begun : object or None
        What `Stage.begin` of this stage has returned, if the stage before has asked for it.
    """

    threads: int
    palette: Palette
    memory: int = 2 * 2**30
    memory_limit: int | None = None
    workers: int = 0
    worker_threads: int = 1
    begun: Any = None

    @abstractmethod
    def rng(self, *key: int) -> np.random.Generator:
        """A generator that depends only on the run's seed, the stage's path, the attempt and `key`."""

    @abstractmethod
    def report(self, **values: Any) -> None:
        """Add JSON-ready numbers to the stage's summary in the run record."""

    @abstractmethod
    def progress(self, done: float, total: float, what: str = "") -> None:
        """Report progress; cheap enough to be called for every layer."""

    @abstractmethod
    def warn(self, message: str) -> None:
        """Warn the user of something that does not stop the run; it is kept in the run record."""

    def map(self, function: Callable[[Any, Any], Any], items: Iterable[Any], common: Any = None) -> Iterator[Any]:
        """Call ``function(common, item)`` for each item, by the workers of the run, or by threads of this process.

        Results must not depend on who calls the function, nor on how often: an item whose worker dies is done again.
        Items are taken as workers get free, and a few results are kept at once. Leaving the iterator drops the rest.

        Parameters
        ----------
        function : function of a module
            Whatever it changes beside its result may be lost. It may use `worker_threads` threads.
        items : iterable
            Arrays and plain values; they travel to the workers, so they should be small.
        common : object, optional
            What all calls need: artifacts, frozen dataclasses, arrays and plain values. It is written once into a
            folder that the workers share, and loaded once by each; its digests are checked.

        Yields
        ------
        object
            Arrays and plain values, in the order of the items.

        Raises
        ------
        TypeError
            If there are workers, and the function is not one of a module, or `common` holds what can't be written.
        """
        from sppm_pipeline.services.threads import ordered_map

        return ordered_map(functools.partial(function, common), items, self.threads)

    def begin_readers(self) -> Sequence[Any]:
        """Begin all stages that read what this stage makes, so that they work on the pieces of it while it is made.

        Returns
        -------
        sequence of object
            What `Stage.begin` of each has returned; they expect every piece. Empty if there is no such stage, if one of
            them, or anybody else, wants the result whole, or if this stage or one of them is a plugin's. Otherwise
            no more of the result will be used than these have received, and its summary.
        """
        return ()

    def worth_workers(self, samples: float) -> bool:
        """True if so many samples, all that `map` would evaluate, are worth handing to workers; False without any.

        Results must not depend on it. Ask once the work is certain to be done: a message says if workers
        are not used.
        """
        return self.workers > 0

    def shared_folder(self) -> Path | None:
        """A new empty folder that this process and all workers see, gone after the run; None without workers."""
        return None

    def remember(self, key: str, state: Any) -> None:  # noqa: B027 - not every context can
        """Keep the state of long work, so that a later run may go on from there; None forgets it.

        Parameters
        ----------
        key : str
            Digest of all that the result depends on but for the program, which is added.
        state : arrays, numbers, strings, and mappings and sequences of them
        """

    def recall(self, key: str) -> Any:
        """The object that an earlier run has kept under a key by `remember` and not forgotten; None if nothing is
        kept."""
        return None

    def scratch(self) -> Path:
        """A folder for temporary files, which the stage removes: where its outputs go, as there must be room there."""
        import tempfile

        return Path(tempfile.gettempdir())

    def hashed(self, name: str, sha256: str) -> None:  # noqa: B027 - not every context asks for it
        """Report the SHA-256 of an output file that has just been written, so that it is not read again for it."""

    @abstractmethod
    def output(self, name: str) -> Path:
        """A path for a final file or folder of this stage.

        It lies in a staging area and is moved to ``<run directory>/<name>`` when the stage has ended well.

        Raises
        ------
        ConfigError
            If the name leaves the run directory or another stage writes it too.
        """
