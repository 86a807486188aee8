"""``read.compression``: the readings of a compression test."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_crushing.compression import CompressionCurve
from sppm_crushing.machine_csv import MAX_BYTES, UNITS, Readings, read_readings
from sppm_crushing.numerics.compression import Steepest, first_maximum, loading, steepest_window
from sppm_pipeline import ConfigError, Context, Headline, InputError, Length, Palette, Size, Stage, option, options


class Blank(NamedTuple):
    """Deflection (n,) of a machine without a specimen over force (n,); neither ever falls, 0 at the smallest force."""

    force: Array
    displacement: Array


def blank_run(force: ArrayLike, displacement: ArrayLike) -> Blank:
    """Monotone curve of least squares through a run without a specimen, loading and unloading taken together."""
    from scipy.optimize import isotonic_regression

    f, d = np.asarray(force, np.float64), np.asarray(displacement, np.float64)
    known, of = np.unique(f, return_inverse=True)
    if len(known) < 2:
        raise ValueError("a run without a specimen needs two or more different forces")
    count = np.bincount(of)
    # isotonic: loading and unloading differ, and readings scatter, but no larger force deflects the machine less
    fitted: Array = isotonic_regression(np.bincount(of, d) / count, weights=count).x
    return Blank(known, fitted - fitted[0])


def without_blank(force: ArrayLike, displacement: ArrayLike, blank: Blank) -> Array:
    """Displacement of the specimen alone; `ValueError` if its forces exceed those of the run without a specimen."""
    f = np.asarray(force, np.float64)
    if f.max() > blank.force[-1]:
        raise ValueError(
            f"the run without a specimen ends at {blank.force[-1]:.4g} N, and the test goes to {f.max():.4g} N"
        )
    return np.asarray(displacement, np.float64) - np.interp(f, blank.force, blank.displacement)


def after_preload(force: ArrayLike, displacement: ArrayLike, preload: float) -> tuple[Array, Array]:
    """Readings from the first force of `preload` on, where displacement becomes zero; `ValueError` without any."""
    f, d = np.asarray(force, np.float64), np.asarray(displacement, np.float64)
    reached = np.flatnonzero(f >= preload)
    if not len(reached):
        raise ValueError(f"the force of the test ends at {f.max():.4g} N, before the preload of {preload:g} N")
    start = int(reached[0])
    return f[start:], d[start:] - d[start]


def without_toe(strain: ArrayLike, stress: ArrayLike, within: float = 0.2) -> tuple[Array, Array, Steepest]:
    """A curve whose strain is zero where the line through its steepest window has no stress, from there on, and that
    line before the shift; `ValueError` if the stress does not rise up to the strain `within`.

    The readings before the window, where specimen and plates settle, are replaced by that line (annex of ASTM D695,
    ASTM D1621, ISO 844). The window is looked for before the first maximum, or up to the strain `within`.
    """
    e, s = np.asarray(strain, np.float64), np.asarray(stress, np.float64)
    curve = loading(e, s)
    peak = first_maximum(curve, within)
    line = steepest_window(curve, within if peak is None else min(peak, within))
    if line is None:
        raise ValueError(f"the stress does not rise up to a strain of {within:g}")
    kept = int(np.argmax(e >= max(line.first, line.root)))
    return np.concatenate([[0.0], e[kept:] - line.root]), np.concatenate([[0.0], s[kept:]]), line


def turned(load: ArrayLike, way: ArrayLike) -> tuple[Array, Array, tuple[bool, bool]]:
    """Load and way with signs such that compression is positive, and which of them were negative."""
    f, d = np.asarray(load, np.float64), np.asarray(way, np.float64)
    # the load is positive where it is largest, and the way has grown by then
    peak = int(np.argmax(np.abs(f)))
    negative = bool(f[peak] < 0), bool(d[peak] < d[0])
    return -f if negative[0] else f, -d if negative[1] else d, negative


def goes_back(way: ArrayLike, by: float, until: float = np.inf) -> float | None:
    """Way from which a test goes back by more than `by` before it goes on, up to `until`; None if it does not."""
    d = np.asarray(way, np.float64)
    farthest = np.maximum.accumulate(d)
    last = int(np.argmax(farthest >= min(until, farthest[-1])))
    back = farthest[: last + 1] - d[: last + 1] > by
    return float(farthest[int(np.argmax(back))]) if back.any() else None


def count_up_to(strain: ArrayLike, limit: float) -> int:
    """Readings up to the largest strain, or to the first beyond a limit."""
    e = np.asarray(strain, np.float64)
    return int(np.argmax(e > limit)) if e.max() > limit else int(np.argmax(e)) + 1


BACK = 0.01
"""Share of the height by which the displacement may go back before it counts as unloading."""

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ReadCompression(Stage):
    """Read force and displacement of a compression test from a text file, as test machines write them.

    Delimiter, decimal comma, encoding, the block of text in front, headings in English, German and Chinese, and units
    in headings or below them are detected and reported. Files of stress and strain are read, too. Where something is
    ambiguous, the stage asks for the option that decides it. Compression becomes positive.
    Corrections are made only if asked for: first `compliance`, then `preload`, then `toe`.
    """

    name: ClassVar[str] = "read.compression"
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("points"), Headline("strain_max", "strain up to"), Headline("stress_max", "stress up to", "MPa"),
        *(Headline(f"notes.{number}", "taken:") for number in range(1, 8)),
    )  # fmt: skip

    path: Path = options.read_path(note=".csv, .txt, .tsv or any other text")
    specimen: str = option(
        "", help="name in charts, where specimens of one name are drawn as their mean and a band; that of the file if "
        "empty"
    )  # fmt: skip
    size: tuple[Length, Length, Length] | None = options.size(
        None, note="the undeformed specimen, compressed along z; not needed for stress and strain"
    )
    area: float | None = option(
        None, help="area of the section, if it is not that of the box", unit="mm2", above=0, maximum=1e9
    )
    mass: float | None = option(None, help="mass of the specimen", unit="g", above=0, maximum=1e9)
    columns: tuple[str, ...] = options.columns(
        (), note="force and displacement, by heading or number from 1 on; found by their headings if empty",
        column=False,
    )  # fmt: skip
    units: tuple[str, ...] = option((), help="units of force and displacement; those of the file if empty")
    decimal: str = option("auto", help="decimal mark", choices=("auto", "point", "comma"))
    compliance: float | Path | None = option(
        None, help="deflection of the machine: mm/kN, or a file of a run without a specimen", minimum=0, maximum=1e3
    )
    preload: float | None = option(
        None, help="force at which displacement is zero; as the file has it if omitted", unit="N", minimum=0,
        maximum=1e9,
    )  # fmt: skip
    toe: bool = option(
        False, help="strain is zero where the line through the steepest 1 % of the first rise has no stress, and what "
        "lies before it becomes that line"
    )  # fmt: skip
    strain: float | None = option(
        None, help="strain at the end; what lies beyond is left out, and nothing if omitted", above=0, maximum=1
    )
    unload: str = option(
        "refuse", help="what becomes of a test that goes back by more than 1 % of the height and on again",
        choices=("refuse", "keep"),
    )  # fmt: skip

    def check_options(self) -> None:
        """Two columns and two units, or none."""
        for name, pair in (("columns", self.columns), ("units", self.units)):
            if len(pair) not in (0, 2):
                raise ConfigError(f"`{name}` names {len(pair)}; it takes two, those of force and of displacement")
        for unit, kinds in zip(self.units, (("force", "stress"), ("displacement", "strain")), strict=False):
            known = [unit for kind in kinds for unit in UNITS[kind]]
            if unit not in known:
                raise ConfigError(f"`units`: {unit!r} is no unit of {kinds[0]}", hint=f"known are {', '.join(known)}")
        if self.size is not None and not min(length.mm() for length in self.size) > 0:
            raise ConfigError(
                "a specimen without a size can't be compressed", hint="give `size` three positive lengths"
            )

    def estimate(self, palette: Palette) -> Size:
        return Size(samples=self.path.stat().st_size / 16)  # two numbers of seven digits, and what is between them

    def run(self, context: Context) -> CompressionCurve:
        """Read, correct, divide by area and height."""
        read = self._readings(self.path)
        area, height = self._section(read)
        try:
            strain, stress, notes = self._corrected(read, area or 1.0, height or 1.0)
        except ValueError as error:
            raise InputError(f"{self.path.name}: {error}") from error
        if abs(strain[0]) > BACK:
            context.warn(
                f"{self.path.name} begins at a strain of {strain[0]:.3g}; strain is counted from zero, so say "
                "`preload: 0` if its first reading is zero, or a force"
            )
        volume = None if self.size is None or area is None else area * self.size[2].mm()
        density = None if self.mass is None or volume is None else 1e3 * self.mass / volume
        name = self.specimen or self.path.stem
        return CompressionCurve(
            strain, stress, "MPa", "measured", name, area, height, density, notes=(*read.notes, *notes)
        )

    def _readings(self, path: Path) -> Readings:
        """Readings of a file, compression positive."""
        from sppm_pipeline.formats import content_of

        data = content_of(path, MAX_BYTES)
        read = read_readings(data, path.name, columns=self.columns, units=self.units, decimal=self.decimal)
        for values, what in ((read.load, read.load_kind), (read.way, read.way_kind)):
            if np.ptp(values) == 0:
                raise InputError(
                    f"{path.name}: the {what} is {values[0]:g} in all {len(values)} readings",
                    hint="name other columns: `columns: [force, displacement]`",
                )
        load, way, negative = turned(read.load, read.way)
        words = [
            f"the {what} was negative in compression, and was turned"
            for what, was in zip((read.load_kind, read.way_kind), negative, strict=True)
            if was
        ]
        return read._replace(load=load, way=way, notes=(*read.notes, *words))

    def _section(self, read: Readings) -> tuple[float | None, float | None]:
        """Area and height, if they are known; they must be where they are needed."""
        width, depth, height = (None,) * 3 if self.size is None else (length.mm() for length in self.size)
        area = self.area if self.area is not None or width is None or depth is None else width * depth
        corrected = self.compliance is not None
        if area is None and (corrected or self.preload is not None or read.load_kind == "force"):
            raise ConfigError(f"the area of the specimen of {self.path.name} is not known", hint="give `size`")
        if height is None and (corrected or read.way_kind == "displacement"):
            raise ConfigError(f"the height of the specimen of {self.path.name} is not known", hint="give `size`")
        return area, height

    def _corrected(self, read: Readings, area: float, height: float) -> tuple[Array, Array, list[str]]:
        """Strain and stress as they are wanted, and what was done."""
        force = read.load * (area if read.load_kind == "stress" else 1.0)
        way = read.way * (height if read.way_kind == "strain" else 1.0)
        limit = np.inf if self.strain is None else self.strain
        back = goes_back(way, BACK * height, limit * height) if self.unload == "refuse" else None
        if back is not None:
            raise InputError(
                f"{self.path.name}: the test goes back at a strain of {back / height:.3g}, and on again",
                hint="`unload: keep` keeps the loop, from which the elastic gradient is measured; or give a `strain` "
                "up to which readings are taken",
            )
        notes = []
        if isinstance(self.compliance, Path):
            blank = self._readings(self.compliance)
            if (blank.load_kind, blank.way_kind) != ("force", "displacement"):
                raise InputError(f"{self.compliance.name}: a run without a specimen has force and displacement")
            way = without_blank(force, way, blank_run(blank.load, blank.way))
            notes.append(f"compliance: that of {self.compliance.name} taken off")
        elif self.compliance is not None:
            way = way - self.compliance * force / 1e3
            notes.append(f"compliance: {self.compliance:g} mm/kN taken off")
        if self.preload is not None:
            before = len(force)
            force, way = after_preload(force, way, self.preload)
            notes.append(f"preload: {before - len(force)} readings below {self.preload:g} N left out")
        strain, stress = way / height, force / area
        if self.toe:
            strain, stress, line = without_toe(strain, stress)
            notes.append(
                f"toe: strain less {line.root:.4g}, the root of the line through {line.first:.4g} to {line.last:.4g}"
            )
        notes = notes or ["no correction"]
        count = count_up_to(strain, limit)
        if count < 3:
            raise ValueError(f"{count} readings are left up to a strain of {limit:.3g}")
        if count < len(strain):
            notes.append(f"{len(strain) - count} readings behind a strain of {strain[count - 1]:.4g} left out")
        return strain[:count], stress[:count], notes
