"""Twenty compression samples on one plate, five porosities by four cell sizes, each with its number engraved.

Usage: ``python plate_of_variants.py [FOLDER]``. It prints what stands behind each number, and what the plate takes.
"""

import itertools
import sys

import sppm_pipeline as sppm

POROSITIES, CELLS_MM = (0.5, 0.6, 0.7, 0.75, 0.8), (2.0, 2.5, 3.0, 4.0)
WIDTH, HEIGHT, PRINTER = 12.0, 12.0, "prusa_sl1s"

step = sppm.step


def plate(
    porosities: tuple[float, ...] = POROSITIES, cells_mm: tuple[float, ...] = CELLS_MM, layer: str = "0.05 mm"
) -> sppm.Pipeline:
    """The stages: four for each sample, then one plate of all."""
    stages = [step.read.primitive(id="body", shape="box", size=[f"{v} mm" for v in (WIDTH, WIDTH, HEIGHT)])]
    names = []
    for number, (porosity, cell) in enumerate(itertools.product(porosities, cells_mm), 1):
        name = f"n{number:02d}"
        names.append(name)
        stages += [
            step.tile.scattered(id=f"{name}_cells", recipe="cell", cell=f"{cell} mm", porosity=porosity),
            # plates above and below, between which a sample is crushed; the upper one carries the number
            step.fill.implicit(
                id=f"{name}_part", sources={"field": f"{name}_cells", "domain": "body"}, skin="0.8 mm",
                skin_toward=[[0, 0, 1], [0, 0, -1]],
            ),
            step.fill.engrave(
                id=f"{name}_engraved", text=name[1:], middle=["0 mm", "0 mm", f"{HEIGHT} mm"], letter_height="6 mm",
                stroke="0.8 mm", groove_depth="0.4 mm",
            ),
            step.slice.field(id=name, printer=PRINTER, layer=layer),
        ]  # fmt: skip
    stages += [
        step.slice.plate(sources={"parts": names}, separation="2.5 mm"),
        step.check.print(resin="generic_gray"),
        step.write.sl1(path="plate.sl1"),
    ]
    cell_recipe = [
        step.sample.dart_throwing(total=68, share=0.6),
        step.connect.mbdst(degree=[3, 5], mode="greedy"),
        step.field.gaussian(pore_radius=0.11, tunnel_radius=0.03),
    ]
    return sppm.Pipeline(stages, recipes={"cell": cell_recipe}, name="plate_of_variants", seed=7)


if __name__ == "__main__":
    run = plate().run(sys.argv[1] if len(sys.argv) > 1 else "runs/plate_of_variants")
    for number, (porosity, cell) in enumerate(itertools.product(POROSITIES, CELLS_MM), 1):
        print(f"{number:02d}: porosity {porosity}, cells of {cell} mm")
    for name in ("resin_g", "resin_ml", "print_time_s", "price"):
        print(name, run.numbers[f"check.print.{name}"])
