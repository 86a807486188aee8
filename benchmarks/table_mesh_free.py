"""The mesh-free column of the paper's efficiency table, against a straightforward script, in one run.

Usage: python -m benchmarks.table_mesh_free
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from benchmarks.measure import median, pipeline_command, table

CONFIG = Path(__file__).parent.parent / "configs" / "table_mesh_free.yaml"
PAPER = {27: (0.811, 1.48), 216: (1.955, 5.49), 512: (3.274, 10.5)}


def stored(folder: Path) -> float:
    return sum(f.stat().st_size for f in folder.rglob("*.png")) / 1e6


def main() -> None:
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        config = Path(scratch) / "table.yaml"
        config.write_text(CONFIG.read_text().split("\nsweep:")[0])
        for cells in (3, 6, 8):
            units = cells**3
            for mode in ("greedy", "exact"):
                out = Path(scratch) / f"{units}-{mode}"
                size = f"cells=[{cells}, {cells}, {cells}]"
                command = pipeline_command(config, out)
                ours = median([*command, "-p", size, "-p", f"mode={mode}"])
                rows.append([units, f"sppm, {mode}", *ours, stored(out)])
            out = Path(scratch) / f"{units}-obvious"
            rival = median([sys.executable, "-m", "benchmarks.rivals.obvious_mesh_free", str(cells), str(out)], runs=3)
            rows.append([units, "numpy, SciPy, Pillow", *rival, stored(out)])
            rows.append([units, "ratio to sppm, greedy", rival.wall / rows[-3][2], rival.cpu / rows[-3][3], "", ""])
            rows.append([units, "paper, its own machine", PAPER[units][0], "", "", PAPER[units][1]])
    table("mesh-free, whole process", ["units", "way", "wall s", "CPU s", "peak MB", "PNG MB"], rows)


if __name__ == "__main__":
    main()
