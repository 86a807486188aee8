"""A part of the reader's own, straight to layers: time and memory of the whole process.

Usage: python -m benchmarks.bunny MESH
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

from benchmarks.measure import median, pipeline_command, table

CONFIG = Path(__file__).parent.parent / "configs" / "bunny.yaml"


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        command = pipeline_command(CONFIG, scratch + "/run")
        result = median([*command, "-p", f"mesh={sys.argv[1]}"], runs=3)
        manifest = json.loads((Path(scratch) / "run" / "slices" / "manifest.json").read_text())
        voxels = manifest["layers"] * manifest["width_px"] * manifest["height_px"]
    table(
        f"{Path(sys.argv[1]).name}: {voxels / 1e6:.0f} Mvoxel, {manifest['layers']} layers",
        ["wall s", "CPU s", "peak MB", "CPU ns/voxel"],
        [[*result, result.cpu / voxels * 1e9]],
    )


if __name__ == "__main__":
    main()
