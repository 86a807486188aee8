"""The interface of a stage; that of its surroundings is in `sppm_pipeline.context`.

A stage is a frozen, keyword-only dataclass. Its fields are its options, each declared once with `option`; the parser,
the command line help, the reference pages and the JSON Schema all come from there. The annotated signature of `run` is
its list of ports: a required port is annotated with an artifact type, an optional one with ``Artifact | None``, a port
that takes one of several types with ``A | B``, one that takes the results of one or more stages with ``tuple[A, ...]``,
a recipe with ``Recipe``. What `run` returns is what the stage makes; a stage annotated ``-> Any`` makes what its recipe
makes, or the last of a type (`Stage.returns`), and a type variable on a port and on the result passes the type through.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from sppm_pipeline.context import Context as Context
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.nouns.report import Headline as Headline
from sppm_pipeline.nouns.size import Size

FAMILIES: Mapping[str, str] = {
    "read": "a file or a primitive becomes an artifact",
    "load": "a part is held and loaded",
    "optimize": "a map is found that suits the loads of a part",
    "grade": "a parameter is made a function of place",
    "sample": "pores are thrown",
    "connect": "pores are joined by tunnels",
    "field": "pores and tunnels become a field",
    "tune": "a recipe is repeated until it meets a target",
    "design": "a recipe is given the cell size and porosity for what is asked",
    "tileset": "a recipe is drawn for many interiors and face colors",
    "tile": "cells are laid into a part",
    "warp": "a tiling is bent to another shape",
    "fill": "a part is cut from the tiling",
    "fix": "a part is changed so that it can be printed",
    "extract": "a field becomes a triangle mesh or an image of voxels",
    "mesh": "a mesh becomes a better one, or a field or mesh becomes one of tetrahedra",
    "homogenize": "effective properties are computed",
    "simulate": "a part is loaded, and deforms",
    "measure": "numbers are read off a curve",
    "crush": "a block is compressed",
    "check": "something is measured, and may be rejected",
    "slice": "a field or mesh becomes a stack of layers",
    "print": "layers become what a machine makes of them",
    "write": "an artifact becomes files",
}


class Rejected(DesignError):
    """A draw does not meet a check; `tune.retry` draws again, elsewhere it ends the run.

    Parameters
    ----------
    message, **details
        See `SppmError`.
    keep_outputs : bool
        Whether what the stage has written is whole and stays in the run directory, such as a report that says why; its
        summary is then recorded, too. Not in the cache, and not if a draw follows.
    """

    def __init__(self, message: str, *, keep_outputs: bool = False, **details: Any) -> None:
        super().__init__(message, **details)
        self.keep_outputs = keep_outputs


@dataclass(frozen=True)
class OptionSpec:
    """The single declaration of an option: what the parser checks and every reference prints.

    Attributes
    ----------
    help : str
        One sentence.
    unit : str or None
        Unit of a bare number, for instance "cell size" or "mm".
    minimum, maximum : float or None
        Inclusive bounds; of the value of a `Length`, of each element of a tuple.
    above, below : float or None
        Exclusive bounds.
    choices : tuple of str
        Allowed words.
    output : bool
        Whether the value names a file or folder that the stage writes.
    suffixes : tuple of str
        How the name of an output may end, in lower case: with one of ``.stl``, ...; ``/`` for a folder.
    column : bool
        Whether the value names a column of a table.
    run_file : bool
        Whether the value names a file in the folder of each run of a sweep.
    formerly : str or None
        An earlier name of the option, still accepted.
    """

    help: str
    unit: str | None = None
    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None
    below: float | None = None
    choices: tuple[str, ...] = ()
    output: bool = False
    suffixes: tuple[str, ...] = ()
    column: bool = False
    run_file: bool = False
    formerly: str | None = None


@dataclass(frozen=True)
class StageAlias:
    """Meaning of a former stage name.

    Attributes
    ----------
    name : str
        The stage's current name.
    options : mapping, or function of the options written in the file that returns a mapping
        Options that the former name implied; those written in the file win. The function may raise `ConfigError`.
    """

    name: str
    options: Mapping[str, Any] | Callable[[Mapping[str, Any]], Mapping[str, Any]] = dataclasses.field(
        default_factory=dict
    )

    @classmethod
    def of_format(cls, former: str, name: str, path: str, *also: str) -> StageAlias:
        """Alias of a writer that was named after a format and keeps it: by default `path`, whose suffix it demands.

        Parameters
        ----------
        former, name : str
        path : str
            Default file name.
        *also : str
            Further suffixes that are accepted.
        """
        allowed = (path[path.rindex(".") :], *also)

        def implied(written: Mapping[str, Any]) -> dict[str, Any]:
            chosen = written.get("path", path)
            if isinstance(chosen, str) and not chosen.lower().endswith(allowed):
                raise ConfigError(
                    f"{former} writes {' or '.join(sorted(allowed, key=len))}, and `path` is {chosen!r}",
                    hint=f"say `stage: {name}`: the ending of the file chooses the format",
                )
            return {"path": chosen}

        return cls(name, implied)


def option(
    default: Any = dataclasses.MISSING,
    *,
    help: str,
    unit: str | None = None,
    minimum: float | None = None,
    maximum: float | None = None,
    above: float | None = None,
    below: float | None = None,
    choices: Iterable[str] = (),
    output: bool = False,
    suffixes: Iterable[str] = (),
    column: bool = False,
    run_file: bool = False,
    formerly: str | None = None,
) -> Any:
    """Declare an option of a stage; without `default` the option is required.

    The type comes from the annotation: bool, int, float, str, `pathlib.Path` (an input file, taken relative to the
    configuration file), `Length`, ``tuple[int, int]``, ``tuple[float, ...]``, and any of these ``| None``.
    A string with `output` names a file or folder below the run directory, which is checked before any work starts;
    `suffixes` are the endings that the stage can write, ``/`` if it writes a folder. A string with `column` names a
    column of a table, one with `run_file` a file in the folder of each run of a sweep; where that is the table of a
    sweep, what no run can make is refused before the sweep.
    An option that was renamed states its earlier name as `formerly`; configurations that use it run, with a warning.
    """
    spec = OptionSpec(
        help=help,
        unit=unit,
        minimum=minimum,
        maximum=maximum,
        above=above,
        below=below,
        choices=tuple(choices),
        output=output,
        suffixes=tuple(suffixes),
        column=column,
        run_file=run_file,
        formerly=formerly,
    )
    return dataclasses.field(default=default, metadata={"option": spec})


class Observed(NamedTuple):
    """A run of a recipe.

    Attributes
    ----------
    made : object
        The last result of the type that was asked for; None if the numbers were remembered.
    numbers : mapping of "stage id.number" to float
        What its stages reported, named as columns of sweeps are.
    """

    made: Any
    numbers: Mapping[str, float]


class Recipe(ABC):
    """A named sub-pipeline handed to a stage that repeats it."""

    name: str

    @abstractmethod
    def run(
        self,
        context: Context,
        *,
        palette: Palette | None = None,
        attempt: int = 0,
        options: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> Any:
        """Run the sub-pipeline and return what its last stage makes.

        Parameters
        ----------
        context : Context
            The context of the calling stage.
        palette : Palette, optional
            What samplers and connectors have to supply.
        attempt : int
            A different attempt draws different random numbers.
        options : mapping of stage id or name to mapping of option to value, optional
            Options that replace those in the file.
        """

    @abstractmethod
    def options(self) -> Mapping[str, Mapping[str, Any]]:
        """Options of each stage of the recipe by stage id, defaults included."""

    def inner_options(self) -> Mapping[str, Mapping[str, Any]]:
        """Those of the recipes that it repeats in turn, by ``recipe.stage id``; `run` takes these names, too."""
        return {}

    def number(self, name: str) -> str:
        """The full name, ``stage id.number``, of a number that its stages report; the id may be omitted if clear.

        Raises
        ------
        ConfigError
            If no stage, or more than one, declares it, as far as they declare their numbers.
        """
        return name

    def observe(
        self,
        context: Context,
        kind: type,
        *,
        attempt: int = 0,
        options: Mapping[str, Mapping[str, Any]] | None = None,
        again: bool = False,
    ) -> Observed:
        """Run the sub-pipeline for the numbers that its stages report, or remember them from an earlier run.

        Parameters
        ----------
        context : Context
            The context of the calling stage.
        kind : type
            Of what is returned: the last result of this type.
        attempt, options
            See `run`.
        again : bool
            Whether to run even if the numbers are remembered, for what is made.

        Raises
        ------
        DesignError
            If the design can't be satisfied or is rejected; this is remembered as well.
        """
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class Stage(ABC):
    """Base of all stages; see the module's docstring for how one is written.

    Attributes
    ----------
    name : str
        ``family.name``; also the file, the YAML prefix and the reference page.
    version : int
        Raised when results change for equal options, so that kept results are not reused.
    cacheable : bool
        False for a stage whose result depends on more than its options, input files, inputs and random numbers, for
        instance on a clock or a network; it then runs every time, and so does what depends on it.
    libraries : tuple of str
        Distributions whose versions its result depends on, besides NumPy, SciPy, Numba and Pillow, which count for
        every stage; of a plugin's stage, what the plugin requires counts as well.
    headline : tuple of Headline
        The numbers of its summary that the terminal shows after a run; if empty, those of the `Report` that it makes,
        else the first five.
    reported : tuple of str or None
        Places of the numbers that it may `Context.report`, so that a column of a sweep's table which no run makes is
        refused before the sweep; None to have none refused. See `Artifact.reported` for how they are written.
    returns : type or None
        Of a stage annotated ``-> Any``: it makes the last result of this type among those of its recipe, which may
        then end in stages that measure; None for what the recipe makes.
    is_random : bool
        Whether it draws random numbers itself: in Python, a call that needs no artifacts then runs if it has a seed,
        and is a step without one.
    maps : bool
        Whether it hands work to the workers of a run (`Context.map`), each of which then takes as much memory.
    requires : mapping of port to (attribute, advice)
        Attributes that the stage before a port must not have as False, as far as it has them, and what to write there;
        an error before any work starts.
    sources : tuple of str
        Publications whose method it implements, for ``sppm cite``.
    advice : str
        What makes the work smaller, said when a run is refused because it can't fit; empty for a default.
    """

    name: ClassVar[str]
    version: ClassVar[int] = 1
    cacheable: ClassVar[bool] = True
    libraries: ClassVar[tuple[str, ...]] = ()
    headline: ClassVar[tuple[Headline, ...]] = ()
    reported: ClassVar[tuple[str, ...] | None] = None
    returns: ClassVar[type | None] = None
    is_random: ClassVar[bool] = False
    maps: ClassVar[bool] = False
    requires: ClassVar[Mapping[str, tuple[str, str]]] = {}
    sources: ClassVar[tuple[str, ...]] = ()
    advice: ClassVar[str] = ""

    @abstractmethod
    def run(self, context: Context, *inputs: Any) -> Any:
        """Do the work; subclasses state their ports and result by annotation."""

    def begin(self, context: Context) -> Any:
        """A receiver of the pieces of this stage's only input while the stage before makes it; None to get it whole.

        Called before this stage's turn, if the stage before asks for it (`Context.begin_readers`); `run` finds it in
        `Context.begun`, whether it was given all pieces or none. Stage before and reader agree on what pieces are, as
        `extract.marching_cubes` and `write.mesh` do. Nothing but temporary files may come of it.
        """
        return None

    def estimate(self, palette: Palette, *inputs: Any, **ports: Any) -> Size | None:
        """Estimate the size of the result and of the work, within milliseconds; None if that is unknown.

        Subclasses take the `Size` of each port by name (None for an open one), and a `RecipeSize` for a recipe. A
        `ConfigError`, of options that do not fit the inputs, is reported by a check before any work. What raises
        `LookupError`, because the geometry of an input is unknown, or another error of this program, is unknown as
        well; other errors trigger a warning, as mistakes. A stage that states none and makes nothing, numbers, or what
        it takes in another form, is as large as what it takes, on a grid if it has a `resolution`.
        """
        return None

    @property
    def rated_as(self) -> str:
        """The entry of the table of rates by which time, memory and disk are estimated from the size."""
        return self.name

    def check_options(self) -> None:  # noqa: B027 - most stages have nothing to add
        """Raise `ConfigError` if options contradict each other; called before any work starts."""
