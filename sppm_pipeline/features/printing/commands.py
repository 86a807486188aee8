"""``sppm printers``: the printers and resins that slicers and writers of printer files know."""

from __future__ import annotations

import dataclasses
import json
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sppm_pipeline.method.nouns.printer import Cards, Printer


def configure(parser: ArgumentParser) -> None:
    """Arguments of the verb."""
    from sppm_pipeline.method.nouns.printer import cards

    name = parser.add_argument("name", nargs="?", metavar="NAME", help="a printer or resin, or part of its name")
    vars(name)["completions"] = sorted(cards().printers)  # for `sppm completion`
    parser.add_argument("--format", metavar="FORMAT", help="only printers whose file is sl1, goo or nanodlp")
    parser.add_argument(
        "--fits", type=_size, metavar="X,Y,Z", help="only printers that hold a part of this size, mm, as it lies"
    )
    parser.add_argument("--cards", type=Path, metavar="FILE", help="YAML file with printers and resins of your own")
    parser.add_argument("--resins", action="store_true", help="list resins instead")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def execute(args: Namespace) -> int:
    """List the cards that are asked for, or show one."""
    from sppm_pipeline.method.nouns.printer import cards

    known = cards(args.cards)
    found: list[Any] = _resins(args, known) if args.resins else _printers(args, known)
    exact = [card for card in found if card.name == args.name] or (found if len(found) == 1 and args.name else [])
    if args.json:
        print(json.dumps([_described(card) for card in exact or found], indent=1))
    elif exact:
        for key, value in _described(exact[0]).items():
            print(f"{key:22}{_words(value)}")
    elif args.resins:
        for resin in found:
            print(f"{resin.name:30}{'' if resin.measured else 'model, not measured'}")
    else:
        _print_table(found)
    return 0


def _printers(args: Namespace, known: Cards) -> list[Printer]:
    from sppm_pipeline.errors import ConfigError
    from sppm_pipeline.method.nouns.printer import FORMATS

    if args.format not in (None, *FORMATS):
        raise ConfigError(f"--format is {args.format!r}", hint=f"known: {', '.join(FORMATS)}")
    found = [
        printer
        for name, printer in sorted(known.printers.items())
        if (args.name is None or args.name in name)
        and args.format in (None, printer.format)
        and (args.fits is None or printer.holds(args.fits))
    ]
    if args.name is not None and not any(args.name in name for name in known.printers):
        known.printer(args.name)  # raises, with the names that are near
    return found


def _resins(args: Namespace, known: Cards) -> list[Any]:
    found = [resin for name, resin in sorted(known.resins.items()) if args.name is None or args.name in name]
    if not found and args.name is not None:
        known.resin(args.name)
    return found


def _size(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.replace("x", ",").split(","))
    except ValueError as error:
        raise ArgumentTypeError(f"{text!r} is no size such as 60,40,80") from error
    return x, y, z


def _print_table(printers: list[Printer]) -> None:
    if not printers:
        print("no printer of the list")
        return
    print(f"{'printer':30}{'plate and height, mm':24}{'pixel, um':14}{'writer':16}then")
    for printer in printers:
        x, y, z = printer.volume_mm
        px, py = (1000 * length for length in printer.pixel_mm)
        pixel = f"{px:.4g}" if abs(px - py) < 0.005 else f"{px:.4g} x {py:.4g}"
        then = f"UVtools to {printer.convert_to}" if printer.convert_to else ""
        print(f"{printer.name:30}{f'{x:g} x {y:g} x {z:g}':24}{pixel:14}{f'write.{printer.format}':16}{then}".rstrip())
    if not any(printer.verified_on_hardware for printer in printers):
        print("none of these cards was verified on hardware")


def _described(card: Any) -> dict[str, Any]:
    entries = dataclasses.asdict(card)
    return {**entries, "pixel_mm": list(card.pixel_mm)} if hasattr(card, "pixel_mm") else entries


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_words(item)}" for key, item in value.items())
    if isinstance(value, (tuple, list)):
        return ", ".join(f"{item:g}" for item in value)
    return "-" if value in ("", None) else str(value)
