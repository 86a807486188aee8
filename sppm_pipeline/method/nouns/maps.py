"""Parameters as functions of place: porosity, scale and radii that vary through a part."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.errors import ConfigError, DesignError, did_you_mean
from sppm_pipeline.nouns.artifact import Artifact, frozen, in_rows
from sppm_pipeline.nouns.palette import Maps
from sppm_pipeline.services.arrays import F64, Bools

Points = F64


class Quantity(NamedTuple):
    """Meaning of a map of a known name."""

    unit: str
    low: float  # bounds of allowed values, which are excluded unless `closed`
    high: float
    closed: bool
    meaning: str


_ANY = math.inf
QUANTITIES = {
    "porosity": Quantity("", 0.0, 1.0, False, "share of void"),
    "spacing": Quantity("mm", 0.0, _ANY, False, "least distance of two pores"),
    "scale": Quantity("", 0.0, _ANY, False, "factor of the recipe's spacing and radii"),
    "pore_radius": Quantity("mm", 0.0, _ANY, False, "radius of an isolated pore"),
    "tunnel_radius": Quantity("mm", 0.0, _ANY, False, "radius of an isolated tunnel"),
    "stretch": Quantity("", 0.0, _ANY, False, "length of pores over their width, along the direction"),
    "direction_x": Quantity("", -_ANY, _ANY, False, "x of the vector along which pores are stretched"),
    "direction_y": Quantity("", -_ANY, _ANY, False, "y of the vector along which pores are stretched"),
    "direction_z": Quantity("", -_ANY, _ANY, False, "z of the vector along which pores are stretched"),
    "stretch_across": Quantity("", 0.0, _ANY, False, "length of pores over their width, along a second direction"),
    "across_x": Quantity("", -_ANY, _ANY, False, "x of the second vector along which pores are stretched"),
    "across_y": Quantity("", -_ANY, _ANY, False, "y of the second vector along which pores are stretched"),
    "across_z": Quantity("", -_ANY, _ANY, False, "z of the second vector along which pores are stretched"),
    "weight": Quantity("", 0.0, 1.0, True, "share of the second of two sets or fields"),
}
"""Names that stages look for; a map of any other name is data for formulas."""

COORDINATES = ("x", "y", "z")
BOX_COORDINATES = ("u", "v", "w")
CELL_COORDINATES = ("cell_x", "cell_y", "cell_z")
DISTANCE = "distance"


class CellFrame(NamedTuple):
    """The lattice that ``cell_x``, ``cell_y``, ``cell_z`` are counted in.

    Attributes
    ----------
    edge : float
        Cell edge, mm.
    origin : tuple of 3 floats
        Low corner of cell (0, 0, 0), mm.
    """

    edge: float
    origin: tuple[float, float, float]


class Place:
    """Points at which maps are evaluated, with what has been computed there.

    Attributes
    ----------
    points : (n, 3) float64, mm
    """

    def __init__(self, grading: Grading, points: Points) -> None:
        self.points = points
        self._grading = grading
        self._known: dict[str, F64] = {}

    def values(self, name: str) -> F64:
        """A coordinate or an earlier map, (n,)."""
        if name in COORDINATES:
            return self.points[:, COORDINATES.index(name)]
        if name in CELL_COORDINATES:
            axis = CELL_COORDINATES.index(name)
            frame = self._grading.frame
            if frame is None:
                raise ConfigError(
                    f"{name!r} counts cells, and there are none here",
                    hint="use x, y, z in mm, or grade a stage that lays cells",
                )
            return (self.points[:, axis] - frame.origin[axis]) / frame.edge
        # maps that several formulas use are computed once for these points
        if name not in self._known:
            self._known[name] = checked(self._grading.law(name), self)
        return self._known[name]


@dataclass(frozen=True, eq=False)
class Law(Artifact):
    """Base of laws behind maps: a formula, a table, or data. Implement `at`.

    Attributes
    ----------
    name : str
    unit : str
        Unit of the values, empty for numbers without one.
    """

    name: str
    unit: str

    def __post_init__(self) -> None:
        for one in fields(self):
            if isinstance(value := getattr(self, one.name), np.ndarray):
                object.__setattr__(self, one.name, frozen(value))

    @abstractmethod
    def at(self, place: Place) -> F64:
        """Values (n,) at the points of a place; not finite where there is none."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of earlier maps that it is computed from."""
        return ()

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the values as far as they are known without looking."""
        return -math.inf, math.inf

    def blame(self) -> str:
        """Name for messages."""
        return f"the map {self.name!r}"


@dataclass(frozen=True, eq=False)
class DataLaw(Law):
    """Base of laws that are data; `outside` there is the "nearest" value, or with "refuse" none."""

    outside: str

    @property
    def box(self) -> F64:
        """Low and high corner of the data, (2, 3) mm."""
        raise NotImplementedError

    def beyond(self, points: F64) -> Bools:
        """Which points (n, 3) lie outside of the box of the data, up to rounding."""
        low, high = self.box
        slack = 1e-9 * np.abs(self.box).max()
        found: Bools = ((points < low - slack) | (points > high + slack)).any(axis=1)
        return found

    def bounded(self, values: F64, outside: Bools) -> F64:
        """`values`, without those outside if these are refused."""
        return np.where(outside, np.nan, values) if self.outside == "refuse" else values


@dataclass(frozen=True, eq=False)
class ImageLaw(DataLaw):
    """An image, linear between the middles of voxels."""

    values: NDArray[Any]  # (nx, ny, nz), any type of numbers
    origin: tuple[float, float, float]  # low corner of the first voxel, mm
    spacing: tuple[float, float, float]  # edges of a voxel, mm
    factor: float  # of the numbers

    @property
    def box(self) -> F64:
        low = np.array(self.origin)
        return np.array([low, low + np.array(self.spacing) * self.values.shape])

    @property
    def bounds(self) -> tuple[float, float]:
        return self.factor * float(self.values.min()), self.factor * float(self.values.max())

    def at(self, place: Place) -> F64:
        from scipy.ndimage import map_coordinates

        # values belong to the centers of voxels; the outer half voxel continues them as a constant
        index = (place.points - self.origin) / self.spacing - 0.5
        index = np.clip(index, 0, np.array(self.values.shape) - 1)
        found = map_coordinates(self.values, index.T, np.float64, order=1, mode="nearest", prefilter=False)
        return self.bounded(self.factor * found, self.beyond(place.points))


def checked(law: Law, place: Place) -> F64:
    """Values of a law; `DesignError` names the first point where one is not finite, or not what the quantity may be."""
    values = law.at(place)
    kind = QUANTITIES.get(law.name)
    bad = ~np.isfinite(values)
    allowed = "a finite number"
    if kind is not None:
        out = (values < kind.low) | (values > kind.high)
        if not kind.closed:
            out |= (values == kind.low) | (values == kind.high)
        bad |= out
        if math.isfinite(kind.low):
            allowed = f"above {kind.low:g}" + (f" and below {kind.high:g}" if math.isfinite(kind.high) else "")
            if kind.closed:
                allowed = f"{kind.low:g} to {kind.high:g}"
    if bad.any():
        first = int(np.argmax(bad))
        x, y, z = place.points[first]
        unit = f" {law.unit}" if law.unit else ""
        raise DesignError(
            f"{law.blame()} is {values[first]:g}{unit} at ({x:g}, {y:g}, {z:g}) mm, and at {int(bad.sum())} of "
            f"{len(bad)} points not {allowed}",
            hint="bound it by clip(value, low, high), or look at the data behind it",
        )
    return values


class Map:
    """One parameter of a `Grading`, as a function of place.

    Attributes
    ----------
    name, unit : str
    range : (low, high)
        Bounds of the values as far as they are known without looking; those that the quantity may have at most.
    """

    def __init__(self, grading: Grading, name: str) -> None:
        law = grading.law(name)
        self.name, self.unit = name, law.unit
        kind = QUANTITIES.get(name)
        low, high = law.bounds
        self.range = (low, high) if kind is None else (max(low, kind.low), min(high, kind.high))
        self._grading = grading

    def at(self, points: ArrayLike) -> F64:
        """Values (n,) at points (n, 3) mm: all finite, and what the quantity may be.

        Raises
        ------
        DesignError
            Naming the first point where there is no such value.
        """
        where = in_rows(np.asarray(points, np.float64), 3, "points")
        return Place(self._grading, where).values(self.name)

    def digest(self) -> str:
        """SHA-256 of all that its values depend on."""
        wanted, found = [self.name], set()
        # only maps that the values depend on: another one added later changes no digest
        while wanted:
            name = wanted.pop()
            found.add(name)
            wanted += [other for other in self._grading.law(name).needs if other not in found]
        laws = tuple(law for law in self._grading.laws if law.name in found)
        return Grading(laws, self._grading.frame).digest()


@dataclass(frozen=True, eq=False)
class Grading(Maps):
    """Maps by name, in the order in which they were made; ``grading["porosity"].at(points)``.

    Attributes
    ----------
    laws : tuple of Law
        One a map.
    frame : CellFrame or None
        The lattice of the part, once there is one; see `in_cells`.
    """

    reported: ClassVar[tuple[str, ...]] = ("maps.*",)
    scattered_by: ClassVar[str] = "sppm_pipeline.features.grading.graded_cloud:scattered_by_maps"

    laws: tuple[Law, ...] = ()
    frame: CellFrame | None = None

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def __getitem__(self, name: str) -> Map:
        return Map(self, name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the maps, in order."""
        return tuple(law.name for law in self.laws)

    def law(self, name: str) -> Law:
        """The law of a map.

        Raises
        ------
        ConfigError
            If there is none of that name.
        """
        for law in self.laws:
            if law.name == name:
                return law
        hint = did_you_mean(name, self.names) if self.laws else "put a `grade` stage before this one"
        raise ConfigError(f"the grading has no map {name!r}", hint=hint)

    def added(self, law: Law) -> Grading:
        """The grading with one map more.

        Raises
        ------
        ConfigError
            If there is one of that name.
        """
        if law.name in self:
            raise ConfigError(f"there are two maps {law.name!r}", hint="give one of them another name by `of`")
        return replace(self, laws=(*self.laws, law))

    def in_cells(self, edge: float, origin: tuple[float, float, float]) -> Grading:
        """The grading for a lattice: its cell edge and the low corner of cell (0, 0, 0), mm.

        Stages that lay cells call it, so that maps may be given in cells.
        """
        return replace(self, frame=CellFrame(edge, origin))

    def check(self) -> None:
        """Names that differ; maps that need none that come later."""
        for number, law in enumerate(self.laws):
            before = self.names[:number]
            if law.name in before:
                raise ValueError(f"there are two maps {law.name!r}")
            for name in law.needs:
                if name not in before:
                    raise ValueError(f"the map {law.name!r} needs {name!r}, which does not come before it")

    def summary(self) -> dict[str, Any]:
        """Names, units and kinds of the maps."""
        kinds = {law.name: type(law).__name__.removesuffix("Law").lower() for law in self.laws}
        return {"maps": {law.name: kinds[law.name] + (f", {law.unit}" if law.unit else "") for law in self.laws}}
