"""Printers and resins as cards: what a slicer must know of a machine, and what a writer of printer files must know.

Cards stand in YAML files, those of the program in ``formats/printers``; users give files of their own in the same form.
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from sppm_pipeline.errors import ConfigError, DesignError, InputError, did_you_mean, meant, near_names
from sppm_pipeline.nouns.length import Length, Pixel, voxel_mm

FORMATS = ("sl1", "goo", "nanodlp")
"""Printer files that this program writes: ``write.sl1`` and so on."""

LARGEST_FILE = 2**20
"""Bytes of a file of cards."""

CLOSE = 1e-4
"""Relative difference at which two pitches or layer heights are the same; profiles round to five digits."""

Pair = tuple[float, float]


def _within(low: float, high: float, default: Any = dataclasses.MISSING) -> Any:
    return dataclasses.field(default=default, metadata={"bounds": (low, high)})


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Motion of the plate between two exposures; of each pair, the first is for bottom layers.

    Attributes
    ----------
    lift_mm : pair of floats
        Distance that the plate is lifted and lowered again.
    lift_mm_min, retract_mm_min : pair of floats
        Speeds, mm a minute.
    wait_before_cure_s, wait_after_cure_s, wait_after_lift_s : pair of floats
        Rests; for a vat that tilts, the last one is the time of the tilt.
    """

    lift_mm: Pair = _within(0, 100, (0.0, 0.0))
    lift_mm_min: Pair = _within(0.01, 10000, (60.0, 60.0))
    retract_mm_min: Pair = _within(0.01, 10000, (60.0, 60.0))
    wait_before_cure_s: Pair = _within(0, 600, (0.0, 0.0))
    wait_after_cure_s: Pair = _within(0, 600, (0.0, 0.0))
    wait_after_lift_s: Pair = _within(0, 600, (0.0, 0.0))

    def seconds(self, bottom: bool) -> float:
        """Time between two exposures, without acceleration."""
        k = 0 if bottom else 1
        moving = 60 * self.lift_mm[k] * (1 / self.lift_mm_min[k] + 1 / self.retract_mm_min[k])
        return moving + self.wait_before_cure_s[k] + self.wait_after_cure_s[k] + self.wait_after_lift_s[k]


@dataclass(frozen=True, kw_only=True)
class Printer:
    """A resin printer. x and y are those of the build plate, as one faces the machine.

    Attributes
    ----------
    name : str
        By which configurations call it.
    model : str
        How the maker and the printer's files call it.
    format : {"sl1", "goo", "nanodlp"}
        The file that is written for it.
    convert_to : str
        The file type that it reads, if another program has to make it from the written one; else empty.
    pixels : pair of ints
        Of the display, along x and y of the plate.
    display_mm : pair of floats
        Size of the display.
    height_mm : float
        Largest height of a part.
    layer_mm : pair of floats
        Smallest and largest layer height; where the source names none, the usual range of such printers.
    mirror_x, mirror_y : bool
        Whether the order of the columns or rows of its pictures is reversed.
    portrait : bool
        Whether its pictures are turned by 90 degrees before they are mirrored: rows run along x of the plate and
        columns along y, the largest first.
    subpixels : bool
        Whether its pictures hold three neighboring pixels as the red, green and blue of one.
    little_endian : bool
        Whether numbers in its files have the lowest byte first, where the format has the highest first.
    motion : Motion
    source : str
        Where these numbers were read.
    verified_on_hardware : bool
        Whether a file of this program has been printed with this card.
    """

    name: str
    model: str
    format: str
    convert_to: str = ""
    pixels: tuple[int, int] = _within(16, 65535)
    display_mm: Pair = _within(1, 2000)
    height_mm: float = _within(1, 2000)
    layer_mm: Pair = _within(0.001, 1, (0.01, 0.2))
    mirror_x: bool = False
    mirror_y: bool = False
    portrait: bool = False
    subpixels: bool = False
    little_endian: bool = False
    motion: Motion = Motion()
    source: str
    verified_on_hardware: bool

    @property
    def pixel_mm(self) -> Pair:
        """Pixel pitch along x and y."""
        # to a picometer, so that 153.36 mm / 8520 is the 0.018 mm that a user writes
        x, y = (round(length / count, 9) for length, count in zip(self.display_mm, self.pixels, strict=True))
        return x, y

    @property
    def picture(self) -> tuple[tuple[int, int], Pair]:
        """Width and height of its pictures, in pixels and in mm."""
        (nx, ny), (x, y) = self.pixels, self.display_mm
        return ((ny, nx), (y, x)) if self.portrait else ((nx, ny), (x, y))

    @property
    def volume_mm(self) -> tuple[float, float, float]:
        """Size of the largest part."""
        return *self.display_mm, self.height_mm

    def contradiction(self) -> str | None:
        """Description of an impossible property of the printer; None if all are possible."""
        if self.format not in FORMATS:
            return f"`format` is {self.format!r}; it is one of {', '.join(FORMATS)}"
        x, y = self.pixel_mm
        if not (min(x, y) >= 0.005 and max(x, y) <= 0.25 and max(x, y) <= 1.6 * min(x, y)):
            return (
                f"pixels of {1000 * x:.4g} x {1000 * y:.4g} um are no display's: {self.pixels[0]} x {self.pixels[1]} "
                f"pixels on {self.display_mm[0]:g} x {self.display_mm[1]:g} mm"
            )
        if self.layer_mm[0] > self.layer_mm[1]:
            return f"`layer_mm` runs from {self.layer_mm[0]:g} down to {self.layer_mm[1]:g}"
        if self.subpixels and self.pixels[0] % 3:
            return f"`subpixels` come in threes, and {self.pixels[0]} pixels along x do not"
        return None

    def holds(self, size_mm: Iterable[float]) -> bool:
        """Test whether a part of a size along x, y, z fits in as it lies."""
        return all(side <= room * (1 + 1e-9) for side, room in zip(size_mm, self.volume_mm, strict=True))

    def require_layer(self, height: float) -> None:
        """Refuse a layer height out of the printer's range.

        Raises
        ------
        ConfigError
        """
        low, high = self.layer_mm
        # heights given as text may be rounded
        if not low * (1 - CLOSE) <= height <= high * (1 + CLOSE):
            raise ConfigError(
                f"`layer` is {height:g} mm; {self.name} prints layers of {low:g} to {high:g} mm",
                hint="choose a height within, for example `layer: 0.05 mm`",
            )

    def require_pixel(self, pitch: Pair) -> None:
        """Refuse a pixel pitch that is not the printer's.

        Raises
        ------
        ConfigError
        """
        if not all(math.isclose(a, b, rel_tol=CLOSE) for a, b in zip(pitch, self.pixel_mm, strict=True)):
            own = " x ".join(f"{1000 * length:.5g}" for length in self.pixel_mm)
            raise ConfigError(
                f"`pixel` is {1000 * pitch[0]:.5g} x {1000 * pitch[1]:.5g} um; those of {self.name} are {own} um",
                hint="leave out `pixel`: the printer sets it",
            )

    def require_room(self, size_mm: Iterable[float], others: Iterable[Printer]) -> None:
        """Refuse a part that is larger than the printer, and name the smallest of `others` that holds it.

        Raises
        ------
        DesignError
        """
        part = x, y, z = tuple(size_mm)
        if self.holds(part):
            return
        # the smallest by volume; the name decides between equals, so that the message is always the same
        larger = sorted((o for o in others if o.holds(part)), key=lambda o: (math.prod(o.volume_mm), o.name))
        hints = ["turned by 90 degrees about z it fits"] if self.holds((y, x, z)) else ["scale the part"]
        if larger:
            hints.append(f"the smallest printer that holds it is {larger[0].name} ({_size(larger[0].volume_mm)})")
        else:
            hints.append("no printer of the list holds it")
        raise DesignError(
            f"the part is {_size(part)}; {self.name} prints {_size(self.volume_mm)}", hint=", or ".join(hints)
        )


@dataclass(frozen=True, kw_only=True)
class Resin:
    """A resin, at the layer height and on the printer it was measured with."""

    name: str
    density_g_ml: float = _within(0.5, 3)
    exposure_s: Pair = _within(0.01, 600)  # of bottom layers and of the others
    bottom_layers: int = _within(0, 1000)
    penetration_mm: float | None = _within(0.001, 5, None)  # depth D_p at which light has fallen to 1/e
    # C_d, to which one exposure cures: D_p ln(E / E_c) (Jacobs 1992, working curve)
    cure_depth_mm: float | None = _within(0.001, 5, None)
    price_per_liter: float | None = _within(0, 1e6, None)
    source: str  # where these numbers were read
    measured: bool  # False for a model, whose numbers are of a usual size only


@dataclass(frozen=True)
class Job:
    """All that a printer's file says beside its layers, and what follows from it."""

    name: str  # of the job: the name of the file without its extension
    printer: Printer
    resin: Resin
    layers: int
    layer_mm: float
    gray: bool  # whether pixels have values between black and white
    volume_mm3: float  # solid volume

    def exposure_s(self, layer: int) -> float:
        """Exposure of a layer, counted from 0."""
        return self.resin.exposure_s[layer >= self.resin.bottom_layers]

    @property
    def seconds(self) -> float:
        """Time of the print: exposures, ways and rests, without acceleration."""
        bottom = min(self.resin.bottom_layers, self.layers)
        first, other = (
            e + self.printer.motion.seconds(b) for e, b in zip(self.resin.exposure_s, (True, False), strict=True)
        )
        return bottom * first + (self.layers - bottom) * other

    @property
    def milliliters(self) -> float:
        """Resin that becomes solid; what is washed away comes on top."""
        return self.volume_mm3 / 1000

    @property
    def grams(self) -> float:
        return self.milliliters * self.resin.density_g_ml

    @property
    def price(self) -> float | None:
        """Price of the resin that becomes solid; None if its card names none."""
        return None if self.resin.price_per_liter is None else self.milliliters / 1000 * self.resin.price_per_liter


def _size(lengths: tuple[float, ...]) -> str:
    return f"{' x '.join(f'{length:.5g}' for length in lengths)} mm"


@dataclass(frozen=True)
class Cards:
    """Printers and resins by name."""

    printers: Mapping[str, Printer]
    resins: Mapping[str, Resin]

    def printer(self, name: str) -> Printer:
        """The printer of a name; an error names those that are near."""
        return _named(name, self.printers, "printer", "`sppm printers` lists them")

    def resin(self, name: str) -> Resin:
        """The resin of a name; an error names those that are near."""
        return _named(name, self.resins, "resin", "`sppm printers --resins` lists them")


Card = TypeVar("Card", Printer, Resin)


def _named(name: str, known: Mapping[str, Card], kind: str, where: str) -> Card:
    if name in known:
        return known[name]
    word = name.lower().replace(" ", "_").replace("-", "_")
    # first names that contain the word or are part of it, then misspelled ones, then those with a similar part
    parts = {part for key in known for part in key.split("_")}
    near = sorted((key for key in known if word in key or key in word), key=len)
    near = near or near_names(word, known)
    near = near or sorted((key for key in known if any(part in key for part in near_names(word, parts))), key=len)
    hint = f"{meant(near[:3])} {where}" if near else where
    raise ConfigError(f"`{kind}`: there is no {kind} called {name!r}", hint=hint)


def cards(own: Path | None = None) -> Cards:
    """The printers and resins of the program, and those of a file of the user's, which win."""
    built_in = _built_in()
    if own is None:
        return built_in
    try:
        found = _read(own.read_bytes(), str(own))
    except OSError as error:
        raise ConfigError(f"`cards` is {own}, which can't be read: {error.strerror}") from error
    # a card of the user replaces the built-in one of the same name
    return Cards({**built_in.printers, **found.printers}, {**built_in.resins, **found.resins})


def cut_for(
    name: str | None, own: Path | None, pixel: Pixel | None, layer: Length | None
) -> tuple[Printer | None, tuple[float, float, float]]:
    """The printer of a slicer's options, and pixel pitch along x and y and layer height (mm).

    A ConfigError says that pixel pitch or layer height are not those of the printer.
    """
    if name is None:
        if own is not None:
            raise ConfigError("`cards` holds printers, and `printer` names none of them")
        if pixel is None:
            raise ConfigError("give `printer` or `pixel`")
        return None, voxel_mm(pixel, layer)
    printer = cards(own).printer(name)
    if layer is None:
        low, high = printer.layer_mm
        raise ConfigError(
            f"`printer: {name}` needs a `layer`", hint=f"give a height of {low:g} to {high:g} mm, as `layer: 0.05 mm`"
        )
    printer.require_layer(layer.mm())
    if pixel is not None:
        printer.require_pixel(voxel_mm(pixel, layer)[:2])
    return printer, (*printer.pixel_mm, layer.mm())


@lru_cache(maxsize=1)
def _built_in() -> Cards:
    folder = files("sppm_pipeline.method.nouns") / "printers"
    found = sorted((f for f in folder.iterdir() if f.name.endswith(".yaml")), key=lambda f: f.name)
    all_cards = [_read(file.read_bytes(), file.name) for file in found]
    printers = {name: card for each in all_cards for name, card in each.printers.items()}
    return Cards(printers, {name: card for each in all_cards for name, card in each.resins.items()})


def _read(data: bytes, file: str) -> Cards:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    if len(data) > LARGEST_FILE:
        raise InputError(f"{file}: {len(data)} bytes are too many for a file of printers; {LARGEST_FILE} are allowed")
    try:
        # the safe loader makes plain data and runs no code
        document = YAML(typ="safe").load(data)
    except (YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"{file}: this is no YAML: {str(error).splitlines()[0]}") from error
    if not isinstance(document, dict) or not document or not set(document) <= {"printers", "resins"}:
        raise InputError(f"{file}: a file of cards holds `printers:`, `resins:`, or both")
    sections: dict[str, dict[str, Any]] = {}
    for section, kind in (("printers", Printer), ("resins", Resin)):
        entries = document.get(section, {})
        if not isinstance(entries, dict):
            raise InputError(f"{file}: `{section}` holds a map of cards by name")
        sections[section] = {str(name): _card(kind, str(name), entry, file) for name, entry in entries.items()}
    return Cards(sections["printers"], sections["resins"])


def _card(kind: type[Any], name: str, entry: Any, file: str) -> Any:
    """A card from its entry; all that is wrong is refused by name of card and key."""
    where = f"{file}: {name}"
    if not isinstance(entry, dict):
        raise InputError(f"{where}: a card is a map of entries, got {entry!r}")
    # annotations are text in this module
    hints = typing.get_type_hints(kind)
    own = {} if kind is Motion else {"name": name}
    fields = {f.name: f for f in dataclasses.fields(kind) if f.name not in own}
    if unknown := [key for key in entry if key not in fields]:
        raise InputError(f"{where}: unknown entry {unknown[0]!r}", hint=did_you_mean(str(unknown[0]), fields))
    if missing := [key for key, f in fields.items() if f.default is dataclasses.MISSING and key not in entry]:
        raise InputError(f"{where}: the entry {missing[0]!r} is missing")
    values = {key: _value(hints[key], fields[key].metadata, value, f"{where}: {key}") for key, value in entry.items()}
    made = kind(**own, **values)
    if kind is Printer and (wrong := made.contradiction()):
        raise InputError(f"{where}: {wrong}")
    return made


def _value(hint: Any, metadata: Mapping[str, Any], value: Any, where: str) -> Any:
    if hint is Motion:
        return _card(Motion, "motion", value, where.removesuffix(": motion"))
    if typing.get_origin(hint) is tuple:
        if not isinstance(value, list) or len(value) != 2:
            raise InputError(f"{where}: two numbers are expected, got {value!r}")
        return tuple(_value(kind, metadata, v, where) for kind, v in zip(typing.get_args(hint), value, strict=True))
    if hint in (str, bool):
        if not isinstance(value, hint):
            raise InputError(f"{where}: {'text' if hint is str else 'true or false'} is expected, got {value!r}")
        return value
    whole = hint is int
    if not whole and value is None:  # an open number of a resin
        return None
    low, high = metadata["bounds"]
    # in Python a bool is an int
    if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)) or not low <= value <= high:
        wanted = f"{'an integer' if whole else 'a number'} of {low:g} to {high:g}"
        raise InputError(f"{where}: {wanted} is expected, got {value!r}")
    return value if whole else float(value)
