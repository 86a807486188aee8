"""Cards of printers and resins: plausible, complete, and refused by name of card and entry."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.errors import ConfigError, DesignError, InputError
from sppm_pipeline.method.nouns.printer import FORMATS, Motion, cards

CARD = """
printers:
  mine: {model: Mine, format: goo, pixels: [1000, 500], display_mm: [50, 25], height_mm: 100,
    source: measured, verified_on_hardware: true, layer_mm: [0.02, 0.1],
    motion: {lift_mm: [6, 3], lift_mm_min: [60, 90], retract_mm_min: [120, 180], wait_before_cure_s: [1, 0.5]}}
resins:
  slow: {density_g_ml: 1.2, exposure_s: [40, 8], bottom_layers: 3, source: the label, measured: false}
"""


def own(tmp_path, text=CARD):
    file = tmp_path / "cards.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_the_printers_of_the_program():
    known = cards().printers
    assert len(known) >= 30
    for name, printer in known.items():
        assert printer.name == name
        assert printer.contradiction() is None
        assert printer.source
        assert not printer.verified_on_hardware  # nobody has printed yet
        # the pitch of a display is a whole number of half micrometers, to the digits of the source
        for pitch, length, count in zip(printer.pixel_mm, printer.display_mm, printer.pixels, strict=True):
            assert pitch * count == pytest.approx(length, rel=1e-6)
            assert 0.01 < pitch < 0.06
    assert {printer.format for printer in known.values()} == set(FORMATS)
    assert known["elegoo_saturn_4"].pixel_mm == (0.019, 0.024)
    assert known["elegoo_mars_4"].pixel_mm == (0.018, 0.018)
    assert known["prusa_sl1s"].picture == ((1620, 2560), (81, 128))
    assert known["elegoo_jupiter_2"].little_endian


def test_cards_of_a_user(tmp_path):
    found = cards(own(tmp_path))
    mine = found.printer("mine")
    assert (mine.pixel_mm, mine.volume_mm, mine.verified_on_hardware) == ((0.05, 0.05), (50, 25, 100), True)
    assert mine.motion.seconds(True) == pytest.approx(6 + 3 + 1)
    assert mine.motion.seconds(False) == pytest.approx(2 + 1 + 0.5)
    assert Motion().seconds(False) == 0
    assert found.resin("slow").penetration_mm is None
    assert found.printer("prusa_sl1").model == "SL1"
    replaced = cards(own(tmp_path, CARD.replace("mine:", "prusa_sl1:")))
    assert replaced.printer("prusa_sl1").model == "Mine"  # one's own card wins


def test_the_cards_of_the_manual(tmp_path):
    page = (Path(__file__).parents[3] / "docs/howto/printer-files.md").read_text(encoding="utf-8")
    found = cards(own(tmp_path, page.split("```text\n")[1].split("```")[0]))
    assert found.printer("mine").pixel_mm == (0.019, 0.024)
    assert found.resin("tough").penetration_mm == 0.12


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("display_mm: [50, 25]", "display_mm: [50, 60]", "mine: pixels of 50 x 120 um are no display's"),
        ("display_mm: [50, 25]", "display_mm: [50]", "mine: display_mm: two numbers are expected"),
        ("display_mm: [50, 25]", "display_mm: [.nan, 25]", "mine: display_mm: a number of 1 to 2000 is expected"),
        ("pixels: [1000, 500]", "pixels: [1000.5, 500]", "mine: pixels: an integer of 16 to 65535 is expected"),
        ("pixels: [1000, 500], ", "", "mine: the entry 'pixels' is missing"),
        ("format: goo", "format: ctb", "`format` is 'ctb'; it is one of sl1, goo, nanodlp"),
        ("height_mm: 100", "hieght_mm: 100", "mine: unknown entry 'hieght_mm'"),
        ("height_mm: 100", "height_mm: true", "height_mm: a number of 1 to 2000 is expected, got True"),
        ("verified_on_hardware: true", "verified_on_hardware: 1", "true or false is expected, got 1"),
        ("layer_mm: [0.02, 0.1]", "layer_mm: [0.1, 0.02]", "`layer_mm` runs from 0.1 down to 0.02"),
        ("source: measured,", "source: measured, subpixels: true,", "come in threes, and 1000"),
        ("lift_mm: [6, 3]", "lift_mm: 6", "mine: motion: lift_mm: two numbers are expected"),
        ("lift_mm: [6, 3]", "lift: [6, 3]", "mine: motion: unknown entry 'lift'"),
        ("density_g_ml: 1.2", "density_g_ml: -1", "slow: density_g_ml: a number of 0.5 to 3"),
        ("printers:", "machines:", "holds `printers:`, `resins:`, or both"),
        (CARD, "[1, 2", "this is no YAML"),
        (CARD, "printers: [1]", "`printers` holds a map"),
        (CARD, "printers: {a: 1}", "a: a card is a map of entries, got 1"),
    ],
)
def test_a_wrong_card_is_named(tmp_path, old, new, message):
    assert old in CARD
    with pytest.raises(InputError) as caught:
        cards(own(tmp_path, CARD.replace(old, new)))
    assert message in str(caught.value)
    assert "cards.yaml" in str(caught.value)


def test_names_that_are_near():
    for word, near in (("saturn 4", "elegoo_saturn_4"), ("Prusa-SL2", "prusa_sl1"), ("satrun", "elegoo_saturn")):
        with pytest.raises(ConfigError, match="there is no printer called") as caught:
            cards().printer(word)
        assert repr(near) in caught.value.hint


def test_layers_and_parts_out_of_range(tmp_path):
    mine = cards(own(tmp_path)).printer("mine")
    mine.require_layer(0.02)
    mine.require_layer(0.1)
    for height in (0.0199, 0.101):
        with pytest.raises(ConfigError, match=r"mine prints layers of 0.02 to 0.1 mm"):
            mine.require_layer(height)
    mine.require_pixel((0.05, 0.05))
    with pytest.raises(ConfigError, match="those of mine are 50 x 50 um"):
        mine.require_pixel((0.05, 0.0501))
    known = cards().printers.values()
    mine.require_room((50, 25, 100), known)
    with pytest.raises(DesignError, match=r"the part is 20 x 30 x 100 mm; mine prints 50 x 25 x 100 mm") as caught:
        mine.require_room((20, 30, 100), known)
    assert "turned by 90 degrees about z it fits" in caught.value.hint
    assert "prusa_sl1 " in caught.value.hint  # the smallest of the list by its volume
    with pytest.raises(DesignError) as caught:
        mine.require_room((400, 30, 100), known)
    assert "no printer of the list holds it" in caught.value.hint


def test_the_verb(capsys, tmp_path):
    def said(*words):
        assert main(["printers", *words]) == 0
        return capsys.readouterr().out

    assert "elegoo_saturn_4" in said()
    listed = [entry["name"] for entry in json.loads(said("--fits", "230,130,100", "--json"))]
    assert listed == ["elegoo_jupiter_2", "phrozen_sonic_mega_8k"]
    assert "write.nanodlp" in said("--format", "nanodlp")
    assert "19 x 24" in said("saturn", "--format", "goo")
    (one,) = json.loads(said("prusa_sl1", "--json"))
    assert (one["pixel_mm"], one["portrait"]) == ([0.04725, 0.04725], True)
    assert "0.05, 0.05" in said("mine", "--cards", str(own(tmp_path)))
    assert "model, not measured" in said("--resins")
    assert "placeholders" in said("--resins", "generic_gray")
    for words in (["satrun"], ["--format", "ctb"], ["--resins", "abs"], ["--fits", "1,2"]):
        assert main(["printers", *words]) == 2
    capsys.readouterr()
